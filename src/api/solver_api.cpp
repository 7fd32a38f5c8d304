// SPDX-License-Identifier: Apache-2.0
// Solving, results, and evaluation for the caller's own loop.
#include <cmath>
#include <limits>
#include <numeric>

#include "api/handles.hpp"
#include "api/mirror.hpp"
#include "api/report.hpp"
#include "linear/direct_solver.hpp"
#include "linear/normal_equations.hpp"
#include "optimizer/evaluator.hpp"
#include "optimizer/solve.hpp"
#include "problem/subproblem.hpp"

namespace clba {
namespace {

clba_solver_options default_solver_options() {
    const MinimizerOptions defaults;
    clba_solver_options options{};
    options.struct_size = sizeof options;
    options.linear_solver = CLBA_LINEAR_SOLVER_AUTO;
    options.preconditioner = CLBA_PRECONDITIONER_DEFAULT;
    options.damping = CLBA_DAMPING_MARQUARDT;
    options.precision = CLBA_PRECISION_AUTO;
    options.max_num_iterations = defaults.max_iterations;
    options.max_linear_solver_iterations = defaults.linear_solver.max_iterations;
    options.min_linear_solver_iterations = defaults.linear_solver.min_iterations;
    options.max_num_consecutive_invalid_steps = defaults.max_consecutive_invalid_steps;
    options.initial_trust_region_radius = defaults.initial_radius;
    options.max_trust_region_radius = defaults.max_radius;
    options.min_trust_region_radius = defaults.min_radius;
    options.min_relative_decrease = defaults.min_relative_decrease;
    options.min_damping_diagonal = defaults.damping.min_diagonal;
    options.max_damping_diagonal = defaults.damping.max_diagonal;
    options.function_tolerance = defaults.function_tolerance;
    options.gradient_tolerance = defaults.gradient_tolerance;
    options.parameter_tolerance = defaults.parameter_tolerance;
    options.target_cost = defaults.target_cost;
    options.max_seconds = defaults.max_seconds;
    options.checkpoint_every = defaults.checkpoint_every;
    return options;
}

void require_named(const char* name, const char* field, int32_t value) {
    require(name != nullptr, field, " = ", value, ", but clba.h lists no such value");
}

template <class Number>
void require_at_least(const char* field, Number value, Number least) {
    require(value >= least, field, " = ", value, ", but it must be >= ", least);
}

void require_above_zero(const char* field, double value) {
    require(value > 0, field, " = ", value, ", but it must be > 0");
}

Preconditioner used_preconditioner(const clba_solver_options& given) {
    switch (given.linear_solver) {
        case CLBA_LINEAR_SOLVER_DIRECT_SCHUR:
        case CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR:
            require(given.preconditioner == CLBA_PRECONDITIONER_DEFAULT,
                    "preconditioner = ", clba_preconditioner_name(given.preconditioner), ", but ",
                    clba_linear_solver_name(given.linear_solver),
                    " takes none; leave it at its default");
            return Preconditioner::none;
        case CLBA_LINEAR_SOLVER_PCG_HESSIAN:
            require(given.preconditioner != CLBA_PRECONDITIONER_SCHUR_JACOBI,
                    "preconditioner = schur_jacobi, but pcg_hessian works on the full Hessian, "
                    "which has no Schur complement; use block_jacobi or pcg_schur");
            return Preconditioner::block_jacobi;
        default:
            return given.preconditioner == CLBA_PRECONDITIONER_BLOCK_JACOBI
                       ? Preconditioner::block_jacobi
                       : Preconditioner::schur_jacobi;
    }
}

// The forcing term that ended in the right basin, at the least time, on real problems
// (docs/results.md): steps cut short by a weak preconditioner let points run away.
double default_eta(const LinearSolverOptions& options) {
    if (options.kind == LinearSolverKind::pcg_hessian) return 1e-3;
    return options.preconditioner == Preconditioner::block_jacobi ? 1e-2 : 0.1;
}

// Of an evaluation or a product.
Precision checked_precision(int32_t precision) {
    require_named(clba_precision_name(precision), "precision", precision);
    require(precision != CLBA_PRECISION_AUTO, "precision = ", precision,
            ", but auto is for solves alone; name the one that is wanted");
    return static_cast<Precision>(precision);
}

Precision used_precision(int32_t given, const Context& context) {
    require_named(clba_precision_name(given), "precision", given);
    if (given == CLBA_PRECISION_AUTO)
        return context.device().has_double ? Precision::mixed : Precision::single;
    return static_cast<Precision>(given);
}

MinimizerOptions minimizer_options(const clba_solver_options& given) {
    require_named(clba_linear_solver_name(given.linear_solver), "linear_solver",
                  given.linear_solver);
    require_named(clba_preconditioner_name(given.preconditioner), "preconditioner",
                  given.preconditioner);
    require_named(clba_damping_name(given.damping), "damping", given.damping);
    require_named(clba_jacobian_name(given.jacobian), "jacobian", given.jacobian);
    require_at_least("max_num_iterations", given.max_num_iterations, 0);
    require_at_least("max_linear_solver_iterations", given.max_linear_solver_iterations, 1);
    require_at_least("min_linear_solver_iterations", given.min_linear_solver_iterations, 0);
    require_at_least("max_num_consecutive_invalid_steps", given.max_num_consecutive_invalid_steps,
                     0);
    require_above_zero("initial_trust_region_radius", given.initial_trust_region_radius);
    require_above_zero("max_trust_region_radius", given.max_trust_region_radius);
    require_above_zero("min_trust_region_radius", given.min_trust_region_radius);
    require_above_zero("min_damping_diagonal", given.min_damping_diagonal);
    require_above_zero("max_damping_diagonal", given.max_damping_diagonal);
    require_above_zero("max_seconds", given.max_seconds);
    require_at_least("min_relative_decrease", given.min_relative_decrease, 0.0);
    require_at_least("function_tolerance", given.function_tolerance, 0.0);
    require_at_least("gradient_tolerance", given.gradient_tolerance, 0.0);
    require_at_least("parameter_tolerance", given.parameter_tolerance, 0.0);
    require_at_least("target_cost", given.target_cost, 0.0);
    require(given.min_damping_diagonal <= given.max_damping_diagonal,
            "min_damping_diagonal = ", given.min_damping_diagonal,
            ", but it must be <= max_damping_diagonal = ", given.max_damping_diagonal);
    require(given.eta >= 0 && given.eta < 1, "eta = ", given.eta,
            ", but it must be in (0, 1), or 0 for the default");
    require_at_least("checkpoint_every", given.checkpoint_every, 0);
    require(given.reserved == 0, "reserved = ", given.reserved, ", but it must be 0");
    require(!given.checkpoint_path || *given.checkpoint_path,
            "checkpoint_path is empty, but it must name a file, or be NULL");
    require(!given.resume_path || *given.resume_path,
            "resume_path is empty, but it must name a file, or be NULL");

    MinimizerOptions options;
    options.linear_solver.kind = static_cast<LinearSolverKind>(given.linear_solver);
    options.linear_solver.preconditioner = used_preconditioner(given);
    options.linear_solver.min_iterations = given.min_linear_solver_iterations;
    options.linear_solver.max_iterations = given.max_linear_solver_iterations;
    options.linear_solver.eta = given.eta > 0 ? given.eta : default_eta(options.linear_solver);
    options.jacobian =
        given.jacobian == CLBA_JACOBIAN_STORED ? JacobianForm::stored : JacobianForm::recomputed;
    options.damping.policy = static_cast<Damping>(given.damping);
    options.damping.min_diagonal = given.min_damping_diagonal;
    options.damping.max_diagonal = given.max_damping_diagonal;
    options.max_iterations = given.max_num_iterations;
    options.max_consecutive_invalid_steps = given.max_num_consecutive_invalid_steps;
    options.initial_radius = given.initial_trust_region_radius;
    options.max_radius = given.max_trust_region_radius;
    options.min_radius = given.min_trust_region_radius;
    options.min_relative_decrease = given.min_relative_decrease;
    options.function_tolerance = given.function_tolerance;
    options.gradient_tolerance = given.gradient_tolerance;
    options.parameter_tolerance = given.parameter_tolerance;
    options.target_cost = given.target_cost;
    options.max_seconds = given.max_seconds;
    if (given.cancellation) options.cancelled = &given.cancellation->is_requested;
    if (given.checkpoint_path) options.checkpoint_path = given.checkpoint_path;
    if (given.resume_path) options.resume_path = given.resume_path;
    options.checkpoint_every = given.checkpoint_every;
    return options;
}

clba_iteration public_row(const IterationRow& row) {
    clba_iteration out{};
    out.struct_size = sizeof out;
    out.iteration = row.iteration;
    out.step_is_accepted = row.step_is_accepted;
    out.step_is_valid = row.step_is_valid;
    out.linear_solver_iterations = row.linear_solver_iterations;
    out.num_behind = row.num_behind;
    out.cost = row.cost;
    out.cost_change = row.cost_change;
    out.gradient_max_norm = row.gradient_max_norm;
    out.step_norm = row.step_norm;
    out.gain_ratio = row.gain_ratio;
    out.trust_region_radius = row.trust_region_radius;
    out.seconds = row.seconds;
    out.remaining_iterations = row.remaining_iterations;
    out.remaining_seconds = row.remaining_seconds;
    return out;
}

clba_summary public_summary(const Summary& summary, const clba_solver_options& given) {
    clba_summary out{};
    out.struct_size = sizeof out;
    out.termination = static_cast<int32_t>(summary.termination);
    out.reason = static_cast<int32_t>(summary.reason);
    out.linear_solver = static_cast<int32_t>(summary.linear_solver);
    out.preconditioner = static_cast<int32_t>(summary.preconditioner);
    out.damping = static_cast<int32_t>(summary.damping);
    out.precision = static_cast<int32_t>(summary.precision);
    out.num_iterations = static_cast<int32_t>(summary.rows.size()) - 1;
    out.num_accepted_steps = summary.num_accepted_steps;
    out.num_rejected_steps = summary.num_rejected_steps;
    out.num_invalid_steps = summary.num_invalid_steps;
    out.num_linear_solver_iterations = summary.num_linear_solver_iterations;
    out.num_behind_initial = summary.num_behind_initial;
    out.num_behind_final = summary.num_behind_final;
    out.num_singular = summary.num_singular;
    out.num_indefinite_blocks = summary.num_indefinite_blocks;
    out.eta = summary.eta;
    out.initial_cost = summary.initial_cost;
    out.final_cost = summary.final_cost;
    out.reference_final_cost = summary.reference_final_cost;
    out.total_seconds = summary.total_seconds;
    out.build_seconds = summary.build_seconds;
    out.setup_seconds = summary.setup_seconds;
    out.linearize_seconds = summary.linearize_seconds;
    out.linear_solver_seconds = summary.linear_solver_seconds;
    out.evaluate_seconds = summary.evaluate_seconds;
    out.reference_seconds = summary.reference_seconds;
    out.other_seconds = summary.total_seconds - summary.build_seconds - summary.setup_seconds -
                        summary.linearize_seconds - summary.linear_solver_seconds -
                        summary.evaluate_seconds - summary.reference_seconds;
    const auto of = [&](Step step) { return summary.step_seconds[static_cast<size_t>(step)]; };
    out.residual_device_seconds = of(Step::residual);
    out.jacobian_device_seconds = of(Step::jacobian);
    out.preconditioner_device_seconds = of(Step::preconditioner);
    out.jx_device_seconds = of(Step::jx);
    out.jty_device_seconds = of(Step::jty);
    out.schur_device_seconds = of(Step::schur);
    out.vector_device_seconds = of(Step::vector);
    out.peak_device_bytes = summary.peak_device_bytes;
    copy_text(summary.device, out.device);
    copy_text(summary.message, out.message);
    out.given_linear_solver = given.linear_solver;
    out.given_preconditioner = given.preconditioner;
    out.given_precision = given.precision;
    out.jacobian = static_cast<int32_t>(summary.jacobian);
    out.factorization_seconds = summary.factorization_seconds;
    const double device_seconds =
        std::accumulate(summary.step_seconds.begin(), summary.step_seconds.end(), 0.0);
    if (device_seconds > 0)
        out.host_seconds = summary.total_seconds - summary.build_seconds -
                           summary.factorization_seconds - device_seconds;
    copy_text(summary.choice, out.choice);
    out.resumed_iteration = summary.resumed_iteration;
    out.num_checkpoints = summary.num_checkpoints;
    copy_text(summary.checkpoint_error, out.checkpoint_error);
    out.gauge = static_cast<int32_t>(summary.gauge.gauge);
    out.num_gauge_freedoms = summary.gauge.num_freedoms;
    out.initial_prior_cost = summary.initial_prior_cost;
    out.final_prior_cost = summary.final_prior_cost;
    return out;
}

// Keeps a cancellation while a solve looks at it.
class CancellationReference {
public:
    explicit CancellationReference(clba_cancellation* cancellation) : cancellation_(cancellation) {
        if (cancellation_) ++cancellation_->references;
    }
    ~CancellationReference() { clba_cancellation_release(cancellation_); }
    CancellationReference(const CancellationReference&) = delete;
    CancellationReference& operator=(const CancellationReference&) = delete;

private:
    clba_cancellation* cancellation_;
};

std::unique_ptr<clba_result> make_result(const Summary& summary, const clba_solver_options& given) {
    auto result = std::make_unique<clba_result>();
    result->summary = public_summary(summary, given);
    for (const IterationRow& row : summary.rows) result->rows.push_back(public_row(row));
    result->report = report_text(result->summary, result->rows);
    result->json = report_json(result->summary, result->rows);
    return result;
}

// The caller's options of a solve, checked.
struct Request {
    Request(const clba_solver_options* caller, const Context& context)
        : given(copied_in(caller, default_solver_options(), "options")),
          cancellation(given.cancellation),
          options(minimizer_options(given)),
          precision(used_precision(given.precision, context)) {
        if (given.on_iteration)
            options.on_iteration = [this](const IterationRow& row) {
                const clba_iteration out = public_row(row);
                return given.on_iteration(&out, given.user_data) == 0;
            };
    }
    Request(const Request&) = delete;
    Request& operator=(const Request&) = delete;

