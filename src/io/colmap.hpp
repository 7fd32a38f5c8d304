// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/reconstruction.hpp"

namespace clba {

// COLMAP's sparse models: a folder with cameras, images and points3D, and since COLMAP 3.12 rigs
// and frames. Rows keep the files' order; observations are those of the tracks, point by point. An
// image's pose is sensor_from_rig * rig_from_world where there are frames. Tracks and images must
// agree on which feature belongs to which point. Errors are Status::format and give file and place.
Reconstruction read_colmap_binary(const std::string& folder);
Reconstruction read_colmap_text(const std::string& folder);

// Whether the folder holds such a model, or a part of one.
bool has_colmap_binary(const std::string& folder);
bool has_colmap_text(const std::string& folder);

// A model that was read and not changed since is written as it was. Else errors of points are
// computed, and frames get their poses from their images; where images of one frame no longer agree
// with its rig (by more than 1e-9 of a radian or of the translations), each image gets a frame and
// each camera a rig of its own. Snavely cameras become radial ones. A folder that holds a model of
// the other kind is refused, as COLMAP would not say which of the two it reads.
void write_colmap_binary(const Reconstruction& reconstruction, const std::string& folder);
void write_colmap_text(const Reconstruction& reconstruction, const std::string& folder);

}  // namespace clba
