// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "base/stopwatch.hpp"
#include "covariance/estimates.hpp"
#include "covariance/image_tangent.hpp"
#include "covariance/point_sights.hpp"
#include "linear/block_inverse.hpp"

namespace clba {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

class ExactCovariances {
public:
    ExactCovariances(const UndampedSystem& system, SchurStructure structure, Covariance& covariance)
        : system_(system),
          layout_(system.device.layout()),
          schur_(system.problem, system.equations, std::move(structure)),
          covariance_(covariance) {}

    void find() {
        const Stopwatch form;
        schur_.form_blocks();
        system_.device.queue().finish();
        covariance_.form_seconds = form.seconds();
        const Stopwatch factor;
        list_left_out();
        bool is_definite = false;
        schur_.use_values(0, [&](double* values) {
            schur_.leave_out(is_left_out_, values);
            is_definite = schur_.cholesky().factorize(values);
        });
        require_regular(is_definite);
        solve_constraints();
        covariance_.factor_seconds = factor.seconds();
        const Stopwatch inverse;
        invert();
        fill_images();
        fill_composed_images();
        covariance_.inverse_seconds = inverse.seconds();
        const Stopwatch points;
        fill_points();
        covariance_.point_seconds = points.seconds();
    }

private:
    // Parameters without observations, and as many scalars as there are freedoms, such that the
    // rows of the similarities there are as independent as can be.
    void list_left_out() {
        is_left_out_.resize(static_cast<size_t>(layout_.num_f));
        for (int32_t k = 0; k < layout_.num_f; ++k)
            is_left_out_[k] = !(layout_.scale[k] > 0) || !system_.is_observed[k];
        const int num_freedoms = system_.gauge.num_freedoms();
        if (num_freedoms == 0) return;
        MatrixXd rows = system_.gauge.of_f().transpose();
        for (const ParameterBlock& block : layout_.blocks)
            if (block.has_pose())
                rows.middleCols<3>(block.offset + 3) /= system_.similarities.extent();
        for (int32_t k = 0; k < layout_.num_f; ++k)
            if (is_left_out_[k]) rows.col(k).setZero();
        const Eigen::ColPivHouseholderQR<MatrixXd> qr(rows);
        for (int k = 0; k < num_freedoms; ++k) is_left_out_[qr.colsPermutation().indices()[k]] = 1;
    }

    void require_regular(bool is_definite) {
        // Of what elimination leaves of a diagonal entry, a multiple of its rounding.
        constexpr double smallest_share = 1e-13;
        std::vector<double> pivots(static_cast<size_t>(layout_.num_f), 0.0);
        if (is_definite) schur_.cholesky().get_pivots(pivots.data());
        const ParameterBlock* worst = nullptr;
        double smallest = smallest_share;
        for (const ParameterBlock& block : layout_.blocks) {
            for (int32_t k = block.offset; k < block.offset + block.size; ++k) {
                if (is_left_out_[k] || pivots[k] >= smallest * system_.diagonal[k]) continue;
                smallest = pivots[k] / system_.diagonal[k];
                worst = &block;
            }
        }
        if (is_definite && !worst) return;
        std::vector<int64_t> num_sights(system_.problem.images.size(), 0);
        for (const Observation& observation : system_.problem.observations)
            num_sights[observation.image] +=
                rank_of(system_.point_factors[observation.point]) == 3 ? 1 : 0;
        for (size_t i = 0; i < num_sights.size(); ++i)
            if (!system_.is_observed[layout_.pose_offset[i]])
                num_sights[i] = std::numeric_limits<int64_t>::max();
        const auto fewest = std::min_element(num_sights.begin(), num_sights.end());
        fail(Status::invalid_argument,
             "the observations do not determine all poses and intrinsics, so that their covariance "
             "is infinite",
             is_definite ? text(": what is left of ", name_of(*worst), " is below rounding")
                         : std::string(),
             "; image ", fewest - num_sights.begin(),
             " has the fewest observations of points with "
             "parallax, ",
             *fewest,
             "; hold constant, or remove, what is not determined, and see that no part of the "
             "images stands alone");
    }

