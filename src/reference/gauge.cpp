// SPDX-License-Identifier: Apache-2.0
#include "reference/gauge.hpp"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <cmath>

#include "reference/priors.hpp"

namespace clba::reference {
namespace {

using Eigen::Vector3d;
using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Motion = Eigen::Matrix<double, 3, 7, Eigen::RowMajor>;

Vector3d vector_of(const std::array<double, 3>& values) {
    return Vector3d(values[0], values[1], values[2]);
}

// Infinitesimal similarities about `origin`, in units in which positions are about 1: the columns
// are rotation, scale and translation.
class Similarities {
public:
    explicit Similarities(const Problem& problem) {
        std::vector<Vector3d> positions;
        for (const Image& image : problem.images)
            positions.push_back(vector_of(camera_center(image.pose)));
        place(positions);
        if (extent_ > 0) return;
        for (const Point& point : problem.points) positions.push_back(vector_of(point));
        place(positions);
        if (!(extent_ > 0)) extent_ = 1;
    }

    // Of a position: [-[x]_x, x, I] with x = (position - origin) / extent.
    Motion of_position(const Vector3d& position) const {
        const Vector3d x = (position - origin_) / extent_;
        Motion motion;
        motion.leftCols<3>() << 0, x.z(), -x.y(), -x.z(), 0, x.x(), x.y(), -x.x(), 0;
        motion.col(3) = x;
        motion.rightCols<3>().setIdentity();
        return motion;
    }
    double extent() const { return extent_; }

private:
    void place(const std::vector<Vector3d>& positions) {
        origin_.setZero();
        extent_ = 0;
        if (positions.empty()) return;
        const auto n = static_cast<double>(positions.size());
        for (const Vector3d& x : positions) origin_ += x / n;
        for (const Vector3d& x : positions) extent_ += (x - origin_).squaredNorm() / n;
        extent_ = std::sqrt(extent_);
    }

    Vector3d origin_;
    double extent_ = 0;
};

// The freedoms that rows held.
class HeldFreedoms {
public:
    // size: what the row would be if nothing in it cancelled.
    void add(const Eigen::Matrix<double, 1, 7>& row, double size = 1) {
        if (size > 0) gram_ += row.transpose() * row / (size * size);
    }
    int count() const {
        constexpr double smallest_share = 1e-10;  // of squares
        const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 7, 7>> solver(
            gram_, Eigen::EigenvaluesOnly);
        const auto& values = solver.eigenvalues();
        return static_cast<int>((values.array() > smallest_share * values[6]).count());
    }

private:
    Eigen::Matrix<double, 7, 7> gram_ = Eigen::Matrix<double, 7, 7>::Zero();
};

}  // namespace

GaugeState gauge_of(const Problem& problem, const ParameterLayout& layout) {
    const Similarities similarities(problem);
    // Of F scalars, in the tangent space of clba.h: w = -R omega, v = -R dC. Intrinsics do not
    // move.
    Eigen::Matrix<double, Eigen::Dynamic, 7, Eigen::RowMajor> motion(layout.num_f, 7);
    motion.setZero();
    const auto set_motion = [&](int32_t offset, const Pose& pose) {
        const RowMajor3 rotation =
            Eigen::Map<const RowMajor3>(rotation_matrix(pose.rotation).data());
        motion.block<3, 3>(offset, 0) = -rotation;
        motion.middleRows<3>(offset + 3) = -similarities.extent() * rotation *
                                           similarities.of_position(vector_of(camera_center(pose)));
    };
    for (const ParameterBlock& block : layout.blocks) {
        if (block.image >= 0) set_motion(block.offset, problem.images[block.image].pose);
        if (block.frame >= 0) set_motion(block.offset, problem.rigs.frames[block.frame]);
        // A sensor's place in its rig is scaled.
        if (block.sensor >= 0)
            motion.block<3, 1>(block.offset + 3, 3) =
                vector_of(problem.rigs.sensors[block.sensor].translation);
    }
    HeldFreedoms held;
    for (int32_t k = 0; k < layout.num_f; ++k)
        if (!(layout.scale[k] > 0)) held.add(motion.row(k), motion.row(k).norm());
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        const auto scale = point_scale(problem, p);
        for (int k = 0; k < 3; ++k)
            if (!(scale[k] > 0))
                held.add(similarities.of_position(vector_of(problem.points[p])).row(k));
    }
    const int by_constants = held.count();
    if (by_constants == 7) return {Gauge::fixed_by_constants, 0};
    if (problem.priors.empty()) return {Gauge::free, 7 - by_constants};

    ImagePriors(problem, layout)
        .for_each_row(problem.images, problem.cameras, problem.rigs.sensors,
                      [&](double, int n, const int32_t* scalars, const double* row) {
                          Eigen::Matrix<double, 1, 7> of_row = Eigen::Matrix<double, 1, 7>::Zero();
                          double size = 0;
                          for (int k = 0; k < n; ++k) {
                              if (scalars[k] < 0) continue;
                              of_row += row[k] * motion.row(scalars[k]);
                              size += std::abs(row[k]) * motion.row(scalars[k]).norm();
                          }
                          held.add(of_row, size);
                      });
    for (const PointPrior& prior : problem.priors.points)
        for (int k = 0; k < 3; ++k)
            held.add(similarities.of_position(vector_of(problem.points[prior.point])).row(k));
    const int num_held = held.count();
    return {num_held == 7 ? Gauge::fixed_by_priors : Gauge::free, 7 - num_held};
}

}  // namespace clba::reference
