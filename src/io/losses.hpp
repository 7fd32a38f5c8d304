// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "io/reconstruction.hpp"

namespace clba {

// What files do not hold, in a user's words. Covariances, losses, constants and uncertainties are
// options of a solve, which no file holds.
std::vector<std::string> losses_of_bal(const Reconstruction& reconstruction);
std::vector<std::string> losses_of_colmap(const Reconstruction& reconstruction);
std::vector<std::string> losses_of_bundler(const Reconstruction& reconstruction);
std::vector<std::string> losses_of_nvm(const Reconstruction& reconstruction);
std::vector<std::string> losses_of_openmvg(const Reconstruction& reconstruction);
std::vector<std::string> losses_of_opensfm(const Reconstruction& reconstruction);

}  // namespace clba
