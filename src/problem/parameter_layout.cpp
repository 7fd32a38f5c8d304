// SPDX-License-Identifier: Apache-2.0
#include "problem/parameter_layout.hpp"

#include <algorithm>
#include <limits>

#include "base/error.hpp"

namespace clba {

ParameterLayout::ParameterLayout(const Problem& problem, const Rigs& rigs)
    : composed(composed_images(rigs)) {
    std::vector<int32_t> num_users(problem.cameras.size(), 0);
    for (const Image& image : problem.images) ++num_users[image.camera];

    int64_t next = 0;
    const auto append = [&](ParameterBlock block) {
        const int size = (block.has_pose() ? num_pose_params : 0) +
                         (block.camera >= 0 ? problem.cameras[block.camera].num_params() : 0);
        block.offset = static_cast<int32_t>(next);
        block.size = size;
        block.matrix = static_cast<int32_t>(num_matrix_values);
        blocks.push_back(block);
        num_matrix_values += size * (size + 1) / 2;
        next += size;
        require(num_matrix_values <= std::numeric_limits<int32_t>::max(),
                "the blocks of poses and intrinsics have ", num_matrix_values,
                " values, but at most 2^31 - 1 are supported");
        scale.resize(static_cast<size_t>(next), 1.0);
    };
    const auto scale_intrinsics = [&](int32_t camera) {
        const int32_t offset = intrinsics_offset[camera];
        for (int k = 0; k < problem.cameras[camera].num_params(); ++k) {
            if (!problem.camera_uncertainties.empty())
                scale[offset + k] = problem.camera_uncertainties[camera][k];
            if (!problem.constant_cameras.empty() && (problem.constant_cameras[camera] >> k & 1))
                scale[offset + k] = 0;
        }
    };

    const auto scale_constants = [&](int32_t offset, int bits) {
        for (int k = 0; k < num_pose_params; ++k)
            if (bits & (k < 3 ? constant_rotation : constant_position)) scale[offset + k] = 0;
    };
    const auto new_block = [&] { return static_cast<int32_t>(blocks.size()); };

    std::vector<int32_t> frame_block(composed.empty() ? 0 : rigs.frames.size(), -1);
    if (!composed.empty()) {
        image_sensor.assign(problem.images.size(), -1);
        for (const int32_t image : composed) image_sensor[image] = rigs.image_sensor[image];
    }
    pose_block.resize(problem.images.size());
    intrinsics_block.assign(problem.cameras.size(), -1);
    pose_offset.resize(problem.images.size());
    intrinsics_offset.assign(problem.cameras.size(), -1);
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = problem.images[i].camera;
        const int32_t frame = is_composed(i) ? rigs.image_frame[i] : -1;
        const bool owns_camera = num_users[camera] == 1 && frame < 0;
        const auto offset = static_cast<int32_t>(next);
        ParameterBlock block;
        if (frame < 0) {
            pose_block[i] = new_block();
            block.image = i;
            block.camera = owns_camera ? camera : -1;
            append(block);
            if (!problem.image_uncertainties.empty())
                std::copy_n(problem.image_uncertainties[i].begin(), num_pose_params,
                            scale.begin() + offset);
            if (rigs.has(i))
                scale_constants(offset, rigs.constant_frames[rigs.image_frame[i]]);
            else if (!problem.constant_images.empty())
                scale_constants(offset, problem.constant_images[i]);
        } else if (frame_block[frame] < 0) {
            pose_block[i] = frame_block[frame] = new_block();
            block.frame = frame;
            append(block);
            scale_constants(offset, rigs.constant_frames[frame]);
        } else {
            pose_block[i] = frame_block[frame];
        }
        pose_offset[i] = blocks[pose_block[i]].offset;
        if (owns_camera) {
            intrinsics_block[camera] = pose_block[i];
            intrinsics_offset[camera] = offset + num_pose_params;
            scale_intrinsics(camera);
        }
        max_image_columns =
            std::max(max_image_columns, num_pose_params + problem.cameras[camera].num_params());
    }
    if (!composed.empty()) sensor_block.assign(rigs.sensors.size(), -1);
    for (const int32_t image : composed) sensor_block[rigs.image_sensor[image]] = 0;
    for (size_t s = 0; s < sensor_block.size(); ++s) {
        if (sensor_block[s] < 0) continue;
        sensor_block[s] = new_block();
        ParameterBlock block;
        block.sensor = static_cast<int32_t>(s);
        append(block);
        scale_constants(blocks.back().offset, rigs.constant_sensors[s]);
    }
    for (int32_t c = 0; c < problem.num_cameras(); ++c) {
        if (num_users[c] > 1) ++num_shared_cameras;
        if (intrinsics_offset[c] >= 0) continue;
        intrinsics_offset[c] = static_cast<int32_t>(next);
        intrinsics_block[c] = new_block();
        ParameterBlock block;
        block.camera = c;
        append(block);
        scale_intrinsics(c);
    }
    num_f = static_cast<int32_t>(next);
}

