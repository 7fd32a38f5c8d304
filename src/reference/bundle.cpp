// SPDX-License-Identifier: Apache-2.0
#include "reference/bundle.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "base/parallel.hpp"
#include "reference/camera_models.hpp"
#include "reference/loss.hpp"

namespace clba::reference {
namespace {

using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using RowMajor2 = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
using RowMajor23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using VectorMap = Eigen::Map<Eigen::VectorXd>;
using ConstVectorMap = Eigen::Map<const Eigen::VectorXd>;

std::vector<RowMajor3> image_rotations(const Problem& problem) {
    std::vector<RowMajor3> rotations;
    rotations.reserve(problem.images.size());
    for (const Image& image : problem.images)
        rotations.emplace_back(
            Eigen::Map<const RowMajor3>(rotation_matrix(image.pose.rotation).data()));
    return rotations;
}

struct Measured {
    Eigen::Vector3d p;  // the point in the camera's frame
    Projection projection;
    const double* whitening;   // lower triangle of L^-1
    Eigen::Vector2d whitened;  // L^-1 (projection - observation)
};

// use(Measured) of observation i: the compiler makes one piece of the two.
template <class Use>
void measure(const Problem& problem, const std::vector<RowMajor3>& rotations, int64_t i,
             Use&& use) {
    const Observation& observation = problem.observations[i];
    const Image& image = problem.images[observation.image];
    const RowMajor3& r = rotations[observation.image];
    const Point& x = problem.points[observation.point];
    const auto& t = image.pose.translation;
    const Eigen::Vector3d p(r(0, 0) * x[0] + r(0, 1) * x[1] + r(0, 2) * x[2] + t[0],
                            r(1, 0) * x[0] + r(1, 1) * x[1] + r(1, 2) * x[2] + t[1],
                            r(2, 0) * x[0] + r(2, 1) * x[1] + r(2, 2) * x[2] + t[2]);
    static constexpr double identity[] = {1, 0, 1};
    Measured m{p, project(problem.cameras[image.camera], p),
               problem.whitening.empty() ? identity : problem.whitening[i].data(),
               Eigen::Vector2d()};
    const double dx = m.projection.pixel.x() - observation.x;
    const double dy = m.projection.pixel.y() - observation.y;
    m.whitened.x() = m.whitening[0] * dx;
    m.whitened.y() = m.whitening[1] * dx + m.whitening[2] * dy;
    use(m);
}

double sqrt_rho_derivative(const Problem& problem, const Measured& m) {
    return std::sqrt(rho_derivative(problem.loss, m.whitened.squaredNorm()));
}

RowMajor3 cross_product_matrix(const Eigen::Vector3d& p) {
    RowMajor3 matrix;
    matrix << 0, -p.z(), p.y(), p.z(), 0, -p.x(), -p.y(), p.x(), 0;
    return matrix;
}

Eigen::Map<const RowMajor2> image_block(const Jacobian& jacobian, int64_t i) {
    return {jacobian.image_blocks.data() + i * 2 * jacobian.columns, 2, jacobian.columns};
}

Eigen::Map<const RowMajor23> point_block(const Jacobian& jacobian, int64_t i) {
    return Eigen::Map<const RowMajor23>(jacobian.point_blocks.data() + i * 6);
}

RowMajor3 point_inverse(const std::vector<double>& point_factors, int32_t point) {
    const Eigen::Map<const RowMajor3> g(point_factors.data() + 9 * int64_t{point});
    return g.transpose() * g;
}

// The image side of one observation: J_F x, and x += J_F^T y.
Eigen::Vector2d image_jx(const Problem& problem, const ParameterLayout& layout,
                         const Jacobian& jacobian, int64_t i, const std::vector<double>& x) {
    const int32_t image = jacobian.image[i], camera = problem.images[image].camera;
    const int num_params = problem.cameras[camera].num_params();
    const auto block = image_block(jacobian, i);
    return block.leftCols(num_pose_params) *
               ConstVectorMap(x.data() + layout.pose_offset[image], num_pose_params) +
           block.middleCols(num_pose_params, num_params) *
               ConstVectorMap(x.data() + layout.intrinsics_offset[camera], num_params);
}

void add_image_jty(const Problem& problem, const ParameterLayout& layout, const Jacobian& jacobian,
                   int64_t i, const Eigen::Vector2d& y, std::vector<double>& x) {
    const int32_t image = jacobian.image[i], camera = problem.images[image].camera;
    const int num_params = problem.cameras[camera].num_params();
    const auto block = image_block(jacobian, i);
    VectorMap(x.data() + layout.pose_offset[image], num_pose_params) +=
        block.leftCols(num_pose_params).transpose() * y;
    VectorMap(x.data() + layout.intrinsics_offset[camera], num_params) +=
        block.middleCols(num_pose_params, num_params).transpose() * y;
}

// Columns [first, first + size) of an image block belong to a block of the layout.
struct BlockColumns {
    int32_t block, first, size;
};

// Of each image: one entry if it owns its camera, else one for the pose and one for the intrinsics.
std::vector<std::vector<BlockColumns>> block_columns(const Problem& problem,
                                                     const ParameterLayout& layout) {
    std::vector<std::vector<BlockColumns>> columns(problem.images.size());
    std::vector<BlockColumns> of_camera(problem.cameras.size());
    for (size_t b = 0; b < layout.blocks.size(); ++b) {
        const ParameterBlock& block = layout.blocks[b];
        if (block.image >= 0)
            columns[block.image] = {{static_cast<int32_t>(b), 0, block.size}};
        else
            of_camera[block.camera] = {static_cast<int32_t>(b), num_pose_params, block.size};
    }
    for (size_t i = 0; i < columns.size(); ++i)
        if (layout.blocks[columns[i].front().block].camera < 0)
            columns[i].push_back(of_camera[problem.images[i].camera]);
    return columns;
}

std::vector<std::vector<double>> zero_blocks(const ParameterLayout& layout) {
    std::vector<std::vector<double>> blocks;
    for (const ParameterBlock& block : layout.blocks)
        blocks.emplace_back(static_cast<size_t>(block.size) * block.size, 0.0);
    return blocks;
}

// blocks += the diagonal blocks of J_F^T m J_F for one observation.
void add_image_blocks(const std::vector<BlockColumns>& columns,
                      const Eigen::Map<const RowMajor2>& j, const Eigen::Matrix2d& m,
                      std::vector<std::vector<double>>& blocks) {
    for (const BlockColumns& part : columns) {
        const auto j_part = j.middleCols(part.first, part.size);
        Eigen::Map<RowMajorMatrix>(blocks[part.block].data(), part.size, part.size) +=
            j_part.transpose() * m * j_part;
    }
}

}  // namespace

Cost residual(const Problem& problem, double* residuals) {
    constexpr int64_t block_size = 4096;
    const auto rotations = image_rotations(problem);
    const int64_t num_blocks = (problem.num_observations() + block_size - 1) / block_size;
    std::vector<Cost> of_block(static_cast<size_t>(num_blocks));
    parallel_for(num_blocks, [&](int64_t block, int) {
        Cost sum;
        const int64_t end = std::min((block + 1) * block_size, problem.num_observations());
        for (int64_t i = block * block_size; i < end; ++i)
            measure(problem, rotations, i, [&](const Measured& m) {
                sum.cost += 0.5 * rho(problem.loss, m.whitened.squaredNorm());
                sum.num_behind += m.projection.is_behind;
                sum.num_singular += m.projection.is_singular;
                if (residuals)
                    Eigen::Map<Eigen::Vector2d>(residuals + 2 * i) =
                        sqrt_rho_derivative(problem, m) * m.whitened;
            });
        of_block[block] = sum;
    });
    Cost total;
    for (const Cost& sum : of_block) {
        total.cost += sum.cost;
        total.num_behind += sum.num_behind;
        total.num_singular += sum.num_singular;
    }
    return total;
}

void visit_errors(const Problem& problem, int64_t first, int64_t count,
                  const std::function<void(int64_t, const ReprojectionError&)>& visit) {
    constexpr int64_t grain = 1 << 12;
    const auto rotations = image_rotations(problem);
    parallel_ranges(count, grain, [&](int64_t begin, int64_t end) {
        for (int64_t i = first + begin; i < first + end; ++i)
            measure(problem, rotations, i, [&](const Measured& m) {
                const Observation& o = problem.observations[i];
                visit(i, {std::hypot(m.projection.pixel.x() - o.x, m.projection.pixel.y() - o.y),
                          m.whitened.norm(), m.projection.is_behind, m.projection.is_singular});
            });
    });
}

std::vector<double> mean_reprojection_errors(const Problem& problem) {
    std::vector<double> distances(problem.observations.size());
    visit_errors(problem, 0, problem.num_observations(),
                 [&](int64_t i, const ReprojectionError& error) { distances[i] = error.pixels; });
    std::vector<double> errors(problem.points.size());
    std::vector<int64_t> counts(problem.points.size());
    for (size_t i = 0; i < distances.size(); ++i) {
        errors[problem.observations[i].point] += distances[i];
        ++counts[problem.observations[i].point];
    }
    for (size_t p = 0; p < errors.size(); ++p)
        if (counts[p] > 0) errors[p] /= static_cast<double>(counts[p]);
    return errors;
}

Jacobian jacobian(const Problem& problem, const ParameterLayout& layout) {
    const auto rotations = image_rotations(problem);
    const auto num_observations = problem.observations.size();
    Jacobian result;
    result.columns = layout.max_image_columns;
    result.image_blocks.assign(num_observations * 2 * result.columns, 0.0);
    result.point_blocks.assign(num_observations * 6, 0.0);
    for (int64_t i = 0; i < problem.num_observations(); ++i) {
        const Observation& observation = problem.observations[i];
        const int32_t camera = problem.images[observation.image].camera;
        const int num_params = problem.cameras[camera].num_params();
        result.image.push_back(observation.image);
        result.point.push_back(observation.point);

        Eigen::Vector3d p;
        Eigen::Matrix2d weight;  // sqrt(rho') L^-1
        measure(problem, rotations, i, [&](const Measured& m) {
            p = m.p;
            weight << m.whitening[0], 0, m.whitening[1], m.whitening[2];
            weight *= sqrt_rho_derivative(problem, m);
        });
        const auto derivatives = projection_derivatives(problem.cameras[camera], p);
        const RowMajor23 a = weight * derivatives.point;
        Eigen::Map<RowMajor2> j_image(result.image_blocks.data() + i * 2 * result.columns, 2,
                                      result.columns);
        Eigen::Map<RowMajor23> j_point(result.point_blocks.data() + i * 6);
        // P moves to exp(w) P + v, so that d P / d w = -[P]_x and d P / d v = I.
        j_image.leftCols<3>() = -a * cross_product_matrix(p);
        j_image.middleCols<3>(3) = a;
        j_image.middleCols(num_pose_params, num_params) =
            weight * derivatives.params.leftCols(num_params);
        j_point = a * rotations[observation.image];

        for (int k = 0; k < num_pose_params; ++k)
            if (layout.scale[layout.pose_offset[observation.image] + k] == 0)
                j_image.col(k).setZero();
        for (int k = 0; k < num_params; ++k)
            if (layout.scale[layout.intrinsics_offset[camera] + k] == 0)
                j_image.col(num_pose_params + k).setZero();
        const auto scale = point_scale(problem, observation.point);
        for (int k = 0; k < 3; ++k)
            if (scale[k] == 0) j_point.col(k).setZero();
    }
    return result;
}

std::vector<double> jx(const Problem& problem, const ParameterLayout& layout,
                       const Jacobian& jacobian, const std::vector<double>& x) {
    std::vector<double> y(2 * jacobian.image.size());
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        const Eigen::Map<const Eigen::Vector3d> x_point(x.data() + layout.num_f +
                                                        3 * int64_t{jacobian.point[i]});
        Eigen::Map<Eigen::Vector2d>(y.data() + 2 * i) =
            image_jx(problem, layout, jacobian, i, x) + point_block(jacobian, i) * x_point;
    }
    return y;
}

