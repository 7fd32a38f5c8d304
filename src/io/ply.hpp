// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>

#include "problem/problem.hpp"

namespace clba {

// Points in white, then camera centres in green, as vertices of a binary little-endian PLY file.
void write_ply(const Problem& problem, const std::string& path);

}  // namespace clba
