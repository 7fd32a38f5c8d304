// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// New row of each old one, -1 if it is gone.
struct RowMaps {
    std::vector<int64_t> observations;
    std::vector<int32_t> points;
};

// Removes the observations i with goes[i] != 0 and, if removes_points, the points that then have no
// observation; all that belongs to a row goes with it, and the order of the rest stays. An
// exception leaves the problem as it was.
RowMaps remove_observations(Problem& problem, const std::vector<uint8_t>& goes,
                            bool removes_points);

}  // namespace clba
