// SPDX-License-Identifier: Apache-2.0
#include "problem/parameter_layout.hpp"

#include <algorithm>
#include <limits>

#include "base/error.hpp"

namespace clba {

ParameterLayout::ParameterLayout(const Problem& problem) {
    std::vector<int32_t> num_users(problem.cameras.size(), 0);
    for (const Image& image : problem.images) ++num_users[image.camera];

    int64_t next = 0;
    const auto append = [&](int32_t image, int32_t camera) {
        const int size = (image >= 0 ? num_pose_params : 0) +
                         (camera >= 0 ? problem.cameras[camera].num_params() : 0);
        blocks.push_back({static_cast<int32_t>(next), size, image, camera,
                          static_cast<int32_t>(num_matrix_values)});
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

    pose_offset.resize(problem.images.size());
    intrinsics_offset.assign(problem.cameras.size(), -1);
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = problem.images[i].camera;
        const bool owns_camera = num_users[camera] == 1;
        const auto offset = static_cast<int32_t>(next);
        append(i, owns_camera ? camera : -1);
        pose_offset[i] = offset;
        for (int k = 0; k < num_pose_params; ++k) {
            if (!problem.image_uncertainties.empty())
                scale[offset + k] = problem.image_uncertainties[i][k];
            const int bit = k < 3 ? constant_rotation : constant_position;
            if (!problem.constant_images.empty() && (problem.constant_images[i] & bit))
                scale[offset + k] = 0;
        }
        if (owns_camera) {
            intrinsics_offset[camera] = offset + num_pose_params;
            scale_intrinsics(camera);
        }
        max_image_columns =
            std::max(max_image_columns, num_pose_params + problem.cameras[camera].num_params());
    }
    for (int32_t c = 0; c < problem.num_cameras(); ++c) {
        if (num_users[c] > 1) ++num_shared_cameras;
        if (intrinsics_offset[c] >= 0) continue;
        intrinsics_offset[c] = static_cast<int32_t>(next);
        append(-1, c);
        scale_intrinsics(c);
    }
    num_f = static_cast<int32_t>(next);
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
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const double* d = delta.data() + layout.pose_offset[i];
        Pose& pose = problem.images[i].pose;
        const auto turn = quaternion_from_rotation_vector({d[0], d[1], d[2]});
        const auto r = rotation_matrix(turn);
        const auto t = pose.translation;
        // A constant rotation keeps its bits.
        if (d[0] != 0 || d[1] != 0 || d[2] != 0)
            pose.rotation = normalized(quaternion_product(turn, pose.rotation));
        for (int k = 0; k < 3; ++k)
            pose.translation[k] =
                r[3 * k] * t[0] + r[3 * k + 1] * t[1] + r[3 * k + 2] * t[2] + d[3 + k];
    }
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
