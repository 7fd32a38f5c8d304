// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/reconstruction.hpp"

namespace clba {

// OpenMVG's sfm_data.json (versions 0.1 to 0.3). Each view with a pose and an intrinsic is an
// image, each intrinsic a camera: pinhole a simple_pinhole one, pinhole_radial_k1 simple_radial,
// pinhole_radial_k3 and pinhole_brown_t2 brown (the former with p1 = p2 = 0 constant), fisheye
// radial_fisheye, or opencv_fisheye with constant focal lengths where k3 or k4 is not 0. Others
// are errors that name them. Ids are the keys of the file. All else (views without a
// pose, control points, what this version does not know) is kept and written back; of the structure
// the positions and observations. Plain, gzip or bzip2.
Reconstruction read_openmvg(const std::string& path);

// Cameras may be of any model that has one focal length and no denominator. Version 0.3, in
// cereal's layout.
void write_openmvg(const Reconstruction& reconstruction, const std::string& path);

// Throws the error of a camera whose model does not fit.
void require_openmvg_cameras(const Problem& problem);

}  // namespace clba
