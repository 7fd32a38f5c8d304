// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "linear/elimination_tree.hpp"

namespace clba {

// order[position] = block. The order as given, minimum degree, and nested dissection with minimum
// degree in the parts are tried; the one that num_threads threads eliminate in the least time wins.
std::vector<int32_t> elimination_order(const BlockGraph& graph, int num_threads);

}  // namespace clba
