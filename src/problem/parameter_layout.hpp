// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// A diagonal block of the image-camera side (F): an image's pose with its own camera's intrinsics,
// a pose alone, or the intrinsics of a shared camera.
struct ParameterBlock {
    int32_t offset = 0;  // of its first scalar in the F vector
    int32_t size = 0;
    int32_t image = -1;   // -1: intrinsics of a camera that several images or none use
    int32_t camera = -1;  // -1: a pose alone
    int32_t matrix = 0;   // first value of its packed lower triangle in an array of all blocks'
};

// Where each parameter is in a tangent vector (order in clba.h): F scalars first, then 3 a point in
// the caller's order.
struct ParameterLayout {
    explicit ParameterLayout(const Problem& problem);

    std::vector<ParameterBlock> blocks;
    std::vector<int32_t> pose_offset;             // of each image
    std::vector<int32_t> intrinsics_offset;       // of each camera
    std::vector<double> scale;                    // of each F scalar: uncertainty, or 0 if constant
    int64_t num_matrix_values = 0;                // of the blocks' packed lower triangles
    int32_t num_f = 0;                            // scalars of the F side
    int32_t num_shared_cameras = 0;               // cameras that more than one image uses
    int32_t max_image_columns = num_pose_params;  // C: 6 + most intrinsics of any camera in use

    int64_t num_parameters(const Problem& problem) const {
        return num_f + 3 * int64_t{problem.num_points()};
    }
};

// Uncertainty of a point's coordinates, 0 if it is constant.
std::array<double, 3> point_scale(const Problem& problem, int32_t point);
bool has_point_scales(const Problem& problem);  // false: point_scale is 1 everywhere

// Moves the state by a step in the tangent space: R <- exp(w) R, t <- exp(w) t + v, the rest is
// added. Constant parameters stay. step has num_parameters numbers.
void apply_step(const ParameterLayout& layout, const double* step, Problem& problem);

}  // namespace clba
