// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/reconstruction.hpp"

namespace clba {

// VisualSFM's NVM_V3: per camera its name, f, rotation as a quaternion, centre and one radial
// distortion r; per point its position, colour and measurements (camera, feature, x, y). Cameras
// look along +z with y down; pixels are counted from the principal point. Plain, gzip or bzip2.
//
// VisualSFM distorts the other way round: undistorted = measured (1 + r |measured / f|^2). Cameras
// with r = 0 become simple_pinhole, the others simple_radial with the k that comes closest over the
// range of their measurements; a notice gives the largest difference in pixels.
//
// A header "FixedK fx cx fy cy" holds all intrinsics constant. The first model is read; what
// follows it (other models, images without a model, the list of PLY files) is kept and written
// back.
Reconstruction read_nvm(const std::string& path);

// Cameras may be of any model that has one focal length and no distortion but k1. An error tells
// where the r that comes closest to k1 would move an observation by more than a pixel.
void write_nvm(const Reconstruction& reconstruction, const std::string& path);

// Throws the error of a camera whose model does not fit.
void require_nvm_cameras(const Problem& problem);

}  // namespace clba