    const clba_solver_options given;
    const CancellationReference cancellation;
    MinimizerOptions options;
    const Precision precision;
};

clba_window default_window() {
    clba_window window{};
    window.struct_size = sizeof window;
    return window;
}

Window window_of(const clba_window& given) {
    require(given.num_images >= 0, "window.num_images = ", given.num_images,
            ", but it must be >= 0");
    require(given.num_points >= 0, "window.num_points = ", given.num_points,
            ", but it must be >= 0");
    require(given.points || given.num_points == 0,
            "window.points is NULL, but window.num_points = ", given.num_points);
    if (given.num_images > 0) require_pointer(given.images, "window.images");
    Window window;
    window.images.assign(given.images, given.images + given.num_images);
    window.all_points = !given.points;
    if (given.points) window.points.assign(given.points, given.points + given.num_points);
    window.refine_shared_cameras = given.refine_shared_cameras != 0;
    return window;
}

clba_evaluation default_evaluation() {
    clba_evaluation evaluation{};
    evaluation.struct_size = sizeof evaluation;
    evaluation.precision = CLBA_PRECISION_DOUBLE;
    evaluation.apply_loss = 1;
    return evaluation;
}

// One array of 2 rows of REAL in slots, from or to observations x 2 of the caller's.
template <class Real>
void upload_rows(const double* values, DeviceProblem& device, std::vector<Buffer>& slots) {
    device.fill_slots<Real>(slots, Jacobian::num_product_rows,
                            [&](int64_t observation, int, auto&& slot) {
                                slot(0) = static_cast<Real>(values[2 * observation]);
                                slot(1) = static_cast<Real>(values[2 * observation + 1]);
                            });
}

template <class Real>
void download_rows(const DeviceProblem& device, const std::vector<Buffer>& slots, double* values) {
    device.visit_slots<Real>(slots, Jacobian::num_product_rows,
                             [&](int64_t observation, int, auto&& slot) {
                                 values[2 * observation] = slot(0);
                                 values[2 * observation + 1] = slot(1);
                             });
}

// The caller's arrays are written last, when nothing can fail any more.
void evaluate(const Problem& problem, DeviceProblem& device, clba_evaluation& request) {
    const Loss loss = request.apply_loss ? problem.loss : Loss();
    Evaluator evaluator(device, loss);
    std::vector<Buffer> residuals;
    if (request.residuals)
        residuals = device.make_slot_rows(Jacobian::num_product_rows,
                                          wide_bytes(device.precision()), "residuals");
    const CostEvaluation evaluation =
        evaluator.cost(device.state, request.residuals ? &residuals : nullptr);
    request.cost = evaluation.cost;
    request.num_behind = evaluation.num_behind;
    request.num_singular = evaluation.num_singular;
    std::vector<double> host_residuals, gradient;
    if (request.residuals) {
        host_residuals.resize(2 * static_cast<size_t>(problem.num_observations()));
        with_wide(device.precision(), [&](auto wide) {
            download_rows<decltype(wide)>(device, residuals, host_residuals.data());
        });
    }
    const bool wants_jacobian = request.jacobian_images || request.jacobian_points;
    reference::Jacobian jacobian;
    if (request.gradient || wants_jacobian) {
        NormalEquations equations(device, DampingOptions(), JacobianForm::stored, loss);
        if (request.gradient) equations.keep_wide_gradient();
        evaluator.linearize(equations);
        if (request.gradient) {
            Vector full = device.make_vector("the gradient");
            equations.get_gradient(full);
            gradient.resize(static_cast<size_t>(device.layout().num_parameters(problem)));
            device.download(full, gradient.data());
        }
        if (wants_jacobian) {
            jacobian = empty_jacobian(problem, device.layout());
            download_jacobian(device, equations.jacobian, jacobian);
            zero_constant_columns(problem, device.layout(), jacobian);
        }
    }
    const auto copy = [](const std::vector<double>& from, double* to) {
        if (to) std::copy(from.begin(), from.end(), to);
    };
    copy(host_residuals, request.residuals);
    copy(gradient, request.gradient);
    copy(jacobian.image_blocks, request.jacobian_images);
    copy(jacobian.point_blocks, request.jacobian_points);
}

// Sets the entries of constant parameters to 0.
void mask_constants(DeviceProblem& device, Vector& vector) {
    device.vectors().mask_constants(device.scale_f, vector.f);
    for (size_t c = 0; c < vector.e.size(); ++c)
        if (device.chunks()[c].point_scale)
            device.vectors().mask_constants(device.chunks()[c].point_scale, vector.e[c]);
}

std::vector<double> multiply(const Problem& problem, DeviceProblem& device, int32_t product,
                             double lambda, const double* x) {
    Evaluator evaluator(device, problem);
    NormalEquations equations(device, DampingOptions(), JacobianForm::stored, problem.loss);
    evaluator.linearize(equations);
    const bool is_double = device.precision() == Precision::double_precision;
    std::vector<Buffer>& slots = equations.jacobian.product();
    Vector vector = device.make_vector("a product's argument");
    std::vector<double> y(product == CLBA_PRODUCT_JX
                              ? 2 * static_cast<size_t>(problem.num_observations())
                              : static_cast<size_t>(device.layout().num_parameters(problem)));
    if (product == CLBA_PRODUCT_JX) {
        device.upload(x, vector);
        mask_constants(device, vector);
        equations.jacobian.multiply(vector);
        is_double ? download_rows<double>(device, slots, y.data())
                  : download_rows<float>(device, slots, y.data());
    } else if (product == CLBA_PRODUCT_JTY) {
        is_double ? upload_rows<double>(x, device, slots) : upload_rows<float>(x, device, slots);
        equations.jacobian.add_transposed(vector);
        mask_constants(device, vector);
        device.download(vector, y.data());
    } else {
        const int64_t failures =
            equations.factor_points(lambda) + equations.factor_image_blocks(lambda);
        require(failures == 0, failures,
                " diagonal blocks of J^T J + lambda D^2 are not positive "
                "definite at lambda = ",
                lambda, "; a larger lambda makes them so");
        device.upload(x, vector);
        Vector result = device.make_vector("a product");
        equations.apply_image_factors(vector, result);
        equations.apply_point_factors(vector, result);
        device.download(result, y.data());
    }
    return y;
}

}  // namespace
}  // namespace clba

