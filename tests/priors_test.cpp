// SPDX-License-Identifier: Apache-2.0
// Priors: their residuals by hand numbers, their derivatives by central differences, steps of all
// linear solvers against a dense solution, and what whole solves make of them.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <iterator>
#include <limits>
#include <string>
#include <vector>

#include "device_rig.hpp"
#include "linear/linear_solver.hpp"
#include "linear/prior_terms.hpp"
#include "optimizer/solve.hpp"
#include "reference/gauge.hpp"
#include "reference/priors.hpp"
#include "reference/random.hpp"
#include "reference/scene.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

constexpr double pi = 3.14159265358979323846;

struct Case {
    std::string name;
    Problem problem;
};

std::vector<Case> cases() {
    using namespace test;
    return {
        {"own cameras", with_priors(small_scene(6, 60, {camera_snavely}, false, 1), 11)},
        {"shared cameras", with_priors(small_scene(6, 60, {camera_snavely}, true, 2), 12)},
        {"mixed models", with_priors(mixed_scene(6, 60, 3), 13)},
        {"constants",
         with_priors(with_constants(small_scene(6, 60, {camera_snavely}, false, 4)), 14)},
        {"uncertainties",
         with_priors(with_uncertainties(small_scene(6, 60, {camera_snavely}, false, 5), 6), 15)}};
}

// Residuals and Jacobian of all priors, dense, over all parameters.
struct DensePriors {
    explicit DensePriors(const Problem& problem) {
        const ParameterLayout layout(problem);
        const auto n = static_cast<Eigen::Index>(layout.num_parameters(problem));
        std::vector<double> r;
        std::vector<Eigen::RowVectorXd> rows;
        reference::ImagePriors(problem, layout)
            .for_each_row(
                problem.images, problem.cameras, {},
                [&](double residual, int count, const int32_t* scalars, const double* row) {
                    r.push_back(residual);
                    rows.emplace_back(Eigen::RowVectorXd::Zero(n));
                    for (int k = 0; k < count; ++k)
                        if (scalars[k] >= 0) rows.back()[scalars[k]] += row[k];
                });
        for (const PointPrior& prior : problem.priors.points) {
            for (int k = 0; k < 3; ++k) {
                double sum = 0;
                rows.emplace_back(Eigen::RowVectorXd::Zero(n));
                for (int c = 0; c < 3; ++c) {
                    const double w = prior.whitening[3 * k + c];
                    sum += w * (problem.points[prior.point][c] - prior.position[c]);
                    if (point_scale(problem, prior.point)[c] > 0)
                        rows.back()[layout.num_f + 3 * prior.point + c] = w;
                }
                r.push_back(sum);
            }
        }
        residuals = Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
        jacobian.resize(residuals.size(), n);
        for (Eigen::Index k = 0; k < residuals.size(); ++k) jacobian.row(k) = rows[k];
    }
    Eigen::VectorXd residuals;
    Eigen::MatrixXd jacobian;
};

TEST(PriorResiduals, HaveHandNumbers) {
    Problem problem = test::small_scene(2, 20, {camera_snavely}, false, 1);
    Pose& pose = problem.images[0].pose;
    const double half = std::sqrt(0.5);
    pose = {{half, 0, 0, half}, {1, 2, 3}};  // a quarter turn about z: centre (-2, 1, -3)
    const std::array<double, 9> twice = {2, 0, 0, 0, 2, 0, 0, 0, 2};
    problem.priors.positions = {{0, {-2, 1, -2}, {1, 0, 0, 0, 1, 0, 0.5, 0.25, 3}}};
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * 9, 1e-14);
    problem.priors.positions[0].position = {-3, -1, -3};  // less by (1, 2, 0)
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * (1 + 4 + 1), 1e-14);

    problem.priors = {};
    problem.points[3] = {1, 2, 3};
    problem.priors.points = {{3, {1, 2, 2.5}, twice}};
    EXPECT_DOUBLE_EQ(reference::prior_cost(problem), 0.5);

    problem.priors = {};
    IntrinsicsPrior intrinsics;
    intrinsics.camera = 1;
    intrinsics.params = problem.cameras[1].params;
    intrinsics.params[0] -= 3;
    intrinsics.params[2] -= 100;  // not held
    intrinsics.whitening[0] = 0.5;
    problem.priors.intrinsics = {intrinsics};
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * 2.25, 1e-12);

    // The target is the identity at the origin: log R = (0, 0, pi / 2), the centre (-2, 1, -3).
    problem.priors = {};
    PosePrior whole;
    for (int k = 0; k < 6; ++k) whole.whitening[7 * k] = 1;
    problem.priors.poses = {whole};
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * (pi * pi / 4 + 4 + 1 + 9), 1e-13);

    // T_1 T_0^-1 = (R_0^-1, -R_0^-1 t_0), a quarter turn back and (-2, 1, -3); M is the same turn.
    problem.priors = {};
    problem.images[1].pose = {};
    RelativePosePrior relative;
    relative.second = 1;
    relative.pose = {{half, 0, 0, -half}, {0, 1, -3}};
    relative.whitening = whole.whitening;
    problem.priors.relative_poses = {relative};
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * 4, 1e-13);
    problem.priors.relative_poses[0].pose = {};
    EXPECT_NEAR(reference::prior_cost(problem), 0.5 * (pi * pi / 4 + 4 + 1 + 9), 1e-13);
}

