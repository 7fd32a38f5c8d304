// SPDX-License-Identifier: Apache-2.0
#include "covariance/gauge.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "base/error.hpp"
#include "covariance/image_tangent.hpp"

namespace clba {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

Vector3d vector_of(const Point& point) {
    return Vector3d(point[0], point[1], point[2]);
}

Matrix3d rotation_of(const Pose& pose) {
    return Eigen::Map<const RowMajor3>(rotation_matrix(pose.rotation).data());
}

Vector3d center_of(const Problem& problem, int32_t image) {
    return vector_of(camera_center(problem.images[image].pose));
}

bool is_constant(const Problem& problem, int32_t image, int bits) {
    return (problem.constants_of_image(image) & bits) != 0;
}

void require_index(int32_t index, int32_t count, const char* what) {
    require(index >= 0 && index < count, "the gauge names ", what, " ", index, ", but num_", what,
            "s = ", count);
}

void require_points(const Problem& problem, const GaugeChoice& choice) {
    for (const int32_t point : choice.points) {
        require(point != -1, "gauge = three_points needs three points; name them in gauge_points");
        require_index(point, problem.num_points(), "point");
    }
}

// Axes of the plane of three points: along the first side, in the plane, normal to it.
Matrix3d frame(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
    const Vector3d side = b - a, other = c - a, normal = side.cross(other);
    require(normal.norm() > 1e-9 * side.norm() * other.norm() && side.norm() > 0,
            "the three points of the gauge lie on a line, about which nothing then holds the "
            "rotation; name others");
    Matrix3d axes;
    axes.col(0) = side.normalized();
    axes.col(2) = normal.normalized();
    axes.col(1) = axes.col(2).cross(axes.col(0));
    return axes;
}

}  // namespace

const char* gauge_name(Gauge gauge) {
    switch (gauge) {
        case Gauge::automatic:
            return "default";
        case Gauge::problem:
            return "problem";
        case Gauge::first_image_and_baseline:
            return "first_image_and_baseline";
        case Gauge::three_points:
            return "three_points";
        case Gauge::inner:
            return "inner";
    }
    return nullptr;
}

Similarities::Similarities(const Problem& problem) {
    std::vector<Vector3d> positions;
    const auto place = [&] {
        origin_.setZero();
        extent_ = 0;
        const auto n = static_cast<double>(positions.size());
        for (const Vector3d& x : positions) origin_ += x / n;
        for (const Vector3d& x : positions) extent_ += (x - origin_).squaredNorm() / n;
        extent_ = std::sqrt(extent_);
    };
    for (int32_t i = 0; i < problem.num_images(); ++i) positions.push_back(center_of(problem, i));
    place();
    if (extent_ > 0) return;
    for (const Point& point : problem.points) positions.push_back(vector_of(point));
    place();
    if (!(extent_ > 0)) extent_ = 1;
}

Eigen::Matrix<double, 3, 7> Similarities::of_position(const Point& position) const {
    const Vector3d x = vector_of(position) - origin_;
    Eigen::Matrix<double, 3, 7> tangent;
    tangent.leftCols<3>() = extent_ * Matrix3d::Identity();
    tangent.middleCols<3>(3) << 0, x.z(), -x.y(), -x.z(), 0, x.x(), x.y(), -x.x(), 0;
    tangent.col(6) = x;
    return tangent;
}

// R' = R exp(-[omega]_x) = exp(-[R omega]_x) R, and dC = -R^T v.
Eigen::Matrix<double, 6, 7> Similarities::of_pose(const Pose& pose) const {
    const Matrix3d rotation = rotation_of(pose);
    Eigen::Matrix<double, 6, 7> tangent = Eigen::Matrix<double, 6, 7>::Zero();
    tangent.block<3, 3>(0, 3) = -rotation;
    tangent.bottomRows<3>() = -rotation * of_position(camera_center(pose));
    return tangent;
}

Eigen::Matrix<double, 6, 7> Similarities::of_block(const Problem& problem,
                                                   const ParameterBlock& block) const {
    if (block.image >= 0) return of_pose(problem.images[block.image].pose);
    if (block.frame >= 0) return of_pose(problem.rigs.frames[block.frame]);
    Eigen::Matrix<double, 6, 7> tangent = Eigen::Matrix<double, 6, 7>::Zero();
    tangent.block<3, 1>(3, 6) = vector_of(problem.rigs.sensors[block.sensor].translation);
    return tangent;
}

