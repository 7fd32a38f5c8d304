// SPDX-License-Identifier: Apache-2.0
// Every kernel over a problem against its serial twin in src/reference. Products, blocks and
// factors are given the Jacobian that the device stored, so that each test sees one kernel's error.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "device_rig.hpp"
#include "reference/bundle.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using test::Rig;

constexpr double double_epsilon = std::numeric_limits<double>::epsilon();
constexpr double slack = 16;  // of bounds that leave out constant factors
constexpr double lambda = 1e-4;

struct Case {
    std::string name;
    Problem problem;
    Precision precision;
    test::Shape shape;
    uint64_t max_allocation_bytes = 0;
};

std::ostream& operator<<(std::ostream& stream, const Case& c) {
    return stream << c.name;
}

std::string case_name(const Case& c) {
    return c.name + "_" + c.shape.name +
           (c.precision == Precision::double_precision ? "_double" : "_mixed");
}

std::vector<double> absolute(std::vector<double> values) {
    for (double& value : values) value = std::abs(value);
    return values;
}

reference::Jacobian absolute(reference::Jacobian jacobian) {
    jacobian.image_blocks = absolute(jacobian.image_blocks);
    jacobian.point_blocks = absolute(jacobian.point_blocks);
    return jacobian;
}

std::vector<double> sum(std::vector<double> a, const std::vector<double>& b, double factor) {
    for (size_t i = 0; i < a.size(); ++i) a[i] += factor * b[i];
    return a;
}

std::vector<double> reduced(const ParameterLayout& layout, const std::vector<double>& x) {
    return {x.begin(), x.begin() + layout.num_f};
}

// |a_i - b_i| <= factor * bound_i; NaN fails.
void expect_near(const std::vector<double>& a, const std::vector<double>& b,
                 const std::vector<double>& bound, double factor, const char* what) {
    ASSERT_EQ(a.size(), b.size()) << what;
    ASSERT_EQ(a.size(), bound.size()) << what;
    for (size_t i = 0; i < a.size(); ++i)
        ASSERT_TRUE(std::abs(a[i] - b[i]) <= factor * bound[i])
            << what << ' ' << i << " of " << a.size() << ": " << a[i] << ", but the twin has "
            << b[i] << "; they may differ by " << factor * bound[i];
}

// Bounds on the rounding errors, over epsilon, of residuals and derivatives in double precision.
// Coordinates in the camera's frame, P = R X + t, have an error of |R| |X| + |t|, which the
// derivatives A of the pixels carry on to the residuals, and which is relative to P.z in u, v and
// all derivatives. A loss adds the error that residuals bring into its weight.
struct Rounding {
    explicit Rounding(const Problem& problem) {
        Problem bare = problem;
        bare.loss = Loss();
        bare.constant_images.clear();
        bare.constant_cameras.clear();
        bare.constant_points.clear();
        const ParameterLayout bare_layout(bare);
        const reference::Jacobian unweighted = absolute(reference::jacobian(bare, bare_layout));
        jacobian = unweighted;
        spread_intrinsics(bare, jacobian);
        const int columns = jacobian.columns;
        for (size_t i = 0; i < problem.observations.size(); ++i) {
            const Observation& observation = problem.observations[i];
            const Image& image = problem.images[static_cast<size_t>(observation.image)];
            const Camera& camera = problem.cameras[static_cast<size_t>(image.camera)];
            const auto r = rotation_matrix(image.pose.rotation);
            const Point& x = problem.points[static_cast<size_t>(observation.point)];
            double size[3], depth = 0, largest = 0;
            for (int k = 0; k < 3; ++k) {
                size[k] = std::abs(image.pose.translation[k]);
                depth = image.pose.translation[2];
                for (int m = 0; m < 3; ++m) size[k] += std::abs(r[3 * k + m] * x[m]);
                largest = std::max(largest, size[k]);
            }
            for (int m = 0; m < 3; ++m) depth += r[6 + m] * x[m];
            double pixel_error[2] = {std::abs(observation.x), std::abs(observation.y)};
            if (!problem.whitening.empty()) {
                const auto& l = problem.whitening[i];
                pixel_error[1] = std::abs(l[1]) * pixel_error[0] + std::abs(l[2]) * pixel_error[1];
                pixel_error[0] *= std::abs(l[0]);
            }
            for (int row = 0; row < 2; ++row) {
                const double* j = unweighted.image_blocks.data() + (2 * i + row) * columns;
                for (int k = 0; k < 3; ++k) pixel_error[row] += j[3 + k] * size[k];
                for (int k = 0; k < camera.num_params(); ++k)
                    pixel_error[row] += j[num_pose_params + k] * std::abs(camera.params[k]);
                residuals.push_back(pixel_error[row]);
            }
            const double of_depth = depth == 0 ? 0 : largest / std::abs(depth);
            const double of_weight = problem.loss.kind == LossKind::none
                                         ? 0
                                         : (pixel_error[0] + pixel_error[1]) / problem.loss.scale;
            scale_blocks(jacobian, i, of_depth + of_weight);
        }
    }

