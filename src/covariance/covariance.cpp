// SPDX-License-Identifier: Apache-2.0
#include "covariance/covariance.hpp"

#include <unistd.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "base/error.hpp"
#include "covariance/estimates.hpp"
#include "covariance/point_sights.hpp"
#include "linear/pcg_solvers.hpp"
#include "optimizer/evaluator.hpp"

namespace clba {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

// Columns of `freedoms` that nothing in the normal equations holds: N^T S N is 0 there, as priors
// apart no residual notices a similarity.
Freedoms unheld(const Problem& problem, NormalEquations& equations,
                const Similarities& similarities, const std::vector<double>& diagonal,
                const Freedoms& freedoms) {
    if (freedoms.cols() == 0) return freedoms;
    DeviceProblem& device = equations.problem();
    const Eigen::MatrixXd tangents = f_tangents(problem, device.layout(), similarities, freedoms);
    PcgSchur system(LinearSolverOptions(), equations);
    Vector x = device.make_reduced_vector("the gauge"), y = device.make_reduced_vector("the gauge");
    Eigen::MatrixXd products(tangents.rows(), tangents.cols());
    std::vector<double> column(static_cast<size_t>(tangents.rows()));
    for (Eigen::Index k = 0; k < tangents.cols(); ++k) {
        Eigen::Map<Eigen::VectorXd>(column.data(), tangents.rows()) = tangents.col(k);
        device.write_wide(column, x.f);
        y.fill_zero();
        system.add_product(x, y);
        device.read_wide(y.f, column, column.size());
        products.col(k) = Eigen::Map<const Eigen::VectorXd>(column.data(), tangents.rows());
    }
    // In units of what U alone would make of each column: that is where the rounding comes from.
    const Eigen::Map<const Eigen::VectorXd> u(diagonal.data(), tangents.rows());
    const Eigen::VectorXd scale =
        (tangents.cwiseAbs2().transpose() * u).cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd energy =
        scale.asDiagonal() * tangents.transpose() * products * scale.asDiagonal();
    constexpr double smallest_share = 1e-11;
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(0.5 *
                                                                (energy + energy.transpose()));
    const auto num_unheld = (solver.eigenvalues().array() <= smallest_share).count();
    if (num_unheld == 0) return Freedoms(7, 0);
    const Eigen::MatrixXd left =
        freedoms * scale.asDiagonal() * solver.eigenvectors().leftCols(num_unheld);
    return Eigen::HouseholderQR<Eigen::MatrixXd>(left).householderQ() *
           Eigen::MatrixXd::Identity(left.rows(), left.cols());
}

uint64_t memory_limit(uint64_t given) {
    if (given > 0) return given;
    return static_cast<uint64_t>(::sysconf(_SC_PHYS_PAGES)) / 2 *
           static_cast<uint64_t>(::sysconf(_SC_PAGESIZE));
}

// S on the device, its inverse, its factor, what the factorisation and the inverse work on, and the
// pairs of observations.
double exact_bytes(const UndampedSystem& system, const SchurStructure& structure) {
    const BlockPattern pattern = schur_pattern(system.problem, system.device.layout(), structure);
    double num_values = 0;
    for (int32_t row = 0; row < pattern.num_blocks(); ++row)
        for (int64_t k = pattern.row_begin[row]; k < pattern.row_begin[row + 1]; ++k)
            num_values +=
                double{1} * pattern.block_size[row] * pattern.block_size[pattern.columns[k]];
    return sizeof(double) * (2 * num_values + 3 * estimate_factor_values(pattern)) +
           16.0 * static_cast<double>(count_pairs(system.problem));
}

void make_blocks(const Problem& problem, Covariance& covariance) {
    const auto place = [](const std::vector<int32_t>& sizes, std::vector<int64_t>& begin,
                          std::vector<double>& values) {
        begin.assign(1, 0);
        for (const int64_t size : sizes) begin.push_back(begin.back() + size * size);
        values.assign(static_cast<size_t>(begin.back()), 0.0);
    };
    for (const Image& image : problem.images) {
        covariance.image_size.push_back(num_pose_params +
                                        problem.cameras[image.camera].num_params());
        covariance.rotations.push_back(rotation_matrix(image.pose.rotation));
    }
    for (const Camera& camera : problem.cameras)
        covariance.camera_size.push_back(camera.num_params());
    place(covariance.image_size, covariance.image_begin, covariance.images);
    place(covariance.camera_size, covariance.camera_begin, covariance.cameras);
    covariance.point_values.assign(9 * covariance.points.size(), 0.0);
}

// Writes what is known without rounding: infinite and constant parameters, and those that the gauge
// holds. state(k): 1 leaves, 0 makes 0, infinity makes infinite.
template <class State>
void settle(int32_t size, double* values, const State& state) {
    for (int32_t r = 0; r < size; ++r) {
        for (int32_t c = 0; c < size; ++c) {
            const double of_row = state(r), of_column = state(c);
            double& value = values[int64_t{r} * size + c];
            if (r == c && of_row == infinity)
                value = infinity;
            else if (of_row != 1 || of_column != 1)
                value = 0;
        }
    }
}

void settle_blocks(const UndampedSystem& system, Covariance& covariance) {
    const ParameterLayout& layout = system.device.layout();
    const auto state_of = [&](int32_t scalar) {
        if (!(layout.scale[scalar] > 0)) return 0.0;
        return system.is_observed[scalar] ? 1.0 : infinity;
    };
    const Problem& problem = system.problem;
    // By the gauge: the image that it names, and those that are rigid with it.
    const auto has_constant_sensor = [&](int32_t image) {
        const int32_t offset = layout.sensor_offset(layout.image_sensor[image]);
        return std::none_of(layout.scale.begin() + offset,
                            layout.scale.begin() + offset + num_pose_params,
                            [](double scale) { return scale > 0; });
    };
    const auto is_held = [&](int32_t image) {
        const int32_t held = system.gauge.held_image();
        if (image == held) return true;
        return held >= 0 && layout.is_composed(image) && layout.is_composed(held) &&
               layout.pose_block[image] == layout.pose_block[held] && has_constant_sensor(image) &&
               has_constant_sensor(held);
    };
    // Entry k of the pose is moved by rotations of frame and sensor, and from the fourth on by
    // their positions too.
    const auto state_of_composed = [&](int32_t image, int32_t k) {
        double state = 0;
        for (const int32_t offset :
             {layout.pose_offset[image], layout.sensor_offset(layout.image_sensor[image])})
            for (int32_t scalar = 0; scalar < (k < 3 ? 3 : num_pose_params); ++scalar)
                state = std::max(state, state_of(offset + scalar));
        return state;
    };
    for (int32_t c = 0; c < problem.num_cameras(); ++c)
        settle(covariance.camera_size[c], covariance.cameras.data() + covariance.camera_begin[c],
               [&](int32_t k) { return state_of(layout.intrinsics_offset[c] + k); });
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = problem.images[i].camera;
        settle(covariance.image_size[i], covariance.images.data() + covariance.image_begin[i],
               [&](int32_t k) {
                   if (k >= num_pose_params)
                       return state_of(layout.intrinsics_offset[camera] + k - num_pose_params);
                   if (is_held(i)) return 0.0;
                   if (!layout.is_composed(i)) return state_of(layout.pose_offset[i] + k);
                   return state_of_composed(i, k);
               });
    }
    for (size_t p = 0; p < covariance.points.size(); ++p) {
        const int32_t point = covariance.points[p];
        const bool is_free = point_scale(problem, point)[0] > 0;
        const double state =
            !is_free ? 0 : (rank_of(system.point_factors[point]) == 3 ? 1 : infinity);
        settle(3, covariance.point_values.data() + 9 * p, [&](int32_t) { return state; });
    }
}

