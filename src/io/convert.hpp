// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "io/reconstruction.hpp"

// Between snavely cameras, which look along -z with y up and (0, 0) at the principal point, and
// those of other formats, which look along z with y down and (0, 0) at a corner of the image. The
// frames differ by diag(1, -1, -1), pixels by the principal point and the sign of y.
namespace clba {

// Snavely cameras become radial ones: the same projections, to rounding. The principal point is
// the centre of the image; where its size is not known, of the smallest one around the camera's
// observations.
Reconstruction with_pixel_cameras(const Reconstruction& reconstruction);

// The same, and brown cameras, which COLMAP does not have, become full_opencv ones.
Reconstruction with_colmap_cameras(const Reconstruction& reconstruction);
bool has_colmap_cameras_only(const Problem& problem);

// simple_pinhole, simple_radial and radial cameras become snavely ones, one an image, which loses
// their principal points. Others are an error that names the camera.
Problem with_snavely_cameras(const Problem& problem);

// Throws the error that with_snavely_cameras would.
void require_snavely_like_cameras(const Problem& problem);

bool has_snavely_cameras(const Problem& problem);  // at least one
bool has_snavely_cameras_only(const Problem& problem);

}  // namespace clba