std::vector<double> jty(const Problem& problem, const ParameterLayout& layout,
                        const Jacobian& jacobian, const std::vector<double>& y) {
    std::vector<double> x(static_cast<size_t>(layout.num_parameters(problem)), 0.0);
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        const Eigen::Map<const Eigen::Vector2d> y_i(y.data() + 2 * i);
        add_image_jty(problem, layout, jacobian, i, y_i, x);
        Eigen::Map<Eigen::Vector3d>(x.data() + layout.num_f + 3 * int64_t{jacobian.point[i]}) +=
            point_block(jacobian, i).transpose() * y_i;
    }
    return x;
}

NormalBlocks normal_blocks(const Problem& problem, const ParameterLayout& layout,
                           const Jacobian& jacobian) {
    const auto columns = block_columns(problem, layout);
    NormalBlocks blocks{zero_blocks(layout), std::vector<double>(9 * problem.points.size(), 0.0)};
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        add_image_blocks(columns[jacobian.image[i]], image_block(jacobian, i),
                         Eigen::Matrix2d::Identity(), blocks.u);
        const auto j_point = point_block(jacobian, i);
        Eigen::Map<RowMajor3>(blocks.v.data() + 9 * int64_t{jacobian.point[i]}) +=
            j_point.transpose() * j_point;
    }
    return blocks;
}

