// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "reference/bundle.hpp"
#include "reference/loss.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

constexpr double epsilon = std::numeric_limits<double>::epsilon();
constexpr LossKind loss_kinds[] = {LossKind::none, LossKind::huber, LossKind::soft_l1,
                                   LossKind::cauchy, LossKind::tukey};

VectorXd as_vector(const std::vector<double>& values) {
    return Eigen::Map<const VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

MatrixXd as_matrix(const double* values, int size) {
    return Eigen::Map<const RowMajorMatrix>(values, size, size);
}

struct Linearized {
    explicit Linearized(const Problem& linearized)
        : problem(linearized),
          layout(problem),
          jacobian(reference::jacobian(problem, layout)),
          dense(test::dense(problem, layout, jacobian)) {}
    MatrixXd f() const { return dense.leftCols(layout.num_f); }
    MatrixXd e() const { return dense.rightCols(dense.cols() - layout.num_f); }

    Problem problem;
    ParameterLayout layout;
    reference::Jacobian jacobian;
    MatrixXd dense;
};

double max_norm(const MatrixXd& matrix) {
    return matrix.size() == 0 ? 0 : matrix.cwiseAbs().maxCoeff();
}

VectorXd residuals_of(const Problem& problem) {
    VectorXd residuals(2 * problem.num_observations());
    reference::residual(problem, residuals.data());
    return residuals;
}

// The problem moved by h along one direction of the tangent space.
Problem moved(const Problem& problem, const ParameterLayout& layout, int64_t parameter, double h) {
    std::vector<double> step(static_cast<size_t>(layout.num_parameters(problem)), 0.0);
    step[static_cast<size_t>(parameter)] = h;
    Problem other = problem;
    apply_step(layout, step.data(), other);
    return other;
}

// A step for differences along each parameter: intrinsics are far larger than 1 or below it.
std::vector<double> parameter_steps(const Problem& problem, const ParameterLayout& layout,
                                    double relative) {
    std::vector<double> steps(static_cast<size_t>(layout.num_parameters(problem)), relative);
    for (int32_t c = 0; c < problem.num_cameras(); ++c)
        for (int k = 0; k < problem.cameras[c].num_params(); ++k)
            steps[layout.intrinsics_offset[c] + k] *=
                std::max(1.0, std::abs(problem.cameras[c].params[k]));
    return steps;
}

void expect_jacobian_equals_differences(const Problem& problem) {
    const Linearized linearized(problem);
    const auto steps = parameter_steps(problem, linearized.layout, std::pow(epsilon, 0.2));
    // Residuals are differences of pixels below 1000.
    const double residual_scale = max_norm(residuals_of(problem)) + 1000;
    for (int64_t k = 0; k < linearized.dense.cols(); ++k) {
        const double h = steps[static_cast<size_t>(k)];
        const auto at = [&](double step) {
            return residuals_of(moved(problem, linearized.layout, k, step));
        };
        const VectorXd difference = test::central_difference(at, h);
        EXPECT_LE(max_norm(linearized.dense.col(k) - difference), 20 * epsilon * residual_scale / h)
            << "column " << k;
    }
}

TEST(Loss, ValuesEqualHandNumbers) {
    const double s = 3, a = 1;  // |r| beyond the scale
    const double tolerance = 4 * epsilon;
    EXPECT_EQ(reference::rho({LossKind::none, a}, s), 3);
    EXPECT_NEAR(reference::rho({LossKind::huber, a}, s), 2.4641016151377544, 3 * tolerance);
    EXPECT_NEAR(reference::rho({LossKind::soft_l1, a}, s), 2, 2 * tolerance);
    EXPECT_NEAR(reference::rho({LossKind::cauchy, a}, s), 1.3862943611198906, 2 * tolerance);
    EXPECT_NEAR(reference::rho({LossKind::tukey, a}, s), 1.0 / 3, tolerance);
    EXPECT_EQ(reference::rho({LossKind::huber, 2}, s), 3);
    EXPECT_NEAR(reference::rho({LossKind::tukey, 2}, s), 4.0 / 3 * (1 - 1.0 / 64), 2 * tolerance);
    EXPECT_EQ(reference::rho_derivative({LossKind::tukey, a}, s), 0);
    EXPECT_EQ(reference::rho_derivative({LossKind::tukey, 2}, s), 1.0 / 16);
}

TEST(Loss, DerivativesEqualCentralDifferences) {
    for (LossKind kind : loss_kinds) {
        for (double q : {0.05, 0.5, 0.9, 1.2, 4.0, 100.0}) {
            SCOPED_TRACE(testing::Message() << "loss " << static_cast<int>(kind) << " at " << q);
            const Loss loss{kind, 2.5};
            const double s = q * loss.scale * loss.scale;
            const double h = s * std::pow(epsilon, 0.2) / 4;
            const auto at = [&](double step) {
                return VectorXd::Constant(1, reference::rho(loss, s + step));
            };
            EXPECT_NEAR(reference::rho_derivative(loss, s), test::central_difference(at, h)[0],
                        10 * epsilon * s / h);
        }
    }
}

TEST(Loss, ValuesAndDerivativesAreContinuousAndStartAsTheSquare) {
    for (LossKind kind : loss_kinds) {
        SCOPED_TRACE(static_cast<int>(kind));
        const Loss loss{kind, 2.5};
        const double a2 = loss.scale * loss.scale;
        const double below = a2 * (1 - epsilon), above = a2 * (1 + epsilon);
        EXPECT_NEAR(reference::rho(loss, below), reference::rho(loss, above), 8 * epsilon * a2);
        EXPECT_NEAR(reference::rho_derivative(loss, below), reference::rho_derivative(loss, above),
                    8 * epsilon);
        EXPECT_EQ(reference::rho(loss, 0), 0);
        EXPECT_EQ(reference::rho_derivative(loss, 0), 1);
        EXPECT_NEAR(reference::rho(loss, 1e-12), 1e-12, 1e-24 + 4 * epsilon * 1e-12);
    }
}

// What Ceres' corrector (Triggs et al. 2000) makes of r: its second-order term, a rank-one change
// of J along r, counts where rho'' > 0 alone; elsewhere both are scaled by sqrt(rho').
TEST(Loss, HasNoSecondOrderTermInTheCorrector) {
    for (LossKind kind : loss_kinds) {
        const Loss loss{kind, 2.5};
        const double a2 = loss.scale * loss.scale;
        double before = 1;
        for (double q = 1e-6; q < 1e6; q *= 1.1) {
            SCOPED_TRACE(testing::Message() << "loss " << static_cast<int>(kind) << " at " << q);
            const double now = reference::rho_derivative(loss, q * a2);
            EXPECT_LE(now, before);  // rho'' <= 0
            EXPECT_GE(now, 0);
            before = now;
        }
        // So the quadratic of curvature rho' that a step minimises lies nowhere below the cost.
        for (double at : {0.1, 0.9, 1.5, 4.0, 50.0})
            for (double other : {0.0, 0.2, 1.0, 2.0, 7.0, 300.0})
                EXPECT_LE(reference::rho(loss, other * a2),
                          reference::rho(loss, at * a2) +
                              reference::rho_derivative(loss, at * a2) * (other - at) * a2 +
                              8 * epsilon * a2 * (at + other))
                    << "loss " << static_cast<int>(kind) << " at " << at << " and " << other;
    }
}

// One pinhole camera at the origin that sees P = (1, 2, 4) at (35, 120).
Problem hand_problem() {
    Problem problem;
    problem.cameras.resize(1);
    problem.cameras[0].model = camera_pinhole;
    problem.cameras[0].params = {100, 200, 10, 20};
    problem.images.resize(1);
    problem.points = {{1, 2, 4}};
    problem.observations = {{0, 0, 32, 116}};
    return problem;
}

TEST(Reference, ResidualEqualsHandNumbers) {
    Problem problem = hand_problem();
    EXPECT_EQ(residuals_of(problem), Eigen::Vector2d(3, 4));
    EXPECT_EQ(reference::residual(problem, nullptr).cost, 12.5);
    problem.whitening = {{2, 0.5, 1}};
    EXPECT_EQ(residuals_of(problem), Eigen::Vector2d(6, 5.5));
    problem.whitening.clear();
    problem.loss = {LossKind::huber, 1.25};  // rho' = 1.25 / 5
    EXPECT_EQ(residuals_of(problem), Eigen::Vector2d(1.5, 2));
    EXPECT_EQ(reference::residual(problem, nullptr).cost, 0.5 * (2 * 1.25 * 5 - 1.5625));
}

TEST(Reference, JacobianEqualsHandNumbers) {
    const Linearized linearized(hand_problem());
    MatrixXd expected(2, 13);
    expected << -12.5, 106.25, -50, 25, 0, -6.25, 0.25, 0, 1, 0, 25, 0, -6.25,  //
        -250, 25, 50, 0, 50, -25, 0, 0.5, 0, 1, 0, 50, -25;
    EXPECT_EQ(linearized.jacobian.columns, 10);
    EXPECT_LE(max_norm(linearized.dense - expected), 4 * epsilon * 250) << linearized.dense;
}

TEST(Reference, JacobianEqualsCentralDifferencesForEveryModel) {
    for (int32_t model : test::all_camera_models()) {
        for (bool shared : {false, true}) {
            SCOPED_TRACE(testing::Message() << camera_models[model].name << ", shared " << shared);
            const Problem problem = test::small_scene(2, 4, {model}, shared, 7);
            expect_jacobian_equals_differences(problem);
            expect_jacobian_equals_differences(test::with_covariances(problem, 8));
        }
    }
}

TEST(Reference, JacobianEqualsCentralDifferencesInMixedProblems) {
    const Problem problem = test::mixed_scene(4, 5, 9);
    expect_jacobian_equals_differences(problem);
    expect_jacobian_equals_differences(test::with_constants(problem));
    expect_jacobian_equals_differences(test::with_uncertainties(problem, 10));
}

TEST(Reference, GradientIsThatOfTheCostForEveryLoss) {
    for (LossKind kind : loss_kinds) {
        SCOPED_TRACE(static_cast<int>(kind));
        const Problem problem =
            test::with_loss(test::with_covariances(test::mixed_scene(4, 5, 11), 12), kind, 15);
        const Linearized linearized(problem);
        const VectorXd gradient = linearized.dense.transpose() * residuals_of(problem);
        const auto cost_of = [](const Problem& other) {
            return reference::residual(other, nullptr).cost;
        };
        const double cost = cost_of(problem);
        const auto steps = parameter_steps(problem, linearized.layout, 1e-5);
        for (int64_t k = 0; k < gradient.size(); ++k) {
            const double h = steps[static_cast<size_t>(k)];
            const auto at = [&](double step) {
                return VectorXd::Constant(1, cost_of(moved(problem, linearized.layout, k, step)));
            };
            // Rounding of pixels near 1000 enters the cost through the gradient.
            EXPECT_NEAR(gradient[k], test::central_difference(at, h)[0],
                        100 * epsilon * (cost + 1000) / h)
                << "parameter " << k << " of " << gradient.size();
        }
    }
}

TEST(Reference, ColumnsOfConstantParametersAreZero) {
    const Problem problem = test::with_constants(test::mixed_scene(5, 11, 13));
    const Linearized linearized(problem);
    int64_t num_constant = 0;
    const auto expect_zero_if_constant = [&](int64_t column, double scale) {
        EXPECT_EQ(linearized.dense.col(column).isZero(0), scale == 0) << "column " << column;
        num_constant += scale == 0;
    };
    for (int32_t k = 0; k < linearized.layout.num_f; ++k)
        expect_zero_if_constant(k, linearized.layout.scale[k]);
    for (int32_t p = 0; p < problem.num_points(); ++p)
        for (int k = 0; k < 3; ++k)
            expect_zero_if_constant(linearized.layout.num_f + 3 * int64_t{p} + k,
                                    point_scale(problem, p)[k]);
    EXPECT_EQ(num_constant, 6 + 3 + 3 + 1 + 3 + 3 * 3);
}

// Own, shared and mixed cameras, and everything that can be wrong.
std::vector<Problem> product_problems() {
    return {test::small_scene(12, 12, test::all_camera_models(), false, 14),
            test::small_scene(6, 12, {camera_opencv, camera_snavely}, true, 15),
            test::with_constants(test::with_loss(
                test::with_covariances(test::mixed_scene(6, 12, 16), 17), LossKind::cauchy, 10)),
            test::planted_trouble(), test::small_scene(0, 0, {camera_snavely}, true, 18)};
}

TEST(Reference, ProductsEqualTheDenseJacobian) {
    for (const Problem& problem : product_problems()) {
        const Linearized linearized(problem);
        const auto x = test::random_vector(linearized.dense.cols(), 19);
        const auto y = test::random_vector(linearized.dense.rows(), 20);
        const auto j_x = reference::jx(problem, linearized.layout, linearized.jacobian, x);
        const auto jt_y = reference::jty(problem, linearized.layout, linearized.jacobian, y);
        const double tolerance = 20 * epsilon * max_norm(linearized.dense);
        EXPECT_LE(max_norm(as_vector(j_x) - linearized.dense * as_vector(x)), tolerance);
        EXPECT_LE(max_norm(as_vector(jt_y) - linearized.dense.transpose() * as_vector(y)),
                  tolerance * static_cast<double>(y.size()));
        const double y_j_x = as_vector(y).dot(as_vector(j_x));
        const double x_jt_y = as_vector(x).dot(as_vector(jt_y));
        EXPECT_NEAR(y_j_x, x_jt_y, tolerance * static_cast<double>(y.size()));
    }
}

TEST(Reference, NormalBlocksAreTheDiagonalBlocksOfJtJ) {
    for (const Problem& problem : product_problems()) {
        const Linearized linearized(problem);
        const MatrixXd jtj = linearized.dense.transpose() * linearized.dense;
        const double tolerance = 10 * epsilon * max_norm(jtj);
        const auto blocks =
            reference::normal_blocks(problem, linearized.layout, linearized.jacobian);
        ASSERT_EQ(blocks.u.size(), linearized.layout.blocks.size());
        for (size_t b = 0; b < blocks.u.size(); ++b) {
            const ParameterBlock& block = linearized.layout.blocks[b];
            ASSERT_EQ(blocks.u[b].size(), static_cast<size_t>(block.size * block.size));
            EXPECT_LE(max_norm(as_matrix(blocks.u[b].data(), block.size) -
                               jtj.block(block.offset, block.offset, block.size, block.size)),
                      tolerance)
                << "block " << b;
        }
        for (int32_t p = 0; p < problem.num_points(); ++p) {
            const int offset = linearized.layout.num_f + 3 * p;
            EXPECT_LE(
                max_norm(as_matrix(&blocks.v[9 * size_t(p)], 3) - jtj.block(offset, offset, 3, 3)),
                tolerance)
                << "point " << p;
        }
    }
}

MatrixXd random_positive_definite(int size, uint64_t seed) {
    const auto values = test::random_vector(int64_t{size} * size, seed);
    const MatrixXd factor = as_matrix(values.data(), size);
    return factor * factor.transpose() + MatrixXd::Identity(size, size);
}

TEST(InverseFactor, EqualsEigensInverse) {
    for (int size : {1, 3, 9, 14}) {
        SCOPED_TRACE(size);
        const MatrixXd a = random_positive_definite(size, 21);
        std::vector<double> g(a.size());
        ASSERT_TRUE(reference::inverse_factor(size, a.data(), nullptr, g.data()));
        const MatrixXd factor = as_matrix(g.data(), size);
        EXPECT_TRUE(factor.isLowerTriangular(0));
        EXPECT_LE(max_norm(factor.transpose() * factor - a.inverse()),
                  10 * epsilon * size * max_norm(a));
    }
}

TEST(InverseFactor, LeavesConstantParametersOut) {
    const MatrixXd a = random_positive_definite(4, 22);
    const double scale[] = {1, 0, 2, 0.5};
    const Eigen::Vector3i free(0, 2, 3);
    std::vector<double> g(16, 7.0);
    ASSERT_TRUE(reference::inverse_factor(4, a.data(), scale, g.data()));
    const MatrixXd factor = as_matrix(g.data(), 4);
    EXPECT_TRUE(factor.row(1).isZero(0));
    EXPECT_TRUE(factor.col(1).isZero(0));
    EXPECT_LE(max_norm((factor.transpose() * factor)(free, free) - a(free, free).inverse()),
              40 * epsilon * max_norm(a));
    const double none[] = {0, 0, 0, 0};
    ASSERT_TRUE(reference::inverse_factor(4, a.data(), none, g.data()));
    EXPECT_TRUE(as_vector(g).isZero(0));
}

TEST(InverseFactor, RefusesWhatIsNotPositiveDefinite) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const double infinity = std::numeric_limits<double>::infinity();
    const std::vector<std::vector<double>> refused = {{1, 2, 2, 1},     {0, 0, 0, 1},
                                                      {1, 1, 1, 1},     {-1, 0, 0, 1},
                                                      {1, nan, nan, 1}, {infinity, 0, 0, 1}};
    for (const auto& a : refused) {
        std::vector<double> g(4, 7.0);
        EXPECT_FALSE(reference::inverse_factor(2, a.data(), nullptr, g.data())) << a[0] << a[1];
        EXPECT_TRUE(as_vector(g).isZero(0));
    }
    // What is refused for its constant part alone is not refused.
    const double indefinite[] = {-1, 0, 0, 4}, scale[] = {0, 1};
    std::vector<double> g(4, 7.0);
    EXPECT_TRUE(reference::inverse_factor(2, indefinite, scale, g.data()));
    EXPECT_EQ(g, (std::vector<double>{0, 0, 0, 0.5}));
}

