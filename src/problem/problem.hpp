// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "problem/camera_model.hpp"
#include "problem/loss.hpp"
#include "problem/pose.hpp"
#include "problem/priors.hpp"
#include "problem/rigs.hpp"

namespace clba {

struct Camera {
    int32_t model = camera_snavely;
    std::array<double, max_camera_params> params{};  // the model's num_params; the rest are 0
    int num_params() const { return camera_models[model].num_params; }
};

struct Image {
    int32_t camera = 0;
    Pose pose;
};

struct Observation {
    int32_t image = 0;
    int32_t point = 0;
    double x = 0, y = 0;  // pixels
};

enum ConstantPose : uint8_t { constant_rotation = 1, constant_position = 2 };

// A bundle-adjustment problem on the host, in the caller's order. Plain data: whoever fills it
// calls validate() before anything else reads it. Vectors marked optional are empty or one row
// each.
struct Problem {
    std::vector<Camera> cameras;
    std::vector<Image> images;
    std::vector<Point> points;
    std::vector<Observation> observations;

    // Lower triangle xx, yx, yy of L^-1 with L L^T the observation's covariance. Optional.
    std::vector<std::array<double, 3>> whitening;

    std::vector<uint8_t> constant_images;    // ConstantPose bits. Optional.
    std::vector<uint32_t> constant_cameras;  // bit k: parameter k. Optional.
    std::vector<uint8_t> constant_points;    // Optional.

    // Uncertainties c > 0 in tangent units. Optional.
    std::vector<std::array<double, num_pose_params>> image_uncertainties;
    std::vector<std::array<double, max_camera_params>> camera_uncertainties;
    std::vector<std::array<double, 3>> point_uncertainties;

    Loss loss;

    Priors priors;

    // Constants and uncertainties of the poses of their images are those of frames and sensors.
    Rigs rigs;

    int32_t num_images() const { return static_cast<int32_t>(images.size()); }
    int32_t num_cameras() const { return static_cast<int32_t>(cameras.size()); }
    int32_t num_points() const { return static_cast<int32_t>(points.size()); }
    int64_t num_observations() const { return static_cast<int64_t>(observations.size()); }

    // ConstantPose bits of the pose that an image has to itself: its own, or its frame's.
    uint8_t constants_of_image(int32_t image) const;

    // Throws an invalid_argument error that names the first offending row, value and rule: values
    // finite, indices in range, quaternions of unit length (to 1e-6).
    void validate() const;
};

}  // namespace clba