// Columns of the Jacobian by moving the state; `far`: rotations up to 3 rad from their targets.
void expect_central_differences(const Problem& problem) {
    const ParameterLayout layout(problem);
    const DensePriors priors(problem);
    ASSERT_GT(priors.residuals.size(), 0);
    const auto n = static_cast<Eigen::Index>(layout.num_parameters(problem));
    for (Eigen::Index k = 0; k < n; ++k) {
        const Eigen::VectorXd expected = test::central_difference(
            [&](double step) {
                std::vector<double> move(static_cast<size_t>(n), 0.0);
                move[static_cast<size_t>(k)] = step;
                Problem moved = problem;
                apply_step(layout, move.data(), moved);
                return DensePriors(moved).residuals;
            },
            1e-3);
        const double size = 1 + priors.jacobian.cwiseAbs().maxCoeff();
        EXPECT_LE((priors.jacobian.col(k) - expected).cwiseAbs().maxCoeff(), 1e-9 * size)
            << "parameter " << k;
    }
}

TEST(PriorResiduals, DerivativesEqualCentralDifferences) {
    for (const Case& test_case : cases()) {
        SCOPED_TRACE(test_case.name);
        expect_central_differences(test_case.problem);
    }
}

TEST(PriorResiduals, DerivativesHoldFarFromTheirTargets) {
    for (double angle : {0.05, 0.5, 2.0, 3.0}) {
        SCOPED_TRACE(angle);
        Problem problem =
            test::with_priors(test::small_scene(5, 10, {camera_snavely}, false, 1), 2);
        const auto turn = quaternion_from_rotation_vector({0.6 * angle, -0.8 * angle, 0});
        for (PosePrior& prior : problem.priors.poses)
            prior.pose.rotation =
                quaternion_product(turn, problem.images[prior.image].pose.rotation);
        for (RelativePosePrior& prior : problem.priors.relative_poses)
            prior.pose.rotation = quaternion_product(turn, prior.pose.rotation);
        expect_central_differences(problem);
    }
}

TEST(PriorResiduals, SparseMatrixAndGradientEqualDenseOnes) {
    for (const Case& test_case : cases()) {
        SCOPED_TRACE(test_case.name);
        const Problem& problem = test_case.problem;
        const ParameterLayout layout(problem);
        const DensePriors dense(problem);
        const Eigen::MatrixXd j = dense.jacobian.leftCols(layout.num_f);
        const Eigen::VectorXd g = j.transpose() * dense.residuals;
        Eigen::MatrixXd difference = j.transpose() * j;
        const double size = difference.cwiseAbs().maxCoeff();
        const reference::ImagePriors priors(problem, layout);
        std::vector<double> gradient, values;
        priors.linearize(problem.images, problem.cameras, {}, gradient, values);
        for (size_t i = 0; i < priors.rows().size(); ++i)
            for (int32_t k = priors.row_begin()[i]; k < priors.row_begin()[i + 1]; ++k)
                difference(priors.rows()[i], priors.columns()[k]) -= values[k];
        EXPECT_LE(difference.cwiseAbs().maxCoeff(), 1e-14 * size);
        for (int32_t k = 0; k < layout.num_f; ++k)
            EXPECT_NEAR(gradient[k], g[k], 1e-13 * g.cwiseAbs().maxCoeff());
    }
}

