// SPDX-License-Identifier: Apache-2.0
// Linear solvers against each other and against the direct solution by CHOLMOD.
#include <gtest/gtest.h>

#include <cmath>
#include <iterator>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "device_rig.hpp"
#include "linear/direct_solver.hpp"
#include "linear/linear_solver.hpp"
#include "optimizer/evaluator.hpp"
#include "problem/parameter_layout.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

// The normal equations of a problem's state.
struct System {
    System(const Problem& host, Precision precision, JacobianForm form = JacobianForm::recomputed)
        : problem(host),
          device(test::test_context(), host, precision),
          evaluator(device, host),
          equations(device, DampingOptions(), form, host.loss) {
        device.upload_state(host);
        evaluator.linearize(equations);
    }

    // Also leaves the moved state in device.trial.
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
        const LinearSolution found = solver->solve(lambda);
        if (solution) *solution = found;
        solver->get_step(step);
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
constexpr JacobianForm both_forms[] = {JacobianForm::recomputed, JacobianForm::stored};
const char* form_name(JacobianForm form) {
    return form == JacobianForm::recomputed ? "recomputed" : "stored";
}

constexpr Method direct_method = {"direct_schur", LinearSolverKind::direct_schur,
                                  Preconditioner::none};
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

constexpr std::pair<Precision, JacobianForm> precisions_and_forms[] = {
    {Precision::double_precision, JacobianForm::recomputed},
    {Precision::double_precision, JacobianForm::stored},
    {Precision::mixed, JacobianForm::recomputed},
    {Precision::mixed, JacobianForm::stored},
};

TEST(LinearSolvers, PcgEqualsCholmod) {
    constexpr double lambda = 1e-2;
    for (const Case& test_case : cases()) {
        for (const auto& [precision, form] : precisions_and_forms) {
            System system(test_case.problem, precision, form);
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
                    << form_name(form) << ", " << solution.num_iterations << " iterations";
            }
        }
    }
}

// The model's decrease, the length of the step and the trial state belong to the step.
TEST(LinearSolvers, SolutionsDescribeTheirSteps) {
    std::vector<Method> methods(std::begin(pcg_methods), std::end(pcg_methods));
    methods.push_back(direct_method);
    for (const Case& test_case : cases()) {
        for (const auto& [precision, form] : precisions_and_forms) {
            const Problem& problem = test_case.problem;
            System system(problem, precision, form);
            const ParameterLayout& layout = system.device.layout();
            const auto n = static_cast<size_t>(layout.num_parameters(problem));
            reference::Jacobian jacobian = empty_jacobian(problem, layout);
            download_jacobian(system.device, system.equations.jacobian, jacobian);
            zero_constant_columns(problem, layout, jacobian);
            Vector device_gradient = system.device.make_vector("gradient");
            system.equations.get_gradient(device_gradient);
            std::vector<double> gradient(n);
            system.device.download(device_gradient, gradient.data());
            for (const Method& method : methods) {
                SCOPED_TRACE(testing::Message() << test_case.name << ", " << method.name << ", "
                                                << real_type(precision) << ", " << form_name(form));
                LinearSolution solution;
                const std::vector<double> step =
                    system.solve(method.kind, method.preconditioner, 1e-2, 0.1, &solution);
                ASSERT_TRUE(solution.is_usable);
                double slope = 0, slope_size = 0, squared_norm = 0, norm_error = 0;
                for (size_t i = 0; i < n; ++i) {
                    slope += gradient[i] * step[i];
                    slope_size += std::abs(gradient[i] * step[i]);
                }
                // Each row of J step is a sum of up to 17 terms in REAL, and rows of a run are
                // added up in REAL: fewer than 64.
                const double real_epsilon = test::epsilon(precision);
                const std::vector<double> product = reference::jx(problem, layout, jacobian, step);
                std::vector<double> size = step;
                reference::Jacobian absolute = jacobian;
                for (double& value : size) value = std::abs(value);
                for (double& value : absolute.image_blocks) value = std::abs(value);
                for (double& value : absolute.point_blocks) value = std::abs(value);
                const std::vector<double> terms = reference::jx(problem, layout, absolute, size);
                for (size_t i = 0; i < product.size(); ++i) {
                    squared_norm += product[i] * product[i];
                    norm_error += 2 * std::abs(product[i]) * 32 * real_epsilon * terms[i];
                }
                norm_error += 64 * real_epsilon * squared_norm;
                constexpr double epsilon = std::numeric_limits<double>::epsilon();
                const double sum_error = epsilon * static_cast<double>(n + product.size());
                EXPECT_NEAR(solution.model_decrease, -slope - 0.5 * squared_norm,
                            sum_error * (slope_size + squared_norm) + 0.5 * norm_error);
                EXPECT_GT(solution.model_decrease, 0);
                EXPECT_NEAR(solution.step_norm, norm(step), sum_error * norm(step));

                Problem wanted = problem, moved = problem;
                apply_step(layout, step.data(), wanted);
                system.device.state.swap(system.device.trial);
                system.device.download_state(moved);
                system.device.state.swap(system.device.trial);
                for (size_t i = 0; i < wanted.images.size(); ++i) {
                    const Pose &pose = wanted.images[i].pose, &device_pose = moved.images[i].pose;
                    for (int k = 0; k < 4; ++k)
                        EXPECT_NEAR(device_pose.rotation[k], pose.rotation[k], 8 * epsilon);
                    for (int k = 0; k < 3; ++k)  // of positions at a distance of 5
                        EXPECT_NEAR(device_pose.translation[k], pose.translation[k], 64 * epsilon);
                }
                for (size_t c = 0; c < wanted.cameras.size(); ++c)
                    EXPECT_EQ(moved.cameras[c].params, wanted.cameras[c].params);
                EXPECT_EQ(moved.points, wanted.points);
            }
        }
    }
}

