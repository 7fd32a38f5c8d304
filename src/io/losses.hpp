// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "io/reconstruction.hpp"

namespace clba {

// What files do not hold, in a user's words. Covariances, losses, constants and uncertainties are
// options of a solve, which no file holds.
std::vector<std::string> losses_of_bal(const Reconstruction& reconstruction);

}  // namespace clba
