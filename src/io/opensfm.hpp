// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/reconstruction.hpp"

namespace clba {

// OpenSfM's reconstruction.json and the tracks.csv beside it (any version of their columns). path
// is the folder of the two, or the former; where that has another name, the tracks have it with
// "reconstruction" and ".json" replaced by "tracks" and ".csv". The first reconstruction of the
// file is read: each shot is an image, each camera a camera. Other reconstructions, tracks without
// a shot or a point, ground control points and what is not known here are kept and written back.
//
// OpenSfM counts coordinates from the image's centre in units of its larger side s; here they are
// pixels, s x + width / 2 and s y + height / 2, as COLMAP counts them. Parameters that a projection
// type does not have are constant. Types without a model here, and rigs of several cameras, are
// errors that name them.
Reconstruction read_opensfm(const std::string& path);

// Whether a folder holds such files.
bool has_opensfm(const std::string& folder);

// Needs the size in pixels of every camera. Writes both files, and ground control points that were
// read.
void write_opensfm(const Reconstruction& reconstruction, const std::string& path);

}  // namespace clba
