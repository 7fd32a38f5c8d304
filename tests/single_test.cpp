// SPDX-License-Identifier: Apache-2.0
// Solves without fp64 on the device, against solves in double precision from the same start; and
// the proof that their kernels know no double.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "base/error.hpp"
#include "device_rig.hpp"
#include "optimizer/solve.hpp"
#include "reference/bundle.hpp"
#include "reference/scene.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

constexpr double float_epsilon = std::numeric_limits<float>::epsilon();

Summary run(Problem& problem, const MinimizerOptions& options, Precision precision) {
    std::unique_ptr<DeviceProblem> device;
    return solve(problem, test::test_context(), options, precision, device);
}

Problem scene(SceneKind kind) {
    SceneOptions options;
    options.kind = kind;
    options.num_images = 24;
    options.observations_per_image = 120;
    options.seed = 3;
    return generate_scene(options).start;
}

struct Case {
    const char* name;
    std::function<Problem()> make;
};
void PrintTo(const Case& test_case, std::ostream* stream) {
    *stream << test_case.name;
}

const std::vector<int32_t> various_models = {camera_opencv, camera_fov, camera_thin_prism_fisheye};

Problem small() {
    return test::small_scene(8, 120, test::all_camera_models(), true, 7);
}

const Case cases[] = {
    {"hall", [] { return scene(SceneKind::hall); }},
    {"street", [] { return scene(SceneKind::street); }},
    {"landmark", [] { return scene(SceneKind::landmark); }},
    {"far_away", [] { return test::shifted(scene(SceneKind::hall), 1e6); }},
    {"in_micrometres", [] { return test::scaled(scene(SceneKind::hall), 1e6); }},
    {"in_megametres", [] { return test::scaled(scene(SceneKind::hall), 1e-6); }},
    {"own_cameras", [] { return test::small_scene(12, 300, various_models, false, 7); }},
    {"shared_cameras", [] { return small(); }},
    {"mixed", [] { return test::mixed_scene(6, 80, 5); }},
    {"mixed_far_away", [] { return test::shifted(test::mixed_scene(6, 80, 5), 1e6); }},
    {"covariances", [] { return test::with_covariances(small(), 3); }},
    {"constants", [] { return test::with_constants(small()); }},
    {"uncertainties", [] { return test::with_uncertainties(small(), 4); }},
    {"huber", [] { return test::with_loss(small(), LossKind::huber, 0.5); }},
    {"soft_l1", [] { return test::with_loss(small(), LossKind::soft_l1, 0.5); }},
    {"cauchy", [] { return test::with_loss(small(), LossKind::cauchy, 0.5); }},
    {"tukey", [] { return test::with_loss(small(), LossKind::tukey, 100); }},
};

class SinglePrecision : public testing::TestWithParam<Case> {};

TEST_P(SinglePrecision, EndsAtTheCostOfDouble) {
    const Problem start = GetParam().make();
    for (const LinearSolverKind kind :
         {LinearSolverKind::pcg_schur, LinearSolverKind::pcg_hessian,
          LinearSolverKind::explicit_schur, LinearSolverKind::direct_schur}) {
        MinimizerOptions options;
        options.max_iterations = 200;
        // Undamped exact steps creep on along what a small scene does not determine.
        options.max_radius = 1e6;
        options.linear_solver.kind = kind;
        if (kind == LinearSolverKind::pcg_hessian) {
            options.linear_solver.preconditioner = Preconditioner::block_jacobi;
            options.linear_solver.eta = 1e-3;
        }
        Problem expected = start;
        const double cost =
            run(expected, options, Precision::double_precision).reference_final_cost;
        Problem problem = start;
        const Summary summary = run(problem, options, Precision::single);
        EXPECT_LE(summary.reference_final_cost, cost * (1 + 1e-4))
            << "solver " << static_cast<int>(kind) << ": " << summary.message;
        EXPECT_EQ(summary.termination, Termination::convergence) << summary.message;
        EXPECT_EQ(summary.precision, Precision::single);
        EXPECT_NEAR(summary.final_cost, summary.reference_final_cost,
                    1e-4 * summary.reference_final_cost);
    }
}

