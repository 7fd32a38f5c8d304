// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "problem/problem.hpp"

namespace clba {

// What is left between two states of a problem after b is aligned to a; units of a.
struct Comparison {
    double scale = 1;  // of the similarity that takes b to a
    double max_center_distance = 0, median_center_distance = 0;  // of camera centres
    double max_point_distance = 0, median_point_distance = 0;
    double extent = 0;  // root mean square distance of a's centres from their mean
};

// Aligns b to a by the similarity that fits the camera centres best (Umeyama 1991). Centres that do
// not fix a similarity (fewer than three, or nearly on a line in a or b) are joined by the points.
// Rows correspond by index, so both need as many images and as many points as each other.
Comparison compare(const Problem& a, const Problem& b);

}  // namespace clba
