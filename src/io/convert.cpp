// SPDX-License-Identifier: Apache-2.0
#include "io/convert.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"

namespace clba {
namespace {

// diag(1, -1, -1) R and t: half a turn about x is the quaternion (0, 1, 0, 0).
Pose half_turn(const Pose& pose) {
    const auto& q = pose.rotation;
    const auto& t = pose.translation;
    return {{-q[1], q[0], -q[3], q[2]}, {t[0], -t[1], -t[2]}};
}

// Of each camera: half the width and height that contain its observations around (0, 0), pixels.
std::vector<std::array<double, 2>> half_sizes(const Problem& problem) {
    std::vector<std::array<double, 2>> half(problem.cameras.size());
    for (const Observation& o : problem.observations) {
        auto& size = half[problem.images[o.image].camera];
        size = {std::max(size[0], std::abs(o.x)), std::max(size[1], std::abs(o.y))};
    }
    // Whole numbers, so that adding them to pixels rounds as little as can be.
    for (auto& size : half)
        for (double& value : size) value = std::floor(value) + 1;
    return half;
}

bool is_snavely(const Camera& camera) {
    return camera.model == camera_snavely;
}

// The same camera without its principal point.
Camera snavely_of(const Problem& problem, int32_t index) {
    const Camera& camera = problem.cameras[index];
    const auto& p = camera.params;
    switch (camera.model) {
        case camera_snavely:
            return camera;
        case camera_simple_pinhole:
            return {camera_snavely, {p[0], 0, 0}};
        case camera_simple_radial:
            return {camera_snavely, {p[0], p[3], 0}};
        case camera_radial:
            return {camera_snavely, {p[0], p[3], p[4]}};
        default:
            fail(Status::invalid_argument, "cameras[", index, "] is a ",
                 camera_models[camera.model].name,
                 " camera, which is none of snavely, simple_pinhole, simple_radial and radial, so "
                 "no file of snavely cameras can hold it; fit one of these models, or write "
                 "another format");
    }
}

// Of images with cameras that were turned. Where not all of a sensor's were there is no rig any
// more.
void turn_sensors(Problem& problem, const std::vector<char>& is_turned) {
    Rigs& rigs = problem.rigs;
    std::vector<int> turned(rigs.sensors.size(), -1);
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        if (!rigs.has(i)) continue;
        int& of_sensor = turned[rigs.image_sensor[i]];
        const int of_image = is_turned[problem.images[i].camera];
        if (of_sensor >= 0 && of_sensor != of_image) {
            rigs = Rigs();
            return;
        }
        of_sensor = of_image;
    }
    for (size_t s = 0; s < turned.size(); ++s)
        if (turned[s] == 1) rigs.sensors[s] = half_turn(rigs.sensors[s]);
}

}  // namespace

bool has_snavely_cameras(const Problem& problem) {
    return std::any_of(problem.cameras.begin(), problem.cameras.end(), is_snavely);
}

bool has_snavely_cameras_only(const Problem& problem) {
    return std::all_of(problem.cameras.begin(), problem.cameras.end(), is_snavely);
}

void require_snavely_like_cameras(const Problem& problem) {
    for (const Image& image : problem.images) snavely_of(problem, image.camera);
}

Reconstruction with_pixel_cameras(const Reconstruction& reconstruction) {
    Reconstruction made = reconstruction;
    Problem& problem = made.problem;
    if (made.cameras.empty()) {
        made.cameras.resize(problem.cameras.size());
        for (size_t i = 0; i < made.cameras.size(); ++i) made.cameras[i].id = i + 1;
    }
    const auto half = half_sizes(problem);
    std::vector<char> moves(problem.cameras.size());
    for (size_t i = 0; i < problem.cameras.size(); ++i) {
        Camera& camera = problem.cameras[i];
        moves[i] = is_snavely(camera);
        if (!moves[i]) continue;
        CameraInfo& info = made.cameras[i];
        if (info.width == 0 || info.height == 0) {
            constexpr double most = 1e15;  // pixels; farther ones are left outside of the image
            info.width = static_cast<uint64_t>(2 * std::min(half[i][0], most));
            info.height = static_cast<uint64_t>(2 * std::min(half[i][1], most));
        }
        const auto [f, k1, k2] = std::array{camera.params[0], camera.params[1], camera.params[2]};
        camera = {camera_radial, {}};
        const double params[] = {f, static_cast<double>(info.width) / 2,
                                 static_cast<double>(info.height) / 2, k1, k2};
        std::copy(std::begin(params), std::end(params), camera.params.begin());
    }
    const auto corner = [&](int32_t image) -> const Camera* {
        const int32_t camera = problem.images[image].camera;
        return moves[camera] ? &problem.cameras[camera] : nullptr;
    };
    for (int32_t i = 0; i < problem.num_images(); ++i)
        if (corner(i)) problem.images[i].pose = half_turn(problem.images[i].pose);
    turn_sensors(problem, moves);
    const auto move = [&](auto& pixel) {
        const Camera* const camera = corner(pixel.image);
        if (!camera) return;
        pixel.x = camera->params[1] + pixel.x;
        pixel.y = camera->params[2] - pixel.y;
    };
    for (Observation& o : problem.observations) move(o);
    for (Feature& feature : made.unmatched) move(feature);
    made.digest_read = 0;
    return made;
}

Reconstruction with_colmap_cameras(const Reconstruction& reconstruction) {
    Reconstruction made = with_pixel_cameras(reconstruction);
    for (Camera& camera : made.problem.cameras)
        if (camera.model == camera_brown) {
            const auto& p = camera.params;
            camera = {camera_full_opencv, {p[0], p[0], p[1], p[2], p[3], p[4], p[6], p[7], p[5]}};
        }
    return made;
}

bool has_colmap_cameras_only(const Problem& problem) {
    return std::none_of(problem.cameras.begin(), problem.cameras.end(), [](const Camera& camera) {
        return camera.model == camera_snavely || camera.model == camera_brown;
    });
}

Problem with_snavely_cameras(const Problem& problem) {
    Problem made;
    made.points = problem.points;
    made.observations = problem.observations;
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const Image& image = problem.images[i];
        const Camera& camera = problem.cameras[image.camera];
        made.cameras.push_back(snavely_of(problem, image.camera));
        made.images.push_back({i, is_snavely(camera) ? image.pose : half_turn(image.pose)});
    }
    for (Observation& o : made.observations) {
        const Camera& camera = problem.cameras[problem.images[o.image].camera];
        if (is_snavely(camera)) continue;
        o.x -= camera.params[1];
        o.y = camera.params[2] - o.y;
    }
    return made;
}

}  // namespace clba
