// SPDX-License-Identifier: Apache-2.0
// Every kernel over a problem against its serial twin in src/reference. Products, blocks and
// factors are given the Jacobian's blocks that the device has, so that each test sees one kernel's
// error.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "device_rig.hpp"
#include "linear/linear_solver.hpp"
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
    JacobianForm form;
    test::Shape shape;
    uint64_t max_allocation_bytes = 0;
};

std::ostream& operator<<(std::ostream& stream, const Case& c) {
    return stream << c.name;
}

std::string case_name(const Case& c) {
    return c.name + "_" + c.shape.name +
           (c.precision == Precision::double_precision ? "_double" : "_mixed") +
           (c.form == JacobianForm::stored ? "_stored" : "_recomputed");
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

reference::Jacobian sum(reference::Jacobian a, const reference::Jacobian& b) {
    for (size_t i = 0; i < a.image_blocks.size(); ++i) a.image_blocks[i] += b.image_blocks[i];
    for (size_t i = 0; i < a.point_blocks.size(); ++i) a.point_blocks[i] += b.point_blocks[i];
    return a;
}

// Entry by entry.
reference::Jacobian product(reference::Jacobian a, const reference::Jacobian& b) {
    for (size_t i = 0; i < a.image_blocks.size(); ++i) a.image_blocks[i] *= b.image_blocks[i];
    for (size_t i = 0; i < a.point_blocks.size(); ++i) a.point_blocks[i] *= b.point_blocks[i];
    return a;
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

void level(double* first, double* second) {
    const double most =
        std::max(*std::max_element(first, first + 3), *std::max_element(second, second + 3));
    std::fill_n(first, 3, most);
    std::fill_n(second, 3, most);
}

// Rotation, position and point of each observation get the largest magnitude of their block: that
// of the terms which a product with blocks never formed adds up, some of which cancel in the block.
reference::Jacobian levelled(reference::Jacobian j) {
    for (int64_t i = 0; i < j.num_observations(); ++i) {
        double* image = j.image_blocks.data() + 2 * i * j.columns;
        for (int first : {0, 3}) level(image + first, image + j.columns + first);
        double* point = j.point_blocks.data() + 6 * i;
        level(point, point + 3);
    }
    return j;
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
        terms = levelled(unweighted);
        spread_intrinsics(bare, terms);
        for (size_t i = 0; i < problem.observations.size(); ++i)
            widen(terms, i, distance_from_axis(problem, problem.observations[i]));
        jacobian = terms;
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
    reference::Jacobian terms;  // of what is added up to make the derivatives

private:
    // Each intrinsic parameter has one scale over all observations of an image.
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
    }
    // r = |(u, v)|
    static double distance_from_axis(const Problem& problem, const Observation& observation) {
        const Pose& pose = problem.images[static_cast<size_t>(observation.image)].pose;
        const Point& x = problem.points[static_cast<size_t>(observation.point)];
        const auto r = rotation_matrix(pose.rotation);
        double p[3];
        for (int k = 0; k < 3; ++k)
            p[k] =
                r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2] + pose.translation[k];
        return p[2] == 0 ? 0 : std::hypot(p[0], p[1]) / std::abs(p[2]);
    }
    // With D = d pixel / d(u, v) the column of P.z is -D (u, v) / P.z: its terms are r times those
    // of the other two, of which a fisheye's cancel far from the axis.
    static void widen(reference::Jacobian& j, size_t i, double r) {
        const double factor = std::max(1.0, r);
        for (int row = 0; row < 2; ++row) {
            double* of_image = j.image_blocks.data() +
                               (2 * i + static_cast<size_t>(row)) * static_cast<size_t>(j.columns);
            for (int k = 0; k < num_pose_params; ++k) of_image[k] *= factor;
        }
        for (size_t k = 0; k < 6; ++k) j.point_blocks[6 * i + k] *= factor;
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
// Sluis), relative to G D^1/2 with D = diag(A). real_epsilon is that of its storage; its square
// roots, quotients and products are computed in it too, from pivots in double.
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
                                               8 * real_epsilon * std::abs(twin[at]);
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
        rig_ = std::make_unique<Rig>(context, problem(), precision(), GetParam().form);
        jacobian_ = rig_->jacobian();
        absolute_ = absolute(jacobian_);
        if (is_recomputed()) absolute_ = levelled(absolute_);
        std::vector<double> of_image(problem().images.size(), 0),
            of_point(problem().points.size(), 0);
        for (const Observation& o : problem().observations)
            most_terms_ = std::max({most_terms_, ++of_image[static_cast<size_t>(o.image)],
                                    ++of_point[static_cast<size_t>(o.point)]});
        most_terms_ += jacobian_.columns;
    }

    const Problem& problem() const { return GetParam().problem; }
    Precision precision() const { return GetParam().precision; }
    bool is_recomputed() const { return GetParam().form == JacobianForm::recomputed; }
    double real_epsilon() const { return test::epsilon(precision()); }
    const ParameterLayout& layout() const { return rig_->device.layout(); }
    int64_t num_parameters() const { return layout().num_parameters(problem()); }
    // Of a sum in REAL, and in double, over all observations of an image or a point.
    double real_bound() const { return real_epsilon() * (most_terms_ + 4); }
    double double_bound() const { return double_epsilon * (4 * most_terms_ + 4); }
    // Of blocks: products of rows in REAL, whose sums over a piece of 128 slots make an error of
    // the square root of their number, added up in double.
    double block_bound() const { return slack * real_epsilon() + double_bound(); }

    // Derivatives in double precision with the columns of constant parameters, which the device
    // keeps in its diagonal and in V.
    reference::Jacobian free_jacobian() const {
        Problem free = problem();
        free.constant_images.clear();
        free.constant_cameras.clear();
        free.constant_points.clear();
        return reference::jacobian(free, ParameterLayout(free));
    }
    // V^-1 r of each point, and the same of magnitudes.
    std::vector<double> point_solution(const std::vector<double>& factors,
                                       const std::vector<double>& r) const {
        std::vector<double> z(r.size());
        for (size_t p = 0; 3 * p < r.size(); ++p) {
            const Eigen::Matrix3d g =
                Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(factors.data() +
                                                                               9 * p);
            Eigen::Map<Eigen::Vector3d>(z.data() + 3 * p) =
                g.transpose() * (g * Eigen::Map<const Eigen::Vector3d>(r.data() + 3 * p));
        }
        return z;
    }
    // (x_F, 0) and (0, x_E).
    std::vector<double> of_images(std::vector<double> f) const {
        f.resize(static_cast<size_t>(num_parameters()), 0.0);
        return f;
    }
    std::vector<double> of_points(const std::vector<double>& e) const {
        std::vector<double> x(static_cast<size_t>(layout().num_f), 0.0);
        x.insert(x.end(), e.begin(), e.end());
        return x;
    }
    std::vector<double> points_of(const std::vector<double>& x) const {
        return {x.begin() + layout().num_f, x.end()};
    }
    std::vector<double> jx(const reference::Jacobian& j, const std::vector<double>& x) const {
        return reference::jx(problem(), layout(), j, x);
    }
    std::vector<double> jty(const reference::Jacobian& j, const std::vector<double>& y) const {
        return reference::jty(problem(), layout(), j, y);
    }

    std::unique_ptr<Rig> rig_;
    reference::Jacobian jacobian_;  // what the device has
    reference::Jacobian absolute_;  // magnitudes of what products with it add up
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
    // Blocks that are stored are rounded to REAL once; the others are computed in REAL from u, v,
    // 1 / z and a weight that are rounded to it.
    reference::Jacobian in_real = absolute(wanted);
    double real_share = precision() == Precision::mixed ? real_epsilon() : 0;
    if (is_recomputed()) {
        in_real = rounding.terms;
        mask_constants(problem(), layout(), in_real);
        real_share = slack * real_epsilon();
    }
    real_share /= slack * double_epsilon;
    expect_near(jacobian_.image_blocks, wanted.image_blocks,
                sum(rounding.jacobian.image_blocks, in_real.image_blocks, real_share),
                slack * double_epsilon, "image block value");
    expect_near(jacobian_.point_blocks, wanted.point_blocks,
                sum(rounding.jacobian.point_blocks, in_real.point_blocks, real_share),
                slack * double_epsilon, "point block value");

    std::vector<double> r(2 * problem().observations.size());
    reference::residual(problem(), r.data());
    const reference::Jacobian size = absolute(wanted);
    const std::vector<double> gradient = jty(wanted, r);
    std::vector<double> bound = jty(size, rounding.residuals);
    bound = sum(bound, jty(rounding.jacobian, absolute(r)), 1);
    bound = sum(bound, jty(size, absolute(r)), most_terms_);
    // Of the points it is rounded to REAL.
    bound = sum(bound, of_points(points_of(absolute(gradient))),
                real_epsilon() / (slack * double_epsilon));
    const std::vector<double> device_gradient = rig_->gradient();
    expect_near(device_gradient, gradient, bound, slack * double_epsilon, "gradient");

    double largest = 0;
    for (double g : device_gradient) largest = std::max(largest, std::abs(g));
    EXPECT_NEAR(rig_->equations.gradient_max_norm(), largest, real_epsilon() * largest);
}

