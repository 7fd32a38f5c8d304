// SPDX-License-Identifier: Apache-2.0
// Whole solves of generated scenes: convergence, determinism, and every way to end.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "device_rig.hpp"
#include "optimizer/solve.hpp"
#include "reference/bundle.hpp"
#include "reference/compare.hpp"
#include "reference/scene.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

Summary run(Problem& problem, const MinimizerOptions& options = {},
            Precision precision = Precision::mixed) {
    std::unique_ptr<DeviceProblem> device;
    return solve(problem, test::test_context(), options, precision, device);
}

Problem scene(SceneKind kind, int32_t num_images = 24) {
    SceneOptions options;
    options.kind = kind;
    options.num_images = num_images;
    options.observations_per_image = 120;
    options.seed = 3;
    return generate_scene(options).start;
}

MinimizerOptions options_for(LinearSolverKind kind, Preconditioner preconditioner, double eta) {
    MinimizerOptions options;
    options.linear_solver.kind = kind;
    options.linear_solver.preconditioner = preconditioner;
    options.linear_solver.eta = eta;
    options.max_iterations = 100;
    options.function_tolerance = 1e-8;
    return options;
}

std::vector<MinimizerOptions> all_solvers() {
    return {options_for(LinearSolverKind::direct_schur, Preconditioner::none, 0.1),
            options_for(LinearSolverKind::pcg_schur, Preconditioner::schur_jacobi, 0.1),
            options_for(LinearSolverKind::pcg_schur, Preconditioner::block_jacobi, 1e-2),
            options_for(LinearSolverKind::pcg_hessian, Preconditioner::block_jacobi, 1e-3)};
}

void expect_sound(const Summary& summary) {
    EXPECT_EQ(summary.rows.front().cost, summary.initial_cost);
    EXPECT_EQ(summary.rows.back().cost, summary.final_cost);
    EXPECT_FALSE(summary.message.empty());
    // The device's sums and the reference's differ by rounding of as many terms.
    EXPECT_NEAR(summary.final_cost, summary.reference_final_cost,
                1e-11 * summary.reference_final_cost);
    int accepted = 0, rejected = 0, invalid = 0;
    for (size_t i = 1; i < summary.rows.size(); ++i) {
        const IterationRow& row = summary.rows[i];
        EXPECT_EQ(row.iteration, static_cast<int>(i));
        if (row.step_is_accepted) {
            ++accepted;
            EXPECT_LT(row.cost, summary.rows[i - 1].cost);
            EXPECT_GT(row.cost_change, 0);
        } else {
            EXPECT_EQ(row.cost, summary.rows[i - 1].cost);
            ++(row.step_is_valid ? rejected : invalid);
        }
    }
    EXPECT_EQ(accepted, summary.num_accepted_steps);
    EXPECT_EQ(rejected, summary.num_rejected_steps);
    EXPECT_EQ(invalid, summary.num_invalid_steps);
}

TEST(Solver, EverySolverReachesTheSameMinimum) {
    for (const SceneKind kind : {SceneKind::hall, SceneKind::street, SceneKind::landmark}) {
        const Problem start = scene(kind);
        double expected = 0;
        for (const MinimizerOptions& options : all_solvers()) {
            for (const Precision precision : {Precision::double_precision, Precision::mixed}) {
                Problem problem = start;
                const Summary summary = run(problem, options, precision);
                expect_sound(summary);
                EXPECT_EQ(summary.termination, Termination::convergence) << summary.message;
                if (expected == 0) expected = summary.final_cost;
                EXPECT_NEAR(summary.final_cost, expected, 1e-5 * expected)
                    << "scene " << static_cast<int>(kind) << ", solver "
                    << static_cast<int>(options.linear_solver.kind) << ", " << real_type(precision);
            }
        }
        // Two residuals an observation of variance 0.25, less what the parameters take up.
        EXPECT_LT(expected, 0.25 * static_cast<double>(start.num_observations()));
    }
}

TEST(Solver, EveryDampingPolicyConverges) {
    const Problem start = scene(SceneKind::hall);
    double expected = 0;
    for (const Damping damping : {Damping::marquardt, Damping::levenberg, Damping::uncertainty}) {
        MinimizerOptions options = all_solvers()[1];
        options.damping.policy = damping;
        Problem problem = start;
        const Summary summary = run(problem, options);
        expect_sound(summary);
        if (expected == 0) expected = summary.final_cost;
        EXPECT_NEAR(summary.final_cost, expected, 1e-4 * expected)
            << "damping " << static_cast<int>(damping);
    }
}