std::vector<double> damping_diagonal(int policy, double smallest, double largest,
                                     const std::vector<double>& scale,
                                     const std::vector<double>& diagonal,
                                     const std::vector<double>& initial_diagonal) {
    std::vector<double> d2(scale.size(), 0.0);
    for (size_t i = 0; i < d2.size(); ++i) {
        const double c = scale[i];
        if (c == 0) continue;
        if (policy == 1)
            d2[i] = std::min(std::max(c * c * diagonal[i], smallest), largest) / (c * c);
        else if (policy == 2)
            d2[i] = std::pow((1 + std::sqrt(initial_diagonal[i])) / c, 2);
        else
            d2[i] = 1 / (c * c);
    }
    return d2;
}

bool inverse_factor(int n, const double* a, const double* scale, double* g) {
    const Eigen::Map<const RowMajorMatrix> full(a, n, n);
    Eigen::Map<RowMajorMatrix> factor(g, n, n);
    factor.setZero();
    std::vector<int> free;
    for (int k = 0; k < n; ++k)
        if (!scale || scale[k] != 0) free.push_back(k);
    const auto num_free = static_cast<int>(free.size());
    Eigen::MatrixXd reduced(num_free, num_free);
    for (int row = 0; row < num_free; ++row)
        for (int column = 0; column < num_free; ++column)
            reduced(row, column) = full(free[row], free[column]);
    if (!reduced.allFinite()) return false;
    const Eigen::LLT<Eigen::MatrixXd> cholesky(reduced);
    if (cholesky.info() != Eigen::Success) return false;
    const Eigen::MatrixXd inverse =
        cholesky.matrixL().solve(Eigen::MatrixXd::Identity(num_free, num_free));
    if (!inverse.allFinite()) return false;
    for (int row = 0; row < num_free; ++row)
        for (int column = 0; column <= row; ++column)
            factor(free[row], free[column]) = inverse(row, column);
    return true;
}