TEST_P(KernelTest, LargestGradientOfTiles) {
    const std::vector<double> gradient = points_of(rig_->gradient());
    for (bool is_planted : {false, true}) {
        // A coordinate of the last point that is seen is no number.
        int32_t point_of_nan = -1;
        if (is_planted) {
            for (const Observation& o : problem().observations)
                point_of_nan = std::max(point_of_nan, o.point);
            if (point_of_nan < 0 || point_scale(problem(), point_of_nan)[0] == 0) return;
            Problem planted = problem();
            planted.points[static_cast<size_t>(point_of_nan)][1] =
                std::numeric_limits<double>::quiet_NaN();
            rig_->device.upload_state(planted);
            rig_->evaluator.linearize(rig_->equations);
            EXPECT_EQ(rig_->equations.gradient_max_norm(), std::numeric_limits<double>::infinity());
        }
        const auto largest = rig_->equations.tile_max.map_read<double>();
        int64_t next = 0;
        for (const Chunk& chunk : rig_->device.tiles().chunks) {
            for (int32_t tile = 0; tile < chunk.num_tiles(); ++tile) {
                double wanted = 0;
                for (int32_t k = 0; k < chunk.tile_num_points[tile]; ++k) {
                    const int32_t point = chunk.slot_point[chunk.tile_points[tile] + k];
                    for (int m = 0; m < 3; ++m)
                        wanted = point == point_of_nan
                                     ? std::numeric_limits<double>::infinity()
                                     : std::max(wanted, std::abs(gradient[3 * point + m]));
                    if (point == point_of_nan) break;
                }
                const double found = largest[next++];
                EXPECT_TRUE(
                    found == wanted ||
                    (std::isfinite(wanted) && std::abs(found - wanted) <= real_epsilon() * wanted))
                    << "tile " << tile << ": " << found << ", but the twin has " << wanted;
            }
        }
    }
}

