// SPDX-License-Identifier: Apache-2.0
#include "problem/rigs.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/error.hpp"
#include "problem/counting_sort.hpp"
#include "problem/problem.hpp"

namespace clba {
namespace {

bool is_origin(const Pose& pose) {
    return pose.rotation[0] == 1 && pose.translation == Point{0, 0, 0};
}

bool is_constant_origin(const Rigs& rigs, int32_t sensor) {
    return rigs.constant_sensors[sensor] == (constant_rotation | constant_position) &&
           is_origin(rigs.sensors[sensor]);
}

double length(const Point& a) {
    return std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
}

void require_pose(const Pose& pose, const char* array, size_t row) {
    double norm = 0;
    for (const double q : pose.rotation) norm += q * q;
    require(std::abs(norm - 1) < 1e-6, array, "[", row, "] has a quaternion of the squared norm ",
            norm, ", but a rotation is a unit quaternion");
    for (const double t : pose.translation)
        require(std::isfinite(t), array, "[", row, "] has the translation ", t,
                ", but it must be finite");
}

}  // namespace

void require_valid(const Rigs& rigs, const Problem& problem) {
    if (rigs.empty()) return;
    const auto num_frames = static_cast<int32_t>(rigs.frames.size());
    const auto num_sensors = static_cast<int32_t>(rigs.sensors.size());
    for (const auto& [rows, size] :
         {std::pair("frames", rigs.image_frame.size()), {"sensors", rigs.image_sensor.size()}})
        require(size == problem.images.size(), "rigs.", rows, " has ", size,
                " rows, but there are ", problem.images.size(), " images");
    std::vector<char> has_image(rigs.frames.size(), 0);
    for (size_t i = 0; i < problem.images.size(); ++i) {
        const int32_t frame = rigs.image_frame[i], sensor = rigs.image_sensor[i];
        require(frame >= -1 && frame < num_frames, "rigs.frames[", i, "] = ", frame,
                ", but num_frames = ", num_frames, " (-1: the image is in no rig)");
        require(frame < 0 ? sensor == -1 : sensor >= 0 && sensor < num_sensors, "rigs.sensors[", i,
                "] = ", sensor, " where rigs.frames[", i, "] = ", frame,
                ", but num_sensors = ", num_sensors, " (-1 where the image is in no rig)");
        if (frame < 0) continue;
        has_image[frame] = 1;
        require(problem.constant_images.empty() || problem.constant_images[i] == 0, "image ", i,
                " is constant, but it is in a rig; say so of its frame and its sensor "
                "(constant_frames, constant_sensors)");
        if (!problem.image_uncertainties.empty())
            for (const double c : problem.image_uncertainties[i])
                require(c == 1, "image ", i, " has an uncertainty of ", c,
                        ", but it is in a rig, where they are 1");
    }
    for (size_t f = 0; f < has_image.size(); ++f)
        require(has_image[f], "frame ", f, " has no image; number the frames that have some");
    for (size_t f = 0; f < rigs.frames.size(); ++f) require_pose(rigs.frames[f], "frame_poses", f);
    for (size_t s = 0; s < rigs.sensors.size(); ++s)
        require_pose(rigs.sensors[s], "sensor_poses", s);
    constexpr int pose = constant_rotation | constant_position;
    for (const auto* constants : {&rigs.constant_frames, &rigs.constant_sensors}) {
        const bool is_frames = constants == &rigs.constant_frames;
        const size_t rows = is_frames ? rigs.frames.size() : rigs.sensors.size();
        const char* name = is_frames ? "constant_frames" : "constant_sensors";
        require(constants->size() == rows, "rigs.", name, " has ", constants->size(),
                " rows, but there are ", rows);
        for (size_t k = 0; k < rows; ++k)
            require(((*constants)[k] & ~pose) == 0, "rigs.", name, "[", k,
                    "] = ", int{(*constants)[k]},
                    ", but it is a sum of CLBA_CONSTANT_ROTATION (1) and CLBA_CONSTANT_POSITION "
                    "(2)");
    }
}

Pose composed_pose(const Rigs& rigs, int32_t image) {
    return product(rigs.sensors[rigs.image_sensor[image]], rigs.frames[rigs.image_frame[image]]);
}

std::vector<int32_t> composed_images(const Rigs& rigs) {
    const auto num_frames = static_cast<int64_t>(rigs.frames.size());
    std::vector<int32_t> of_rigs;
    for (size_t i = 0; i < rigs.image_frame.size(); ++i)
        if (rigs.has(static_cast<int32_t>(i))) of_rigs.push_back(static_cast<int32_t>(i));
    std::vector<int32_t> by_frame(of_rigs.size());
    const std::vector<int32_t> begin = counting_sort(
        static_cast<int64_t>(of_rigs.size()), num_frames,
        [&](int64_t k) { return rigs.image_frame[of_rigs[k]]; },
        [&](int64_t k, int32_t slot) { by_frame[slot] = of_rigs[k]; });
    std::vector<int32_t> composed;
    for (int64_t f = 0; f < num_frames; ++f) {
        const bool is_alone = begin[f + 1] - begin[f] == 1;
        if (is_alone && is_constant_origin(rigs, rigs.image_sensor[by_frame[begin[f]]])) continue;
        composed.insert(composed.end(), by_frame.begin() + begin[f],
                        by_frame.begin() + begin[f + 1]);
    }
    return composed;
}

std::vector<Pose> frames_from_images(const Rigs& rigs, const std::vector<Image>& images) {
    const auto num_images = static_cast<int32_t>(images.size());
    std::vector<Pose> frames(rigs.frames.size());
    std::vector<int32_t> source(frames.size(), -1);  // the image that a frame's pose is taken from
    for (const bool only_origins : {true, false}) {
        for (int32_t i = 0; i < num_images; ++i) {
            if (!rigs.has(i) || source[rigs.image_frame[i]] >= 0) continue;
            const int32_t sensor = rigs.image_sensor[i];
            const bool at_origin = is_origin(rigs.sensors[sensor]);
            if (at_origin != only_origins) continue;
            const Pose& pose = images[i].pose;
            frames[rigs.image_frame[i]] =
                at_origin ? pose : product(inverse(rigs.sensors[sensor]), pose);
            source[rigs.image_frame[i]] = i;
        }
    }
    constexpr double largest_turn = 1e-6, largest_shift = 1e-6, rounding = 1e-9;
    for (int32_t i = 0; i < num_images; ++i) {
        if (!rigs.has(i)) continue;
        const int32_t frame = rigs.image_frame[i];
        const Pose& pose = images[i].pose;
        const Pose& sensor = rigs.sensors[rigs.image_sensor[i]];
        const Pose by_rig = product(sensor, frames[frame]);
        const Pose apart = product(pose, inverse(by_rig));
        const double turn = 2 * std::hypot(apart.rotation[1], apart.rotation[2], apart.rotation[3]);
        const Point center = camera_center(pose), of_rig = camera_center(by_rig);
        const Point shift{center[0] - of_rig[0], center[1] - of_rig[1], center[2] - of_rig[2]};
        require(
            turn <= largest_turn && length(shift) <= largest_shift * length(sensor.translation) +
                                                         rounding * length(center),
            "image ", i, " is turned by ", turn, " rad and ", length(shift),
            " away from where its sensor ", rigs.image_sensor[i], " is in frame ", frame,
            " by image ", source[frame],
            "; set poses that agree with the rigs, or give the rigs the poses of frames, which "
            "then place the images");
    }
    return frames;
}

void take_frames_of_images(const std::vector<int32_t>& composed, Problem& problem) {
    if (problem.rigs.empty()) return;
    std::vector<char> is_composed(problem.images.size(), 0);
    for (const int32_t i : composed) is_composed[i] = 1;
    for (int32_t i = 0; i < problem.num_images(); ++i)
        if (problem.rigs.has(i) && !is_composed[i])
            problem.rigs.frames[problem.rigs.image_frame[i]] = problem.images[i].pose;
}

void compose_images(const Rigs& rigs, std::vector<Image>& images) {
    for (size_t i = 0; i < rigs.image_frame.size(); ++i)
        if (rigs.image_frame[i] >= 0) images[i].pose = composed_pose(rigs, static_cast<int32_t>(i));
}

std::array<double, 36> frame_tangent(const Pose& sensor) {
    const auto r = rotation_matrix(sensor.rotation);
    const auto& t = sensor.translation;
    std::array<double, 36> a{};
    for (int c = 0; c < 3; ++c) {
        const double x = r[c], y = r[3 + c], z = r[6 + c];  // column c of R_s
        const std::array<double, 3> cross{t[1] * z - t[2] * y, t[2] * x - t[0] * z,
                                          t[0] * y - t[1] * x};
        for (int row = 0; row < 3; ++row) {
            a[6 * row + c] = a[6 * (row + 3) + c + 3] = r[3 * row + c];
            a[6 * (row + 3) + c] = cross[row];
        }
    }
    return a;
}

}  // namespace clba
