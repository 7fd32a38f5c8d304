// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

struct CameraInfo {
    uint64_t id = 0;
    uint64_t width = 0, height = 0;  // pixels; 0: unknown
};

struct ImageInfo {
    uint64_t id = 0;
    std::string name;
};

struct PointInfo {
    uint64_t id = 0;
    std::array<uint8_t, 3> color{255, 255, 255};
};

// An image's feature that no point claims.
struct Feature {
    int32_t image = 0;
    int32_t index = 0;    // among all features of its image
    double x = 0, y = 0;  // pixels
};

// What reconstruction files hold: a problem, and what a solver has no use for but a file written
// back must keep. Each vector is empty or has one row a camera, image, point or observation.
struct Reconstruction {
    Problem problem;
    std::vector<CameraInfo> cameras;
    std::vector<ImageInfo> images;
    std::vector<PointInfo> points;
    std::vector<int32_t> observation_features;  // index of the feature among those of its image
    std::vector<Feature> unmatched;             // any number, by image, then index
};

}  // namespace clba