using namespace clba;

const char* clba_linear_solver_name(int32_t linear_solver) {
    switch (linear_solver) {
        case CLBA_LINEAR_SOLVER_PCG_SCHUR:
            return "pcg_schur";
        case CLBA_LINEAR_SOLVER_PCG_HESSIAN:
            return "pcg_hessian";
        case CLBA_LINEAR_SOLVER_DIRECT_SCHUR:
            return "direct_schur";
        case CLBA_LINEAR_SOLVER_EXPLICIT_SCHUR:
            return "explicit_schur";
        case CLBA_LINEAR_SOLVER_AUTO:
            return "auto";
        default:
            return nullptr;
    }
}

const char* clba_preconditioner_name(int32_t preconditioner) {
    switch (preconditioner) {
        case CLBA_PRECONDITIONER_DEFAULT:
            return "default";
        case CLBA_PRECONDITIONER_BLOCK_JACOBI:
            return "block_jacobi";
        case CLBA_PRECONDITIONER_SCHUR_JACOBI:
            return "schur_jacobi";
        default:
            return nullptr;
    }
}

const char* clba_damping_name(int32_t damping) {
    switch (damping) {
        case CLBA_DAMPING_MARQUARDT:
            return "marquardt";
        case CLBA_DAMPING_LEVENBERG:
            return "levenberg";
        case CLBA_DAMPING_UNCERTAINTY:
            return "uncertainty";
        default:
            return nullptr;
    }
}