TEST_P(KernelTest, ProductsWithTheJacobian) {
    const std::vector<double> x = test::random_vector(num_parameters(), 1);
    const Vector device_x = rig_->upload(x);
    rig_->equations.jacobian.multiply(device_x);
    const std::vector<double> product = rig_->product();
    expect_near(product, reference::jx(problem(), layout(), jacobian_, x),
                reference::jx(problem(), layout(), absolute_, absolute(x)),
                real_epsilon() * (jacobian_.columns + 6), "J x");
    const double squared_norm =
        std::inner_product(product.begin(), product.end(), product.begin(), 0.0);
    EXPECT_NEAR(rig_->equations.jacobian.squared_norm(device_x), squared_norm,
                double_epsilon * static_cast<double>(product.size() + 2) * squared_norm);

    const std::vector<double> y = test::random_vector(2 * problem().num_observations(), 2);
    rig_->set_product(y);
    Vector transposed = rig_->device.make_vector("test");
    rig_->equations.jacobian.add_transposed(transposed);
    expect_near(rig_->download(transposed), reference::jty(problem(), layout(), jacobian_, y),
                reference::jty(problem(), layout(), absolute_, absolute(y)), real_bound(), "J^T y");
}

TEST_P(KernelTest, DiagonalBlocks) {
    const auto wanted = reference::normal_blocks(problem(), layout(), jacobian_).u;
    const auto bound = reference::normal_blocks(problem(), layout(), absolute_).u;
    const auto u = rig_->image_matrices(rig_->equations.u());
    for (size_t b = 0; b < u.size(); ++b)
        expect_near(u[b], lower_triangle(wanted[b]), bound[b], block_bound(), "U");
}

// With E = slack epsilon R the error of J: that of J_k^2 is below 2 |J_k| E_k + E_k^2.
TEST_P(KernelTest, Diagonal) {
    const Rounding rounding(problem());
    const reference::Jacobian j = free_jacobian(), squares = product(j, j);
    const std::vector<double> ones(2 * problem().observations.size(), 1.0);
    std::vector<double> bound = jty(product(absolute(j), rounding.jacobian), ones);
    bound = sum(bound, jty(product(rounding.jacobian, rounding.jacobian), ones),
                slack * double_epsilon);
    bound = sum(bound, jty(squares, ones), most_terms_);
    expect_near(rig_->download_reduced(rig_->equations.diagonal),
                reduced(layout(), jty(squares, ones)), reduced(layout(), bound),
                2 * slack * double_epsilon, "diagonal");
}

