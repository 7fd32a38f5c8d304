// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "io/reconstruction.hpp"

namespace clba {

// Bundler's bundle.out, version 0.3: per camera f k1 k2, R, t; per point its position, colour and
// views (camera, key, x, y). Cameras look along -z, pixels are counted from the image's centre with
// y up: the model snavely. A camera with f = 0 was not reconstructed; it becomes no image, and is
// written back. An ImageInfo's id is the camera's index in the file. Names come from the list of
// images beside it: <name without .out>.list.txt or list.txt, one line a camera, if there is one.
// Plain, gzip or bzip2.
Reconstruction read_bundler(const std::string& path);

// Cameras must be snavely, simple_pinhole, simple_radial or radial; principal points are lost.
// Names are written to <name without .out>.list.txt, if images have any.
void write_bundler(const Reconstruction& reconstruction, const std::string& path);

}  // namespace clba
