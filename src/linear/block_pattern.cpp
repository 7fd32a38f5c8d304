// SPDX-License-Identifier: Apache-2.0
#include "linear/block_pattern.hpp"

#include "base/error.hpp"

namespace clba {

void check_pattern(const BlockPattern& pattern) {
    const int32_t num_blocks = pattern.num_blocks();
    require(pattern.row_begin.size() == pattern.block_size.size() + 1, "row_begin has ",
            pattern.row_begin.size(), " entries, but num_blocks + 1 = ", num_blocks + 1);
    require(pattern.row_begin.front() == 0, "row_begin[0] = ", pattern.row_begin.front(),
            ", but it must be 0");
    for (int32_t row = 0; row < num_blocks; ++row) {
        require(pattern.block_size[row] >= 1, "block_size[", row, "] = ", pattern.block_size[row],
                ", but it must be >= 1");
        const int64_t begin = pattern.row_begin[row], end = pattern.row_begin[row + 1];
        require(begin < end && end <= static_cast<int64_t>(pattern.columns.size()), "row_begin[",
                row + 1, "] = ", end, " must be > ", begin, " and <= the ", pattern.columns.size(),
                " columns: each row has its diagonal block");
        require(pattern.columns[begin] >= 0 && pattern.columns[end - 1] == row, "block row ", row,
                " begins with column ", pattern.columns[begin], " and ends with ",
                pattern.columns[end - 1], ", but columns are >= 0 and the last is the diagonal");
        for (int64_t k = begin + 1; k < end; ++k)
            require(pattern.columns[k - 1] < pattern.columns[k], "columns[", k,
                    "] = ", pattern.columns[k], " must be above the one before it in its row, ",
                    pattern.columns[k - 1]);
    }
    require(pattern.row_begin.back() == static_cast<int64_t>(pattern.columns.size()),
            "row_begin ends with ", pattern.row_begin.back(), ", but there are ",
            pattern.columns.size(), " columns");
}

}  // namespace clba
