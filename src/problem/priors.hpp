// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "problem/camera_model.hpp"
#include "problem/pose.hpp"

namespace clba {

// Gaussian priors: each adds 1/2 |L^-1 (h(x) - target)|^2 to the cost, with L L^T its covariance.
// `whitening` is L^-1: row-major, lower triangular.

// h: the camera centre -R^T t.
struct PositionPrior {
    int32_t image = 0;
    Point position{};
    std::array<double, 9> whitening{};
};

// h: log(R R0^T) and the camera centre less that of `pose`.
struct PosePrior {
    int32_t image = 0;
    Pose pose;
    std::array<double, 36> whitening{};
};

// h: the model's parameters. Rows and columns of those without a prior are 0; rows have
// max_camera_params numbers.
struct IntrinsicsPrior {
    int32_t camera = 0;
    std::array<double, max_camera_params> params{};
    std::array<double, max_camera_params * max_camera_params> whitening{};
};

// h: the point.
struct PointPrior {
    int32_t point = 0;
    Point position{};
    std::array<double, 9> whitening{};
};

// h: log of the rotation, and the translation, of pose^-1 T_second T_first^-1 with T
// camera_from_world.
struct RelativePosePrior {
    int32_t first = 0, second = 0;  // images
    Pose pose;                      // second camera from first camera
    std::array<double, 36> whitening{};
};

// At most one prior of a kind an image, camera or point, and any number a pair of images.
struct Priors {
    std::vector<PositionPrior> positions;
    std::vector<PosePrior> poses;
    std::vector<IntrinsicsPrior> intrinsics;
    std::vector<PointPrior> points;
    std::vector<RelativePosePrior> relative_poses;

    bool has_image_side() const {
        return !positions.empty() || !poses.empty() || !intrinsics.empty() ||
               !relative_poses.empty();
    }
    bool empty() const { return !has_image_side() && points.empty(); }
};

}  // namespace clba