    // Y = Z C for the constraints C of the gauge, at the F side, and the sights of the points that
    // they name.
    void solve_constraints() {
        const Constraints& constraints = system_.gauge.constraints();
        MatrixXd right_side = constraints.f;
        std::vector<int32_t> points;
        for (const auto& [point, c] : constraints.points) points.push_back(point);
        const std::vector<PointSights> sights = make_point_sights(
            system_.problem, system_.device, system_.equations, system_.point_factors, points);
        for (size_t p = 0; p < points.size(); ++p)
            for (const PointSights::Part& part : sights[p].parts)
                right_side.middleRows(layout_.blocks[part.block].offset, part.gain.cols()) -=
                    part.gain.transpose() * constraints.points[p].second;
        for (int32_t k = 0; k < layout_.num_f; ++k)
            if (is_left_out_[k]) right_side.row(k).setZero();
        for (Eigen::Index k = 0; k < right_side.cols(); ++k)
            schur_.cholesky().solve(right_side.col(k).data(), right_side.col(k).data());
        solution_ = right_side;
        MatrixXd products = constraints.f.transpose() * solution_;  // C^T Z C
        for (size_t p = 0; p < points.size(); ++p) {
            const auto& c = constraints.points[p].second;
            products += c.transpose() * (sights[p].inverse * c + point_solution(sights[p]));
        }
        products_ = system_.gauge.inverse() * products * system_.gauge.inverse().transpose();
    }

    // -V^-1 W^T Y.
    MatrixXd point_solution(const PointSights& sights) const {
        MatrixXd of_point = MatrixXd::Zero(3, solution_.cols());
        for (const PointSights::Part& part : sights.parts)
            of_point -= part.gain *
                        solution_.middleRows(layout_.blocks[part.block].offset, part.gain.cols());
        return of_point;
    }

    // T Z T^T = Z - N M Y^T - Y M^T N^T + N M (C^T Z C) M^T N^T, of a diagonal block.
    template <class Tangents, class Solution>
    MatrixXd transformed(MatrixXd block, const Tangents& n, const Solution& y) const {
        if (system_.gauge.num_freedoms() == 0) return block;
        const MatrixXd cross = n * system_.gauge.inverse() * y.transpose();
        block += n * products_ * n.transpose() - cross - cross.transpose();
        return block;
    }

    void invert() {
        BlockCholesky<double>& cholesky = schur_.cholesky();
        BlockInverse<double> inverse(cholesky);
        const BlockPattern& pattern = schur_.pattern();
        values_.resize(static_cast<size_t>(cholesky.num_values()));
        covariance_.bytes = sizeof(double) * static_cast<uint64_t>(2 * cholesky.num_values() +
                                                                   cholesky.num_factor_values() +
                                                                   inverse.num_work_values());
        inverse.compute(values_.data());
        for (int32_t row = 0; row < pattern.num_blocks(); ++row) {
            const ParameterBlock& block = layout_.blocks[row];
            double* diagonal =
                values_.data() + cholesky.value_offset(pattern.row_begin[row + 1] - 1);
            for (int32_t k = 0; k < block.size; ++k)
                if (is_left_out_[block.offset + k]) diagonal[k * (block.size + 1)] = 0;
        }
    }

    // Z at (row, column) of the blocks of S, row >= column.
    Eigen::Map<const RowMajor> block(int32_t row, int32_t column) {
        const BlockPattern& pattern = schur_.pattern();
        const auto begin = pattern.columns.begin() + pattern.row_begin[row];
        const auto end = pattern.columns.begin() + pattern.row_begin[row + 1];
        const auto entry = std::lower_bound(begin, end, column) - pattern.columns.begin();
        return {values_.data() + schur_.cholesky().value_offset(entry), layout_.blocks[row].size,
                layout_.blocks[column].size};
    }