    std::vector<double> residuals;
    reference::Jacobian jacobian;

private:
    // Groups of columns have one scale: rotation, position, point, and each intrinsic parameter
    // over all observations of an image.
    static void spread_intrinsics(const Problem& problem, reference::Jacobian& j) {
        std::vector<std::vector<double>> largest(
            problem.images.size(), std::vector<double>(static_cast<size_t>(j.columns), 0.0));
        const auto for_each_row = [&](auto&& visit) {
            for (int64_t i = 0; i < j.num_observations(); ++i)
                for (int row = 0; row < 2; ++row)
                    visit(largest[static_cast<size_t>(j.image[i])],
                          j.image_blocks.data() + (2 * i + row) * j.columns);
        };
        for_each_row([&](std::vector<double>& most, const double* row) {
            for (int k = num_pose_params; k < j.columns; ++k) most[k] = std::max(most[k], row[k]);
        });
        for_each_row([&](std::vector<double>& most, double* row) {
            for (int k = num_pose_params; k < j.columns; ++k) row[k] = most[k];
        });
        for (int64_t i = 0; i < j.num_observations(); ++i) {
            double* top = j.image_blocks.data() + 2 * i * j.columns;
            for (int first : {0, 3}) level({top + first, top + j.columns + first});
            double* point = j.point_blocks.data() + 6 * i;
            level({point, point + 3});
        }
    }
    static void level(std::pair<double*, double*> rows) {
        const double most = std::max(*std::max_element(rows.first, rows.first + 3),
                                     *std::max_element(rows.second, rows.second + 3));
        std::fill_n(rows.first, 3, most);
        std::fill_n(rows.second, 3, most);
    }
    static void scale_blocks(reference::Jacobian& j, size_t i, double factor) {
        const auto columns = static_cast<size_t>(j.columns);
        for (size_t k = 0; k < 2 * columns; ++k) j.image_blocks[2 * i * columns + k] *= factor;
        for (size_t k = 0; k < 6; ++k) j.point_blocks[6 * i + k] *= factor;
    }
};

// Sets the columns of constant parameters to 0, as the twin has them.
void mask_constants(const Problem& problem, const ParameterLayout& layout, reference::Jacobian& j) {
    for (int64_t i = 0; i < j.num_observations(); ++i) {
        const int32_t image = j.image[i], camera = problem.images[image].camera;
        const auto scale = point_scale(problem, j.point[i]);
        for (int row = 0; row < 2; ++row) {
            double* of_image = j.image_blocks.data() + (2 * i + row) * j.columns;
            for (int k = 0; k < num_pose_params; ++k)
                if (layout.scale[layout.pose_offset[image] + k] == 0) of_image[k] = 0;
            for (int k = 0; k < problem.cameras[camera].num_params(); ++k)
                if (layout.scale[layout.intrinsics_offset[camera] + k] == 0)
                    of_image[num_pose_params + k] = 0;
            for (int k = 0; k < 3; ++k)
                if (scale[k] == 0) j.point_blocks[3 * (2 * i + row) + k] = 0;
        }
    }
}

// Lower triangles of full matrices, for comparison with what the device stores.
std::vector<double> lower_triangle(std::vector<double> matrix) {
    const auto n = static_cast<size_t>(std::lround(std::sqrt(matrix.size())));
    for (size_t row = 0; row < n; ++row)
        for (size_t k = row + 1; k < n; ++k) matrix[row * n + k] = 0;
    return matrix;
}

std::vector<double> point_matrix(const std::vector<double>& matrices, size_t point) {
    return {matrices.begin() + static_cast<long>(9 * point),
            matrices.begin() + static_cast<long>(9 * point + 9)};
}