void multiply(double factor, Covariance& covariance) {
    for (auto* values : {&covariance.images, &covariance.cameras, &covariance.point_values})
        for (double& value : *values) value *= factor;
}

void find(const UndampedSystem& system, const CovarianceOptions& options, Covariance& covariance) {
    const auto sample = [&] {
        covariance.method = CovarianceMethod::sampled;
        multiply(0, covariance);  // what an exact method without memory left
        const double asked = std::ceil(2 / (options.relative_error * options.relative_error));
        covariance.num_samples =
            options.num_samples > 0 ? options.num_samples : static_cast<int32_t>(asked);
        sample_covariances(system, options, covariance);
    };
    if (options.method == CovarianceMethod::sampled) return sample();
    const bool may_sample = options.method == CovarianceMethod::automatic;
    try {
        SchurStructure structure(system.problem, system.device.tiles(),
                                 ExplicitSchur::slice_size(system.device));
        if (may_sample &&
            exact_bytes(system, structure) > static_cast<double>(memory_limit(options.max_bytes)))
            return sample();
        find_exact_covariances(system, std::move(structure), covariance);
    } catch (const Error& error) {
        if (!may_sample || error.status() != Status::out_of_memory) throw;
        sample();
    } catch (const std::bad_alloc&) {
        if (!may_sample) throw;
        sample();
    }
}

}  // namespace