// V = L L^T, where V comes from derivatives in double precision. Rounding L to REAL changes V by
// epsilon |L| |L|^T <= epsilon sqrt(V_ii V_kk). The second pivot p has lost V_11 / p digits, which
// come back where the third one is cut off at 0; p below 64 epsilon V_11 is taken for 0, and with
// it what stands below, up to sqrt(p V_22).
TEST_P(KernelTest, PointRoots) {
    const Rounding rounding(problem());
    const reference::Jacobian j = free_jacobian();
    const auto blocks = [&](const reference::Jacobian& of) {
        return reference::normal_blocks(problem(), layout(), of).v;
    };
    const std::vector<double> wanted = blocks(j), size = blocks(absolute(j)),
                              error = blocks(rounding.jacobian),
                              both = blocks(sum(absolute(j), rounding.jacobian));
    const std::vector<double> v = rig_->point_blocks();
    const std::vector<double> roots = rig_->point_matrices(rig_->equations.point_roots);
    constexpr double scale = slack * double_epsilon;
    for (size_t p = 0; p < problem().points.size(); ++p) {
        const double v00 = wanted[9 * p], v10 = wanted[9 * p + 3], v11 = wanted[9 * p + 4];
        const double lost = 64 * double_epsilon * v11;
        const double pivot = std::max(v00 > 0 ? v11 - v10 * v10 / v00 : v11, lost);
        const bool may_be_lost = pivot <= 2 * lost;
        for (size_t row = 0; row < 3; ++row) {
            EXPECT_GE(roots[9 * p + 4 * row], 0);
            for (size_t k = 0; k <= row; ++k) {
                const size_t at = 9 * p + 3 * row + k;
                const double diagonal = std::sqrt(wanted[9 * p + 4 * row] * wanted[9 * p + 4 * k]);
                double bound = scale * (both[at] - size[at] - error[at]) +
                               scale * scale * error[at] + double_bound() * size[at] +
                               (real_epsilon() + scale) * diagonal;
                if (row == 1 && k == 1 && may_be_lost) bound += 2 * lost;
                if (row == 2 && k == 1 && may_be_lost)
                    bound += std::sqrt(2 * lost * wanted[9 * p + 8]);
                if (k == 2 && pivot > 0) bound += scale * diagonal * v11 / pivot;
                ASSERT_TRUE(std::abs(v[at] - wanted[at]) <= bound)
                    << "V of point " << p << ' ' << row << ' ' << k << ": " << v[at]
                    << ", but the twin has " << wanted[at] << "; they may differ by " << bound;
            }
        }
    }
}

TEST_P(KernelTest, InverseFactors) {
    EXPECT_EQ(rig_->equations.factor_points(lambda), 0);
    EXPECT_EQ(rig_->equations.factor_image_blocks(lambda), 0);
    const std::vector<double> d2 = rig_->damping();
    const std::vector<double> scales = rig_->scales();
    const auto u = rig_->image_matrices(rig_->equations.u());
    const auto image_factors = rig_->image_matrices(rig_->equations.image_factors());
    for (size_t b = 0; b < u.size(); ++b) {
        const int32_t offset = layout().blocks[b].offset;
        expect_inverse_factor(with_damping(u[b], d2.data() + offset), scales.data() + offset,
                              image_factors[b], 0);
    }
    const auto v = rig_->point_blocks();
    const auto point_factors = rig_->point_matrices(rig_->equations.point_factors());
    for (size_t p = 0; p < problem().points.size(); ++p) {
        const size_t offset = static_cast<size_t>(layout().num_f) + 3 * p;
        expect_inverse_factor(with_damping(point_matrix(v, p), d2.data() + offset),
                              scales.data() + offset, point_matrix(point_factors, p),
                              real_epsilon());
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
    const auto factors = rig_->point_matrices(rig_->equations.point_factors());
    const std::vector<double> no_damping(static_cast<size_t>(layout().num_f), 0.0);
    const std::vector<double> x = test::random_vector(layout().num_f, 4);
    Vector y = rig_->device.make_reduced_vector("test");
    rig_->equations.jacobian.add_schur_product(rig_->upload_reduced(x),
                                               rig_->equations.point_factors(), y);
    const std::vector<double> u_x =
        reduced(layout(), jty(absolute_, jx(absolute_, of_images(absolute(x)))));
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
                    sum(sum(u[b], u[b], 1), difference[b], -1), block_bound(), "block of S");
}

TEST_P(KernelTest, EliminationOfPoints) {
    ASSERT_EQ(rig_->equations.factor_points(lambda), 0);
    const auto factors = rig_->point_matrices(rig_->equations.point_factors());
    const std::vector<double> g = points_of(rig_->gradient());
    Vector y = rig_->upload_reduced(test::random_vector(layout().num_f, 4));  // to be overwritten
    rig_->equations.jacobian.eliminate(rig_->device.make_reduced_vector("zero"),
                                       rig_->equations.point_gradient,
                                       rig_->equations.point_factors(), y);
    const std::vector<double> wanted =
        reduced(layout(), jty(jacobian_, jx(jacobian_, of_points(point_solution(factors, g)))));
    const std::vector<double> bound = reduced(
        layout(),
        jty(absolute_, jx(absolute_, of_points(point_solution(absolute(factors), absolute(g))))));
    expect_near(rig_->download_reduced(y), sum(std::vector<double>(wanted.size(), 0.0), wanted, -1),
                bound, 4 * real_bound(), "-W V^-1 g");
}