std::vector<double> with_damping(std::vector<double> lower, const double* d2) {
    const auto n = static_cast<size_t>(std::lround(std::sqrt(lower.size())));
    for (size_t row = 0; row < n; ++row) {
        lower[row * n + row] += lambda * d2[row];
        for (size_t k = 0; k < row; ++k) lower[k * n + row] = lower[row * n + k];
    }
    return lower;
}

// Errors of an inverse factor G grow with the condition of A scaled to unit diagonal (van der
// Sluis), relative to G D^1/2 with D = diag(A). real_epsilon is that of its storage.
void expect_inverse_factor(const std::vector<double>& a, const double* scale,
                           const std::vector<double>& g, double real_epsilon) {
    const auto n = static_cast<int>(std::lround(std::sqrt(a.size())));
    std::vector<double> twin(a.size());
    ASSERT_TRUE(reference::inverse_factor(n, a.data(), scale, twin.data()));
    MatrixXd scaled = Eigen::Map<const RowMajorMatrix>(a.data(), n, n);
    VectorXd root = VectorXd::Ones(n);
    for (int k = 0; k < n; ++k) {
        if (!scale || scale[k] != 0) {
            root[k] = std::sqrt(scaled(k, k));
            continue;
        }
        scaled.row(k).setZero();
        scaled.col(k).setZero();
        scaled(k, k) = 1;
    }
    scaled = root.cwiseInverse().asDiagonal() * scaled * root.cwiseInverse().asDiagonal();
    const VectorXd eigenvalues =
        Eigen::SelfAdjointEigenSolver<MatrixXd>(scaled, Eigen::EigenvaluesOnly).eigenvalues();
    const double condition = eigenvalues[n - 1] / std::max(eigenvalues[0], double_epsilon);
    const MatrixXd twin_scaled =
        Eigen::Map<const RowMajorMatrix>(twin.data(), n, n) * root.asDiagonal();
    const MatrixXd bound = MatrixXd::Constant(n, n, twin_scaled.cwiseAbs().maxCoeff()) *
                           root.cwiseInverse().asDiagonal();
    for (int row = 0; row < n; ++row) {
        for (int k = 0; k < n; ++k) {
            const auto at = static_cast<size_t>(row * n + k);
            const bool is_zero = k > row || (scale && (scale[row] == 0 || scale[k] == 0));
            const double tolerance = is_zero
                                         ? 0
                                         : slack * n * double_epsilon * condition * bound(row, k) +
                                               real_epsilon * std::abs(twin[at]);
            ASSERT_TRUE(std::abs(g[at] - twin[at]) <= tolerance)
                << "factor " << row << ' ' << k << " of " << n << ": " << g[at]
                << ", but the twin has " << twin[at] << "; they may differ by " << tolerance;
        }
    }
}

// A problem on the device, and the twins' inputs.
class KernelTest : public testing::TestWithParam<Case> {
protected:
    void SetUp() override {
        const auto context = test::test_context(GetParam().max_allocation_bytes);
        test::set_shape(*context, GetParam().shape);
        rig_ = std::make_unique<Rig>(context, problem(), precision());
        jacobian_ = rig_->jacobian();
        absolute_ = absolute(jacobian_);
        std::vector<double> of_image(problem().images.size(), 0),
            of_point(problem().points.size(), 0);
        for (const Observation& o : problem().observations)
            most_terms_ = std::max({most_terms_, ++of_image[static_cast<size_t>(o.image)],
                                    ++of_point[static_cast<size_t>(o.point)]});
        most_terms_ += jacobian_.columns;
    }

    const Problem& problem() const { return GetParam().problem; }
    Precision precision() const { return GetParam().precision; }
    const ParameterLayout& layout() const { return rig_->device.layout(); }
    int64_t num_parameters() const { return layout().num_parameters(problem()); }
    // Of a sum in REAL, and in double, over all observations of an image or a point.
    double real_bound() const { return test::epsilon(precision()) * (most_terms_ + 4); }
    double double_bound() const { return double_epsilon * (4 * most_terms_ + 4); }

    std::unique_ptr<Rig> rig_;
    reference::Jacobian jacobian_, absolute_;  // what the device stored
    double most_terms_ = 0;
};