Covariance compute_covariance(const Problem& problem, DeviceProblem& device,
                              const CovarianceOptions& options) {
    const ParameterLayout& layout = device.layout();
    Covariance covariance;
    covariance.points = options.points;
    if (options.all_points) {
        covariance.points.resize(problem.points.size());
        std::iota(covariance.points.begin(), covariance.points.end(), 0);
    }
    make_blocks(problem, covariance);

    Evaluator evaluator(device, problem);
    const CostEvaluation cost = evaluator.cost(device.state, nullptr);
    NormalEquations equations(device, DampingOptions(), JacobianForm::recomputed, problem.loss);
    evaluator.linearize(equations);
    equations.factor_undamped_points();
    const auto point_factors = download_point_factors(equations, device);
    std::vector<double> diagonal(static_cast<size_t>(layout.num_f));
    device.read_wide(equations.diagonal.f, diagonal, diagonal.size());
    for (const double value : diagonal)
        require(std::isfinite(value),
                "the derivatives at this state are not finite; solve the problem first");
    IsObserved is_observed(diagonal.size());
    for (size_t k = 0; k < diagonal.size(); ++k) is_observed[k] = diagonal[k] > 0;

    const Similarities similarities(problem);
    const Freedoms freedoms = unheld(problem, equations, similarities, diagonal,
                                     free_similarities(problem, layout, similarities));
    covariance.gauge = options.gauge;
    covariance.num_freedoms = static_cast<int>(freedoms.cols());
    if (covariance.gauge.gauge == Gauge::automatic)
        covariance.gauge.gauge =
            freedoms.cols() == 0 ? Gauge::problem : Gauge::first_image_and_baseline;
    choose_images(problem, layout, is_observed, covariance.gauge);
    for (const int32_t point : covariance.gauge.points)
        require(covariance.gauge.gauge != Gauge::three_points || point < 0 ||
                    point >= problem.num_points() || rank_of(point_factors[point]) == 3,
                "point ", point,
                " of the gauge is not determined, as it is constant or has no parallax; name "
                "another");
    const GaugeTransform gauge(
        problem, layout, similarities, freedoms,
        make_constraints(problem, layout, similarities, freedoms, is_observed, covariance.gauge),
        covariance.gauge);

    int64_t num_determined = 0;
    for (int32_t k = 0; k < layout.num_f; ++k) {
        if (!(layout.scale[k] > 0)) continue;
        ++(is_observed[k] ? num_determined : covariance.num_undetermined_parameters);
    }
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        const int rank = rank_of(point_factors[p]);
        num_determined += rank;
        if (rank < 3 && point_scale(problem, p)[0] > 0) ++covariance.num_undetermined_points;
    }
    covariance.cost = cost.cost;
    covariance.redundancy =
        2 * (problem.num_observations() - cost.num_singular) - num_determined + freedoms.cols();
    covariance.variance_factor = covariance.redundancy > 0
                                     ? 2 * cost.cost / static_cast<double>(covariance.redundancy)
                                     : std::numeric_limits<double>::quiet_NaN();
    require(!options.apply_variance_factor || covariance.redundancy > 0,
            "apply_variance_factor = 1, but there are no more observations than parameters: the "
            "redundancy is ",
            covariance.redundancy, "; leave the factor out");

    const UndampedSystem system{problem, device,      equations, similarities,
                                gauge,   is_observed, diagonal,  point_factors};
    find(system, options, covariance);
    if (options.apply_variance_factor) multiply(covariance.variance_factor, covariance);
    settle_blocks(system, covariance);
    return covariance;
}

}  // namespace clba