// S is formed in double from the Jacobian and the point factors that the device keeps, and
// CHOLMOD's from the same Jacobian: they differ by the rounding of the factors to REAL, times a
// condition number below 1e5 at this lambda.
TEST(LinearSolvers, ExplicitEqualsCholmod) {
    constexpr double lambda = 1e-2;
    std::vector<Case> all = cases();
    all.push_back({"repeated pairs", test::small_scene(6, 60, {camera_snavely}, true, 10)});
    const std::vector<Observation> once = all.back().problem.observations;
    for (size_t i = 0; i < once.size(); i += 3) {
        all.back().problem.observations.push_back(once[i]);
        all.back().problem.observations.back().x += 1;
    }
    for (const Case& test_case : all) {
        for (const auto& [precision, form] : precisions_and_forms) {
            System system(test_case.problem, precision, form);
            LinearSolution direct, solution;
            const std::vector<double> expected = system.solve(
                LinearSolverKind::direct_schur, Preconditioner::none, lambda, 0.1, &direct);
            const std::vector<double> step = system.solve(
                LinearSolverKind::explicit_schur, Preconditioner::none, lambda, 0.1, &solution);
            EXPECT_TRUE(solution.is_usable);
            EXPECT_EQ(solution.num_iterations, 1);
            EXPECT_LE(distance(step, expected), 1e5 * test::epsilon(precision) * norm(expected))
                << test_case.name << ", " << real_type(precision) << ", " << form_name(form);
            EXPECT_NEAR(solution.step_norm, norm(step), 1e-6 * norm(step));
        }
    }
}

TEST(LinearSolvers, ConstantParametersHaveNoStep) {
    const Problem problem =
        test::with_constants(test::small_scene(6, 60, {camera_snavely}, false, 4));
    const ParameterLayout layout(problem);
    for (const JacobianForm form : both_forms) {
        System system(problem, Precision::mixed, form);
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
}

TEST(LinearSolvers, ReducedSystemIsSymmetric) {
    for (const Case& test_case : cases()) {
        for (const JacobianForm form : both_forms) {
            System system(test_case.problem, Precision::double_precision, form);
            ASSERT_EQ(system.equations.factor_points(1e-3), 0);
            const int64_t n = system.device.layout().num_parameters(test_case.problem);
            Vector x = system.device.make_vector("x"), y = system.device.make_vector("y");
            Vector sx = system.device.make_reduced_vector("sx"),
                   sy = system.device.make_reduced_vector("sy");
            system.device.upload(test::random_vector(n, 7).data(), x);
            system.device.upload(test::random_vector(n, 8).data(), y);
            system.equations.jacobian.add_schur_product(x, system.equations.point_factors(), sx);
            system.equations.jacobian.add_schur_product(y, system.equations.point_factors(), sy);
            VectorOperations& vectors = system.device.vectors();
            const double scale = std::sqrt(vectors.dot(sx, sx) * vectors.dot(sy, sy));
            EXPECT_NEAR(vectors.dot(sy, x), vectors.dot(sx, y),
                        1e3 * std::numeric_limits<double>::epsilon() * scale)
                << test_case.name << ", " << form_name(form);
        }
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
        options.eta = 1e-12;
        options.max_iterations = 3;
        EXPECT_EQ(
            make_linear_solver(options, problem, system.equations)->solve(1e-4).num_iterations, 3)
            << method.name;
        options.eta = 0.9;
        options.max_iterations = 50;
        options.min_iterations = 7;
        EXPECT_EQ(
            make_linear_solver(options, problem, system.equations)->solve(1e-4).num_iterations, 7)
            << method.name;
    }
}

TEST(LinearSolvers, EndWhenTimeIsUp) {
    const Problem problem = test::small_scene(12, 150, {camera_snavely}, false, 9);
    System system(problem, Precision::mixed);
    const StopTest no_time(nullptr, 0);
    for (const Method& method : pcg_methods) {
        LinearSolverOptions options;
        options.kind = method.kind;
        options.preconditioner = method.preconditioner;
        options.eta = 1e-12;
        const LinearSolution cut =
            make_linear_solver(options, problem, system.equations)->solve(1e-4, no_time);
        EXPECT_EQ(cut.stopped, StopCause::out_of_time) << method.name;
        EXPECT_EQ(cut.num_iterations, system.device.queue().tuning().pcg_interval) << method.name;
        EXPECT_TRUE(cut.is_usable) << method.name;
        EXPECT_GT(cut.model_decrease, 0) << method.name;
    }
    for (const LinearSolverKind kind :
         {LinearSolverKind::explicit_schur, LinearSolverKind::direct_schur}) {
        LinearSolverOptions options;
        options.kind = kind;
        const auto solver = make_linear_solver(options, problem, system.equations);
        const LinearSolution cut = solver->solve(1e-4, no_time);
        EXPECT_EQ(cut.stopped, StopCause::out_of_time);
        EXPECT_FALSE(cut.is_usable);
        EXPECT_EQ(cut.num_indefinite_blocks, 0);
        EXPECT_TRUE(solver->solve(1e-4).is_usable);  // the next one is not hurt
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