TEST_P(KernelTest, ResidualsAndCost) {
    const Rounding rounding(problem());
    std::vector<double> wanted(2 * problem().observations.size());
    const reference::Cost cost = reference::residual(problem(), wanted.data());
    const CostEvaluation evaluation = rig_->cost();
    expect_near(rig_->residuals, wanted, rounding.residuals, slack * double_epsilon, "residual");
    double cost_bound = cost.cost * static_cast<double>(wanted.size() + 8);
    for (size_t i = 0; i < wanted.size(); ++i)
        cost_bound += slack * std::abs(wanted[i]) * rounding.residuals[i];
    EXPECT_NEAR(evaluation.cost, cost.cost, double_epsilon * cost_bound);
    EXPECT_EQ(evaluation.num_behind, cost.num_behind);
    EXPECT_EQ(evaluation.num_singular, cost.num_singular);
    EXPECT_EQ(rig_->evaluator.cost(rig_->device.state, nullptr).cost, evaluation.cost);
}

TEST_P(KernelTest, JacobianAndGradient) {
    Rounding rounding(problem());
    const reference::Jacobian wanted = reference::jacobian(problem(), layout());
    mask_constants(problem(), layout(), rounding.jacobian);
    mask_constants(problem(), layout(), jacobian_);
    EXPECT_TRUE(rig_->padding_is_zero());
    const double stored =
        precision() == Precision::mixed ? test::epsilon(precision()) / (slack * double_epsilon) : 0;
    expect_near(jacobian_.image_blocks, wanted.image_blocks,
                sum(rounding.jacobian.image_blocks, absolute(wanted.image_blocks), stored),
                slack * double_epsilon, "image block value");
    expect_near(jacobian_.point_blocks, wanted.point_blocks,
                sum(rounding.jacobian.point_blocks, absolute(wanted.point_blocks), stored),
                slack * double_epsilon, "point block value");

    std::vector<double> r(2 * problem().observations.size());
    reference::residual(problem(), r.data());
    const reference::Jacobian size = absolute(wanted);
    std::vector<double> bound = reference::jty(problem(), layout(), size, rounding.residuals);
    bound = sum(bound, reference::jty(problem(), layout(), rounding.jacobian, absolute(r)), 1);
    bound = sum(bound, reference::jty(problem(), layout(), size, absolute(r)), most_terms_);
    expect_near(rig_->download(rig_->equations.gradient),
                reference::jty(problem(), layout(), wanted, r), bound, slack * double_epsilon,
                "gradient");
}

TEST_P(KernelTest, ProductsWithTheJacobian) {
    const std::vector<double> x = test::random_vector(num_parameters(), 1);
    const Vector device_x = rig_->upload(x);
    rig_->equations.jacobian.multiply(device_x);
    const std::vector<double> product = rig_->product();
    expect_near(product, reference::jx(problem(), layout(), jacobian_, x),
                reference::jx(problem(), layout(), absolute_, absolute(x)),
                test::epsilon(precision()) * (jacobian_.columns + 6), "J x");
    const double squared_norm =
        std::inner_product(product.begin(), product.end(), product.begin(), 0.0);
    EXPECT_NEAR(rig_->equations.jacobian.squared_norm(device_x), squared_norm,
                double_epsilon * static_cast<double>(product.size() + 2) * squared_norm);

    const std::vector<double> y = test::random_vector(2 * problem().num_observations(), 2);
    rig_->set_product(y);
    Vector transposed = rig_->upload(x);  // to be overwritten
    rig_->equations.jacobian.multiply_transposed(transposed);
    expect_near(rig_->download(transposed), reference::jty(problem(), layout(), jacobian_, y),
                reference::jty(problem(), layout(), absolute_, absolute(y)), real_bound(), "J^T y");
}

TEST_P(KernelTest, DiagonalBlocks) {
    const reference::NormalBlocks wanted = reference::normal_blocks(problem(), layout(), jacobian_);
    const reference::NormalBlocks bound = reference::normal_blocks(problem(), layout(), absolute_);
    const auto u = rig_->image_matrices(rig_->equations.u());
    for (size_t b = 0; b < u.size(); ++b)
        expect_near(u[b], lower_triangle(wanted.u[b]), bound.u[b], double_bound(), "U");
    const std::vector<double> v = rig_->point_matrices(rig_->equations.v(), false);
    for (size_t p = 0; p < problem().points.size(); ++p)
        expect_near(point_matrix(v, p), lower_triangle(point_matrix(wanted.v, p)),
                    point_matrix(bound.v, p), double_bound(), "V");
}

