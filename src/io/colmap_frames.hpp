// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/colmap_model.hpp"
#include "io/id_index.hpp"

namespace clba::colmap {

// Checks rigs and frames and makes them the problem's: each image's pose is sensor_from_rig *
// rig_from_world. Where a sensor's pose is not known a notice says that its images are free.
void take_poses_from_frames(Reconstruction& made, const IdIndex& image_rows,
                            const std::string& folder);

// The other way: poses of sensors and frames by the problem's, or its rigs and frames where they
// are not the model's. Where images no longer agree with their rig, rigs and frames of one image
// each.
void update_frames(const Problem& problem, Model& model);

// Whether the problem's rigs can be written: each sensor has a camera, which nobody else has.
bool can_hold_rigs(const Problem& problem);

}  // namespace clba::colmap