// (H + lambda D^2) step = -gradient, dense, with D^2 by Marquardt's rule.
struct DenseSystem {
    explicit DenseSystem(const Problem& problem) {
        const ParameterLayout layout(problem);
        const DensePriors priors(problem);
        const Eigen::MatrixXd j =
            test::dense(problem, layout, reference::jacobian(problem, layout));
        std::vector<double> r(2 * problem.observations.size());
        cost = reference::residual(problem, r.data()).cost + 0.5 * priors.residuals.squaredNorm();
        const Eigen::Map<Eigen::VectorXd> of_observations(r.data(),
                                                          static_cast<Eigen::Index>(r.size()));
        gradient = j.transpose() * of_observations + priors.jacobian.transpose() * priors.residuals;
        h = j.transpose() * j + priors.jacobian.transpose() * priors.jacobian;
        for (double scale : layout.scale) is_free.push_back(scale > 0);
        for (int32_t p = 0; p < problem.num_points(); ++p)
            for (double scale : point_scale(problem, p)) is_free.push_back(scale > 0);
        std::vector<double> scale = layout.scale, diagonal(is_free.size());
        for (int32_t p = 0; p < problem.num_points(); ++p)
            for (double of_point : point_scale(problem, p)) scale.push_back(of_point);
        for (size_t k = 0; k < diagonal.size(); ++k)
            diagonal[k] = h(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(k));
        damping = reference::damping_diagonal(1, 1e-6, 1e32, scale, diagonal, diagonal);
    }
    Eigen::VectorXd solve(double lambda) const {
        Eigen::MatrixXd damped = h;
        Eigen::VectorXd right = -gradient;
        for (Eigen::Index k = 0; k < h.rows(); ++k) {
            damped(k, k) += lambda * damping[static_cast<size_t>(k)];
            if (is_free[static_cast<size_t>(k)]) continue;
            damped(k, k) = 1;
            right[k] = 0;
        }
        return damped.ldlt().solve(right);
    }
    double cost = 0;
    Eigen::MatrixXd h;
    Eigen::VectorXd gradient;
    std::vector<double> damping;
    std::vector<bool> is_free;
};

constexpr Precision all_precisions[] = {Precision::double_precision, Precision::mixed,
                                        Precision::single};

// Each camera model and precision has kernels of its own to compile: mixed models in double alone.
std::vector<Precision> precisions_of(const Case& test_case) {
    if (test_case.name == "mixed models") return {Precision::double_precision};
    return {std::begin(all_precisions), std::end(all_precisions)};
}

// Of sums and products in the precision, times a condition number below 1e5 of damped systems.
double step_tolerance(Precision precision) {
    return precision == Precision::double_precision ? 1e5 * test::epsilon(precision) : 2e-2;
}

TEST(PriorTerms, CostAndGradientEqualTheReference) {
    for (const Case& test_case : cases()) {
        const DenseSystem expected(test_case.problem);
        for (const Precision precision : precisions_of(test_case)) {
            SCOPED_TRACE(test_case.name + ", " + real_type(precision) + ", " +
                         wide_type(precision));
            test::Rig rig(test::test_context(), test_case.problem, precision,
                          JacobianForm::recomputed);
            const double epsilon = precision == Precision::single
                                       ? std::numeric_limits<float>::epsilon()
                                       : std::numeric_limits<double>::epsilon();
            const CostEvaluation cost = rig.evaluator.cost(rig.device.state, nullptr);
            const double prior_cost = reference::prior_cost(test_case.problem);
            EXPECT_NEAR(cost.prior_cost, prior_cost, 100 * epsilon * prior_cost);
            EXPECT_NEAR(cost.cost, expected.cost, 1000 * epsilon * expected.cost);
            const std::vector<double> gradient = rig.gradient();
            const double size = expected.gradient.cwiseAbs().maxCoeff();
            for (size_t k = 0; k < gradient.size(); ++k)
                EXPECT_NEAR(gradient[k], expected.gradient[static_cast<Eigen::Index>(k)],
                            1e3 * test::epsilon(precision) * size);
            EXPECT_NEAR(rig.equations.gradient_max_norm(), size,
                        1e3 * test::epsilon(precision) * size);
            const std::vector<double> damping = rig.damping();
            for (size_t k = 0; k < damping.size(); ++k)
                EXPECT_NEAR(damping[k], expected.damping[k],
                            1e3 * test::epsilon(precision) * (1 + expected.damping[k]));
        }
    }
}

