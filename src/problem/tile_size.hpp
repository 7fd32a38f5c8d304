// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/point_order.hpp"

namespace clba {

struct TileSizeLimits {
    int32_t max_points = 0;
    int32_t compute_units = 1;
    int32_t lanes = 16;
};

// The number of points a tile with which a kernel over observations is likely to take least time.
//
// Kernels pass over the slots of each run, which are padded to `lanes`, and for each run read the
// image's data and write its sums, which takes as long as 25 slots; a tile by itself takes as long
// as 250. Larger tiles have fewer and longer runs. T equal tiles on U compute units keep the last
// unit waiting half a tile on average, and units idle if T < U:
//     time ~ (slots + 25 runs + 250 T) max(U / T, 1 + U / (2 T)).
// Tried are T_0, 2 T_0, 4 T_0, ... tiles, T_0 the smallest multiple of U with tiles of at most
// max_points; slots and runs are counted for all of these at once, and in problems of many tiles
// only in a sample of the largest tiles.
int32_t best_tile_size(const Visibility& visibility, const std::vector<int32_t>& order,
                       int32_t num_images, const TileSizeLimits& limits);

}  // namespace clba