const char* clba_precision_name(int32_t precision) {
    switch (precision) {
        case CLBA_PRECISION_AUTO:
            return "auto";
        case CLBA_PRECISION_DOUBLE:
            return "double";
        case CLBA_PRECISION_MIXED:
            return "mixed";
        case CLBA_PRECISION_SINGLE:
            return "single";
        default:
            return nullptr;
    }
}

const char* clba_jacobian_name(int32_t jacobian) {
    switch (jacobian) {
        case CLBA_JACOBIAN_DEFAULT:
            return "default";
        case CLBA_JACOBIAN_RECOMPUTED:
            return "recomputed";
        case CLBA_JACOBIAN_STORED:
            return "stored";
        default:
            return nullptr;
    }
}

clba_status clba_cancellation_create(clba_cancellation** cancellation) {
    if (cancellation) *cancellation = nullptr;
    return guarded([&] {
        require_pointer(cancellation, "cancellation");
        *cancellation = new clba_cancellation();
    });
}

clba_status clba_cancellation_retain(clba_cancellation* cancellation) {
    return guarded([&] {
        require_pointer(cancellation, "cancellation");
        ++cancellation->references;
    });
}

void clba_cancellation_release(clba_cancellation* cancellation) {
    if (cancellation && --cancellation->references == 0) delete cancellation;
}