TEST_P(SinglePrecision, EqualBitsTwice) {
    const Problem start = GetParam().make();
    Problem a = start, b = start;
    MinimizerOptions options;
    options.max_iterations = 4;
    options.linear_solver.kind = LinearSolverKind::automatic;
    const Summary first = run(a, options, Precision::single);
    const Summary second = run(b, options, Precision::single);
    EXPECT_EQ(first.final_cost, second.final_cost);
    EXPECT_EQ(a.points, b.points);
    for (size_t i = 0; i < a.images.size(); ++i)
        EXPECT_EQ(a.images[i].pose.translation, b.images[i].pose.translation);
}

INSTANTIATE_TEST_SUITE_P(Problems, SinglePrecision, testing::ValuesIn(cases),
                         [](const auto& of) { return std::string(of.param.name); });

TEST(SinglePrecisionState, ComesBackAsItWasWhereNothingMoved) {
    const Problem start = test::shifted(test::with_constants(small()), 1e3);
    DeviceProblem device(test::test_context(), start, Precision::single);
    device.upload_state(start);
    Problem problem = start;
    device.download_state(problem);
    EXPECT_EQ(problem.points, start.points);
    for (size_t i = 0; i < start.images.size(); ++i) {
        EXPECT_EQ(problem.images[i].pose.rotation, start.images[i].pose.rotation);
        EXPECT_EQ(problem.images[i].pose.translation, start.images[i].pose.translation);
    }
    for (size_t c = 0; c < start.cameras.size(); ++c)
        EXPECT_EQ(problem.cameras[c].params, start.cameras[c].params);
}

TEST(SinglePrecisionState, ConstantsKeepTheirBits) {
    const Problem start = test::with_constants(small());
    Problem problem = start;
    EXPECT_GT(run(problem, {}, Precision::single).num_accepted_steps, 0);
    EXPECT_EQ(problem.images[0].pose.rotation, start.images[0].pose.rotation);
    EXPECT_EQ(problem.images[0].pose.translation, start.images[0].pose.translation);
    EXPECT_EQ(problem.images[1].pose.rotation, start.images[1].pose.rotation);
    const Point moved = camera_center(problem.images[2].pose);
    const Point kept = camera_center(start.images[2].pose);
    for (size_t k = 0; k < 3; ++k)
        EXPECT_NEAR(moved[k], kept[k], 64 * std::numeric_limits<double>::epsilon() * 5);
    EXPECT_EQ(problem.cameras[0].params[0], start.cameras[0].params[0]);
    EXPECT_EQ(problem.cameras.back().params, start.cameras.back().params);
    for (size_t p = 0; p < start.points.size(); ++p)
        if (start.constant_points[p]) {
            EXPECT_EQ(problem.points[p], start.points[p]) << p;
        }
}

// A step far below the resolution of a float at this distance from the origin moves the state.
TEST(SinglePrecisionState, SmallStepsAreNotLost) {
    const double distance = 1e6, length = 1e-4;
    const Problem start = test::shifted(test::mixed_scene(4, 20, 2), distance);
    DeviceProblem device(test::test_context(), start, Precision::single);
    const ParameterLayout& layout = device.layout();
    std::vector<double> step(static_cast<size_t>(layout.num_parameters(start)));
    std::fill(step.begin() + layout.num_f, step.end(), length);
    for (int32_t offset : layout.pose_offset) std::fill_n(step.begin() + offset + 3, 3, length);
    Vector on_device = device.make_vector("a step");
    device.upload(step.data(), on_device);
    device.upload_state(start);
    const int num_steps = 10;
    Problem expected = start;
    for (int k = 0; k < num_steps; ++k) {
        device.update(on_device);
        device.state.swap(device.trial);
        apply_step(layout, step.data(), expected);
    }
    Problem problem = start;
    device.download_state(problem);
    // Pairs have 48 bits; a step is rounded to a float, and turned by a rotation of floats.
    const double tolerance = num_steps * (std::ldexp(distance, -46) + 4 * float_epsilon * length);
    for (size_t p = 0; p < start.points.size(); ++p)
        for (size_t k = 0; k < 3; ++k)
            EXPECT_NEAR(problem.points[p][k], expected.points[p][k], tolerance);
    for (size_t i = 0; i < start.images.size(); ++i) {
        const Point center = camera_center(problem.images[i].pose);
        const Point wanted = camera_center(expected.images[i].pose);
        for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(center[k], wanted[k], tolerance);
    }
}

