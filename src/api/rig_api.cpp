// SPDX-License-Identifier: Apache-2.0
// Rigs: sensors that are fixed to one body.
#include <cmath>
#include <utility>

#include "api/numbers.hpp"
#include "problem/parameter_layout.hpp"

namespace clba {
namespace {

clba_rigs default_rigs() {
    clba_rigs rigs{};
    rigs.struct_size = sizeof rigs;
    return rigs;
}

std::vector<Pose> read_poses(const double* values, int32_t count, const char* name) {
    const Rows rows(values, 0, 7, name, count);
    std::vector<Pose> poses(static_cast<size_t>(count));
    for (int32_t i = 0; i < count; ++i) {
        poses[i] = read_pose(rows, i, name);
        double norm2 = 0;
        for (double q : poses[i].rotation) norm2 += q * q;
        // What is of length 1 but for rounding keeps its bits.
        if (std::abs(norm2 - 1) > 1e-15) poses[i].rotation = normalized(poses[i].rotation);
    }
    return poses;
}

std::vector<uint8_t> read_constants(const int32_t* flags, int32_t count, const char* name) {
    std::vector<uint8_t> constants(static_cast<size_t>(count), 0);
    for (int32_t i = 0; flags && i < count; ++i) {
        require((flags[i] & ~int32_t{CLBA_CONSTANT_POSE}) == 0, name, "[", i, "] = ", flags[i],
                ", but it is a sum of CLBA_CONSTANT_ROTATION (1) and CLBA_CONSTANT_POSITION (2)");
        constants[i] = static_cast<uint8_t>(flags[i]);
    }
    return constants;
}

Rigs read_rigs(const clba_rigs& given, const Problem& problem) {
    Rigs rigs;
    require(given.reserved == 0, "rigs.reserved = ", given.reserved, ", but it must be 0");
    require(given.num_frames >= 0, "rigs.num_frames = ", given.num_frames, ", but it must be >= 0");
    require(given.num_sensors >= 0, "rigs.num_sensors = ", given.num_sensors,
            ", but it must be >= 0");
    if (given.num_frames == 0) return rigs;
    require_pointer(given.frames, "rigs.frames");
    require_pointer(given.sensors, "rigs.sensors");
    rigs.image_frame.assign(given.frames, given.frames + problem.num_images());
    rigs.image_sensor.assign(given.sensors, given.sensors + problem.num_images());
    rigs.sensors = read_poses(given.sensor_poses, given.num_sensors, "rigs.sensor_poses");
    if (given.frame_poses)
        rigs.frames = read_poses(given.frame_poses, given.num_frames, "rigs.frame_poses");
    else
        rigs.frames.resize(static_cast<size_t>(given.num_frames));
    rigs.constant_sensors =
        read_constants(given.constant_sensors, given.num_sensors, "rigs.constant_sensors");
    rigs.constant_frames =
        read_constants(given.constant_frames, given.num_frames, "rigs.constant_frames");
    require_valid(rigs, problem);
    if (!given.frame_poses) rigs.frames = frames_from_images(rigs, problem.images);
    return rigs;
}

bool is_same_structure(const Rigs& a, const Rigs& b) {
    return a.image_frame == b.image_frame && a.image_sensor == b.image_sensor &&
           a.sensors.size() == b.sensors.size() && composed_images(a) == composed_images(b);
}

void copy_poses(const std::vector<Pose>& poses, const std::vector<uint8_t>& constants,
                int32_t first, int32_t count, const char* what, double* values, size_t stride,
                int32_t* flags, size_t flags_stride) {
    require_range(first, count, static_cast<int64_t>(poses.size()), what);
    const Rows rows(values, stride, 7, "poses", 0);
    const Rows flag_rows(flags, flags_stride, 1, "flags", 0);
    for (int32_t i = 0; i < count; ++i) {
        if (values) write_pose(poses[first + i], rows, i);
        if (flags) flag_rows.set(i, 0, constants[first + i]);
    }
}

}  // namespace
}  // namespace clba

using namespace clba;

clba_status clba_rigs_init(clba_rigs* rigs, size_t struct_size) {
    return guarded([&] { init_struct(rigs, struct_size, default_rigs(), "rigs"); });
}

clba_status clba_problem_set_rigs(clba_problem* problem, const clba_rigs* rigs) {
    return changed(problem, [&](Problem& p) {
        Rigs read = read_rigs(copied_in(rigs, default_rigs(), "rigs"), p);
        const bool is_same = is_same_structure(read, p.rigs);
        p.rigs = std::move(read);
        compose_images(p.rigs, p.images);
        return is_same ? Changed::scales : Changed::rigs;
    });
}

clba_status clba_problem_get_frames(const clba_problem* problem, int32_t first, int32_t count,
                                    double* poses, size_t poses_stride, int32_t* flags,
                                    size_t flags_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Rigs& rigs = problem->problem.rigs;
        copy_poses(rigs.frames, rigs.constant_frames, first, count, "frames", poses, poses_stride,
                   flags, flags_stride);
    });
}

clba_status clba_problem_get_sensors(const clba_problem* problem, int32_t first, int32_t count,
                                     double* poses, size_t poses_stride, int32_t* flags,
                                     size_t flags_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Rigs& rigs = problem->problem.rigs;
        copy_poses(rigs.sensors, rigs.constant_sensors, first, count, "sensors", poses,
                   poses_stride, flags, flags_stride);
    });
}

clba_status clba_problem_get_image_rigs(const clba_problem* problem, int32_t first, int32_t count,
                                        int32_t* frames, size_t frames_stride, int32_t* sensors,
                                        size_t sensors_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const Rigs& rigs = problem->problem.rigs;
        require_range(first, count, problem->problem.num_images(), "images");
        const Rows frame_rows(frames, frames_stride, 1, "frames", 0);
        const Rows sensor_rows(sensors, sensors_stride, 1, "sensors", 0);
        for (int32_t i = 0; i < count; ++i) {
            const bool has_rig = rigs.has(first + i);
            if (frames) frame_rows.set(i, 0, has_rig ? rigs.image_frame[first + i] : -1);
            if (sensors) sensor_rows.set(i, 0, has_rig ? rigs.image_sensor[first + i] : -1);
        }
    });
}

clba_status clba_problem_get_sensor_offsets(const clba_problem* problem, int64_t* offsets) {
    return guarded([&] {
        require_pointer(problem, "problem");
        const ParameterLayout layout(problem->problem);
        const size_t num_sensors = problem->problem.rigs.sensors.size();
        if (num_sensors > 0) require_pointer(offsets, "offsets");
        for (size_t s = 0; s < num_sensors; ++s) {
            const bool has_offset = !layout.sensor_block.empty() && layout.sensor_block[s] >= 0;
            offsets[s] = has_offset ? layout.sensor_offset(static_cast<int32_t>(s)) : -1;
        }
    });
}