Freedoms free_similarities(const Problem& problem, const ParameterLayout& layout,
                           const Similarities& similarities) {
    Eigen::Matrix<double, 7, 7> held = Eigen::Matrix<double, 7, 7>::Zero();
    for (const ParameterBlock& block : layout.blocks) {
        if (!block.has_pose()) continue;
        const auto tangent = similarities.of_block(problem, block);
        for (int k = 0; k < num_pose_params; ++k) {
            if (layout.scale[block.offset + k] > 0) continue;
            double unit = k < 3 ? 1 : similarities.extent();
            // However short a rig is, it has a length.
            if (block.sensor >= 0) unit = std::abs(tangent(k, 6));
            if (unit > 0) held += tangent.row(k).transpose() * tangent.row(k) / (unit * unit);
        }
    }
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        if (point_scale(problem, p)[0] > 0) continue;
        const Eigen::Matrix<double, 3, 7> tangent =
            similarities.of_position(problem.points[p]) / similarities.extent();
        held += tangent.transpose() * tangent;
    }
    // Priors hold as constants do, however loose: they are a part of the normal equations.
    const Priors& priors = problem.priors;
    const auto hold_position = [&](const Point& position) {
        const Eigen::Matrix<double, 3, 7> tangent =
            similarities.of_position(position) / similarities.extent();
        held += tangent.transpose() * tangent;
    };
    for (const PositionPrior& prior : priors.positions)
        hold_position(camera_center(problem.images[prior.image].pose));
    for (const PosePrior& prior : priors.poses) {
        hold_position(camera_center(problem.images[prior.image].pose));
        held.block<3, 3>(3, 3) += Matrix3d::Identity();
    }
    for (const PointPrior& prior : priors.points) hold_position(problem.points[prior.point]);
    // A relative pose has a length, and nothing else that a similarity changes.
    if (!priors.relative_poses.empty()) held(6, 6) += 1;
    // Squares: what moves constants by less than 1e-5 of what the others do is free.
    constexpr double smallest_share = 1e-10;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 7, 7>> solver(held);
    const auto& values = solver.eigenvalues();
    const auto num_free =
        values[6] > 0 ? (values.array() <= smallest_share * values[6]).count() : Eigen::Index{7};
    return solver.eigenvectors().leftCols(num_free);
}

void choose_images(const Problem& problem, const ParameterLayout& layout,
                   const IsObserved& is_observed, GaugeChoice& choice) {
    if (choice.gauge != Gauge::first_image_and_baseline) return;
    for (const int32_t image : choice.images)
        if (image != -1) require_index(image, problem.num_images(), "image");
    const auto observed = [&](int32_t image) {
        return is_observed[layout.pose_offset[image]] != 0;
    };
    auto& [first, second] = choice.images;
    for (int32_t i = 0; i < problem.num_images() && choice.images[0] < 0; ++i)
        if (is_constant(problem, i, constant_rotation | constant_position) && i != second)
            first = i;
    for (int32_t i = 0; i < problem.num_images() && choice.images[0] < 0; ++i)
        if (observed(i) && i != second) first = i;
    double farthest = -1;
    const bool is_given = second >= 0;
    for (int32_t i = 0; i < problem.num_images() && first >= 0 && !is_given; ++i) {
        if (i == first || !observed(i) || is_constant(problem, i, constant_position)) continue;
        const double distance = (center_of(problem, i) - center_of(problem, first)).norm();
        if (distance > farthest) second = i;
        farthest = std::max(farthest, distance);
    }
    require(first >= 0 && second >= 0,
            "gauge = first_image_and_baseline needs two images with observations; name another "
            "gauge");
    require(first != second, "gauge_image and gauge_second_image are both ", first,
            ", but the baseline is between two images");
}

