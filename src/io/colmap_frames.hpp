// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/colmap_model.hpp"
#include "io/id_index.hpp"

namespace clba::colmap {

// Checks rigs and frames and sets each image's pose to sensor_from_rig * rig_from_world. Where a
// frame has several images, which the problem holds as free ones, a notice says so.
void take_poses_from_frames(Reconstruction& made, const IdIndex& image_rows,
                            const std::string& folder);

// The other way: poses of frames from those of their images, or, where images no longer agree with
// their rig, rigs and frames of one image each.
void update_frames(Model& model);

}  // namespace clba::colmap