TEST(PriorTerms, EveryLinearSolverTakesTheDenseStep) {
    constexpr double lambda = 1e-2;
    const struct {
        LinearSolverKind kind;
        Preconditioner preconditioner;
    } methods[] = {{LinearSolverKind::pcg_schur, Preconditioner::schur_jacobi},
                   {LinearSolverKind::pcg_schur, Preconditioner::block_jacobi},
                   {LinearSolverKind::pcg_hessian, Preconditioner::block_jacobi},
                   {LinearSolverKind::explicit_schur, Preconditioner::none},
                   {LinearSolverKind::direct_schur, Preconditioner::none},
                   {LinearSolverKind::automatic, Preconditioner::schur_jacobi}};
    for (const Case& test_case : cases()) {
        const DenseSystem dense(test_case.problem);
        const Eigen::VectorXd expected = dense.solve(lambda);
        for (const Precision precision : precisions_of(test_case)) {
            test::Rig rig(test::test_context(), test_case.problem, precision,
                          JacobianForm::recomputed);
            for (const auto& method : methods) {
                SCOPED_TRACE(test_case.name + ", " + real_type(precision) + ", solver " +
                             std::to_string(static_cast<int>(method.kind)));
                LinearSolverOptions options;
                options.kind = method.kind;
                options.preconditioner = method.preconditioner;
                options.eta = std::numeric_limits<double>::epsilon();
                options.min_iterations = precision == Precision::single ? 0 : 200;
                options.max_iterations = 2000;
                const auto solver = make_linear_solver(options, test_case.problem, rig.equations);
                const LinearSolution solution = solver->solve(lambda);
                ASSERT_TRUE(solution.is_usable);
                Vector device_step = rig.device.make_vector("step");
                solver->get_step(device_step);
                const std::vector<double> values = rig.download(device_step);
                const Eigen::Map<const Eigen::VectorXd> step(
                    values.data(), static_cast<Eigen::Index>(values.size()));
                const double tolerance = step_tolerance(precision);
                EXPECT_LE((step - expected).norm(), tolerance * expected.norm());
                const double decrease = -dense.gradient.dot(step) - 0.5 * step.dot(dense.h * step);
                EXPECT_NEAR(solution.model_decrease, decrease, 0.1 * tolerance * decrease);
                EXPECT_NEAR(solution.step_norm, step.norm(), 1e-4 * step.norm());
            }
        }
    }
}

// Work-groups of several work-items, several tiles, and shares of priors that are not equal.
TEST(PriorTerms, WorkGroupsOfAnySizeGiveTheDenseStep) {
    const Case test_case = cases()[3];
    const DenseSystem dense(test_case.problem);
    const Eigen::VectorXd expected = dense.solve(1e-2);
    const auto context = test::test_context();
    test::set_shape(*context, test::group_shape(64, 3, 16, 16));
    test::Rig rig(context, test_case.problem, Precision::double_precision,
                  JacobianForm::recomputed);
    EXPECT_NEAR(rig.evaluator.cost(rig.device.state, nullptr).cost, dense.cost, 1e-13 * dense.cost);
    for (const LinearSolverKind kind :
         {LinearSolverKind::pcg_schur, LinearSolverKind::pcg_hessian}) {
        LinearSolverOptions options;
        options.kind = kind;
        options.preconditioner = kind == LinearSolverKind::pcg_schur ? Preconditioner::schur_jacobi
                                                                     : Preconditioner::block_jacobi;
        options.min_iterations = 200;
        const auto solver = make_linear_solver(options, test_case.problem, rig.equations);
        const LinearSolution solution = solver->solve(1e-2);
        ASSERT_TRUE(solution.is_usable);
        Vector device_step = rig.device.make_vector("step");
        solver->get_step(device_step);
        const std::vector<double> values = rig.download(device_step);
        const Eigen::Map<const Eigen::VectorXd> step(values.data(),
                                                     static_cast<Eigen::Index>(values.size()));
        EXPECT_LE((step - expected).norm(),
                  step_tolerance(Precision::double_precision) * expected.norm());
        const double decrease = -dense.gradient.dot(step) - 0.5 * step.dot(dense.h * step);
        EXPECT_NEAR(solution.model_decrease, decrease, 1e-11 * decrease);
    }
    test::set_shape(*context, test::device_shape());
}