TEST_P(KernelTest, InverseFactors) {
    EXPECT_EQ(rig_->equations.factor_points(lambda), 0);
    EXPECT_EQ(rig_->equations.factor_images(lambda, rig_->equations.u()), 0);
    const std::vector<double> d2 = rig_->download(rig_->equations.damping());
    const std::vector<double> scales = rig_->scales();
    const auto u = rig_->image_matrices(rig_->equations.u());
    const auto image_factors = rig_->image_matrices(rig_->equations.image_factors());
    for (size_t b = 0; b < u.size(); ++b) {
        const int32_t offset = layout().blocks[b].offset;
        expect_inverse_factor(with_damping(u[b], d2.data() + offset), scales.data() + offset,
                              image_factors[b], 0);
    }
    const auto v = rig_->point_matrices(rig_->equations.v(), false);
    const auto point_factors = rig_->point_matrices(rig_->equations.point_factors(), true);
    for (size_t p = 0; p < problem().points.size(); ++p) {
        const size_t offset = static_cast<size_t>(layout().num_f) + 3 * p;
        expect_inverse_factor(with_damping(point_matrix(v, p), d2.data() + offset),
                              scales.data() + offset, point_matrix(point_factors, p),
                              test::epsilon(precision()));
    }

    // z = G^T G r with the factors that the device stored.
    const std::vector<double> r = test::random_vector(num_parameters(), 3);
    std::vector<double> wanted(r.size()), bound(r.size());
    const auto apply = [&](const std::vector<double>& factor, size_t offset) {
        const auto n = static_cast<int>(std::lround(std::sqrt(factor.size())));
        const MatrixXd g = Eigen::Map<const RowMajorMatrix>(factor.data(), n, n);
        const Eigen::Map<const VectorXd> part(r.data() + offset, n);
        Eigen::Map<VectorXd>(wanted.data() + offset, n) = g.transpose() * (g * part);
        const MatrixXd size = g.cwiseAbs();
        Eigen::Map<VectorXd>(bound.data() + offset, n) =
            size.transpose() * (size * part.cwiseAbs());
    };
    for (size_t b = 0; b < u.size(); ++b)
        apply(image_factors[b], static_cast<size_t>(layout().blocks[b].offset));
    for (size_t p = 0; p < problem().points.size(); ++p)
        apply(point_matrix(point_factors, p), static_cast<size_t>(layout().num_f) + 3 * p);
    Vector z = rig_->upload(r);
    rig_->equations.apply_image_factors(rig_->upload(r), z);
    rig_->equations.apply_point_factors(rig_->upload(r), z);
    expect_near(rig_->download(z), wanted, bound, slack * 4 * double_epsilon, "G^T G r");
}

// Weak points have a V^-1 far larger than 1, so that S = U - W V^-1 W^T cancels: bounds add up the
// two terms. The twins subtract them, hence 2 U - S.
TEST_P(KernelTest, SchurComplement) {
    ASSERT_EQ(rig_->equations.factor_points(lambda), 0);
    const auto factors = rig_->point_matrices(rig_->equations.point_factors(), true);
    const std::vector<double> no_damping(static_cast<size_t>(layout().num_f), 0.0);
    const std::vector<double> x = test::random_vector(layout().num_f, 4);
    Vector y = rig_->upload_reduced(x);
    rig_->equations.jacobian.schur_multiply(rig_->upload_reduced(x),
                                            rig_->equations.point_factors(), y);
    std::vector<double> image_side = absolute(x);
    image_side.resize(static_cast<size_t>(num_parameters()), 0.0);
    const std::vector<double> u_x = reduced(
        layout(), reference::jty(problem(), layout(), absolute_,
                                 reference::jx(problem(), layout(), absolute_, image_side)));
    const std::vector<double> bound =
        sum(sum(u_x, u_x, 1),
            reference::schur_product(problem(), layout(), absolute_, absolute(factors), no_damping,
                                     absolute(x)),
            -1);
    expect_near(rig_->download_reduced(y),
                reference::schur_product(problem(), layout(), jacobian_, factors, no_damping, x),
                bound, 4 * real_bound(), "S x");

    Buffer packed(rig_->device.queue(), rig_->device.matrices_bytes(), "blocks");
    rig_->equations.jacobian.schur_blocks(rig_->equations.point_factors(), packed);
    const auto blocks = rig_->image_matrices(packed);
    const auto wanted = reference::schur_diagonal_blocks(problem(), layout(), jacobian_, factors);
    const auto u = reference::normal_blocks(problem(), layout(), absolute_).u;
    const auto difference =
        reference::schur_diagonal_blocks(problem(), layout(), absolute_, absolute(factors));
    for (size_t b = 0; b < blocks.size(); ++b)
        expect_near(blocks[b], lower_triangle(wanted[b]),
                    sum(sum(u[b], u[b], 1), difference[b], -1),
                    slack * test::epsilon(precision()) + double_bound(), "block of S");
}