// The damped Schur complement by dense algebra, and the point factors that belong to it.
struct DenseSchur {
    explicit DenseSchur(const Linearized& linearized) {
        const Problem& problem = linearized.problem;
        const MatrixXd f = linearized.f(), e = linearized.e();
        damping = test::random_vector(linearized.layout.num_f, 23);
        for (double& value : damping) value = 10 * (value + 1.5);
        point_factors.resize(9 * problem.points.size());
        MatrixXd v_inverse = MatrixXd::Zero(e.cols(), e.cols());
        for (int32_t p = 0; p < problem.num_points(); ++p) {
            const MatrixXd columns = e.middleCols(3 * p, 3);
            const MatrixXd v =
                columns.transpose() * columns + point_damping * MatrixXd::Identity(3, 3);
            EXPECT_TRUE(reference::inverse_factor(3, v.data(), point_scale(problem, p).data(),
                                                  &point_factors[9 * size_t(p)]));
            v_inverse.block(3 * p, 3 * p, 3, 3) = v.inverse();
        }
        undamped = f.transpose() * f - f.transpose() * e * v_inverse * e.transpose() * f;
        // Rounding of V is multiplied by its condition number.
        tolerance = 100 * epsilon * max_norm(f.transpose() * f) *
                    (1 + max_norm(e.transpose() * e) / point_damping);
    }

