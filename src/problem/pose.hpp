// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>

namespace clba {

using Point = std::array<double, 3>;

// Camera from world: P = R X + t.
struct Pose {
    std::array<double, 4> rotation{1, 0, 0, 0};  // unit quaternion w, x, y, z
    std::array<double, 3> translation{0, 0, 0};
};

Point camera_center(const Pose& pose);       // -R^T t
Pose product(const Pose& a, const Pose& b);  // a after b
Pose inverse(const Pose& pose);

// Row-major 3x3 rotation of a unit quaternion.
std::array<double, 9> rotation_matrix(const std::array<double, 4>& quaternion);
// The unit quaternion, w >= 0, of a rotation matrix that may be rounded.
std::array<double, 4> quaternion_from_matrix(const std::array<double, 9>& matrix);
// exp([w]_x) for a rotation vector w, and its inverse with an angle in [0, pi].
std::array<double, 4> quaternion_from_rotation_vector(const std::array<double, 3>& w);
std::array<double, 3> rotation_vector_from_quaternion(const std::array<double, 4>& quaternion);
std::array<double, 4> normalized(const std::array<double, 4>& quaternion);
std::array<double, 4> quaternion_product(const std::array<double, 4>& a,
                                         const std::array<double, 4>& b);

}  // namespace clba