// Marquardt's damping is invariant under column scaling: uncertainties change nothing but rounding.
// Under the other policies they change the path.
TEST(Solver, UncertaintiesActByTheDampingPolicy) {
    const Problem start = scene(SceneKind::hall);
    const Problem weighted = test::with_uncertainties(start, 11);
    const auto path = [&](Problem problem, Damping damping) {
        MinimizerOptions options = all_solvers()[0];
        options.damping.policy = damping;
        options.max_iterations = 4;
        options.initial_radius = 1;
        return run(problem, options, Precision::double_precision).rows;
    };
    const auto largest_difference = [&](Damping damping) {
        const std::vector<IterationRow> a = path(start, damping), b = path(weighted, damping);
        double largest = 0;
        for (size_t i = 0; i < std::min(a.size(), b.size()); ++i)
            largest = std::max(largest, std::abs(a[i].cost - b[i].cost) / a[i].cost);
        return largest;
    };
    EXPECT_LT(largest_difference(Damping::marquardt), 1e-8);
    EXPECT_GT(largest_difference(Damping::levenberg), 1e-6);
    EXPECT_GT(largest_difference(Damping::uncertainty), 1e-6);
}

bool equal_states(const Problem& a, const Problem& b) {
    return std::equal(a.images.begin(), a.images.end(), b.images.begin(),
                      [](const Image& x, const Image& y) {
                          return x.pose.rotation == y.pose.rotation &&
                                 x.pose.translation == y.pose.translation;
                      }) &&
           a.points == b.points;
}

// The weights of Tong et al. (2013), extrinsics some 1000 times as uncertain as intrinsics,
// multiply the columns of J, and Marquardt's D^2 = diag(J^T J) with them: the iterates stay those
// of no weights. With a power of two not even rounding differs.
TEST(Solver, WeightsDoNotChangeTheIteratesUnderMarquardtsDamping) {
    const Problem start = scene(SceneKind::hall);
    Problem weighted = start;
    weighted.image_uncertainties.assign(start.images.size(), {1024, 1024, 1024, 1024, 1024, 1024});
    weighted.camera_uncertainties.assign(start.cameras.size(), {1, 1, 1});
    weighted.point_uncertainties.assign(start.points.size(), {1024, 1024, 1024});
    MinimizerOptions options = all_solvers().back();
    options.jacobian = JacobianForm::stored;
    for (const int iterations : {1, 2, 4}) {
        options.max_iterations = iterations;
        Problem a = start, b = weighted;
        ASSERT_EQ(run(a, options, Precision::double_precision).num_accepted_steps, iterations);
        run(b, options, Precision::double_precision);
        EXPECT_TRUE(equal_states(a, b)) << "after " << iterations << " iterations";
    }
}

TEST(Solver, EqualRunsGiveEqualBits) {
    const Problem start = scene(SceneKind::landmark);
    for (const MinimizerOptions& options : all_solvers()) {
        Problem first = start, second = start;
        const Summary a = run(first, options), b = run(second, options);
        EXPECT_TRUE(equal_states(first, second));
        ASSERT_EQ(a.rows.size(), b.rows.size());
        for (size_t i = 0; i < a.rows.size(); ++i) EXPECT_EQ(a.rows[i].cost, b.rows[i].cost);
    }
}

TEST(Solver, OrderOfInputChangesRoundingOnly) {
    const Problem start = scene(SceneKind::hall);
    Problem permuted = start;
    std::reverse(permuted.observations.begin(), permuted.observations.end());
    std::vector<int32_t> new_point(start.points.size());
    std::iota(new_point.begin(), new_point.end(), 0);
    std::rotate(new_point.begin(), new_point.begin() + 17, new_point.end());
    for (size_t p = 0; p < start.points.size(); ++p)
        permuted.points[new_point[p]] = start.points[p];
    for (Observation& o : permuted.observations) o.point = new_point[o.point];

    MinimizerOptions options = all_solvers()[1];
    options.function_tolerance = 1e-12;
    Problem a = start, b = permuted;
    const Summary first = run(a, options, Precision::double_precision);
    const Summary second = run(b, options, Precision::double_precision);
    EXPECT_NEAR(first.final_cost, second.final_cost, 1e-9 * first.final_cost);
    const auto camera = [](const Problem& p, size_t i) { return camera_center(p.images[i].pose); };
    for (size_t i = 0; i < a.images.size(); ++i)
        for (int k = 0; k < 3; ++k) EXPECT_NEAR(camera(a, i)[k], camera(b, i)[k], 1e-4);
}