    static constexpr double point_damping = 1e4;
    std::vector<double> damping, point_factors;
    MatrixXd undamped;
    double tolerance;
};

TEST(Reference, SchurProductEqualsTheDenseSchurComplement) {
    for (const Problem& problem : product_problems()) {
        const Linearized linearized(problem);
        const DenseSchur schur(linearized);
        const auto x = test::random_vector(linearized.layout.num_f, 24);
        const auto s_x = reference::schur_product(problem, linearized.layout, linearized.jacobian,
                                                  schur.point_factors, schur.damping, x);
        const VectorXd expected =
            schur.undamped * as_vector(x) + as_vector(schur.damping).cwiseProduct(as_vector(x));
        EXPECT_LE(max_norm(as_vector(s_x) - expected), schur.tolerance);
    }
}

TEST(Reference, SchurDiagonalBlocksAreExactWhereNoImageSeesAPointTwice) {
    for (const Problem& problem : {test::small_scene(12, 12, test::all_camera_models(), false, 25),
                                   test::with_constants(test::mixed_scene(6, 12, 26)),
                                   test::small_scene(6, 12, {camera_radial}, true, 27)}) {
        const Linearized linearized(problem);
        const DenseSchur schur(linearized);
        const auto blocks = reference::schur_diagonal_blocks(
            problem, linearized.layout, linearized.jacobian, schur.point_factors);
        ASSERT_EQ(blocks.size(), linearized.layout.blocks.size());
        for (size_t b = 0; b < blocks.size(); ++b) {
            const ParameterBlock& block = linearized.layout.blocks[b];
            if (block.image < 0) continue;
            EXPECT_LE(
                max_norm(as_matrix(blocks[b].data(), block.size) -
                         schur.undamped.block(block.offset, block.offset, block.size, block.size)),
                schur.tolerance)
                << "block " << b;
        }
    }
}

