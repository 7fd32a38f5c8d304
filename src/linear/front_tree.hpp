// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "linear/dense_kernels.hpp"
#include "linear/elimination_tree.hpp"

namespace clba {

// A dense matrix of the multifrontal method (Duff and Reid 1983): num_pivots columns to eliminate
// at once and the rows below them that these reach.
struct Front {
    int32_t parent = -1;      // -1: a root
    int32_t first_block = 0;  // pivots: positions [first_block, end_block) of the order
    int32_t end_block = 0;
    std::vector<int32_t> blocks_below;      // positions, ascending
    int64_t num_pivots = 0, num_below = 0;  // rows of the matrix
    std::vector<int32_t> children;          // ascending
    std::vector<ScatterRun> runs;           // where the rows below are in the parent's front

    int64_t num_rows() const { return num_pivots + num_below; }
    double flops() const {
        return elimination_flops(static_cast<double>(num_pivots), static_cast<double>(num_below));
    }
};

struct FrontTree {
    std::vector<int32_t> order;      // position -> block
    std::vector<int64_t> row_begin;  // of each position in the reordered matrix; num_blocks + 1
    std::vector<Front> fronts;       // children before parents, subtrees contiguous
};

// The fronts of the order, small ones joined with their parents where the zeros that this stores
// cost less than a front's overhead.
FrontTree make_fronts(const BlockGraph& graph, const std::vector<int32_t>& order);

// Row of the front's matrix where a position's block begins; the front must hold the position.
int64_t row_in_front(const FrontTree& tree, const Front& front,
                     const std::vector<int64_t>& begin_below, int32_t position);
// Row of the front's matrix where each of its blocks below begins.
std::vector<int64_t> rows_of_blocks_below(const FrontTree& tree, const Front& front);

}  // namespace clba
