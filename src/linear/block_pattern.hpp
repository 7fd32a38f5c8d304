// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

namespace clba {

// The lower triangle of a symmetric matrix of blocks, by block rows.
struct BlockPattern {
    std::vector<int32_t> block_size;  // rows (and columns) of each diagonal block, >= 1
    std::vector<int64_t> row_begin;   // num_blocks + 1: where each block row's entries begin
    std::vector<int32_t> columns;     // of the entries, ascending in a row, which ends with its own

    int32_t num_blocks() const { return static_cast<int32_t>(block_size.size()); }
};

// Throws an invalid_argument error where one of the rules above is broken.
void check_pattern(const BlockPattern& pattern);

}  // namespace clba