TEST(Reference, SchurDiagonalBlocksAreSemidefinite) {
    for (const Problem& problem : product_problems()) {
        const Linearized linearized(problem);
        const DenseSchur schur(linearized);
        const auto blocks = reference::schur_diagonal_blocks(
            problem, linearized.layout, linearized.jacobian, schur.point_factors);
        for (size_t b = 0; b < blocks.size(); ++b) {
            const MatrixXd block = as_matrix(blocks[b].data(), linearized.layout.blocks[b].size);
            const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(block, Eigen::EigenvaluesOnly);
            EXPECT_GE(solver.eigenvalues().minCoeff(), -100 * epsilon * max_norm(block))
                << "block " << b;
        }
    }
}

TEST(Reference, SmallScenesAreWellPosed) {
    for (bool shared : {false, true}) {
        const Problem problem =
            test::small_scene(2 * num_camera_models, 50, test::all_camera_models(), shared, 28);
        EXPECT_EQ(ParameterLayout(problem).num_shared_cameras, shared ? num_camera_models : 0);
        std::vector<int> num_observations(problem.points.size(), 0);
        for (const Observation& observation : problem.observations)
            ++num_observations[observation.point];
        EXPECT_GE(*std::min_element(num_observations.begin(), num_observations.end()), 2);
        const auto cost = reference::residual(problem, nullptr);
        EXPECT_EQ(cost.num_behind, 0);
        EXPECT_EQ(cost.num_singular, 0);
        // The start is about 0.01 radians or units away, at 800 pixels for each.
        EXPECT_LE(cost.cost, 0.5 * 20 * 20 * static_cast<double>(2 * problem.num_observations()));
    }
}