TEST(Solver, LargeCoordinatesLoseNothing) {
    const Problem start = scene(SceneKind::hall);
    MinimizerOptions options = all_solvers()[1];
    Problem near = start, far = test::shifted(start, 1e6);
    const Summary expected = run(near, options);
    const Summary moved = run(far, options);
    EXPECT_NEAR(moved.final_cost, expected.final_cost, 1e-5 * expected.final_cost);
}

// Points behind their camera, seen once, or not at all; images that see nothing; repeated pairs.
TEST(Solver, PlantedTroubleIsCountedAndSolved) {
    for (const MinimizerOptions& options : all_solvers()) {
        Problem problem = test::planted_trouble();
        // Out of the camera's plane: a step that leaves it would be rejected for ever, because the
        // cost jumps there.
        for (Observation& o : problem.observations)
            if (o.image == 0 && (o.point == 11 || o.point == 12)) o.image = 3;
        for (int p = 1; p < 10; ++p) problem.points[p][0] += 0.02;
        const Summary summary = run(problem, options);
        expect_sound(summary);
        EXPECT_EQ(summary.num_behind_initial, test::planted_num_behind);
        EXPECT_LT(summary.final_cost, 0.5 * summary.initial_cost);
        for (const Point& point : problem.points)
            for (double x : point) EXPECT_TRUE(std::isfinite(x));
    }
}

TEST(Solver, SingularObservationsAreCountedAndDoNoHarm) {
    for (const MinimizerOptions& options : all_solvers()) {
        Problem problem = test::planted_trouble();
        const Summary summary = run(problem, options);
        expect_sound(summary);
        EXPECT_EQ(summary.num_singular, test::planted_num_singular);
        EXPECT_LE(summary.final_cost, summary.initial_cost);
        for (const Point& point : problem.points)
            for (double x : point) EXPECT_TRUE(std::isfinite(x));
    }
}

TEST(Solver, SharedCamerasStaySharedAndConstantsStay) {
    Problem problem = test::with_constants(test::mixed_scene(6, 80, 5));
    const Problem start = problem;
    const Summary summary = run(problem, all_solvers()[1]);
    expect_sound(summary);
    EXPECT_LT(summary.final_cost, summary.initial_cost);
    EXPECT_EQ(problem.images[0].pose.rotation, start.images[0].pose.rotation);
    EXPECT_EQ(problem.images[0].pose.translation, start.images[0].pose.translation);
    EXPECT_EQ(problem.images[1].pose.rotation, start.images[1].pose.rotation);
    const Point before = camera_center(start.images[2].pose);
    const Point after = camera_center(problem.images[2].pose);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(before[k], after[k], 1e-12);
    EXPECT_NE(problem.images[2].pose.rotation, start.images[2].pose.rotation);
    EXPECT_EQ(problem.points[0], start.points[0]);
    EXPECT_NE(problem.points[1], start.points[1]);
}

// All camera models in one problem, in exact pixels: the solve must find the state these came from.
TEST(Solver, EveryModelIsRecovered) {
    const test::Recoverable scene = test::recoverable_scene();
    for (const LinearSolverKind kind :
         {LinearSolverKind::explicit_schur, LinearSolverKind::direct_schur}) {
        MinimizerOptions options = options_for(kind, Preconditioner::none, 0.1);
        // Newton's steps end at rounding, after those along what full_opencv's factor hardly shows.
        options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 0;
        options.max_iterations = 22;
        Problem problem = scene.start;
        const Summary summary = run(problem, options, Precision::double_precision);
        EXPECT_GT(summary.initial_cost, 1e3);
        EXPECT_LT(summary.final_cost, 1e-18);
        EXPECT_EQ(summary.num_behind_final, 0);
        const Comparison left = compare(scene.truth, problem);
        EXPECT_LT(left.max_center_distance, 1e-9);
        EXPECT_LT(left.max_point_distance, 1e-9);
        for (size_t c = 0; c < problem.cameras.size(); ++c)
            for (int k = 0; k < problem.cameras[c].num_params(); ++k) {
                const double truth = scene.truth.cameras[c].params[k];
                EXPECT_NEAR(problem.cameras[c].params[k], truth,
                            1e-9 * std::max(1.0, std::abs(truth)))
                    << camera_models[problem.cameras[c].model].name << ", parameter " << k;
            }
    }
}