void clba_cancellation_request(clba_cancellation* cancellation) {
    if (cancellation) cancellation->is_requested = true;
}

void clba_cancellation_reset(clba_cancellation* cancellation) {
    if (cancellation) cancellation->is_requested = false;
}

int32_t clba_cancellation_is_requested(const clba_cancellation* cancellation) {
    return cancellation && cancellation->is_requested;
}

const char* clba_gauge_state_name(int32_t gauge) {
    switch (gauge) {
        case CLBA_GAUGE_STATE_FREE:
            return "free";
        case CLBA_GAUGE_STATE_FIXED_BY_CONSTANTS:
            return "fixed_by_constants";
        case CLBA_GAUGE_STATE_FIXED_BY_PRIORS:
            return "fixed_by_priors";
        default:
            return nullptr;
    }
}

clba_status clba_solver_options_init(clba_solver_options* options, size_t struct_size) {
    return guarded([&] { init_struct(options, struct_size, default_solver_options(), "options"); });
}

clba_status clba_problem_solve(clba_problem* problem, clba_context* context,
                               const clba_solver_options* options, clba_result** result) {
    if (result) *result = nullptr;
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(context, "context");
        const Request request(options, *context->context);
        try {
            const Summary summary = solve(problem->problem, context->context, request.options,
                                          request.precision, problem->mirror);
            if (result) *result = make_result(summary, request.given).release();
        } catch (...) {
            problem->mirror.reset();
            throw;
        }
    });
}