TEST_P(KernelTest, StateUpdateAndImageRecords) {
    std::vector<double> step = test::random_vector(num_parameters(), 5);
    const std::vector<double> scales = rig_->scales();
    for (size_t k = 0; k < step.size(); ++k)
        if (scales[k] == 0) step[k] = 0;
    // Rotations by 0, by angles whose squares vanish, and by more than half a turn.
    constexpr double turns[] = {0, 1e-12, 1e-4, 1, 4};
    for (size_t i = 0; i < problem().images.size(); ++i)
        for (int k = 0; k < 3; ++k) step[layout().pose_offset[i] + k] *= turns[i % 5];
    Problem wanted = problem(), moved = problem();
    apply_step(layout(), step.data(), wanted);
    rig_->device.update(rig_->upload(step));
    rig_->device.state.swap(rig_->device.trial);
    rig_->device.download_state(moved);
    const double tolerance = 8 * double_epsilon;
    rig_->device.update_image_records(rig_->device.state);
    const auto records = rig_->device.image_records.map_read<double>();
    for (size_t i = 0; i < wanted.images.size(); ++i) {
        const Pose &pose = wanted.images[i].pose, &device_pose = moved.images[i].pose;
        const double* d = step.data() + layout().pose_offset[i];
        double size = 0;
        for (int k = 0; k < 3; ++k)
            size += std::abs(problem().images[i].pose.translation[k]) + std::abs(d[3 + k]);
        for (int k = 0; k < 4; ++k)
            EXPECT_NEAR(device_pose.rotation[k], pose.rotation[k], tolerance);
        for (int k = 0; k < 3; ++k)
            EXPECT_NEAR(device_pose.translation[k], pose.translation[k], tolerance * size);
        const auto at = static_cast<int64_t>(i) * (12 + max_camera_params);
        const auto rotation = rotation_matrix(device_pose.rotation);
        for (int k = 0; k < 9; ++k) EXPECT_NEAR(records[at + k], rotation[k], tolerance);
        for (int k = 0; k < 3; ++k) EXPECT_EQ(records[at + 9 + k], device_pose.translation[k]);
        const Camera& camera = moved.cameras[static_cast<size_t>(moved.images[i].camera)];
        for (int k = 0; k < max_camera_params; ++k)
            EXPECT_EQ(records[at + 12 + k], camera.params[k]);
    }
    for (size_t c = 0; c < wanted.cameras.size(); ++c)
        EXPECT_EQ(moved.cameras[c].params, wanted.cameras[c].params);
    EXPECT_EQ(moved.points, wanted.points);
}

Problem with_repeated_pairs(Problem problem) {
    const std::vector<Observation> once = problem.observations;
    for (size_t i = 0; i < once.size(); i += 2) {
        Observation again = once[i];
        again.x += 1;
        for (size_t k = 0; k < 1 + i % 3; ++k) problem.observations.push_back(again);
    }
    return problem;
}

Problem one_observation() {
    Problem problem = test::small_scene(1, 1, {camera_radial}, false, 3);
    problem.observations.resize(1);
    return problem;
}

Problem nothing_observed() {
    Problem problem = test::mixed_scene(4, 5, 3);
    problem.observations.clear();
    return problem;
}

Problem main_scene() {
    const Problem scene =
        test::is_small() ? test::mixed_scene(4, 20, 1) : test::mixed_scene(7, 150, 1);
    return test::with_uncertainties(test::with_constants(test::with_covariances(scene, 2)), 3);
}

constexpr Precision both[] = {Precision::double_precision, Precision::mixed};