TEST(Solver, SeveralChunksGiveTheSameResult) {
    const Problem start = scene(SceneKind::hall);
    const auto small_buffers = test::test_context(200000);
    for (const MinimizerOptions& options : all_solvers()) {
        Problem whole = start, chunked = start;
        std::unique_ptr<DeviceProblem> device;
        const Summary summary =
            solve(chunked, small_buffers, options, Precision::double_precision, device);
        ASSERT_GT(device->chunks().size(), 1u);
        expect_sound(summary);
        const Summary expected = run(whole, options, Precision::double_precision);
        EXPECT_NEAR(summary.final_cost, expected.final_cost, 1e-7 * expected.final_cost);
    }
}

TEST(Solver, EveryLimitEndsTheSolve) {
    const Problem start = scene(SceneKind::hall);
    const auto reason_with = [&](auto&& change) {
        MinimizerOptions options;
        change(options);
        Problem problem = start;
        const Summary summary = run(problem, options);
        expect_sound(summary);
        return summary.reason;
    };
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.max_iterations = 0; }),
              Reason::max_iterations);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.max_iterations = 2; }),
              Reason::max_iterations);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.max_seconds = 1e-9; }), Reason::max_seconds);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.target_cost = 1e6; }), Reason::target_cost);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.gradient_tolerance = 1e12; }),
              Reason::gradient_tolerance);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.parameter_tolerance = 1e3; }),
              Reason::parameter_tolerance);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) { o.function_tolerance = 0.9; }),
              Reason::function_tolerance);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) {
                  o.initial_radius = 1e-3;
                  o.min_radius = 1;
              }),
              Reason::min_radius);
    EXPECT_EQ(reason_with([](MinimizerOptions& o) {
                  o.on_iteration = [](const IterationRow& row) { return row.iteration < 1; };
              }),
              Reason::callback);
}

TEST(Solver, DampingBelowTheRoundingOfProductsIsRaised) {
    const Problem start = scene(SceneKind::hall);
    MinimizerOptions options =
        options_for(LinearSolverKind::explicit_schur, Preconditioner::schur_jacobi, 0.1);
    Problem problem = start;
    const double expected = run(problem, options, Precision::double_precision).final_cost;
    options.initial_radius = 1e16;  // S in fp32 is indefinite
    problem = start;
    const Summary summary = run(problem, options);
    expect_sound(summary);
    EXPECT_GT(summary.num_invalid_steps, 0);
    EXPECT_EQ(summary.reason, Reason::function_tolerance);
    EXPECT_NEAR(summary.final_cost, expected, 1e-6 * expected);
}

TEST(Solver, StartThatIsNotFiniteFails) {
    Problem problem = scene(SceneKind::hall);
    problem.points[5] = {1e300, -1e300, 1e300};
    problem.cameras[0].params[0] = 1e300;
    const Problem start = problem;
    const Summary summary = run(problem);
    EXPECT_EQ(summary.termination, Termination::failure);
    EXPECT_EQ(summary.reason, Reason::invalid_start);
    EXPECT_TRUE(equal_states(problem, start));
}

TEST(Solver, NothingToDo) {
    Problem empty = scene(SceneKind::hall);
    empty.observations.clear();
    EXPECT_EQ(run(empty).reason, Reason::nothing_to_do);
    Problem constant = scene(SceneKind::hall);
    constant.constant_images.assign(constant.images.size(), constant_rotation | constant_position);
    constant.constant_cameras.assign(constant.cameras.size(), 7);
    constant.constant_points.assign(constant.points.size(), 1);
    const Summary summary = run(constant);
    EXPECT_EQ(summary.reason, Reason::nothing_to_do);
    EXPECT_GT(summary.final_cost, 0);
}

TEST(Solver, RobustLossesLeaveOutliersAside) {
    SceneOptions options;
    options.num_images = 24;
    options.observations_per_image = 150;
    options.outlier_share = 0.05;
    options.seed = 4;
    const Scene generated = generate_scene(options);
    const auto error = [&](Loss loss) {
        Problem problem = generated.start;
        problem.loss = loss;
        MinimizerOptions solver = all_solvers()[1];
        expect_sound(run(problem, solver));
        // Focal lengths are free of the gauge.
        double sum = 0;
        for (size_t i = 0; i < problem.cameras.size(); ++i)
            sum += std::abs(problem.cameras[i].params[0] - generated.truth.cameras[i].params[0]);
        return sum / static_cast<double>(problem.cameras.size());
    };
    const double plain = error({});
    for (const LossKind kind : {LossKind::huber, LossKind::soft_l1, LossKind::cauchy})
        EXPECT_LT(error({kind, 1.0}), 0.3 * plain) << "loss " << static_cast<int>(kind);
}

}  // namespace
}  // namespace clba