    void fill_images() {
        const Problem& problem = system_.problem;
        std::vector<int32_t> block_of_camera(problem.cameras.size(), -1);
        for (size_t b = 0; b < layout_.blocks.size(); ++b) {
            const ParameterBlock& of_block = layout_.blocks[b];
            const auto row = static_cast<int32_t>(b);
            if (!of_block.has_pose()) {
                block_of_camera[of_block.camera] = row;
                Eigen::Map<RowMajor>(
                    covariance_.cameras.data() + covariance_.camera_begin[of_block.camera],
                    of_block.size, of_block.size) = block(row, row);
            }
        }
        for (int32_t b = 0; b < schur_.pattern().num_blocks(); ++b) {
            const int32_t image = layout_.blocks[b].image;
            if (image < 0) continue;
            const int32_t camera = problem.images[image].camera;
            const int32_t shared = block_of_camera[camera];
            const int32_t size = covariance_.image_size[image], n = size - num_pose_params;
            const int32_t offset = layout_.pose_offset[image];
            MatrixXd joint(size, size), y(size, solution_.cols());
            y.topRows(num_pose_params) = solution_.middleRows(offset, num_pose_params);
            y.bottomRows(n) = solution_.middleRows(layout_.intrinsics_offset[camera], n);
            MatrixXd tangents = MatrixXd::Zero(size, solution_.cols());
            tangents.topRows(num_pose_params) =
                system_.gauge.of_f().middleRows(offset, num_pose_params);
            if (shared < 0) {
                joint = block(b, b);
            } else {
                joint.topLeftCorner<num_pose_params, num_pose_params>() = block(b, b);
                joint.bottomRightCorner(n, n) = block(shared, shared);
                joint.bottomLeftCorner(n, num_pose_params) = block(shared, b);
                joint.topRightCorner(num_pose_params, n) = block(shared, b).transpose();
            }
            joint = transformed(joint, tangents, y);
            Eigen::Map<RowMajor>(covariance_.images.data() + covariance_.image_begin[image], size,
                                 size) = joint;
            if (shared < 0)
                Eigen::Map<RowMajor>(covariance_.cameras.data() + covariance_.camera_begin[camera],
                                     n, n) = joint.bottomRightCorner(n, n);
        }
    }

    static std::string name_of(const ParameterBlock& block) {
        if (block.image >= 0) return text("image ", block.image);
        if (block.frame >= 0) return text("frame ", block.frame);
        if (block.sensor >= 0) return text("sensor ", block.sensor);
        return text("camera ", block.camera);
    }

    // From the joint blocks of frames, sensors and cameras.
    void fill_composed_images() {
        for (const int32_t image : layout_.composed) {
            const ImageTangent tangent(system_.problem, layout_, image);
            const int32_t size = covariance_.image_size[image];
            MatrixXd joint = MatrixXd::Zero(size, size);
            for (const ImageTangent::Part& a : tangent.parts()) {
                for (const ImageTangent::Part& b : tangent.parts()) {
                    if (b.block > a.block) continue;
                    const MatrixXd product =
                        a.matrix * block(a.block, b.block) * b.matrix.transpose();
                    joint += product;
                    if (b.block != a.block) joint += product.transpose();
                }
            }
            Eigen::Map<RowMajor>(covariance_.images.data() + covariance_.image_begin[image], size,
                                 size) =
                transformed(joint, tangent(system_.gauge.of_f()), tangent(solution_));
        }
    }

    void fill_points() {
        const std::vector<int32_t>& points = covariance_.points;
        const std::vector<PointSights> sights = make_point_sights(
            system_.problem, system_.device, system_.equations, system_.point_factors, points);
        const auto& constraints = system_.gauge.constraints().points;
        parallel_ranges(static_cast<int64_t>(points.size()), 64, [&](int64_t begin, int64_t end) {
            for (int64_t p = begin; p < end; ++p) {
                MatrixXd of_point = sights[p].inverse;
                for (const PointSights::Part& a : sights[p].parts) {
                    for (const PointSights::Part& b : sights[p].parts) {
                        if (b.block > a.block) continue;
                        const Eigen::Matrix3d product =
                            a.gain * block(a.block, b.block) * b.gain.transpose();
                        of_point += product;
                        if (b.block != a.block) of_point += product.transpose();
                    }
                }
                MatrixXd y = point_solution(sights[p]);
                for (const auto& [point, c] : constraints)
                    if (point == points[p]) y += sights[p].inverse * c;
                Eigen::Map<RowMajor>(covariance_.point_values.data() + 9 * p, 3, 3) =
                    transformed(of_point, system_.gauge.of_point(points[p]), y);
            }
        });
    }

    const UndampedSystem& system_;
    const ParameterLayout& layout_;
    ExplicitSchur schur_;
    Covariance& covariance_;
    std::vector<char> is_left_out_;
    std::vector<double> values_;  // Z
    MatrixXd solution_;           // Y of the F side
    MatrixXd products_;           // M C^T Z C M^T
};

}  // namespace

void find_exact_covariances(const UndampedSystem& system, SchurStructure structure,
                            Covariance& covariance) {
    ExactCovariances(system, std::move(structure), covariance).find();
}

}  // namespace clba
