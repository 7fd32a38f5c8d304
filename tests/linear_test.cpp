// SPDX-License-Identifier: Apache-2.0
// Linear solvers against each other and against the direct solution by CHOLMOD.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "device_rig.hpp"
#include "linear/linear_solver.hpp"
#include "optimizer/evaluator.hpp"
#include "problem/parameter_layout.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

// The normal equations of a problem's state.
struct System {
    System(const Problem& host, Precision precision)
        : problem(host),
          device(test::test_context(), host, precision),
          evaluator(device, host),
          equations(device, DampingOptions()) {
        device.upload_state(host);
        evaluator.linearize(equations);
        equations.update_blocks();
    }

    std::vector<double> solve(LinearSolverKind kind, Preconditioner preconditioner, double lambda,
                              double eta, LinearSolution* solution = nullptr,
                              int min_iterations = 0) {
        LinearSolverOptions options;
        options.kind = kind;
        options.preconditioner = preconditioner;
        options.eta = eta;
        options.max_iterations = 2000;
        options.min_iterations = min_iterations;
        const auto solver = make_linear_solver(options, problem, equations);
        Vector step = device.make_vector("step");
        const LinearSolution found = solver->solve(lambda, step);
        if (solution) *solution = found;
        std::vector<double> values(static_cast<size_t>(device.layout().num_parameters(problem)));
        device.download(step, values.data());
        return values;
    }

    const Problem& problem;
    DeviceProblem device;
    Evaluator evaluator;
    NormalEquations equations;
};

double norm(const std::vector<double>& x) {
    double sum = 0;
    for (double value : x) sum += value * value;
    return std::sqrt(sum);
}

double distance(std::vector<double> a, const std::vector<double>& b) {
    for (size_t i = 0; i < a.size(); ++i) a[i] -= b[i];
    return norm(a);
}

struct Method {
    const char* name;
    LinearSolverKind kind;
    Preconditioner preconditioner;
};
constexpr Method pcg_methods[] = {
    {"pcg_schur schur_jacobi", LinearSolverKind::pcg_schur, Preconditioner::schur_jacobi},
    {"pcg_schur block_jacobi", LinearSolverKind::pcg_schur, Preconditioner::block_jacobi},
    {"pcg_hessian block_jacobi", LinearSolverKind::pcg_hessian, Preconditioner::block_jacobi},
};

struct Case {
    const char* name;
    Problem problem;
};

std::vector<Case> cases() {
    using namespace test;
    return {
        {"own snavely cameras", small_scene(6, 60, {camera_snavely}, false, 1)},
        {"shared snavely cameras", small_scene(6, 60, {camera_snavely}, true, 2)},
        {"mixed models", mixed_scene(6, 60, 3)},
        {"constants", with_constants(small_scene(6, 60, {camera_snavely}, false, 4))},
        {"uncertainties", with_uncertainties(small_scene(6, 60, {camera_snavely}, false, 5), 6)}};
}

TEST(LinearSolvers, PcgEqualsCholmod) {
    constexpr double lambda = 1e-2;
    for (const Case& test_case : cases()) {
        for (const Precision precision : {Precision::double_precision, Precision::mixed}) {
            System system(test_case.problem, precision);
            LinearSolution direct;
            const std::vector<double> expected = system.solve(
                LinearSolverKind::direct_schur, Preconditioner::none, lambda, 0.1, &direct);
            ASSERT_TRUE(direct.is_usable) << test_case.name;
            ASSERT_GT(norm(expected), 0);
            for (const Method& method : pcg_methods) {
                // The products' rounding, times a condition number below 1e5 of the preconditioned
                // systems at this lambda. The test of the quadratic model sees no more than the
                // square root of it: so many iterations are asked for.
                constexpr int enough_iterations = 300;
                const double epsilon = precision == Precision::mixed
                                           ? std::numeric_limits<float>::epsilon()
                                           : std::numeric_limits<double>::epsilon();
                const double tolerance = 1e5 * epsilon;
                LinearSolution solution;
                const std::vector<double> step = system.solve(
                    method.kind, method.preconditioner, lambda,
                    std::numeric_limits<double>::epsilon(), &solution, enough_iterations);
                EXPECT_TRUE(solution.is_usable);
                EXPECT_LE(distance(step, expected), tolerance * norm(expected))
                    << test_case.name << ", " << method.name << ", " << real_type(precision) << ", "
                    << solution.num_iterations << " iterations";
            }
        }
    }
}