Constraints make_constraints(const Problem& problem, const ParameterLayout& layout,
                             const Similarities& similarities, const Freedoms& freedoms,
                             const IsObserved& is_observed, const GaugeChoice& choice) {
    const auto num_freedoms = freedoms.cols();
    const char* name = gauge_name(choice.gauge);
    Constraints constraints;
    if (choice.gauge == Gauge::problem) {
        require(num_freedoms == 0,
                "gauge = problem, but what the problem holds by constants and priors leaves ",
                num_freedoms,
                " of the 7 freedoms of a similarity; hold a pose and another image's position, or "
                "three points, or choose another gauge");
        constraints.f.resize(layout.num_f, 0);
        return constraints;
    }
    require(num_freedoms > 0, "gauge = ", name,
            ", but the problem itself fixes all 7 freedoms of a similarity; choose gauge = "
            "problem");
    std::vector<Eigen::VectorXd> columns;
    const double unit = 1 / similarities.extent();
    const auto hold = [&](int32_t image, const Eigen::Matrix<double, 6, 1>& weights) {
        Eigen::MatrixXd column = Eigen::MatrixXd::Zero(layout.num_f, 1);
        ImageTangent(problem, layout, image).add_pose_functional(layout, weights, column);
        if (!column.isZero(0)) columns.emplace_back(column);
    };
    if (choice.gauge == Gauge::first_image_and_baseline) {
        const int32_t first = choice.images[0], second = choice.images[1];
        for (int k = 0; k < num_pose_params; ++k)
            hold(first, (k < 3 ? 1 : unit) * Eigen::Matrix<double, 6, 1>::Unit(k));
        const Vector3d baseline = center_of(problem, second) - center_of(problem, first);
        require(baseline.norm() > 1e-9 * similarities.extent(), "images ", first, " and ", second,
                " of the gauge are at the same place; name two that are apart");
        Eigen::Matrix<double, 6, 1> along = Eigen::Matrix<double, 6, 1>::Zero();
        along.tail<3>() = unit * (rotation_of(problem.images[second].pose) * baseline.normalized());
        // Constant sensors of rigs hold the scale, and nothing else does alone.
        const bool is_scale_held = layout.has_rigs() && freedoms.row(6).norm() < 1e-6;
        if (!is_scale_held) hold(second, along);
    } else if (choice.gauge == Gauge::three_points) {
        require_points(problem, choice);
        std::array<Vector3d, 3> x;
        for (int k = 0; k < 3; ++k) x[k] = vector_of(problem.points[choice.points[k]]);
        const Vector3d normal = frame(x[0], x[1], x[2]).col(2);
        columns.assign(7, Eigen::VectorXd::Zero(layout.num_f));
        for (int k = 0; k < 3; ++k) {
            Eigen::Matrix<double, 3, Eigen::Dynamic> of_point =
                Eigen::Matrix<double, 3, Eigen::Dynamic>::Zero(3, 7);
            if (k < 2)
                of_point.middleCols<3>(3 * k) = unit * Matrix3d::Identity();
            else
                of_point.col(6) = unit * normal;
            constraints.points.emplace_back(choice.points[k], of_point);
        }
    } else {
        Eigen::MatrixXd inner = Eigen::MatrixXd::Zero(layout.num_f, num_freedoms);
        for (int32_t i = 0; i < problem.num_images(); ++i) {
            if (!is_observed[layout.pose_offset[i] + 3]) continue;
            Eigen::MatrixXd weights = Eigen::MatrixXd::Zero(num_pose_params, num_freedoms);
            weights.bottomRows<3>() = unit * unit *
                                      similarities.of_pose(problem.images[i].pose).bottomRows<3>() *
                                      freedoms;
            ImageTangent(problem, layout, i).add_pose_functional(layout, weights, inner);
        }
        for (Eigen::Index k = 0; k < num_freedoms; ++k) columns.emplace_back(inner.col(k));
    }
    require(static_cast<Eigen::Index>(columns.size()) == num_freedoms, "gauge = ", name,
            " would hold ", columns.size(), " parameters, but the problem leaves ", num_freedoms,
            " of the 7 freedoms of a similarity; name an image that is constant as the first, or "
            "choose gauge = inner");
    constraints.f.resize(layout.num_f, num_freedoms);
    for (Eigen::Index k = 0; k < num_freedoms; ++k) constraints.f.col(k) = columns[k];
    return constraints;
}

