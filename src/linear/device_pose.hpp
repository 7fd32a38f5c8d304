// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>

#include "problem/pose.hpp"

namespace clba {

// Coordinates and poses as a device has them (kernels/positions.clh, kernels/state.cl).

// A coordinate and its parts, `low` apart, in single precision.
void split_position(double coordinate, float* parts, int64_t low);
void split_position(double coordinate, double* parts, int64_t low);
// Back: what the device did not move keeps the digits that it had no room for.
void join_position(const float* parts, int64_t low, double& coordinate);
void join_position(const double* parts, int64_t low, double& coordinate);

// Likewise 10 numbers in single precision, else 7.
void upload_pose(const Pose& pose, float* values);
void upload_pose(const Pose& pose, double* values);
void download_pose(const float* values, Pose& pose);
void download_pose(const double* values, Pose& pose);

}  // namespace clba