std::vector<double> schur_product(const Problem& problem, const ParameterLayout& layout,
                                  const Jacobian& jacobian,
                                  const std::vector<double>& point_factors,
                                  const std::vector<double>& damping_f,
                                  const std::vector<double>& x) {
    std::vector<Eigen::Vector2d> j_x(jacobian.image.size());
    std::vector<Eigen::Vector3d> points(problem.points.size(), Eigen::Vector3d::Zero());
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        j_x[i] = image_jx(problem, layout, jacobian, i, x);
        points[jacobian.point[i]] += point_block(jacobian, i).transpose() * j_x[i];
    }
    for (int32_t p = 0; p < problem.num_points(); ++p)
        points[p] = point_inverse(point_factors, p) * points[p];
    std::vector<double> result(static_cast<size_t>(layout.num_f));
    for (size_t k = 0; k < result.size(); ++k) result[k] = damping_f[k] * x[k];
    for (int64_t i = 0; i < jacobian.num_observations(); ++i)
        add_image_jty(problem, layout, jacobian, i,
                      j_x[i] - point_block(jacobian, i) * points[jacobian.point[i]], result);
    return result;
}

std::vector<std::vector<double>> schur_diagonal_blocks(const Problem& problem,
                                                       const ParameterLayout& layout,
                                                       const Jacobian& jacobian,
                                                       const std::vector<double>& point_factors) {
    const auto columns = block_columns(problem, layout);
    auto blocks = zero_blocks(layout);
    for (int64_t i = 0; i < jacobian.num_observations(); ++i) {
        const auto j_point = point_block(jacobian, i);
        const Eigen::Matrix2d m =
            Eigen::Matrix2d::Identity() -
            j_point * point_inverse(point_factors, jacobian.point[i]) * j_point.transpose();
        add_image_blocks(columns[jacobian.image[i]], image_block(jacobian, i), m, blocks);
    }
    return blocks;
}

}  // namespace clba::reference