void fix_gauge(const GaugeChoice& given, const GaugeTarget& target, Problem& problem) {
    const auto any = [](const auto& flags) {
        return std::any_of(flags.begin(), flags.end(), [](auto flag) { return flag != 0; });
    };
    require(!any(problem.constant_images) && !any(problem.constant_points) &&
                !any(problem.rigs.constant_frames),
            "the gauge of this problem is held by constant poses or points, which must not move; "
            "only a problem without them can be moved");
    const Rigs& rigs = problem.rigs;
    for (size_t s = 0; s < rigs.sensors.size(); ++s)
        require(!(rigs.constant_sensors[s] & constant_position) ||
                    rigs.sensors[s].translation == Point{0, 0, 0},
                "the scale of this problem is held by sensor ", s,
                " of a rig, whose position in it is constant; only a problem without such sensors "
                "can be moved");
    const Priors& priors = problem.priors;
    require(priors.positions.empty() && priors.poses.empty() && priors.points.empty() &&
                priors.relative_poses.empty(),
            "the gauge of this problem is held by priors, whose residuals would change; remove the "
            "priors first");
    GaugeChoice choice = given;
    require(choice.gauge != Gauge::problem,
            "gauge = problem names nothing to put in its place; name another");
    double scale = 1;
    Matrix3d rotation = Matrix3d::Identity();
    Vector3d from = Vector3d::Zero(), to = Vector3d::Zero();  // X -> scale rotation (X - from) + to
    if (choice.gauge == Gauge::first_image_and_baseline) {
        const ParameterLayout layout(problem);
        IsObserved is_observed(layout.scale.size(), 0);
        for (const Observation& observation : problem.observations)
            is_observed[layout.pose_offset[observation.image]] = 1;
        choose_images(problem, layout, is_observed, choice);
        require(std::isfinite(target.baseline) && target.baseline > 0,
                "baseline = ", target.baseline, ", but it must be finite and > 0");
        const auto [first, second] = choice.images;
        from = center_of(problem, first);
        const double baseline = (center_of(problem, second) - from).norm();
        require(baseline > 0, "images ", first, " and ", second,
                " of the gauge are at the same place; name two that are apart");
        scale = target.baseline / baseline;
        // R' = R rotation^T.
        rotation = rotation_of(target.pose).transpose() * rotation_of(problem.images[first].pose);
        to = vector_of(camera_center(target.pose));
    } else if (choice.gauge == Gauge::three_points) {
        require_points(problem, choice);
        std::array<Vector3d, 3> x, y;
        for (int k = 0; k < 3; ++k) {
            x[k] = vector_of(problem.points[choice.points[k]]);
            y[k] = vector_of(target.points[k]);
        }
        rotation = frame(y[0], y[1], y[2]) * frame(x[0], x[1], x[2]).transpose();
        scale = (y[1] - y[0]).norm() / (x[1] - x[0]).norm();
        from = x[0];
        to = y[0];
    } else {
        Eigen::Index n = 0;
        Eigen::Matrix3Xd centers(3, problem.num_images()), targets(3, problem.num_images());
        for (int32_t i = 0; i < problem.num_images(); ++i) {
            const Vector3d known = vector_of((*target.centers)[i]);
            if (known.array().isNaN().all()) continue;
            centers.col(n) = center_of(problem, i);
            targets.col(n++) = known;
        }
        require(n >= 3, "gauge = inner needs the centres of three images or more, but there are ",
                n);
        centers.conservativeResize(3, n);
        targets.conservativeResize(3, n);
        const Eigen::Matrix4d similarity = Eigen::umeyama(centers, targets, true);
        scale = similarity.block<3, 1>(0, 0).norm();
        require(std::isfinite(scale) && scale > 0,
                "the camera centres fall together and fix no similarity; choose another gauge");
        rotation = similarity.topLeftCorner<3, 3>() / scale;
        to = similarity.topRightCorner<3, 1>();
    }
    const Eigen::Quaterniond turn(Matrix3d(rotation.transpose()));
    const auto move = [&](Pose& pose) {
        const Vector3d center = scale * (rotation * (vector_of(camera_center(pose)) - from)) + to;
        pose.rotation =
            normalized(quaternion_product(pose.rotation, {turn.w(), turn.x(), turn.y(), turn.z()}));
        const Vector3d translation = -(rotation_of(pose) * center);
        std::copy_n(translation.data(), 3, pose.translation.begin());
    };
    for (int32_t i = 0; i < problem.num_images(); ++i)
        if (!rigs.has(i)) move(problem.images[i].pose);
    for (Pose& frame : problem.rigs.frames) move(frame);
    for (Pose& sensor : problem.rigs.sensors)
        for (double& coordinate : sensor.translation) coordinate *= scale;
    compose_images(problem.rigs, problem.images);
    for (Point& point : problem.points) {
        const Vector3d moved = scale * (rotation * (vector_of(point) - from)) + to;
        std::copy_n(moved.data(), 3, point.begin());
    }
    // Without the rounding of the move.
    if (choice.gauge == Gauge::first_image_and_baseline && !rigs.has(choice.images[0]))
        problem.images[choice.images[0]].pose = target.pose;
}

}  // namespace clba
