// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

// Small files of each format that its reader accepts, together with all that the format allows.
namespace clba::test {

std::vector<std::string> bal_seeds();
std::vector<std::string> bundler_seeds();
std::vector<std::string> nvm_seeds();
std::vector<std::string> openmvg_seeds();
std::vector<std::string> opensfm_seeds();
std::vector<std::string> colmap_text_seeds();
std::vector<std::string> colmap_binary_seeds();

}  // namespace clba::test
