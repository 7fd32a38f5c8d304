// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <string>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// Bundle Adjustment in the Large, a text of numbers separated by white space:
//   num_images num_points num_observations
//   image point x y                                   an observation
//   rotation vector (3), translation (3), f, k1, k2   an image
//   x y z                                             a point
// Plain, gzip or bzip2, told apart by content. Each image gets a snavely camera of its own. Content
// errors are Status::format and give file, line, value and rule.
//
// A rotation becomes a quaternion, which rounds it: rotations, unless null, gets the vectors as
// they are in the file.
using RotationVectors = std::vector<std::array<double, 3>>;
Problem read_bal(const std::string& path, RotationVectors* rotations = nullptr);

// Compressed if path ends in .gz or .bz2. Every camera must be a snavely one; images that share a
// camera each get its numbers. Covariances, loss, constants and uncertainties have no place in the
// format and are not written. rotations (may be null): vectors of the first images, which are
// written where they still are their rotations.
void write_bal(const Problem& problem, const std::string& path,
               const RotationVectors* rotations = nullptr);

}  // namespace clba
