// SPDX-License-Identifier: Apache-2.0
#include "problem/pose.hpp"

#include <algorithm>
#include <cmath>

namespace clba {

Point camera_center(const Pose& pose) {
    const auto r = rotation_matrix(pose.rotation);
    const auto& t = pose.translation;
    Point center;
    for (int k = 0; k < 3; ++k) center[k] = -(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
    return center;
}

Pose product(const Pose& a, const Pose& b) {
    const auto r = rotation_matrix(a.rotation);
    Pose made{quaternion_product(a.rotation, b.rotation), a.translation};
    for (size_t i = 0; i < 3; ++i)
        for (size_t k = 0; k < 3; ++k) made.translation[i] += r[3 * i + k] * b.translation[k];
    return made;
}

Pose inverse(const Pose& pose) {
    const auto& q = pose.rotation;
    return {{q[0], -q[1], -q[2], -q[3]}, camera_center(pose)};
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