// Residuals are as good far from the origin as near it.
TEST(SinglePrecisionResiduals, HaveTheDigitsOfFloats) {
    for (const double offset : {0.0, 1e6}) {
        const Problem problem = test::shifted(small(), offset);
        std::vector<double> expected(2 * problem.observations.size());
        reference::residual(problem, expected.data());
        DeviceProblem device(test::test_context(), problem, Precision::single);
        device.upload_state(problem);
        Evaluator evaluator(device, problem);
        const auto two_rows = [](const CameraModel&) { return 2; };
        std::vector<Buffer> slots = device.make_slot_rows(two_rows, sizeof(float), "residuals");
        evaluator.cost(device.state, &slots);
        double largest = 0;
        device.visit_slots<float>(slots, two_rows, [&](int64_t i, int, auto&& slot) {
            const double x = slot(0) - expected[2 * i], y = slot(1) - expected[2 * i + 1];
            largest = std::max(largest, std::hypot(x, y));
        });
        // Pixels are below 2000, and 1e6 leaves 4e-9 of a distance of 5 in a pair.
        EXPECT_LE(largest, 32 * float_epsilon * 2000) << offset;
    }
}

TEST(SinglePrecisionTrouble, IsCountedAndAnswered) {
    const Problem start = test::planted_trouble();
    for (const LinearSolverKind kind :
         {LinearSolverKind::pcg_schur, LinearSolverKind::explicit_schur}) {
        Problem problem = start;
        MinimizerOptions options;
        options.linear_solver.kind = kind;
        const Summary summary = run(problem, options, Precision::single);
        EXPECT_EQ(summary.num_behind_initial, test::planted_num_behind);
        EXPECT_NE(summary.termination, Termination::failure) << summary.message;
        EXPECT_LT(summary.reference_final_cost, summary.initial_cost);
    }
    DeviceProblem device(test::test_context(), start, Precision::single);
    device.upload_state(start);
    EXPECT_EQ(Evaluator(device, start).cost(device.state, nullptr).num_singular,
              test::planted_num_singular);
}

// At the minimum the cost changes by rounding alone: that must end the solve, not damp it to death.
TEST(SinglePrecisionTrouble, RoundingEndsASolve) {
    Problem problem = scene(SceneKind::hall);
    MinimizerOptions options;
    options.function_tolerance = 1e-12;
    options.max_iterations = 200;
    const Summary summary = run(problem, options, Precision::single);
    EXPECT_EQ(summary.termination, Termination::convergence);
    EXPECT_LE(summary.rows.size(), 40u);
}

TEST(SinglePrecisionKernels, CompileWithoutDouble) {
    const std::shared_ptr<Context> context = test::test_context();
    const std::string options =
        precision_defines(Precision::single) +
        " -cl-std=CL1.2 -DLANE_LOOP=" + (context->tuning.lane_loop ? "1" : "0");
    const auto expect_compiles = [&](const char* path, const CameraModel& model, const char* form) {
        EXPECT_NO_THROW(context->program(path, std::string("camera_models/") + model.name + ".clh",
                                         options + form))
            << path << ", " << model.name;
    };
    constexpr const char* bare = " -DSTORED=0 -DWEIGHT_ROWS=0 -DWHITENED=0 -DLOSS=3";
    constexpr const char* full = " -DSTORED=1 -DWEIGHT_ROWS=3 -DWHITENED=1 -DLOSS=1";
    for (const char* path :
         {"residual.cl", "linearize.cl", "products.cl", "blocks.cl", "schur_records.cl"})
        for (const char* form : {bare, full})
            for (int32_t model : {camera_snavely, camera_opencv})
                expect_compiles(path, camera_models[model], form);
    for (const char* path : {"residual.cl", "linearize.cl"})
        for (const CameraModel& model : camera_models) expect_compiles(path, model, bare);
    for (const char* path :
         {"state.cl", "vector.cl", "pcg.cl", "reduce.cl", "factors.cl", "schur_pairs.cl"})
        EXPECT_NO_THROW(context->program(path, "", options)) << path;
    // The word is forbidden indeed.
    EXPECT_THROW(context->program("vector.cl", "", options + " -DREAL=double"), Error);
    EXPECT_THROW(
        context->program("residual.cl", "camera_models/snavely.clh", options + " -DWIDE=double"),
        Error);
}

}  // namespace
}  // namespace clba
