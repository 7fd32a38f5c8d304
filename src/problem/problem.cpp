// SPDX-License-Identifier: Apache-2.0
#include "problem/problem.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"

namespace clba {
namespace {

void require_finite(double value, const char* array, int64_t row, const char* component) {
    require(std::isfinite(value), array, "[", row, "].", component, " = ", value,
            ", but it must be finite");
}

constexpr const char* axis_names[] = {"x", "y", "z"};

template <class Optional, class Rows>
void require_matching(const Optional& optional, const Rows& rows, const char* name,
                      const char* rows_name) {
    require(optional.empty() || optional.size() == rows.size(), name, " has ", optional.size(),
            " rows, but there are ", rows.size(), " ", rows_name);
}

template <class Values>
void require_positive(const std::vector<Values>& rows, const char* name) {
    for (size_t i = 0; i < rows.size(); ++i)
        for (size_t k = 0; k < rows[i].size(); ++k)
            require(std::isfinite(rows[i][k]) && rows[i][k] > 0, name, "[", i, "][", k,
                    "] = ", rows[i][k], ", but an uncertainty must be finite and > 0");
}

}  // namespace

void Problem::validate() const {
    for (size_t i = 0; i < cameras.size(); ++i) {
        const Camera& camera = cameras[i];
        require(is_camera_model(camera.model), "cameras[", i, "].model = ", camera.model,
                ", but the models are 0 to ", num_camera_models - 1);
        for (int k = 0; k < camera.num_params(); ++k)
            require(std::isfinite(camera.params[k]), "cameras[", i, "].params[", k,
                    "] = ", camera.params[k], ", but it must be finite");
    }
    for (size_t i = 0; i < images.size(); ++i) {
        const Image& image = images[i];
        require(image.camera >= 0 && image.camera < num_cameras(), "images[", i,
                "].camera = ", image.camera, ", but num_cameras = ", num_cameras());
        double norm = 0;
        for (double q : image.pose.rotation) {
            require_finite(q, "images", static_cast<int64_t>(i), "rotation");
            norm += q * q;
        }
        require(std::abs(norm - 1) < 1e-6, "images[", i, "].rotation has the squared norm ", norm,
                ", but a rotation is a unit quaternion");
        for (double t : image.pose.translation)
            require_finite(t, "images", static_cast<int64_t>(i), "translation");
    }
    for (size_t i = 0; i < points.size(); ++i)
        for (int k = 0; k < 3; ++k)
            require_finite(points[i][k], "points", static_cast<int64_t>(i), axis_names[k]);
    for (size_t i = 0; i < observations.size(); ++i) {
        const Observation& o = observations[i];
        require(o.image >= 0 && o.image < num_images(), "observations[", i, "].image = ", o.image,
                ", but num_images = ", num_images());
        require(o.point >= 0 && o.point < num_points(), "observations[", i, "].point = ", o.point,
                ", but num_points = ", num_points());
        require_finite(o.x, "observations", static_cast<int64_t>(i), "x");
        require_finite(o.y, "observations", static_cast<int64_t>(i), "y");
    }
    require_matching(whitening, observations, "covariances", "observations");
    require_matching(constant_images, images, "constant_images", "images");
    require_matching(constant_cameras, cameras, "constant_cameras", "cameras");
    require_matching(constant_points, points, "constant_points", "points");
    require_matching(image_uncertainties, images, "image_uncertainties", "images");
    require_matching(camera_uncertainties, cameras, "camera_uncertainties", "cameras");
    require_matching(point_uncertainties, points, "point_uncertainties", "points");
    require_positive(image_uncertainties, "image_uncertainties");
    require_positive(camera_uncertainties, "camera_uncertainties");
    require_positive(point_uncertainties, "point_uncertainties");
    for (size_t i = 0; i < whitening.size(); ++i)
        for (double value : whitening[i])
            require_finite(value, "covariances", static_cast<int64_t>(i), "factor");
    require(std::isfinite(loss.scale) && loss.scale > 0, "loss scale = ", loss.scale,
            ", but it must be finite and > 0");
}

Point camera_center(const Pose& pose) {
    const auto r = rotation_matrix(pose.rotation);
    const auto& t = pose.translation;
    Point center;
    for (int k = 0; k < 3; ++k) center[k] = -(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
    return center;
}

std::array<double, 9> rotation_matrix(const std::array<double, 4>& q) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
            2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
}

std::array<double, 4> quaternion_from_matrix(const std::array<double, 9>& m) {
    // Shepperd (1978): the largest of 4 w^2, 4 x^2, 4 y^2, 4 z^2 leads, so that nothing cancels.
    const std::array<double, 4> squares{1 + m[0] + m[4] + m[8], 1 + m[0] - m[4] - m[8],
                                        1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8]};
    const double wx = m[7] - m[5], wy = m[2] - m[6], wz = m[3] - m[1];
    const double xy = m[1] + m[3], xz = m[2] + m[6], yz = m[5] + m[7];
    std::array<double, 4> q;
    switch (std::max_element(squares.begin(), squares.end()) - squares.begin()) {
        case 0:
            q = {squares[0], wx, wy, wz};
            break;
        case 1:
            q = {wx, squares[1], xy, xz};
            break;
        case 2:
            q = {wy, xy, squares[2], yz};
            break;
        default:
            q = {wz, xz, yz, squares[3]};
    }
    if (q[0] < 0)
        for (double& value : q) value = -value;
    return normalized(q);
}

std::array<double, 4> quaternion_from_rotation_vector(const std::array<double, 3>& w) {
    const double angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    const double angle = std::sqrt(angle2);
    // sin(angle / 2) / angle, by its Taylor series where the quotient loses digits.
    const double factor = angle < 1e-4 ? 0.5 - angle2 / 48 : std::sin(angle / 2) / angle;
    return normalized({std::cos(angle / 2), factor * w[0], factor * w[1], factor * w[2]});
}

std::array<double, 3> rotation_vector_from_quaternion(const std::array<double, 4>& quaternion) {
    const double sign = quaternion[0] < 0 ? -1 : 1;
    const double w = sign * quaternion[0];
    const double x = sign * quaternion[1], y = sign * quaternion[2], z = sign * quaternion[3];
    const double sine = std::sqrt(x * x + y * y + z * z);
    const double factor = sine < 1e-9 ? 2.0 : 2 * std::atan2(sine, w) / sine;
    return {factor * x, factor * y, factor * z};
}

std::array<double, 4> normalized(const std::array<double, 4>& q) {
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    return {q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm};
}

std::array<double, 4> quaternion_product(const std::array<double, 4>& a,
                                         const std::array<double, 4>& b) {
    return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

}  // namespace clba