TEST_P(KernelTest, BackSubstitution) {
    ASSERT_EQ(rig_->equations.factor_points(lambda), 0);
    Jacobian& jacobian = rig_->equations.jacobian;
    const auto factors = rig_->point_matrices(rig_->equations.point_factors());
    const std::vector<double> g = points_of(rig_->gradient());
    std::vector<double> x = test::random_vector(layout().num_f, 8);
    for (double& value : x) value *= 1e-3;
    const BackSubstitution found = jacobian.back_substitute(
        rig_->upload_reduced(x), rig_->equations.point_gradient, rig_->equations.point_factors());
    const std::vector<double> step = rig_->point_values(jacobian.point_step(), 3);

    const std::vector<double> right =
        sum(g, points_of(jty(jacobian_, jx(jacobian_, of_images(x)))), 1);
    const std::vector<double> size =
        sum(absolute(g), points_of(jty(absolute_, jx(absolute_, of_images(absolute(x))))), 1);
    const std::vector<double> minus_step = point_solution(factors, right);
    expect_near(step, sum(std::vector<double>(step.size(), 0.0), minus_step, -1),
                point_solution(absolute(factors), size), 4 * real_bound(), "step of points");

    // What follows is of the step that the device found.
    std::vector<double> points, trial;
    rig_->device.state.points.swap(rig_->device.trial.points);
    Problem moved = problem();
    rig_->device.download_state(moved);
    for (size_t p = 0; p < moved.points.size(); ++p) {
        points.insert(points.end(), problem().points[p].begin(), problem().points[p].end());
        trial.insert(trial.end(), moved.points[p].begin(), moved.points[p].end());
    }
    expect_near(trial, sum(points, step, 1), sum(absolute(points), absolute(step), 1),
                double_epsilon, "trial point");
    double slope = 0, slope_size = 0, squared_steps = 0, squared_norm = 0, norm_error = 0;
    for (size_t i = 0; i < step.size(); ++i) {
        slope += g[i] * step[i];
        slope_size += std::abs(g[i] * step[i]);
        squared_steps += step[i] * step[i];
    }
    const double terms = static_cast<double>(step.size() + 8);
    EXPECT_NEAR(found.slope, slope, double_epsilon * terms * slope_size);
    EXPECT_NEAR(found.squared_point_steps, squared_steps, double_epsilon * terms * squared_steps);
    const std::vector<double> full = sum(of_images(x), of_points(step), 1);
    const std::vector<double> j_step = jx(jacobian_, full), j_size = jx(absolute_, absolute(full));
    const double error = real_epsilon() * (jacobian_.columns + 6);
    for (size_t i = 0; i < j_step.size(); ++i) {
        squared_norm += j_step[i] * j_step[i];
        norm_error += (2 * std::abs(j_step[i]) + error * j_size[i]) * error * j_size[i];
    }
    EXPECT_NEAR(found.squared_norm, squared_norm,
                norm_error + real_bound() * squared_norm +
                    double_epsilon * static_cast<double>(j_step.size()) * squared_norm);
}

TEST_P(KernelTest, StepOfAllParameters) {
    const std::vector<double> scales = rig_->scales(), g = rig_->gradient();
    std::vector<double> step = test::random_vector(num_parameters(), 9);
    for (size_t k = 0; k < step.size(); ++k) step[k] *= scales[k] > 0 ? 1e-3 : 0;
    LinearSolution solution;
    take_step(rig_->equations, rig_->upload(g), rig_->upload(step), solution);
    const std::vector<double> j_step = jx(jacobian_, step), j_size = jx(absolute_, absolute(step));
    const double error = real_epsilon() * (jacobian_.columns + 6);
    double decrease = 0, tolerance = 0, squared_step = 0;
    const double sum_error = double_epsilon * static_cast<double>(step.size() + j_step.size() + 8);
    for (size_t i = 0; i < step.size(); ++i) {
        decrease -= g[i] * step[i];
        tolerance += sum_error * std::abs(g[i] * step[i]);
        squared_step += step[i] * step[i];
    }
    for (size_t i = 0; i < j_step.size(); ++i) {
        decrease -= 0.5 * j_step[i] * j_step[i];
        tolerance += (std::abs(j_step[i]) + error * j_size[i]) * error * j_size[i] +
                     sum_error * j_step[i] * j_step[i];
    }
    EXPECT_NEAR(solution.model_decrease, decrease, tolerance);
    EXPECT_NEAR(solution.step_norm, std::sqrt(squared_step), sum_error * std::sqrt(squared_step));
    Problem moved = problem(), wanted = problem();
    apply_step(layout(), step.data(), wanted);
    rig_->device.state.swap(rig_->device.trial);
    rig_->device.download_state(moved);
    EXPECT_EQ(moved.points, wanted.points);
    for (size_t c = 0; c < wanted.cameras.size(); ++c)
        EXPECT_EQ(moved.cameras[c].params, wanted.cameras[c].params);
}

