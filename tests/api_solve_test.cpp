// SPDX-License-Identifier: Apache-2.0
// Solving and evaluating through the C interface.
#include <clba/clba.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>
#include <numeric>

#include "api_rig.hpp"

namespace clba_test {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double epsilon = std::numeric_limits<double>::epsilon();

class Solving : public testing::Test {
protected:
    Solving() : context(make_context()), scene(generate()), start(data_of(scene.start)) {}

    // A fresh copy of the start.
    Problem fresh() const { return problem_of(start); }

    Context context;
    Scene scene;
    Data start;
};

TEST_F(Solving, RefusesNullAndOptionsOutOfRange) {
    const Problem problem = fresh();
    clba_result* result = nullptr;
    EXPECT_TRUE(refused(clba_problem_solve(nullptr, context.get(), nullptr, &result), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_solve(problem.get(), nullptr, nullptr, &result), {"context"}));
    const auto refuses = [&](auto clba_solver_options::*field, auto value, const char* name) {
        clba_solver_options options = solver_options();
        options.*field = value;
        EXPECT_TRUE(
            refused(clba_problem_solve(problem.get(), context.get(), &options, &result), {name}))
            << name << ' ' << value;
        EXPECT_EQ(result, nullptr);
    };
    for (int32_t bad : {-1, 1000}) {
        refuses(&clba_solver_options::linear_solver, bad, "linear_solver");
        refuses(&clba_solver_options::preconditioner, bad, "preconditioner");
        refuses(&clba_solver_options::damping, bad, "damping");
        refuses(&clba_solver_options::precision, bad, "precision");
    }
    refuses(&clba_solver_options::linear_solver, 0, "linear_solver");
    refuses(&clba_solver_options::max_num_iterations, -1, "max_num_iterations");
    refuses(&clba_solver_options::max_linear_solver_iterations, 0, "max_linear_solver_iterations");
    refuses(&clba_solver_options::min_linear_solver_iterations, -1, "min_linear_solver_iterations");
    refuses(&clba_solver_options::max_num_consecutive_invalid_steps, -1,
            "max_num_consecutive_invalid_steps");
    for (double bad : {-1.0, nan}) {
        refuses(&clba_solver_options::initial_trust_region_radius, bad,
                "initial_trust_region_radius");
        refuses(&clba_solver_options::max_trust_region_radius, bad, "max_trust_region_radius");
        refuses(&clba_solver_options::min_trust_region_radius, bad, "min_trust_region_radius");
        refuses(&clba_solver_options::min_relative_decrease, bad, "min_relative_decrease");
        refuses(&clba_solver_options::min_damping_diagonal, bad, "min_damping_diagonal");
        refuses(&clba_solver_options::max_damping_diagonal, bad, "max_damping_diagonal");
        refuses(&clba_solver_options::function_tolerance, bad, "function_tolerance");
        refuses(&clba_solver_options::gradient_tolerance, bad, "gradient_tolerance");
        refuses(&clba_solver_options::parameter_tolerance, bad, "parameter_tolerance");
        refuses(&clba_solver_options::target_cost, bad, "target_cost");
        refuses(&clba_solver_options::max_seconds, bad, "max_seconds");
        refuses(&clba_solver_options::eta, bad, "eta");
    }
    refuses(&clba_solver_options::max_damping_diagonal, 1e-7, "min_damping_diagonal");
    refuses(&clba_solver_options::eta, 1.0, "eta");
    clba_solver_options options = solver_options();
    options.linear_solver = CLBA_LINEAR_SOLVER_PCG_HESSIAN;
    options.preconditioner = CLBA_PRECONDITIONER_SCHUR_JACOBI;
    EXPECT_TRUE(refused(clba_problem_solve(problem.get(), context.get(), &options, nullptr),
                        {"schur_jacobi", "pcg_hessian"}));
    options.linear_solver = CLBA_LINEAR_SOLVER_DIRECT_SCHUR;
    EXPECT_TRUE(refused(clba_problem_solve(problem.get(), context.get(), &options, nullptr),
                        {"direct_schur"}));
    EXPECT_EQ(data_of(problem), data_of(fresh()));
}

TEST_F(Solving, DirectSchurWithoutThePlugin) {
    // This test must be the first of the program that wants the plug-in: it is opened once.
    testing::FLAGS_gtest_death_test_style = "threadsafe";
    const auto solve_without = [&] {
        ::setenv("CLBA_CHOLMOD", "/nonexistent", 1);
        const Problem problem = fresh();
        clba_solver_options options = solver_options();
        options.linear_solver = CLBA_LINEAR_SOLVER_DIRECT_SCHUR;
        const bool is_refused =
            refused(clba_problem_solve(problem.get(), context.get(), &options, nullptr),
                    CLBA_ERROR_NO_PLUGIN, {"/nonexistent", "CLBA_CHOLMOD"});
        std::fprintf(stderr, "%s", clba_last_error());
        const bool is_right = is_refused && data_of(problem) == data_of(fresh());
        std::_Exit(is_right ? 0 : 1);
    };
    EXPECT_EXIT(solve_without(), testing::ExitedWithCode(0), "install");
}

struct How {
    int32_t linear_solver, preconditioner, precision, damping;
};

TEST_F(Solving, EveryWayEndsAtTheSameCost) {
    std::vector<double> costs;
    for (const int32_t precision : {CLBA_PRECISION_DOUBLE, CLBA_PRECISION_MIXED})
        for (const How& how : {
                 How{CLBA_LINEAR_SOLVER_PCG_SCHUR, CLBA_PRECONDITIONER_SCHUR_JACOBI, precision,
                     CLBA_DAMPING_MARQUARDT},
                 How{CLBA_LINEAR_SOLVER_PCG_SCHUR, CLBA_PRECONDITIONER_BLOCK_JACOBI, precision,
                     CLBA_DAMPING_LEVENBERG},
                 How{CLBA_LINEAR_SOLVER_PCG_HESSIAN, CLBA_PRECONDITIONER_BLOCK_JACOBI, precision,
                     CLBA_DAMPING_MARQUARDT},
                 How{CLBA_LINEAR_SOLVER_DIRECT_SCHUR, CLBA_PRECONDITIONER_DEFAULT, precision,
                     CLBA_DAMPING_UNCERTAINTY},
             }) {
            const Problem problem = fresh();
            clba_solver_options options = converged_options();
            options.linear_solver = how.linear_solver;
            options.preconditioner = how.preconditioner;
            options.precision = how.precision;
            options.damping = how.damping;
            const clba_summary summary = solve(problem, context, options);
            EXPECT_EQ(summary.linear_solver, how.linear_solver);
            EXPECT_EQ(summary.preconditioner, how.preconditioner);
            EXPECT_EQ(summary.precision, how.precision);
            EXPECT_EQ(summary.damping, how.damping);
            EXPECT_EQ(summary.termination, CLBA_CONVERGENCE);
            EXPECT_NEAR(summary.reference_final_cost / summary.final_cost, 1, 1e-12);
            EXPECT_EQ(summary.num_iterations, summary.num_accepted_steps +
                                                  summary.num_rejected_steps +
                                                  summary.num_invalid_steps);
            costs.push_back(summary.final_cost);
        }
    for (double cost : costs) EXPECT_NEAR(cost / costs[0], 1, 1e-7);
    // The optimum fits the noisy observations better than the truth does.
    EXPECT_LT(costs[0], cost_of(scene.truth, context));
}

TEST_F(Solving, OtherModelsAndSharedCameras) {
    const Data data = with_other_models(start);
    const Problem problem = problem_of(data);
    // Image 2 lost its camera, the others see what they saw: images 0 and 1 by other formulas.
    Data snavely = start;
    std::copy_n(snavely.params.begin() + 3, 3, snavely.params.begin() + 6);
    const double cost = cost_of(problem_of(snavely), context);
    EXPECT_NEAR(cost_of(problem, context) / cost, 1, 1e-12);
    const clba_summary summary = solve(problem, context, converged_options());
    EXPECT_EQ(summary.termination, CLBA_CONVERGENCE);
    EXPECT_LT(summary.final_cost, cost);
    // Both images still have the one camera, and the camera without images has not moved.
    const Data after = data_of(problem);
    EXPECT_EQ(after.cameras, data.cameras);
    EXPECT_TRUE(
        std::equal(after.params.begin() + 13, after.params.begin() + 16, data.params.begin() + 13));
}

TEST_F(Solving, EqualBitsTwice) {
    const Problem a = fresh(), b = fresh();
    const clba_summary first = solve(a, context, solver_options());
    const Context other = make_context();
    const clba_summary second = solve(b, other, solver_options());
    EXPECT_EQ(first.final_cost, second.final_cost);
    EXPECT_EQ(data_of(a), data_of(b));
}

TEST_F(Solving, OrderOfObservationsDoesNotMatter) {
    Data shuffled = start;
    const size_t n = start.images.size();
    for (size_t i = 0; i < n; ++i) {
        const size_t from = (i * 7919 + 13) % n;  // 7919 is prime and no divisor of n
        shuffled.images[i] = start.images[from];
        shuffled.points[i] = start.points[from];
        shuffled.xy[2 * i] = start.xy[2 * from];
        shuffled.xy[2 * i + 1] = start.xy[2 * from + 1];
    }
    ASSERT_NE(n % 7919, 0u);
    const Problem a = fresh(), b = problem_of(shuffled);
    EXPECT_NEAR(cost_of(a, context) / cost_of(b, context), 1, 100 * epsilon);
    const clba_summary first = solve(a, context, converged_options());
    const clba_summary second = solve(b, context, converged_options());
    EXPECT_NEAR(first.final_cost / second.final_cost, 1, 1e-9);
}

TEST_F(Solving, SummaryRowsAndReports) {
    const Problem problem = fresh();
    clba_result* made = nullptr;
    ASSERT_OK(clba_problem_solve(problem.get(), context.get(), nullptr, &made));
    const Result result(made);
    clba_summary s{};
    s.struct_size = sizeof s;
    ASSERT_OK(clba_result_get_summary(made, &s));
    EXPECT_EQ(s.linear_solver, CLBA_LINEAR_SOLVER_PCG_SCHUR);
    EXPECT_EQ(s.preconditioner, CLBA_PRECONDITIONER_SCHUR_JACOBI);
    EXPECT_EQ(s.precision, CLBA_PRECISION_MIXED);
    EXPECT_STRNE(s.device, "");
    EXPECT_STRNE(s.message, "");
    EXPECT_GT(s.peak_device_bytes, 0u);
    const double parts = s.build_seconds + s.setup_seconds + s.linearize_seconds +
                         s.linear_solver_seconds + s.evaluate_seconds + s.reference_seconds +
                         s.other_seconds;
    EXPECT_NEAR(parts, s.total_seconds, 1e-12 * (1 + s.total_seconds));
    for (double seconds :
         {s.residual_device_seconds, s.jacobian_device_seconds, s.preconditioner_device_seconds,
          s.schur_device_seconds, s.vector_device_seconds})
        EXPECT_GT(seconds, 0);
    ASSERT_EQ(clba_result_num_rows(made), s.num_iterations + 1);
    clba_iteration row{}, before{};
    row.struct_size = sizeof row;
    for (int32_t i = 0; i <= s.num_iterations; ++i) {
        before = row;
        ASSERT_OK(clba_result_get_row(made, i, &row));
        EXPECT_EQ(row.iteration, i);
        if (i == 0) {
            EXPECT_EQ(row.cost, s.initial_cost);
            continue;
        }
        EXPECT_LE(row.cost, before.cost);
        EXPECT_GE(row.seconds, before.seconds);
        EXPECT_EQ(row.step_is_accepted, row.cost < before.cost);
        if (row.step_is_accepted) {
            EXPECT_EQ(row.cost_change, before.cost - row.cost);
        }
    }
    EXPECT_EQ(row.cost, s.final_cost);
    EXPECT_TRUE(refused(clba_result_get_row(made, -1, &row), {"-1"}));
    EXPECT_TRUE(refused(clba_result_get_row(made, s.num_iterations + 1, &row), {"rows"}));
    EXPECT_TRUE(refused(clba_result_get_row(nullptr, 0, &row), {"result"}));
    EXPECT_TRUE(refused(clba_result_get_summary(nullptr, &s), {"result"}));
    EXPECT_EQ(clba_result_num_rows(nullptr), 0);
    const std::string report = clba_result_report(made), json = clba_result_json(made);
    for (const std::string& part :
         std::vector<std::string>{"Solver summary", s.device, s.message, "pcg_schur", "mixed"})
        EXPECT_NE(report.find(part), std::string::npos) << part;
    // That it is valid JSON is checked by whoever parses it: the command's test.
    EXPECT_EQ(json.front(), '{');
    EXPECT_EQ(json.back(), '}');
    EXPECT_EQ(std::count(json.begin(), json.end(), '{'), s.num_iterations + 2);
    EXPECT_EQ(std::count(json.begin(), json.end(), '}'), s.num_iterations + 2);
    EXPECT_STREQ(clba_result_report(nullptr), "");
    EXPECT_STREQ(clba_result_json(nullptr), "{}");
    clba_result_release(nullptr);
    // The state is the last row's.
    EXPECT_NEAR(cost_of(problem, context) / s.final_cost, 1, 100 * epsilon);
}

TEST_F(Solving, HandlesAreReleasedInAnyOrder) {
    clba_context* other = make_context().release();
    clba_problem* problem = fresh().release();
    clba_result* result = nullptr;
    ASSERT_OK(clba_problem_solve(problem, other, nullptr, &result));
    clba_context_release(other);
    // The problem goes on to another context.
    EXPECT_OK(clba_problem_solve(problem, context.get(), nullptr, nullptr));
    clba_problem_release(problem);
    EXPECT_STRNE(clba_result_report(result), "");
    clba_result_release(result);
}

TEST_F(Solving, LimitsAndTargets) {
    clba_solver_options options = solver_options();
    options.max_num_iterations = 0;
    const Problem problem = fresh();
    clba_summary s = solve(problem, context, options);
    EXPECT_EQ(s.termination, CLBA_NO_CONVERGENCE);
    EXPECT_EQ(s.reason, CLBA_REASON_MAX_ITERATIONS);
    EXPECT_EQ(s.num_iterations, 0);
    EXPECT_EQ(s.initial_cost, s.final_cost);
    EXPECT_EQ(data_of(problem), data_of(fresh()));

    options.max_num_iterations = 1;
    s = solve(fresh(), context, options);
    EXPECT_EQ(s.num_iterations, 1);
    EXPECT_EQ(s.reason, CLBA_REASON_MAX_ITERATIONS);

    options = solver_options();
    options.max_seconds = 1e-9;
    s = solve(fresh(), context, options);
    EXPECT_EQ(s.termination, CLBA_NO_CONVERGENCE);
    EXPECT_EQ(s.reason, CLBA_REASON_MAX_SECONDS);

    options = solver_options();
    options.target_cost = 0.5 * s.initial_cost;
    s = solve(fresh(), context, options);
    EXPECT_EQ(s.termination, CLBA_CONVERGENCE);
    EXPECT_EQ(s.reason, CLBA_REASON_TARGET_COST);
    EXPECT_LE(s.final_cost, options.target_cost);

    options = solver_options();
    options.gradient_tolerance = 1e300;
    EXPECT_EQ(solve(fresh(), context, options).reason, CLBA_REASON_GRADIENT_TOLERANCE);
    options = solver_options();
    options.function_tolerance = 0;
    options.parameter_tolerance = 1;
    EXPECT_EQ(solve(fresh(), context, options).reason, CLBA_REASON_PARAMETER_TOLERANCE);
    EXPECT_EQ(solve(fresh(), context, solver_options()).reason, CLBA_REASON_FUNCTION_TOLERANCE);
}

struct Watcher {
    int32_t stop_at = -1;
    double max_seconds = infinity;
    std::vector<clba_iteration> rows;
    static int32_t watch(const clba_iteration* row, void* user_data) {
        auto* self = static_cast<Watcher*>(user_data);
        self->rows.push_back(*row);
        return row->iteration == self->stop_at || row->seconds > self->max_seconds;
    }
};

TEST_F(Solving, CallbackSeesEveryRowAndStops) {
    Watcher watcher;
    clba_solver_options options = solver_options();
    options.on_iteration = Watcher::watch;
    options.user_data = &watcher;
    clba_summary s = solve(fresh(), context, options);
    ASSERT_EQ(watcher.rows.size(), static_cast<size_t>(s.num_iterations) + 1);
    EXPECT_EQ(watcher.rows[0].struct_size, sizeof(clba_iteration));
    EXPECT_EQ(watcher.rows.front().cost, s.initial_cost);
    EXPECT_EQ(watcher.rows.back().cost, s.final_cost);

    for (int32_t stop_at : {0, 2}) {
        watcher = Watcher();
        watcher.stop_at = stop_at;
        const Problem problem = fresh();
        s = solve(problem, context, options);
        EXPECT_EQ(s.termination, CLBA_USER_STOP);
        EXPECT_EQ(s.reason, CLBA_REASON_CALLBACK);
        EXPECT_EQ(s.num_iterations, stop_at);
        EXPECT_EQ(watcher.rows.back().cost, s.final_cost);
        EXPECT_NEAR(cost_of(problem, context) / watcher.rows.back().cost, 1, 100 * epsilon);
    }
    // A time budget of the caller's own: it is spent at once.
    watcher = Watcher();
    watcher.max_seconds = 0;
    s = solve(fresh(), context, options);
    EXPECT_EQ(s.reason, CLBA_REASON_CALLBACK);
    EXPECT_EQ(watcher.rows.size(), 1u);
}

TEST_F(Solving, NothingToDo) {
    clba_problem* made = nullptr;
    ASSERT_OK(clba_problem_create(&made));
    const Problem empty(made);
    EXPECT_EQ(solve(empty, context, solver_options()).reason, CLBA_REASON_NOTHING_TO_DO);

    Data data = start;
    data.images.clear();
    data.points.clear();
    data.xy.clear();
    const Problem unobserved = problem_of(data);
    clba_summary s = solve(unobserved, context, solver_options());
    EXPECT_EQ(s.termination, CLBA_CONVERGENCE);
    EXPECT_EQ(s.reason, CLBA_REASON_NOTHING_TO_DO);
    EXPECT_EQ(s.final_cost, 0);
    EXPECT_EQ(data_of(unobserved), data_of(problem_of(data)));
    EXPECT_EQ(cost_of(unobserved, context), 0);

    const Problem problem = fresh();
    const std::vector<int32_t> all(start.xyz.size(), CLBA_CONSTANT_POSE), every(8, 7);
    ASSERT_OK(clba_problem_set_constant_images(problem.get(), start.num_images(), all.data(), 0));
    ASSERT_OK(clba_problem_set_constant_points(problem.get(), start.num_points(), all.data(), 0));
    ASSERT_OK(
        clba_problem_set_constant_cameras(problem.get(), start.num_cameras(), every.data(), 0));
    s = solve(problem, context, solver_options());
    EXPECT_EQ(s.reason, CLBA_REASON_NOTHING_TO_DO);
    EXPECT_NEAR(s.final_cost / cost_of(fresh(), context), 1, 100 * epsilon);
    EXPECT_EQ(data_of(problem), data_of(fresh()));
    // Count 0 frees them again.
    ASSERT_OK(clba_problem_set_constant_images(problem.get(), 0, nullptr, 0));
    s = solve(problem, context, solver_options());
    EXPECT_LT(s.final_cost, s.initial_cost);
}

TEST_F(Solving, ConstantsStay) {
    std::vector<int32_t> images(8, 0), points(start.xyz.size() / 3, 0), cameras(8, 0);
    images[0] = CLBA_CONSTANT_POSE;
    images[1] = CLBA_CONSTANT_ROTATION;
    images[2] = CLBA_CONSTANT_POSITION;
    cameras[1] = 1;  // f
    cameras[3] = 6;  // k1, k2
    for (size_t i = 0; i < points.size(); i += 5) points[i] = 1;
    for (const int32_t solver : {CLBA_LINEAR_SOLVER_PCG_SCHUR, CLBA_LINEAR_SOLVER_PCG_HESSIAN,
                                 CLBA_LINEAR_SOLVER_DIRECT_SCHUR}) {
        const Problem problem = fresh();
        clba_problem* p = problem.get();
        ASSERT_OK(clba_problem_set_constant_images(p, 8, images.data(), 0));
        ASSERT_OK(clba_problem_set_constant_cameras(p, 8, cameras.data(), 0));
        ASSERT_OK(clba_problem_set_constant_points(p, start.num_points(), points.data(), 0));
        const Data before = data_of(problem);
        std::vector<double> centers(24), moved(24);
        ASSERT_OK(clba_problem_get_centers(p, 0, 8, centers.data(), 0));
        clba_solver_options options = solver_options();
        options.linear_solver = solver;
        const clba_summary s = solve(problem, context, options);
        EXPECT_GT(s.num_accepted_steps, 1);
        const Data after = data_of(problem);
        ASSERT_OK(clba_problem_get_centers(p, 0, 8, moved.data(), 0));
        const auto same = [](const std::vector<double>& a, const std::vector<double>& b,
                             size_t first, size_t count) {
            return std::equal(a.begin() + static_cast<std::ptrdiff_t>(first),
                              a.begin() + static_cast<std::ptrdiff_t>(first + count),
                              b.begin() + static_cast<std::ptrdiff_t>(first));
        };
        EXPECT_TRUE(same(before.poses, after.poses, 0, 7));
        EXPECT_TRUE(same(before.poses, after.poses, 7, 4));
        EXPECT_FALSE(same(before.poses, after.poses, 11, 3));
        EXPECT_FALSE(same(before.poses, after.poses, 14, 4));
        for (size_t k = 6; k < 9; ++k) {
            const double size = std::abs(centers[6]) + std::abs(centers[7]) + std::abs(centers[8]);
            EXPECT_NEAR(moved[k], centers[k], 100 * epsilon * size);
        }
        EXPECT_FALSE(same(centers, moved, 9, 3));
        EXPECT_TRUE(same(before.params, after.params, 3, 1));
        EXPECT_FALSE(same(before.params, after.params, 4, 2));
        EXPECT_FALSE(same(before.params, after.params, 9, 1));
        EXPECT_TRUE(same(before.params, after.params, 10, 2));
        for (size_t i = 0; i < points.size(); ++i)
            EXPECT_EQ(same(before.xyz, after.xyz, 3 * i, 3), points[i] != 0) << i;
    }
}

// The paper's weights: without effect where D follows the scaling of the columns.
TEST_F(Solving, UncertaintiesActByTheDamping) {
    std::vector<double> values(start.xyz.size(), 0.02);
    for (size_t i = 0; i < values.size(); i += 3) values[i] = 50;
    const auto run = [&](int32_t damping, bool has_uncertainties) {
        const Problem problem = fresh();
        clba_problem* p = problem.get();
        if (has_uncertainties) {
            EXPECT_OK(clba_problem_set_image_uncertainties(p, 8, values.data(), 0));
            EXPECT_OK(clba_problem_set_camera_uncertainties(p, 8, values.data(), 0));
            EXPECT_OK(
                clba_problem_set_point_uncertainties(p, start.num_points(), values.data(), 0));
        }
        clba_solver_options options = solver_options();
        options.damping = damping;
        options.precision = CLBA_PRECISION_DOUBLE;
        options.linear_solver = CLBA_LINEAR_SOLVER_DIRECT_SCHUR;
        options.max_num_iterations = 2;
        options.initial_trust_region_radius = damping == CLBA_DAMPING_UNCERTAINTY ? 1e-6 : 1;
        options.min_damping_diagonal = 1e-30;
        return solve(problem, context, options).final_cost;
    };
    EXPECT_NEAR(run(CLBA_DAMPING_MARQUARDT, true) / run(CLBA_DAMPING_MARQUARDT, false), 1, 1e-9);
    for (const int32_t damping : {CLBA_DAMPING_LEVENBERG, CLBA_DAMPING_UNCERTAINTY})
        EXPECT_GT(std::abs(run(damping, true) / run(damping, false) - 1), 1e-6) << damping;
}

TEST(Losses, ResistOutliers) {
    const Context context = make_context();
    const Scene scene = generate(0.05);
    const Data start = data_of(scene.start);
    const auto distance_with = [&](int32_t loss) {
        const Problem problem = problem_of(start);
        EXPECT_OK(clba_problem_set_loss(problem.get(), loss, 1.5));
        const clba_summary s = solve(problem, context, converged_options());
        EXPECT_LT(s.final_cost, s.initial_cost);
        EXPECT_NEAR(s.reference_final_cost / s.final_cost, 1, 1e-12);
        clba_comparison comparison;
        comparison.struct_size = sizeof comparison;
        EXPECT_OK(clba_problem_compare(scene.truth.get(), problem.get(), &comparison));
        return comparison.median_center_distance;
    };
    const double without = distance_with(CLBA_LOSS_NONE);
    for (const int32_t loss : {CLBA_LOSS_HUBER, CLBA_LOSS_SOFT_L1, CLBA_LOSS_CAUCHY})
        EXPECT_LT(distance_with(loss), 0.5 * without) << clba_loss_name(loss);
}

// One observation with a residual of known length.
TEST(Losses, AreThoseOfTheHeader) {
    const Context context = make_context();
    Data data;
    data.models = {CLBA_CAMERA_SIMPLE_PINHOLE};
    data.params = {100, 0, 0};
    data.cameras = {0};
    data.poses = {1, 0, 0, 0, 0, 0, 0};
    data.xyz = {0, 0, 1};
    data.images = data.points = {0};
    data.xy = {3, 4};
    const Problem problem = problem_of(data);
    const double s = 25, a = 2;
    const double small = 7;  // a^2 above s
    const std::function<double(double)> rho[] = {
        [&](double) { return s; },
        [&](double scale) { return s <= scale * scale ? s : 2 * scale * 5 - scale * scale; },
        [&](double scale) { return 2 * scale * scale * (std::sqrt(1 + s / scale / scale) - 1); },
        [&](double scale) { return scale * scale * std::log(1 + s / scale / scale); },
        [&](double scale) {
            const double a2 = scale * scale, rest = 1 - s / a2;
            return s <= a2 ? a2 / 3 * (1 - rest * rest * rest) : a2 / 3;
        }};
    for (int32_t loss = CLBA_LOSS_NONE; loss <= CLBA_LOSS_TUKEY; ++loss)
        for (double scale : {a, small}) {
            ASSERT_OK(clba_problem_set_loss(problem.get(), loss, scale));
            EXPECT_NEAR(cost_of(problem, context), 0.5 * rho[loss](scale), 1e-13)
                << clba_loss_name(loss);
        }
}

TEST_F(Solving, CovariancesScaleTheCost) {
    const Problem problem = fresh();
    clba_problem* p = problem.get();
    const int64_t n = start.num_observations();
    const double cost = cost_of(problem, context);
    const std::vector<double> sigmas(static_cast<size_t>(n), 4.0);
    ASSERT_OK(clba_problem_set_sigmas(p, n, sigmas.data(), 0));
    EXPECT_NEAR(cost_of(problem, context) * 16 / cost, 1, 100 * epsilon);
    std::vector<double> covariances;
    for (int64_t i = 0; i < n; ++i) covariances.insert(covariances.end(), {16, 0, 16});
    ASSERT_OK(clba_problem_set_covariances(p, n, covariances.data(), 0));
    EXPECT_NEAR(cost_of(problem, context) * 16 / cost, 1, 100 * epsilon);
    ASSERT_OK(clba_problem_set_covariances(p, 0, nullptr, 0));
    EXPECT_NEAR(cost_of(problem, context) / cost, 1, 100 * epsilon);

    // A correlated one by hand: r^T C^-1 r with C^-1 = [yy, -xy; -xy, xx] / det.
    std::vector<double> residuals(2 * static_cast<size_t>(n));
    clba_evaluation evaluation;
    ASSERT_OK(clba_evaluation_init(&evaluation, sizeof evaluation));
    evaluation.residuals = residuals.data();
    ASSERT_OK(clba_problem_evaluate(p, context.get(), &evaluation));
    double expected = 0;
    covariances.clear();
    for (size_t i = 0; i < static_cast<size_t>(n); ++i) {
        const double xx = 1 + 0.1 * static_cast<double>(i % 7), xy = 0.3, yy = 2;
        const double x = residuals[2 * i], y = residuals[2 * i + 1];
        covariances.insert(covariances.end(), {xx, xy, yy});
        expected += 0.5 * (yy * x * x - 2 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
    }
    ASSERT_OK(clba_problem_set_covariances(p, n, covariances.data(), 0));
    EXPECT_NEAR(cost_of(problem, context) / expected, 1, 1e-12);
}

// Evaluations, checked against the stored blocks.
class Evaluating : public testing::Test {
protected:
    Evaluating()
        : context(make_context()),
          data(with_other_models(data_of(generate().start))),
          problem(problem_of(data)) {
        std::vector<int32_t> images(8, 0), points(data.xyz.size() / 3, 0), cameras(8, 0);
        images[3] = CLBA_CONSTANT_POSE;
        images[4] = CLBA_CONSTANT_ROTATION;
        cameras[1] = 1 << 6;
        cameras[2] = 7;  // no image uses it
        points[1] = 1;
        clba_problem* p = problem.get();
        EXPECT_OK(clba_problem_set_constant_images(p, 8, images.data(), 0));
        EXPECT_OK(clba_problem_set_constant_cameras(p, 8, cameras.data(), 0));
        EXPECT_OK(clba_problem_set_constant_points(p, data.num_points(), points.data(), 0));
        EXPECT_OK(clba_problem_set_loss(p, CLBA_LOSS_HUBER, 5));
        info = info_of(problem);
        n = static_cast<size_t>(info.num_observations);
        m = static_cast<size_t>(info.num_parameters);
        poses.resize(8);
        intrinsics.resize(8);
        EXPECT_OK(clba_problem_get_offsets(p, poses.data(), intrinsics.data()));
        evaluate(CLBA_PRECISION_DOUBLE);
    }

    void evaluate(int32_t precision) {
        columns = static_cast<size_t>(info.num_parameters_per_image_block);
        residuals.assign(2 * n, nan);
        gradient.assign(m, nan);
        of_images.assign(2 * columns * n, nan);
        of_points.assign(6 * n, nan);
        EXPECT_OK(clba_evaluation_init(&evaluation, sizeof evaluation));
        evaluation.precision = precision;
        evaluation.residuals = residuals.data();
        evaluation.gradient = gradient.data();
        evaluation.jacobian_images = of_images.data();
        evaluation.jacobian_points = of_points.data();
        EXPECT_OK(clba_problem_evaluate(problem.get(), context.get(), &evaluation));
    }

    // visit(row of J, parameter, value) for each stored entry.
    template <class Visit>
    void entries(const Visit& visit) const {
        for (size_t i = 0; i < n; ++i) {
            const auto image = static_cast<size_t>(data.images[i]);
            const auto camera = static_cast<size_t>(data.cameras[image]);
            const auto num_params =
                static_cast<size_t>(clba_camera_model_num_params(data.models[camera]));
            for (size_t row = 2 * i; row < 2 * i + 2; ++row) {
                for (size_t k = 0; k < columns; ++k) {
                    const double value = of_images[row * columns + k];
                    if (k < 6)
                        visit(row, static_cast<size_t>(poses[image]) + k, value);
                    else if (k < 6 + num_params)
                        visit(row, static_cast<size_t>(intrinsics[camera]) + k - 6, value);
                    else
                        EXPECT_EQ(value, 0);
                }
                for (size_t k = 0; k < 3; ++k)
                    visit(row,
                          static_cast<size_t>(info.num_image_camera_parameters) +
                              3 * static_cast<size_t>(data.points[i]) + k,
                          of_points[3 * row + k]);
            }
        }
    }

    // Sums of products with what rounding may cost them.
    struct Sums {
        explicit Sums(size_t size) : value(size, 0.0), magnitude(size, 0.0) {}
        void add(size_t at, double term) {
            value[at] += term;
            magnitude[at] += std::abs(term);
        }
        void expect_near(const std::vector<double>& got, double unit) const {
            for (size_t k = 0; k < value.size(); ++k)
                ASSERT_NEAR(got[k], value[k], unit * magnitude[k]) << k;
        }
        std::vector<double> value, magnitude;
    };

    std::vector<double> argument(size_t size) const {
        std::vector<double> x(size);
        for (size_t k = 0; k < size; ++k) x[k] = std::sin(0.37 * static_cast<double>(k) + 1);
        return x;
    }

    Context context;
    Data data;
    Problem problem;
    clba_problem_info info;
    size_t n, m, columns = 0;
    std::vector<int64_t> poses, intrinsics;
    clba_evaluation evaluation;
    std::vector<double> residuals, gradient, of_images, of_points;
};

TEST_F(Evaluating, GradientIsJTransposedTimesResiduals) {
    Sums sums(m);
    entries([&](size_t row, size_t k, double value) { sums.add(k, value * residuals[row]); });
    sums.expect_near(gradient, 1e-13);
    EXPECT_GT(*std::max_element(gradient.begin(), gradient.end()), 0);
    // Columns of constants are 0.
    for (size_t k = 0; k < 6; ++k) EXPECT_EQ(gradient[static_cast<size_t>(poses[3]) + k], 0);
    for (size_t k = 0; k < 3; ++k) {
        EXPECT_EQ(gradient[static_cast<size_t>(poses[4]) + k], 0);
        EXPECT_NE(gradient[static_cast<size_t>(poses[4]) + 3 + k], 0);
        EXPECT_EQ(gradient[static_cast<size_t>(info.num_image_camera_parameters) + 3 + k], 0);
    }
    EXPECT_EQ(gradient[static_cast<size_t>(intrinsics[1]) + 6], 0);
}

TEST_F(Evaluating, GradientIsThatOfTheCost) {
    // Along one direction, by the central difference of fourth order.
    std::vector<double> direction = argument(m), step(m);
    for (size_t k = 0; k < m; ++k) direction[k] *= 1e-2 / (1 + std::abs(gradient[k]));
    const auto cost_at = [&](double t) {
        const Problem moved = problem_of(data);
        clba_problem* p = moved.get();
        EXPECT_OK(clba_problem_set_loss(p, CLBA_LOSS_HUBER, 5));
        for (size_t k = 0; k < m; ++k) step[k] = gradient[k] != 0 ? t * direction[k] : 0;
        EXPECT_OK(clba_problem_apply_step(p, step.data()));
        return cost_of(moved, context);
    };
    const double h = 1e-3;
    const double slope =
        (8 * (cost_at(h) - cost_at(-h)) - (cost_at(2 * h) - cost_at(-2 * h))) / (12 * h);
    const double expected =
        std::inner_product(gradient.begin(), gradient.end(), direction.begin(), 0.0);
    EXPECT_NEAR(slope, expected, 1e-6 * std::abs(expected) + 1e-12 * evaluation.cost / h);
}

TEST_F(Evaluating, LeavesTheLossOut) {
    const double with_loss = evaluation.cost;
    evaluation.apply_loss = 0;
    ASSERT_OK(clba_problem_evaluate(problem.get(), context.get(), &evaluation));
    const std::vector<double> plain = residuals, plain_gradient = gradient;
    const double cost = evaluation.cost;
    EXPECT_GT(cost, 1.1 * with_loss);
    EXPECT_NEAR(cost, std::inner_product(plain.begin(), plain.end(), plain.begin(), 0.0) / 2,
                1e-12 * cost);
    ASSERT_OK(clba_problem_set_loss(problem.get(), CLBA_LOSS_NONE, 1));
    evaluate(CLBA_PRECISION_DOUBLE);
    EXPECT_EQ(evaluation.cost, cost);
    EXPECT_EQ(residuals, plain);
    EXPECT_EQ(gradient, plain_gradient);
}

TEST_F(Evaluating, MixedDiffersFromDoubleByRounding) {
    const std::vector<double> exact = of_images, exact_points = of_points, exact_g = gradient,
                              exact_r = residuals;
    const double cost = evaluation.cost;
    evaluate(CLBA_PRECISION_MIXED);
    EXPECT_EQ(evaluation.cost, cost);
    EXPECT_EQ(residuals, exact_r);
    const double single = std::numeric_limits<float>::epsilon();
    bool differs = false;
    for (size_t i = 0; i < exact.size(); ++i) {
        ASSERT_NEAR(of_images[i], exact[i], single * std::abs(exact[i]));
        differs = differs || of_images[i] != exact[i];
    }
    for (size_t i = 0; i < exact_points.size(); ++i)
        ASSERT_NEAR(of_points[i], exact_points[i], single * std::abs(exact_points[i]));
    EXPECT_TRUE(differs);
    // The gradient is in double precision.
    for (size_t k = 0; k < m; ++k)
        ASSERT_NEAR(gradient[k], exact_g[k], 1e-10 * (1 + std::abs(exact_g[k])));
}

TEST_F(Evaluating, Products) {
    const std::vector<double> x = argument(m), y = argument(2 * n);
    std::vector<double> jx(2 * n), jty(m);
    for (const int32_t precision :
         {CLBA_PRECISION_DOUBLE, CLBA_PRECISION_MIXED, CLBA_PRECISION_SINGLE}) {
        evaluate(precision);
        Sums expected_jx(2 * n), expected_jty(m);
        entries([&](size_t row, size_t k, double value) {
            expected_jx.add(row, value * x[k]);
            expected_jty.add(k, value * y[row]);
        });
        clba_problem* p = problem.get();
        ASSERT_OK(clba_problem_multiply(p, context.get(), CLBA_PRODUCT_JX, precision, 0, x.data(),
                                        jx.data()));
        ASSERT_OK(clba_problem_multiply(p, context.get(), CLBA_PRODUCT_JTY, precision, 0, y.data(),
                                        jty.data()));
        const double unit = precision == CLBA_PRECISION_DOUBLE ? 1e-14 : 2e-6;
        expected_jx.expect_near(jx, unit);
        expected_jty.expect_near(jty, unit);
    }
}

TEST_F(Evaluating, BlockJacobiInvertsTheDiagonalBlocks) {
    // The block of each parameter: an image with its own camera, a shared camera, a point.
    std::vector<size_t> block(m);
    for (size_t k = static_cast<size_t>(info.num_image_camera_parameters); k < m; ++k)
        block[k] = 100 + (k - static_cast<size_t>(info.num_image_camera_parameters)) / 3;
    for (size_t i = 0; i < 8; ++i) {
        const auto camera = static_cast<size_t>(data.cameras[i]);
        const bool is_own = camera != 1;
        const auto num_params =
            static_cast<size_t>(clba_camera_model_num_params(data.models[camera]));
        for (size_t k = 0; k < 6; ++k) block[static_cast<size_t>(poses[i]) + k] = i;
        for (size_t k = 0; k < num_params; ++k)
            block[static_cast<size_t>(intrinsics[camera]) + k] = is_own ? i : 50;
    }
    for (size_t k = 0; k < 3; ++k) block[static_cast<size_t>(intrinsics[2]) + k] = 51;
    std::vector<double> dense(2 * n * m, 0.0), diagonal(m, 0.0);
    entries([&](size_t row, size_t k, double value) { dense[row * m + k] += value; });
    for (size_t row = 0; row < 2 * n; ++row)
        for (size_t k = 0; k < m; ++k) diagonal[k] += dense[row * m + k] * dense[row * m + k];
    // x = M y for a known y; y = M^-1 x has to come back.
    const double lambda = 0.5;
    std::vector<double> y = argument(m), x(m), got(m);
    for (size_t k = 0; k < m; ++k)
        if (diagonal[k] == 0) y[k] = 0;
    for (size_t k = 0; k < m; ++k) x[k] = lambda * diagonal[k] * y[k];
    for (size_t row = 0; row < 2 * n; ++row)
        for (size_t k = 0; k < m; ++k) {
            const double j = dense[row * m + k];
            if (j == 0) continue;
            for (size_t l = 0; l < m; ++l)
                if (block[l] == block[k]) x[k] += j * dense[row * m + l] * y[l];
        }
    ASSERT_OK(clba_problem_multiply(problem.get(), context.get(), CLBA_PRODUCT_BLOCK_JACOBI,
                                    CLBA_PRECISION_DOUBLE, lambda, x.data(), got.data()));
    // With lambda = 1 / 2 a scaled block's condition is below 3 times its size of at most 14.
    for (size_t k = 0; k < m; ++k) {
        double error_scale = 0;
        for (size_t l = 0; l < m; ++l)
            if (block[l] == block[k] && diagonal[k] > 0)
                error_scale += std::abs(y[l]) * std::sqrt(diagonal[l] / diagonal[k]);
        ASSERT_NEAR(got[k], y[k], 1000 * epsilon * error_scale) << k;
    }
}

TEST_F(Evaluating, ApplyStepMovesInTheTangentSpace) {
    // Image 0 turns by w about its own centre and moves by v along its own axes.
    std::vector<double> step(m, 0.0), before(3), after(3);
    const double angle = 0.3;
    step[0] = angle;
    ASSERT_OK(clba_problem_get_centers(problem.get(), 0, 1, before.data(), 0));
    const Data old = data_of(problem);
    ASSERT_OK(clba_problem_apply_step(problem.get(), step.data()));
    ASSERT_OK(clba_problem_get_centers(problem.get(), 0, 1, after.data(), 0));
    const double size = std::abs(before[0]) + std::abs(before[1]) + std::abs(before[2]);
    for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(after[k], before[k], 100 * epsilon * size);
    const Data turned = data_of(problem);
    EXPECT_NEAR(turned.poses[0],
                std::cos(angle / 2) * old.poses[0] - std::sin(angle / 2) * old.poses[1], 1e-15);
    EXPECT_EQ(turned.xyz, old.xyz);

    step.assign(m, 1.0);
    ASSERT_OK(clba_problem_apply_step(problem.get(), step.data()));
    const Data moved = data_of(problem);
    const auto pose_of_3 = [](const Data& d) {
        return std::vector<double>(d.poses.begin() + 21, d.poses.begin() + 28);
    };
    EXPECT_EQ(pose_of_3(moved), pose_of_3(turned));
    for (size_t k = 28; k < 32; ++k) EXPECT_EQ(moved.poses[k], turned.poses[k]);
    for (size_t k = 32; k < 35; ++k) EXPECT_EQ(moved.poses[k], turned.poses[k] + 1);
    EXPECT_EQ(moved.xyz[0], turned.xyz[0] + 1);
    EXPECT_EQ(moved.xyz[3], turned.xyz[3]);
    EXPECT_EQ(moved.params[0], turned.params[0] + 1);
}

TEST_F(Evaluating, RefusesWhatItCannotCompute) {
    std::vector<double> x(m, 1.0), y(m + 2 * n);
    clba_problem* p = problem.get();
    clba_context* c = context.get();
    EXPECT_TRUE(refused(clba_problem_evaluate(nullptr, c, &evaluation), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_evaluate(p, nullptr, &evaluation), {"context"}));
    EXPECT_TRUE(refused(clba_problem_evaluate(p, c, nullptr), {"evaluation"}));
    evaluation.precision = 0;
    EXPECT_TRUE(refused(clba_problem_evaluate(p, c, &evaluation), {"precision"}));
    const auto multiply = [&](int32_t product, int32_t precision, double lambda) {
        return clba_problem_multiply(p, c, product, precision, lambda, x.data(), y.data());
    };
    EXPECT_TRUE(refused(multiply(0, 1, 0), {"product = 0"}));
    EXPECT_TRUE(refused(multiply(4, 1, 0), {"product = 4"}));
    EXPECT_TRUE(refused(multiply(1, 4, 0), {"precision = 4"}));
    for (double bad : {-1.0, nan, infinity})
        EXPECT_TRUE(refused(multiply(CLBA_PRODUCT_BLOCK_JACOBI, 1, bad), {"lambda"}));
    EXPECT_TRUE(
        refused(clba_problem_multiply(nullptr, c, 1, 1, 0, x.data(), y.data()), {"problem"}));
    EXPECT_TRUE(
        refused(clba_problem_multiply(p, nullptr, 1, 1, 0, x.data(), y.data()), {"context"}));
    EXPECT_TRUE(refused(clba_problem_multiply(p, c, 1, 1, 0, nullptr, y.data()), {"x is NULL"}));
    EXPECT_TRUE(refused(clba_problem_multiply(p, c, 1, 1, 0, x.data(), nullptr), {"y is NULL"}));
    // A point that one image sees has a block of rank 2.
    Data thin = data;
    const auto last = std::find(thin.points.begin(), thin.points.end(), 0);
    const int32_t point = *last;
    for (size_t i = static_cast<size_t>(last - thin.points.begin()) + 1; i < thin.points.size();
         ++i)
        if (thin.points[i] == point) thin.points[i] = 2;
    const Problem thinned = problem_of(thin);
    EXPECT_TRUE(refused(clba_problem_multiply(thinned.get(), c, CLBA_PRODUCT_BLOCK_JACOBI,
                                              CLBA_PRECISION_DOUBLE, 0, x.data(), y.data()),
                        {"positive definite", "lambda"}));
}

}  // namespace
}  // namespace clba_test