TEST(LinearSolvers, ConstantParametersHaveNoStep) {
    const Problem problem =
        test::with_constants(test::small_scene(6, 60, {camera_snavely}, false, 4));
    System system(problem, Precision::mixed);
    const ParameterLayout layout(problem);
    for (const Method& method : pcg_methods) {
        const std::vector<double> step =
            system.solve(method.kind, method.preconditioner, 1e-4, 0.1);
        for (int32_t k = 0; k < layout.num_f; ++k) {
            if (!(layout.scale[k] > 0)) {
                EXPECT_EQ(step[k], 0) << method.name << " scalar " << k;
            }
        }
        for (int32_t p = 0; p < problem.num_points(); ++p) {
            if (point_scale(problem, p)[0] > 0) continue;
            for (int k = 0; k < 3; ++k)
                EXPECT_EQ(step[layout.num_f + 3 * p + k], 0) << method.name << " point " << p;
        }
    }
}

TEST(LinearSolvers, ReducedSystemIsSymmetric) {
    for (const Case& test_case : cases()) {
        System system(test_case.problem, Precision::double_precision);
        ASSERT_EQ(system.equations.factor_points(1e-3), 0);
        const int64_t n = system.device.layout().num_parameters(test_case.problem);
        Vector x = system.device.make_vector("x"), y = system.device.make_vector("y");
        Vector sx = system.device.make_reduced_vector("sx"),
               sy = system.device.make_reduced_vector("sy");
        system.device.upload(test::random_vector(n, 7).data(), x);
        system.device.upload(test::random_vector(n, 8).data(), y);
        system.equations.jacobian.schur_multiply(x, system.equations.point_factors(), sx);
        system.equations.jacobian.schur_multiply(y, system.equations.point_factors(), sy);
        VectorOperations& vectors = system.device.vectors();
        const double scale = std::sqrt(vectors.dot(sx, sx) * vectors.dot(sy, sy));
        EXPECT_NEAR(vectors.dot(sy, x), vectors.dot(sx, y),
                    1e3 * std::numeric_limits<double>::epsilon() * scale)
            << test_case.name;
    }
}

TEST(LinearSolvers, LooserForcingTakesFewerIterations) {
    const Problem problem = test::small_scene(12, 150, {camera_snavely}, false, 9);
    System system(problem, Precision::mixed);
    for (const Method& method : pcg_methods) {
        LinearSolution loose, tight;
        system.solve(method.kind, method.preconditioner, 1e-4, 0.5, &loose);
        system.solve(method.kind, method.preconditioner, 1e-4, 1e-6, &tight);
        EXPECT_LT(loose.num_iterations, tight.num_iterations) << method.name;
    }
}

TEST(LinearSolvers, IterationLimitsHold) {
    const Problem problem = test::small_scene(12, 150, {camera_snavely}, false, 9);
    System system(problem, Precision::mixed);
    for (const Method& method : pcg_methods) {
        LinearSolverOptions options;
        options.kind = method.kind;
        options.preconditioner = method.preconditioner;
        Vector step = system.device.make_vector("step");
        options.eta = 1e-12;
        options.max_iterations = 3;
        EXPECT_EQ(make_linear_solver(options, problem, system.equations)
                      ->solve(1e-4, step)
                      .num_iterations,
                  3)
            << method.name;
        options.eta = 0.9;
        options.max_iterations = 50;
        options.min_iterations = 7;
        EXPECT_EQ(make_linear_solver(options, problem, system.equations)
                      ->solve(1e-4, step)
                      .num_iterations,
                  7)
            << method.name;
    }
}

// Image 4 of the planted problem sees nothing: without damping its block is 0.
TEST(LinearSolvers, IndefiniteBlocksAreCountedAndDampingHeals) {
    const Problem problem = test::planted_trouble();
    System system(problem, Precision::double_precision);
    for (const Method& method : pcg_methods) {
        LinearSolution solution;
        system.solve(method.kind, method.preconditioner, 0.0, 0.1, &solution);
        EXPECT_FALSE(solution.is_usable) << method.name;
        EXPECT_GT(solution.num_indefinite_blocks, 0) << method.name;
        const std::vector<double> step =
            system.solve(method.kind, method.preconditioner, 1.0, 0.1, &solution);
        EXPECT_TRUE(solution.is_usable) << method.name;
        EXPECT_EQ(solution.num_indefinite_blocks, 0) << method.name;
        EXPECT_TRUE(std::isfinite(norm(step))) << method.name;
    }
    LinearSolution direct;
    system.solve(LinearSolverKind::direct_schur, Preconditioner::none, 0.0, 0.1, &direct);
    EXPECT_FALSE(direct.is_usable);
    EXPECT_GT(direct.num_indefinite_blocks, 0);
}

}  // namespace
}  // namespace clba