// Compiling kernels takes most of the time, and each loss, camera model, precision and use of
// covariances has its own: what does not depend on the precision is tested in one.
std::vector<Case> problem_cases() {
    const int num_points = test::is_small() ? 12 : 60;
    const std::vector<int32_t> snavely = {camera_snavely};
    std::vector<Case> cases;
    const auto add = [&](const std::string& name, const Problem& problem, Precision precision) {
        cases.push_back({name, problem, precision, test::device_shape()});
    };
    const auto add_both = [&](const std::string& name, const Problem& problem) {
        for (Precision precision : both) add(name, problem, precision);
    };
    for (int32_t model : test::all_camera_models())
        add_both(camera_models[model].name,
                 test::small_scene(test::is_small() ? 2 : 5, num_points, {model}, false,
                                   static_cast<uint64_t>(model) + 10));
    add_both("everything", main_scene());
    const Problem scene = test::small_scene(4, num_points, snavely, false, 20);
    // Scales about the size of the residuals, so that both branches of a loss are taken.
    add("huber", test::with_loss(scene, LossKind::huber, 5), Precision::mixed);
    add("soft_l1", test::with_loss(scene, LossKind::soft_l1, 5), Precision::double_precision);
    add("cauchy", test::with_loss(scene, LossKind::cauchy, 5), Precision::double_precision);
    add("tukey", test::with_loss(scene, LossKind::tukey, 8), Precision::mixed);
    add("covariances_tukey", test::with_loss(test::with_covariances(scene, 26), LossKind::tukey, 8),
        Precision::double_precision);
    add_both("trouble", test::planted_trouble());
    add("nothing_observed", nothing_observed(), Precision::mixed);
    if (test::is_small()) return cases;
    add_both("all_models", test::small_scene(9, 100, test::all_camera_models(), false, 21));
    add_both("all_models_shared", test::small_scene(14, 100, test::all_camera_models(), true, 22));
    add_both("snavely_shared", test::small_scene(6, 80, snavely, true, 23));
    add_both("covariances", test::with_covariances(test::mixed_scene(6, 80, 24), 25));
    add_both("constants", test::with_constants(test::mixed_scene(6, 80, 27)));
    add_both("uncertainties", test::with_uncertainties(test::mixed_scene(6, 80, 28), 29));
    add_both("shifted", test::shifted(test::mixed_scene(6, 80, 30), 1e6));
    add_both("scaled", test::scaled(test::mixed_scene(6, 80, 31), 1e6));
    add_both("repeated_pairs", with_repeated_pairs(test::mixed_scene(6, 80, 32)));
    add_both("one_observation", one_observation());
    add_both("many_points", test::small_scene(6, 2000, snavely, false, 33));
    add_both("empty", Problem());
    return cases;
}

// Work-groups, tiles and lanes of awkward sizes. A compiler for CPUs takes long over work-groups
// with barriers: all camera models are left to the simulated device.
std::vector<Case> shape_cases() {
    const Problem everything = main_scene();
    const Problem repeated = with_repeated_pairs(
        test::small_scene(6, test::is_small() ? 12 : 100, {camera_snavely}, true, 40));
    std::vector<Case> cases;
    const auto add = [&](const char* name, const Problem& problem, const test::Shape& shape) {
        cases.push_back({name, problem, Precision::mixed, shape});
    };
    add("everything", everything, test::loop_shape("plain_loops", false, 3, 3, 5));
    add("everything", everything, test::group_shape(7, 3, 3, 5));
    if (test::is_small()) {
        add("trouble", test::planted_trouble(), test::group_shape(4, 3, 16, 4));
        add("repeated_pairs", repeated, test::group_shape(16, 2, 16, 5));
        return cases;
    }
    add("repeated_pairs", repeated, test::loop_shape("vector_loops", true, 8, 8, 64));
    add("repeated_pairs", repeated, test::loop_shape("one_lane", true, 1, 1, 64));
    for (int size : {1, 2, 63, 64, 65})
        add("repeated_pairs", repeated, test::group_shape(size, size, 16, 64));
    return cases;
}