int ParameterLayout::parts_of(int32_t image, int32_t camera, ImagePart* parts) const {
    const int32_t pose = pose_block[image], intrinsics = intrinsics_block[camera];
    int count = 0;
    parts[count++] = {pose, 0, blocks[pose].size, is_composed(image)};
    if (is_composed(image))
        parts[count++] = {sensor_block[image_sensor[image]], 0, num_pose_params, false};
    if (intrinsics != pose)
        parts[count++] = {intrinsics, num_pose_params, blocks[intrinsics].size, false};
    return count;
}

std::array<double, 3> point_scale(const Problem& problem, int32_t point) {
    if (!problem.constant_points.empty() && problem.constant_points[point]) return {0, 0, 0};
    if (!problem.point_uncertainties.empty()) return problem.point_uncertainties[point];
    return {1, 1, 1};
}

bool has_point_scales(const Problem& problem) {
    return !problem.constant_points.empty() || !problem.point_uncertainties.empty();
}

void apply_step(const ParameterLayout& layout, const double* step, Problem& problem) {
    std::vector<double> delta(layout.scale.size());
    for (size_t k = 0; k < delta.size(); ++k) delta[k] = layout.scale[k] > 0 ? step[k] : 0;
    const auto move = [&](int32_t offset, Pose& pose) {
        const double* d = delta.data() + offset;
        const auto turn = quaternion_from_rotation_vector({d[0], d[1], d[2]});
        const auto r = rotation_matrix(turn);
        const auto t = pose.translation;
        // A constant rotation keeps its bits.
        if (d[0] != 0 || d[1] != 0 || d[2] != 0)
            pose.rotation = normalized(quaternion_product(turn, pose.rotation));
        for (int k = 0; k < 3; ++k)
            pose.translation[k] =
                r[3 * k] * t[0] + r[3 * k + 1] * t[1] + r[3 * k + 2] * t[2] + d[3 + k];
    };
    for (int32_t i = 0; i < problem.num_images(); ++i)
        if (!layout.is_composed(i)) move(layout.pose_offset[i], problem.images[i].pose);
    take_frames_of_images(layout.composed, problem);
    for (const ParameterBlock& block : layout.blocks) {
        if (block.frame >= 0) move(block.offset, problem.rigs.frames[block.frame]);
        if (block.sensor >= 0) move(block.offset, problem.rigs.sensors[block.sensor]);
    }
    compose_images(problem.rigs, problem.images);
    for (int32_t c = 0; c < problem.num_cameras(); ++c)
        for (int k = 0; k < problem.cameras[c].num_params(); ++k)
            problem.cameras[c].params[k] += delta[layout.intrinsics_offset[c] + k];
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        const auto scale = point_scale(problem, p);
        for (int k = 0; k < 3; ++k)
            if (scale[k] > 0) problem.points[p][k] += step[layout.num_f + 3 * int64_t{p} + k];
    }
}

}  // namespace clba