clba_status clba_window_init(clba_window* window, size_t struct_size) {
    return guarded([&] { init_struct(window, struct_size, default_window(), "window"); });
}

clba_status clba_problem_solve_window(clba_problem* problem, clba_context* context,
                                      const clba_solver_options* options, clba_window* window,
                                      clba_result** result) {
    if (result) *result = nullptr;
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(context, "context");
        require_pointer(window, "window");
        clba_window described = copied_in(window, default_window(), "window");
        const Request request(options, *context->context);
        require(
            !request.given.checkpoint_path && !request.given.resume_path,
            "checkpoint_path and resume_path are for solves of whole problems; leave them NULL");
        if (!problem->index) problem->index = std::make_unique<ObservationIndex>(problem->problem);
        Subproblem part = extract(problem->problem, *problem->index, window_of(described));
        std::unique_ptr<DeviceProblem> device;
        const Summary summary =
            solve(part.problem, context->context, request.options, request.precision, device);
        auto made = result ? make_result(summary, request.given) : nullptr;
        write_state_back(part, problem->problem);
        described.num_free_points = part.num_free_points;
        described.num_constant_images = part.num_constant_images;
        described.num_observations = part.problem.num_observations();
        copy_out(described, window, "window");
        if (result) *result = made.release();
    });
}

