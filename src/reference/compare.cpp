// SPDX-License-Identifier: Apache-2.0
#include "reference/compare.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/error.hpp"

namespace clba {
namespace {

Eigen::Matrix3Xd centers_of(const Problem& problem) {
    Eigen::Matrix3Xd centers(3, problem.num_images());
    for (int32_t i = 0; i < problem.num_images(); ++i)
        centers.col(i) = Eigen::Vector3d(camera_center(problem.images[i].pose).data());
    return centers;
}

Eigen::Matrix3Xd points_of(const Problem& problem) {
    Eigen::Matrix3Xd points(3, problem.num_points());
    for (int32_t i = 0; i < problem.num_points(); ++i)
        points.col(i) = Eigen::Vector3d(problem.points[i].data());
    return points;
}

Eigen::Matrix3Xd joined(const Eigen::Matrix3Xd& left, const Eigen::Matrix3Xd& right) {
    Eigen::Matrix3Xd both(3, left.cols() + right.cols());
    both << left, right;
    return both;
}

// Root mean square distance of the columns from their mean.
double spread(const Eigen::Matrix3Xd& positions) {
    if (positions.cols() == 0) return 0;
    const Eigen::Vector3d mean = positions.rowwise().mean();
    return std::sqrt((positions.colwise() - mean).squaredNorm() /
                     static_cast<double>(positions.cols()));
}

// False for fewer than three positions, and for those within a hundredth of a line: noise across it
// would then turn whatever lies beside the line a hundred times as far.
bool fixes_similarity(const Eigen::Matrix3Xd& positions) {
    if (positions.cols() < 3) return false;
    const Eigen::Vector3d mean = positions.rowwise().mean();
    const Eigen::Matrix3Xd centred = positions.colwise() - mean;
    const Eigen::Matrix3d scatter = centred * centred.transpose();
    const Eigen::Vector3d ascending =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter, Eigen::EigenvaluesOnly)
            .eigenvalues();
    return std::sqrt(std::max(ascending[1], 0.0)) > 1e-2 * std::sqrt(ascending[2]);
}

Eigen::Matrix4d similarity(const Eigen::Matrix3Xd& from, const Eigen::Matrix3Xd& to) {
    // Positions that all fall together have no scale and no rotation.
    const double magnitude = from.cols() > 0 ? from.cwiseAbs().maxCoeff() : 0;
    if (spread(from) > 1e-14 * magnitude && spread(to) > 0) return Eigen::umeyama(from, to, true);
    Eigen::Matrix4d translation = Eigen::Matrix4d::Identity();
    if (from.cols() > 0)
        translation.topRightCorner<3, 1>() = to.rowwise().mean() - from.rowwise().mean();
    return translation;
}

struct Distances {
    double max = 0, median = 0;
};

Distances distances(const Eigen::Matrix3Xd& a, const Eigen::Matrix3Xd& b,
                    const Eigen::Matrix4d& a_from_b) {
    const auto count = static_cast<size_t>(a.cols());
    if (count == 0) return {};
    std::vector<double> values(count);
    for (size_t i = 0; i < count; ++i) {
        const auto column = static_cast<Eigen::Index>(i);
        values[i] = (a.col(column) - a_from_b.topLeftCorner<3, 3>() * b.col(column) -
                     a_from_b.topRightCorner<3, 1>())
                        .norm();
    }
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(count / 2);
    std::nth_element(values.begin(), middle, values.end());
    const double lower = count % 2 == 1 ? *middle : *std::max_element(values.begin(), middle);
    return {*std::max_element(middle, values.end()), (lower + *middle) / 2};
}

}  // namespace

Comparison compare(const Problem& a, const Problem& b) {
    require(a.num_images() == b.num_images(), "a has ", a.num_images(), " images and b has ",
            b.num_images(), ", but images are compared by index");
    require(a.num_points() == b.num_points(), "a has ", a.num_points(), " points and b has ",
            b.num_points(), ", but points are compared by index");

    const Eigen::Matrix3Xd centers_a = centers_of(a), centers_b = centers_of(b);
    const Eigen::Matrix3Xd points_a = points_of(a), points_b = points_of(b);
    const Eigen::Matrix4d a_from_b =
        fixes_similarity(centers_a) && fixes_similarity(centers_b)
            ? similarity(centers_b, centers_a)
            : similarity(joined(centers_b, points_b), joined(centers_a, points_a));
    const Distances centers = distances(centers_a, centers_b, a_from_b);
    const Distances points = distances(points_a, points_b, a_from_b);

    Comparison comparison;
    comparison.scale = a_from_b.col(0).head<3>().norm();
    comparison.max_center_distance = centers.max;
    comparison.median_center_distance = centers.median;
    comparison.max_point_distance = points.max;
    comparison.median_point_distance = points.median;
    comparison.extent = spread(centers_a);
    return comparison;
}

}  // namespace clba
