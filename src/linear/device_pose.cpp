// SPDX-License-Identifier: Apache-2.0
#include "linear/device_pose.hpp"

#include <algorithm>
#include <array>

namespace clba {

void split_position(double coordinate, float* parts, int64_t low) {
    // GCC 12's vectoriser (-O2) takes a conversion to float and back for none, unless it is
    // volatile.
    const volatile float high = static_cast<float>(coordinate);
    parts[0] = high;
    parts[low] = static_cast<float>(coordinate - static_cast<double>(high));
}
void split_position(double coordinate, double* parts, int64_t) {
    parts[0] = coordinate;
}

void join_position(const float* parts, int64_t low, double& coordinate) {
    float before[2];
    split_position(coordinate, before, 1);
    if (parts[0] != before[0] || parts[low] != before[1])
        coordinate = static_cast<double>(parts[0]) + static_cast<double>(parts[low]);
}
void join_position(const double* parts, int64_t, double& coordinate) {
    coordinate = parts[0];
}

void upload_pose(const Pose& pose, double* values) {
    std::copy(pose.rotation.begin(), pose.rotation.end(), values);
    std::copy(pose.translation.begin(), pose.translation.end(), values + 4);
}
void download_pose(const double* values, Pose& pose) {
    std::copy_n(values, 4, pose.rotation.begin());
    std::copy_n(values + 4, 3, pose.translation.begin());
}

void upload_pose(const Pose& pose, float* values) {
    std::transform(pose.rotation.begin(), pose.rotation.end(), values,
                   [](double x) { return static_cast<float>(x); });
    const Point center = camera_center(pose);
    for (int k = 0; k < 3; ++k) split_position(center[k], values + 4 + k, 3);
}
void download_pose(const float* values, Pose& pose) {
    std::array<float, 10> before;
    upload_pose(pose, before.data());
    if (std::equal(before.begin(), before.end(), values)) return;
    Point center = camera_center(pose);
    for (int k = 0; k < 3; ++k) join_position(values + 4 + k, 3, center[k]);
    if (!std::equal(values, values + 4, before.begin()))
        pose.rotation = normalized({values[0], values[1], values[2], values[3]});
    const auto r = rotation_matrix(pose.rotation);
    for (int k = 0; k < 3; ++k)
        pose.translation[k] =
            -(r[3 * k] * center[0] + r[3 * k + 1] * center[1] + r[3 * k + 2] * center[2]);
}

}  // namespace clba
