// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <string>

#include "io/json_document.hpp"
#include "io/reconstruction.hpp"

namespace clba {

// Pixels of OpenSfM's normalised coordinates, and back.
struct OpenSfmScale {
    double size = 1, center_x = 0, center_y = 0;

    OpenSfmScale(uint64_t width, uint64_t height)
        : size(static_cast<double>(std::max(width, height))),
          center_x(static_cast<double>(width) / 2),
          center_y(static_cast<double>(height) / 2) {}
};

struct OpenSfmCamera {
    Camera camera;
    uint32_t constant = 0;  // bits of parameters that the projection type does not have
    CameraInfo info;
};
OpenSfmCamera read_opensfm_camera(const JsonPlace& place);

// Sets the members of a camera, of a new one too; those that still mean the same stay as they are.
void set_opensfm_camera(Json& json, const Camera& camera, const CameraInfo& info, int32_t index);

}  // namespace clba
