// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "linear/block_pattern.hpp"

namespace clba {

// The graph of a block pattern: blocks that share an entry off the diagonal.
struct BlockGraph {
    std::vector<int32_t> weight;  // block sizes
    std::vector<int64_t> begin;   // num_blocks + 1
    std::vector<int32_t> neighbours;

    int32_t num_blocks() const { return static_cast<int32_t>(weight.size()); }
};
BlockGraph make_graph(const BlockPattern& pattern);

// The elimination tree of an order of the blocks; all is by position in that order.
struct EliminationTree {
    std::vector<int32_t> parent;      // -1: a root
    std::vector<int32_t> num_below;   // blocks below the diagonal in the factor's column
    std::vector<int64_t> rows_below;  // the same in rows of the matrix
    std::vector<double> flops;        // to eliminate the block
};
// order[position] = block.
EliminationTree make_tree(const BlockGraph& graph, const std::vector<int32_t>& order);

// Multiplications and additions to eliminate p columns of a dense symmetric matrix of p + u rows.
double elimination_flops(double p, double u);

// Nodes of a forest, children (numbered below their parents) before parents, subtrees contiguous.
std::vector<int32_t> postorder(const std::vector<int32_t>& parent);
std::vector<int32_t> inverse_permutation(const std::vector<int32_t>& order);

// How several threads share a forest: first disjoint subtrees, each by one thread, then what is
// above them, node after node, with the threads inside a node where it is large.
struct TreeSplit {
    std::vector<int32_t> subtree_roots;  // the costliest first
    double time = 0;                     // estimate, in the unit of cost for one thread
};
// Of the splits that come from opening the costliest subtree again and again, the fastest.
TreeSplit split_tree(const std::vector<int32_t>& parent, const std::vector<double>& flops,
                     int num_threads);

}  // namespace clba