void clba_result_release(clba_result* result) {
    delete result;
}

clba_status clba_result_get_summary(const clba_result* result, clba_summary* summary) {
    return guarded([&] {
        require_pointer(result, "result");
        copy_out(result->summary, summary, "summary");
    });
}

int32_t clba_result_num_rows(const clba_result* result) {
    return result ? static_cast<int32_t>(result->rows.size()) : 0;
}

clba_status clba_result_get_row(const clba_result* result, int32_t index, clba_iteration* row) {
    return guarded([&] {
        require_pointer(result, "result");
        require(index >= 0 && index < clba_result_num_rows(result), "index = ", index,
                ", but there are ", clba_result_num_rows(result), " rows");
        copy_out(result->rows[static_cast<size_t>(index)], row, "row");
    });
}

const char* clba_result_report(const clba_result* result) {
    return result ? result->report.c_str() : "";
}

const char* clba_result_json(const clba_result* result) {
    return result ? result->json.c_str() : "{}";
}

clba_status clba_evaluation_init(clba_evaluation* evaluation, size_t struct_size) {
    return guarded(
        [&] { init_struct(evaluation, struct_size, default_evaluation(), "evaluation"); });
}

clba_status clba_problem_evaluate(clba_problem* problem, clba_context* context,
                                  clba_evaluation* evaluation) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(context, "context");
        require_pointer(evaluation, "evaluation");
        clba_evaluation request = copied_in(evaluation, default_evaluation(), "evaluation");
        with_mirror(problem, context, checked_precision(request.precision),
                    [&](DeviceProblem& device) { evaluate(problem->problem, device, request); });
        copy_out(request, evaluation, "evaluation");
    });
}

clba_status clba_problem_multiply(clba_problem* problem, clba_context* context, int32_t product,
                                  int32_t precision, double lambda, const double* x, double* y) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(context, "context");
        require_pointer(x, "x");
        require_pointer(y, "y");
        require(product >= CLBA_PRODUCT_JX && product <= CLBA_PRODUCT_BLOCK_JACOBI,
                "product = ", product, ", but the products are ", int{CLBA_PRODUCT_JX}, " to ",
                int{CLBA_PRODUCT_BLOCK_JACOBI});
        require(std::isfinite(lambda) && lambda >= 0, "lambda = ", lambda,
                ", but it must be finite and >= 0");
        with_mirror(problem, context, checked_precision(precision), [&](DeviceProblem& device) {
            const std::vector<double> result =
                multiply(problem->problem, device, product, lambda, x);
            std::copy(result.begin(), result.end(), y);
        });
    });
}
