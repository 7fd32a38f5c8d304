// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// A diagonal block of the image-camera side (F): an image's pose with its own camera's intrinsics,
// a pose alone, the intrinsics of a shared camera, or the pose of a frame or a sensor of rigs.
struct ParameterBlock {
    int32_t offset = 0;  // of its first scalar in the F vector
    int32_t size = 0;
    int32_t image = -1;   // -1: no image's own
    int32_t camera = -1;  // -1: a pose alone
    int32_t matrix = 0;   // first value of its packed lower triangle in an array of all blocks'
    int32_t frame = -1;   // of rigs
    int32_t sensor = -1;  // of rigs
    bool has_pose() const { return image >= 0 || frame >= 0 || sensor >= 0; }
};

// Columns of an image (6 of its pose, then its intrinsics) that belong to a parameter block.
struct ImagePart {
    int32_t block = 0;
    int32_t first_column = 0;
    int32_t size = 0;
    bool is_of_frame = false;  // the image's tangent is frame_tangent times the block's
};

// Where each parameter is in a tangent vector (order in clba.h): F scalars first, then 3 a point in
// the caller's order.
struct ParameterLayout {
    explicit ParameterLayout(const Problem& problem) : ParameterLayout(problem, problem.rigs) {}
    // As if no image were in a rig.
    static ParameterLayout of_images(const Problem& problem) {
        return ParameterLayout(problem, Rigs());
    }

    std::vector<ParameterBlock> blocks;
    std::vector<int32_t> pose_offset;        // of each image: its own pose, or its frame's
    std::vector<int32_t> intrinsics_offset;  // of each camera
    std::vector<int32_t> pose_block;         // likewise, the blocks
    std::vector<int32_t> intrinsics_block;
    std::vector<int32_t> composed;  // images whose pose is one of a frame and a sensor, by frame
    std::vector<int32_t> sensor_block;  // of each sensor, -1: of no composed image
    std::vector<int32_t> image_sensor;  // of each image, -1: not composed; empty if none is
    std::vector<double> scale;          // of each F scalar: uncertainty, or 0 if constant
    int64_t num_matrix_values = 0;      // of the blocks' packed lower triangles
    int32_t num_f = 0;                  // scalars of the F side
    int32_t num_shared_cameras = 0;     // cameras that more than one image uses
    int32_t max_image_columns = num_pose_params;  // C: 6 + most intrinsics of any camera in use

    // Of the image with this camera, in the order of columns, a frame's before its sensor's; how
    // many there are.
    static constexpr int max_image_parts = 3;
    int parts_of(int32_t image, int32_t camera, ImagePart* parts) const;
    bool has_rigs() const { return !composed.empty(); }
    bool is_composed(int32_t image) const {
        return !image_sensor.empty() && image_sensor[image] >= 0;
    }
    int32_t sensor_offset(int32_t sensor) const { return blocks[sensor_block[sensor]].offset; }

    int64_t num_parameters(const Problem& problem) const {
        return num_f + 3 * int64_t{problem.num_points()};
    }

private:
    ParameterLayout(const Problem& problem, const Rigs& rigs);
};

// Uncertainty of a point's coordinates, 0 if it is constant.
std::array<double, 3> point_scale(const Problem& problem, int32_t point);
bool has_point_scales(const Problem& problem);  // false: point_scale is 1 everywhere

// Moves the state by a step in the tangent space: R <- exp(w) R, t <- exp(w) t + v, the rest is
// added. Constant parameters stay. step has num_parameters numbers.
void apply_step(const ParameterLayout& layout, const double* step, Problem& problem);

}  // namespace clba