Summary solved(Problem& problem, LinearSolverKind kind, Precision precision,
               int max_iterations = 100) {
    MinimizerOptions options;
    options.linear_solver.kind = kind;
    options.max_iterations = max_iterations;
    options.function_tolerance = 1e-14;
    options.linear_solver.eta = 1e-6;
    std::unique_ptr<DeviceProblem> device;
    return solve(problem, test::test_context(), options, precision, device);
}

TEST(PriorSolves, EndWhereADenseGaussNewtonEnds) {
    for (const Case& test_case : cases()) {
        SCOPED_TRACE(test_case.name);
        Problem reference_problem = test_case.problem;
        const ParameterLayout layout(reference_problem);
        double expected = 0;
        for (int k = 0; k < 30; ++k) {
            const DenseSystem system(reference_problem);
            expected = system.cost;
            const Eigen::VectorXd step = system.solve(1e-9);
            apply_step(layout, step.data(), reference_problem);
        }
        for (const LinearSolverKind kind :
             {LinearSolverKind::pcg_schur, LinearSolverKind::explicit_schur}) {
            Problem problem = test_case.problem;
            const Summary summary = solved(problem, kind, Precision::double_precision);
            EXPECT_NEAR(summary.final_cost, expected, 1e-9 * expected);
            EXPECT_NEAR(summary.reference_final_cost, summary.final_cost, 1e-12 * expected);
            EXPECT_NEAR(summary.initial_prior_cost, reference::prior_cost(test_case.problem),
                        1e-12 * summary.initial_prior_cost);
            EXPECT_NEAR(summary.final_prior_cost, reference::prior_cost(problem),
                        1e-12 * summary.final_prior_cost);
            EXPECT_LT(summary.final_prior_cost, summary.initial_prior_cost);
            for (size_t i = 0; i < problem.images.size(); ++i) {
                const Point a = camera_center(problem.images[i].pose);
                const Point b = camera_center(reference_problem.images[i].pose);
                for (int k = 0; k < 3; ++k) EXPECT_NEAR(a[k], b[k], 1e-6);
            }
        }
    }
}

// On a fresh device and on one that has solved before.
TEST(PriorSolves, GiveEqualBitsTwice) {
    const Problem start = cases()[1].problem;
    MinimizerOptions options;
    options.max_iterations = 8;
    for (const Precision precision : all_precisions) {
        Problem first = start, second = start;
        std::unique_ptr<DeviceProblem> device;
        const Summary a = solve(first, test::test_context(), options, precision, device);
        const Summary b = solve(second, test::test_context(), options, precision, device);
        EXPECT_EQ(a.final_cost, b.final_cost);
        EXPECT_EQ(a.final_prior_cost, b.final_prior_cost);
        EXPECT_EQ(first.points, second.points);
        for (size_t i = 0; i < first.images.size(); ++i) {
            EXPECT_EQ(first.images[i].pose.rotation, second.images[i].pose.rotation);
            EXPECT_EQ(first.images[i].pose.translation, second.images[i].pose.translation);
        }
    }
}

// Without a common point S has no block of the two images but that of their prior.
TEST(PriorSolves, RelativePosesCoupleImagesThatSeeNothingInCommon) {
    Problem problem = test::small_scene(6, 60, {camera_snavely}, false, 7);
    std::vector<Observation> kept;
    for (const Observation& o : problem.observations)
        if ((o.image < 3) == (o.point < 30)) kept.push_back(o);
    problem.observations = kept;
    problem = test::with_priors(problem, 8);
    Eigen::VectorXd first;
    for (const LinearSolverKind kind :
         {LinearSolverKind::direct_schur, LinearSolverKind::explicit_schur,
          LinearSolverKind::pcg_schur}) {
        test::Rig rig(test::test_context(), problem, Precision::double_precision,
                      JacobianForm::recomputed);
        LinearSolverOptions options;
        options.kind = kind;
        options.min_iterations = 200;
        const auto solver = make_linear_solver(options, problem, rig.equations);
        ASSERT_TRUE(solver->solve(1e-3).is_usable);
        Vector device_step = rig.device.make_vector("step");
        solver->get_step(device_step);
        const std::vector<double> values = rig.download(device_step);
        const Eigen::VectorXd step = Eigen::Map<const Eigen::VectorXd>(
            values.data(), static_cast<Eigen::Index>(values.size()));
        if (first.size() == 0) first = DenseSystem(problem).solve(1e-3);
        EXPECT_LE((step - first).norm(), 1e-9 * first.norm()) << static_cast<int>(kind);
    }
}

