// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "linear/block_pattern.hpp"
#include "problem/problem.hpp"
#include "problem/visibility_tiles.hpp"

namespace clba {

// Which images see points in common: the blocks of U - W V^-1 W^T, an image a block row, and for
// each chunk the pairs of observations that add to each block.
struct SchurStructure {
    SchurStructure(const Problem& problem, const VisibilityTiles& tiles);

    // Pairs (a, b) of records: a by the image of the block's row, b by that of its column, of one
    // point. Records count the slots of a chunk, segment by segment.
    struct ChunkPairs {
        std::vector<int64_t> block_pairs;  // first pair of each block, and end
        std::vector<std::array<int32_t, 2>> pairs;
        std::vector<int32_t> first_record;  // of each segment
        int64_t num_records = 0;
    };

    // Block (i, j) with j <= i for each pair of images that see a point in common, and (i, i) for
    // all.
    std::vector<int64_t> row_begin;  // first block of each image's row, and end
    std::vector<int32_t> columns;    // ascending in a row
    std::vector<ChunkPairs> chunks;
    int64_t num_blocks() const { return static_cast<int64_t>(columns.size()); }
    int64_t num_pairs() const;
};

// The pairs that SchurStructure would hold: sum over the points of k (k - 1) / 2 + k for k
// observations, more where an image sees a point repeatedly.
int64_t count_pairs(const Problem& problem);

// Blocks of the reduced camera system: parameter blocks of the layout that meet in a block of
// pairs.
BlockPattern schur_pattern(const Problem& problem, const ParameterLayout& layout,
                           const SchurStructure& structure);

}  // namespace clba