// A step that is rejected leaves the Jacobian to the next one.
TEST_P(KernelTest, CostOfATrialLeavesTheJacobian) {
    std::vector<double> step = test::random_vector(num_parameters(), 10);
    const std::vector<double> scales = rig_->scales();
    for (size_t k = 0; k < step.size(); ++k) step[k] *= scales[k] > 0 ? 0.1 : 0;
    const Vector device_step = rig_->upload(step);
    rig_->equations.jacobian.multiply(device_step);
    const std::vector<double> product = rig_->product();
    rig_->device.update(device_step);
    rig_->evaluator.cost(rig_->device.trial, nullptr);
    rig_->equations.jacobian.multiply(device_step);
    EXPECT_EQ(rig_->product(), product);
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
    const auto records = rig_->device.state.image_records.map_read<double>();
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
        const auto at = static_cast<int64_t>(i) * (12 + rig_->device.most_camera_params());
        const auto rotation = rotation_matrix(device_pose.rotation);
        for (int k = 0; k < 9; ++k) EXPECT_NEAR(records[at + k], rotation[k], tolerance);
        for (int k = 0; k < 3; ++k) EXPECT_EQ(records[at + 9 + k], device_pose.translation[k]);
        const Camera& camera = moved.cameras[static_cast<size_t>(moved.images[i].camera)];
        for (int k = 0; k < rig_->device.most_camera_params(); ++k)
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

// Points seen once: V has rank 2. Rays of most of them are within an angle of 10^-k, or 0, of the
// plane z = 0, where the block of x and y alone is close to singular.
Problem seen_once() {
    Problem problem;
    problem.cameras.resize(1);
    problem.cameras[0].model = camera_simple_pinhole;
    problem.cameras[0].params = {800, 400, 300};
    // Looks along x + y: the rows of R are the camera's axes.
    const double half = std::sqrt(0.5);
    Eigen::Matrix3d rotation;
    rotation << half, -half, 0, 0, 0, -1, half, half, 0;
    const Eigen::Quaterniond q(rotation);
    problem.images.resize(1);
    problem.images[0].pose.rotation = {q.w(), q.x(), q.y(), q.z()};
    for (int k = 0; k <= 18; ++k) {
        const double height = k == 0 ? 0 : std::pow(10.0, -k);
        problem.points.push_back({2, 2, height});
        problem.points.push_back({1, 3, height});
    }
    for (int32_t p = 0; p < problem.num_points(); ++p)
        problem.observations.push_back({0, p, 400.0 + p, 300});
    problem.validate();
    return problem;
}

// Runs are longer than the 128 slots of a piece (kernels/blocks.cl).
Problem many_points() {
    return test::small_scene(4, 3000, {camera_snavely}, false, 33);
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

constexpr Precision both_precisions[] = {Precision::double_precision, Precision::mixed};
constexpr JacobianForm both_forms[] = {JacobianForm::recomputed, JacobianForm::stored};

// Compiling kernels takes most of the time, and each loss, camera model, precision and use of
// covariances has its own: what does not depend on the precision is tested in one.
std::vector<Case> problem_cases() {
    const int num_points = test::is_small() ? 12 : 60;
    const std::vector<int32_t> snavely = {camera_snavely};
    std::vector<Case> cases;
    const auto add_form = [&](const std::string& name, const Problem& problem, Precision precision,
                              JacobianForm form) {
        cases.push_back({name, problem, precision, form, test::device_shape()});
    };
    const auto add = [&](const std::string& name, const Problem& problem, Precision precision) {
        add_form(name, problem, precision, JacobianForm::recomputed);
    };
    const auto add_both = [&](const std::string& name, const Problem& problem) {
        for (Precision precision : both_precisions) add(name, problem, precision);
    };
    const auto add_forms = [&](const std::string& name, const Problem& problem,
                               Precision precision) {
        for (JacobianForm form : both_forms) add_form(name, problem, precision, form);
    };
    const auto add_all = [&](const std::string& name, const Problem& problem) {
        for (Precision precision : both_precisions) add_forms(name, problem, precision);
    };
    for (int32_t model : test::all_camera_models())
        add(camera_models[model].name,
            test::with_widest_camera(test::small_scene(test::is_small() ? 2 : 5, num_points,
                                                       {model}, false,
                                                       static_cast<uint64_t>(model) + 10)),
            Precision::mixed);
    add("wide_angle", test::wide_angle_scene(), Precision::mixed);
    add_all("everything", main_scene());
    const Problem scene = test::small_scene(4, num_points, snavely, false, 20);
    // Scales about the size of the residuals, so that both branches of a loss are taken.
    add_forms("huber", test::with_loss(scene, LossKind::huber, 5), Precision::mixed);
    add("soft_l1", test::with_loss(scene, LossKind::soft_l1, 5), Precision::double_precision);
    add("cauchy", test::with_loss(scene, LossKind::cauchy, 5), Precision::double_precision);
    add("tukey", test::with_loss(scene, LossKind::tukey, 8), Precision::mixed);
    add_forms("covariances_tukey",
              test::with_loss(test::with_covariances(scene, 26), LossKind::tukey, 8),
              Precision::double_precision);
    add_forms("trouble", test::planted_trouble(), Precision::mixed);
    add("trouble", test::planted_trouble(), Precision::double_precision);
    add_both("seen_once", seen_once());
    add("nothing_observed", nothing_observed(), Precision::mixed);
    if (test::is_small()) return cases;
    add("all_models", test::small_scene(13, 100, test::all_camera_models(), false, 21),
        Precision::mixed);
    add("all_models_shared", test::small_scene(26, 100, test::all_camera_models(), true, 22),
        Precision::mixed);
    // One of each kind of distortion.
    add("some_models",
        test::small_scene(6, 100, {camera_full_opencv, camera_fov, camera_thin_prism_fisheye},
                          false, 21),
        Precision::double_precision);
    add_both("snavely_shared", test::small_scene(6, 80, snavely, true, 23));
    add_both("covariances", test::with_covariances(test::mixed_scene(6, 80, 24), 25));
    add_both("constants", test::with_constants(test::mixed_scene(6, 80, 27)));
    add_both("uncertainties", test::with_uncertainties(test::mixed_scene(6, 80, 28), 29));
    add_both("shifted", test::shifted(test::mixed_scene(6, 80, 30), 1e6));
    add_both("scaled", test::scaled(test::mixed_scene(6, 80, 31), 1e6));
    add_all("repeated_pairs", with_repeated_pairs(test::mixed_scene(6, 80, 32)));
    add_both("one_observation", one_observation());
    add_both("many_points", many_points());
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
    const auto add_form = [&](const char* name, const Problem& problem, JacobianForm form,
                              const test::Shape& shape) {
        cases.push_back({name, problem, Precision::mixed, form, shape});
    };
    const auto add = [&](const char* name, const Problem& problem, const test::Shape& shape) {
        for (JacobianForm form : both_forms) add_form(name, problem, form, shape);
    };
    add("everything", everything, test::loop_shape("plain_loops", false, 3, 3, 5));
    add_form("everything", everything, JacobianForm::recomputed, test::group_shape(7, 3, 3, 5));
    if (test::is_small()) {
        add("trouble", test::planted_trouble(), test::group_shape(4, 3, 16, 4));
        add("repeated_pairs", repeated, test::group_shape(16, 2, 16, 5));
        return cases;
    }
    add("repeated_pairs", repeated, test::loop_shape("vector_loops", true, 8, 8, 64));
    add("repeated_pairs", repeated, test::loop_shape("one_lane", true, 1, 1, 64));
    for (int size : {1, 64}) add("repeated_pairs", repeated, test::group_shape(size, size, 16, 64));
    return cases;
}

std::vector<Case> chunk_cases() {
    const test::Shape shape = test::loop_shape("chunks", true, 4, 16, 8);
    const Problem everything = main_scene();
    const uint64_t limit = test::is_small() ? 10'000 : 45'000;  // of floats
    std::vector<Case> cases;
    const auto add = [&](const char* name, const Problem& problem, Precision precision,
                         uint64_t bytes) {
        for (JacobianForm form : both_forms)
            cases.push_back({name, problem, precision, form, shape, bytes});
    };
    add("everything", everything, Precision::mixed, limit);
    add("everything", everything, Precision::double_precision, 2 * limit);
    if (!test::is_small())
        add("repeated_pairs", with_repeated_pairs(test::mixed_scene(6, 200, 50)),
            Precision::double_precision, 600'000);
    return cases;
}

// D^2 of the three policies, where the clamp and the diagonal of the first linearisation matter.
class DampingTest : public testing::TestWithParam<Damping> {};

TEST_P(DampingTest, EqualsTwinAtTwoStates) {
    const auto context = test::test_context();
    test::set_shape(*context, test::device_shape());
    Problem problem = main_scene();
    const DampingOptions options{GetParam(), 3e2, 1e6};
    Rig rig(context, problem, Precision::mixed, JacobianForm::recomputed, options);
    const auto diagonal = [&] {
        std::vector<double> values = rig.download_reduced(rig.equations.diagonal);
        const auto v = rig.point_blocks();
        for (size_t p = 0; p < problem.points.size(); ++p)
            for (size_t k = 0; k < 3; ++k) values.push_back(v[9 * p + 4 * k]);
        return values;
    };
    const std::vector<double> initial = diagonal(), scales = rig.scales();
    for (int state = 0; state < 2; ++state) {
        const std::vector<double> now = diagonal();
        EXPECT_EQ(now == initial, state == 0);
        const std::vector<double> wanted =
            reference::damping_diagonal(static_cast<int>(options.policy), options.min_diagonal,
                                        options.max_diagonal, scales, now, initial);
        expect_near(rig.damping(), wanted, wanted, 8 * double_epsilon, "D^2");
        std::vector<double> step = test::random_vector(static_cast<int64_t>(scales.size()), 6);
        for (size_t k = 0; k < step.size(); ++k) step[k] *= scales[k] > 0 ? 1e-3 : 0;
        rig.device.update(rig.upload(step));
        rig.device.state.swap(rig.device.trial);
        rig.evaluator.linearize(rig.equations);
    }
}

INSTANTIATE_TEST_SUITE_P(Policies, DampingTest,
                         testing::Values(Damping::marquardt, Damping::levenberg,
                                         Damping::uncertainty));

// All that the kernels leave for a solver, as bits.
std::vector<double> all_results(const Problem& problem, Precision precision, JacobianForm form,
                                const test::Shape& shape) {
    const auto context = test::test_context();
    test::set_shape(*context, shape);
    Rig rig(context, problem, precision, form);
    std::vector<double> all = {rig.cost().cost};
    const auto append = [&](const std::vector<double>& values) {
        all.insert(all.end(), values.begin(), values.end());
    };
    append(rig.residuals);
    append(rig.jacobian().image_blocks);
    append(rig.jacobian().point_blocks);
    append(rig.gradient());
    append(rig.download_reduced(rig.equations.diagonal));
    append(rig.point_matrices(rig.equations.point_roots));
    rig.equations.factor_points(lambda);
    append(rig.point_matrices(rig.equations.point_factors()));
    Vector y = rig.upload(test::random_vector(rig.device.layout().num_parameters(problem), 7));
    rig.equations.jacobian.multiply(y);
    append(rig.product());
    rig.equations.jacobian.add_transposed(y);
    append(rig.download(y));
    Vector z = rig.device.make_reduced_vector("test");
    rig.equations.jacobian.add_schur_product(y, rig.equations.point_factors(), z);
    append(rig.download_reduced(z));
    rig.equations.jacobian.eliminate(rig.device.make_reduced_vector("zero"),
                                     rig.equations.point_gradient, rig.equations.point_factors(),
                                     z);
    append(rig.download_reduced(z));
    const BackSubstitution points = rig.equations.jacobian.back_substitute(
        z, rig.equations.point_gradient, rig.equations.point_factors());
    append({points.squared_norm, points.slope, points.squared_point_steps});
    append(rig.point_values(rig.equations.jacobian.point_step(), 3));
    for (const auto& matrix : rig.image_matrices(rig.equations.u())) append(matrix);
    Buffer packed(rig.device.queue(), rig.device.matrices_bytes(), "blocks");
    rig.equations.jacobian.schur_blocks(rig.equations.point_factors(), packed);
    for (const auto& matrix : rig.image_matrices(packed)) append(matrix);
    all.push_back(rig.device.vectors().dot(y, y));
    return all;
}

TEST(Determinism, TwoRunsGiveEqualBits) {
    const Problem problem = main_scene();
    const auto expect_equal = [&](JacobianForm form, const test::Shape& shape) {
        EXPECT_EQ(all_results(problem, Precision::mixed, form, shape),
                  all_results(problem, Precision::mixed, form, shape));
    };
    for (JacobianForm form : both_forms) expect_equal(form, test::device_shape());
    expect_equal(JacobianForm::recomputed, test::group_shape(7, 3, 3, 5));
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

// So that blocks are added up over several pieces of a run; tiles shrink with the number of units.
TEST(Pieces, AreSeveralOfARun) {
    const auto context = test::test_context();
    if (context->device().compute_units > 4) GTEST_SKIP() << "tiles are small";
    test::set_shape(*context, test::device_shape());
    const DeviceProblem device(context, many_points(), Precision::mixed);
    const Segment& segment = device.tiles().chunks.front().segments.front();
    int32_t longest = 0;
    for (int32_t run = 0; run < segment.num_runs(); ++run)
        longest = std::max(longest, segment.run_slots[run + 1] - segment.run_slots[run]);
    EXPECT_GT(longest, 128);
}

const auto name_of = [](const testing::TestParamInfo<Case>& info) { return case_name(info.param); };
INSTANTIATE_TEST_SUITE_P(Problems, KernelTest, testing::ValuesIn(problem_cases()), name_of);
INSTANTIATE_TEST_SUITE_P(Shapes, KernelTest, testing::ValuesIn(shape_cases()), name_of);
INSTANTIATE_TEST_SUITE_P(Chunks, KernelTest, testing::ValuesIn(chunk_cases()), name_of);

}  // namespace
}  // namespace clba