double position_error(const Problem& problem, const Problem& truth) {
    double sum = 0;
    for (size_t i = 0; i < problem.images.size(); ++i) {
        const Point a = camera_center(problem.images[i].pose);
        const Point b = camera_center(truth.images[i].pose);
        for (int k = 0; k < 3; ++k) sum += (a[k] - b[k]) * (a[k] - b[k]);
    }
    return std::sqrt(sum / static_cast<double>(problem.images.size()));
}

TEST(PriorSolves, GpsBringsPositionsBelowItsNoise) {
    SceneOptions scene_options;
    scene_options.kind = SceneKind::street;
    scene_options.num_images = 24;
    scene_options.observations_per_image = 80;
    scene_options.seed = 3;
    const Scene scene = generate_scene(scene_options);
    Problem unaided = scene.start;
    solved(unaided, LinearSolverKind::explicit_schur, Precision::double_precision, 30);
    scene::Random random(5, 0);
    constexpr double sigma = 0.05;
    std::vector<PositionPrior> priors;
    double noise = 0;
    for (int32_t i = 0; i < scene.truth.num_images(); ++i) {
        PositionPrior prior{i, camera_center(scene.truth.images[i].pose), {}};
        for (int k = 0; k < 3; ++k) {
            const double error = sigma * random.normal();
            noise += error * error;
            prior.position[k] += error;
            prior.whitening[4 * k] = 1 / sigma;
        }
        priors.push_back(prior);
    }
    noise = std::sqrt(noise / static_cast<double>(priors.size()));
    for (const Precision precision : all_precisions) {
        Problem aided = scene.start;
        aided.priors.positions = priors;
        const Summary summary = solved(aided, LinearSolverKind::explicit_schur, precision, 30);
        EXPECT_EQ(summary.gauge.gauge, reference::Gauge::fixed_by_priors);
        EXPECT_LT(position_error(aided, scene.truth), 0.7 * noise) << real_type(precision);
        EXPECT_LT(position_error(aided, scene.truth), position_error(unaided, scene.truth));
    }
}

TEST(Gauge, CountsWhatIsHeld) {
    using reference::Gauge;
    Problem problem = test::small_scene(6, 60, {camera_snavely}, false, 1);
    const auto freedoms = [&](Gauge expected) {
        const reference::GaugeState state = reference::gauge_of(problem, ParameterLayout(problem));
        EXPECT_EQ(state.gauge, expected);
        return state.num_freedoms;
    };
    EXPECT_EQ(freedoms(Gauge::free), 7);
    problem.constant_images.assign(6, 0);
    problem.constant_images[0] = constant_rotation | constant_position;
    EXPECT_EQ(freedoms(Gauge::free), 1);
    problem.constant_images[1] = constant_position;
    EXPECT_EQ(freedoms(Gauge::fixed_by_constants), 0);
    problem.constant_images.clear();
    problem.constant_points.assign(problem.points.size(), 0);
    problem.constant_points[0] = problem.constant_points[1] = 1;
    EXPECT_EQ(freedoms(Gauge::free), 1);  // the turn about the line through both
    problem.constant_points[2] = 1;
    EXPECT_EQ(freedoms(Gauge::fixed_by_constants), 0);
    problem.constant_points.clear();

    const Problem with = test::with_priors(problem, 1);
    problem.priors.relative_poses = with.priors.relative_poses;
    EXPECT_EQ(freedoms(Gauge::free), 6);  // they hold the scale
    problem.priors = {};
    problem.priors.poses = {with.priors.poses[0]};
    EXPECT_EQ(freedoms(Gauge::free), 1);
    problem.priors.relative_poses = with.priors.relative_poses;
    EXPECT_EQ(freedoms(Gauge::fixed_by_priors), 0);
    problem.priors = {};
    problem.priors.intrinsics = with.priors.intrinsics;
    EXPECT_EQ(freedoms(Gauge::free), 7);
    problem.priors.positions = {with.priors.positions[0], with.priors.positions[1]};
    EXPECT_EQ(freedoms(Gauge::free), 1);
    problem.priors.points = {with.priors.points[0]};
    EXPECT_EQ(freedoms(Gauge::fixed_by_priors), 0);
}

}  // namespace
}  // namespace clba