TEST(Reference, PlantedTroubleIsCountedAndStaysFinite) {
    const Problem problem = test::planted_trouble();
    const auto cost = reference::residual(problem, nullptr);
    EXPECT_EQ(cost.num_behind, test::planted_num_behind);
    EXPECT_EQ(cost.num_singular, test::planted_num_singular);
    EXPECT_TRUE(std::isfinite(cost.cost));
    const Linearized linearized(problem);
    EXPECT_TRUE(linearized.dense.allFinite());
    for (int64_t i = 0; i < problem.num_observations(); ++i) {
        const Observation& observation = problem.observations[i];
        const bool is_singular =
            observation.image == 0 && (observation.point == 11 || observation.point == 12);
        EXPECT_EQ(linearized.dense.middleRows(2 * i, 2).isZero(0), is_singular) << i;
    }
}

TEST(Reference, MovingTheWorldFarAwayChangesOnlyDigits) {
    const Problem problem = test::planted_trouble();
    const Problem far = test::shifted(problem, 1e6);
    EXPECT_EQ(reference::residual(far, nullptr).num_behind, test::planted_num_behind);
    EXPECT_EQ(reference::residual(far, nullptr).num_singular, test::planted_num_singular);
    // Coordinates of 1e6 keep epsilon * 1e6, which the Jacobian turns into pixels.
    const double rounding = 10 * epsilon * 1e6 * max_norm(Linearized(problem).e());
    EXPECT_LE(max_norm(residuals_of(far) - residuals_of(problem)), rounding);
}

TEST(Reference, EnlargingTheWorldChangesNoPixel) {
    const Problem problem = test::planted_trouble();
    const Problem large = test::scaled(problem, 1e6);
    EXPECT_LE(max_norm(residuals_of(large) - residuals_of(problem)), 100 * epsilon * 1e4);
    EXPECT_EQ(reference::residual(large, nullptr).num_singular, test::planted_num_singular);
}

}  // namespace
}  // namespace clba