std::vector<Case> chunk_cases() {
    const test::Shape shape = test::loop_shape("chunks", true, 4, 16, 8);
    const Problem everything = main_scene();
    const uint64_t limit = test::is_small() ? 15'000 : 45'000;  // of floats
    std::vector<Case> cases = {
        {"everything", everything, Precision::mixed, shape, limit},
        {"everything", everything, Precision::double_precision, shape, 2 * limit},
    };
    if (!test::is_small())
        cases.push_back({"repeated_pairs", with_repeated_pairs(test::mixed_scene(6, 200, 50)),
                         Precision::double_precision, shape, 600'000});
    return cases;
}

// D^2 of the three policies, where the clamp and the diagonal of the first linearisation matter.
class DampingTest : public testing::TestWithParam<Damping> {};

TEST_P(DampingTest, EqualsTwinAtTwoStates) {
    const auto context = test::test_context();
    test::set_shape(*context, test::device_shape());
    Problem problem = main_scene();
    const DampingOptions options{GetParam(), 3e2, 1e6};
    Rig rig(context, problem, Precision::mixed, options);
    const auto diagonal = [&] {
        std::vector<double> values;
        const auto append = [&](const std::vector<double>& matrix, size_t n) {
            for (size_t k = 0; k < n; ++k) values.push_back(matrix[k * (n + 1)]);
        };
        const auto u = rig.image_matrices(rig.equations.u());
        for (size_t b = 0; b < u.size(); ++b)
            append(u[b], static_cast<size_t>(rig.device.layout().blocks[b].size));
        const auto v = rig.point_matrices(rig.equations.v(), false);
        for (size_t p = 0; p < problem.points.size(); ++p) append(point_matrix(v, p), 3);
        return values;
    };
    const std::vector<double> initial = diagonal(), scales = rig.scales();
    for (int state = 0; state < 2; ++state) {
        const std::vector<double> now = diagonal();
        EXPECT_EQ(now == initial, state == 0);
        const std::vector<double> wanted =
            reference::damping_diagonal(static_cast<int>(options.policy), options.min_diagonal,
                                        options.max_diagonal, scales, now, initial);
        expect_near(rig.download(rig.equations.damping()), wanted, wanted, 8 * double_epsilon,
                    "D^2");
        std::vector<double> step = test::random_vector(static_cast<int64_t>(scales.size()), 6);
        for (size_t k = 0; k < step.size(); ++k) step[k] *= scales[k] > 0 ? 1e-3 : 0;
        rig.device.update(rig.upload(step));
        rig.device.state.swap(rig.device.trial);
        rig.evaluator.linearize(rig.equations);
        rig.equations.update_blocks();
    }
}

INSTANTIATE_TEST_SUITE_P(Policies, DampingTest,
                         testing::Values(Damping::marquardt, Damping::levenberg,
                                         Damping::uncertainty));

// All that the kernels leave for a solver, as bits.
std::vector<double> all_results(const Problem& problem, Precision precision,
                                const test::Shape& shape) {
    const auto context = test::test_context();
    test::set_shape(*context, shape);
    Rig rig(context, problem, precision);
    std::vector<double> all = {rig.cost().cost};
    const auto append = [&](const std::vector<double>& values) {
        all.insert(all.end(), values.begin(), values.end());
    };
    append(rig.residuals);
    append(rig.jacobian().image_blocks);
    append(rig.jacobian().point_blocks);
    append(rig.download(rig.equations.gradient));
    rig.equations.factor_points(lambda);
    append(rig.point_matrices(rig.equations.point_factors(), true));
    Vector y = rig.upload(test::random_vector(rig.device.layout().num_parameters(problem), 7));
    rig.equations.jacobian.multiply(y);
    append(rig.product());
    rig.equations.jacobian.multiply_transposed(y);
    append(rig.download(y));
    Vector z = rig.device.make_reduced_vector("test");
    rig.equations.jacobian.schur_multiply(y, rig.equations.point_factors(), z);
    append(rig.download_reduced(z));
    Buffer packed(rig.device.queue(), rig.device.matrices_bytes(), "blocks");
    rig.equations.jacobian.schur_blocks(rig.equations.point_factors(), packed);
    for (const auto& matrix : rig.image_matrices(packed)) append(matrix);
    all.push_back(rig.device.vectors().dot(y, y));
    return all;
}

TEST(Determinism, TwoRunsGiveEqualBits) {
    const Problem problem = main_scene();
    for (const test::Shape& shape : {test::device_shape(), test::group_shape(7, 3, 3, 5)})
        EXPECT_EQ(all_results(problem, Precision::mixed, shape),
                  all_results(problem, Precision::mixed, shape));
}

// So that the cases above do test several.
TEST(Chunks, AreSeveralBelowTheLimit) {
    for (const Case& c : chunk_cases()) {
        const auto context = test::test_context(c.max_allocation_bytes);
        test::set_shape(*context, c.shape);
        const DeviceProblem device(context, c.problem, c.precision);
        EXPECT_GT(device.chunks().size(), 1u) << case_name(c);
    }
}

const auto name_of = [](const testing::TestParamInfo<Case>& info) { return case_name(info.param); };
INSTANTIATE_TEST_SUITE_P(Problems, KernelTest, testing::ValuesIn(problem_cases()), name_of);
INSTANTIATE_TEST_SUITE_P(Shapes, KernelTest, testing::ValuesIn(shape_cases()), name_of);
INSTANTIATE_TEST_SUITE_P(Chunks, KernelTest, testing::ValuesIn(chunk_cases()), name_of);

}  // namespace
}  // namespace clba
