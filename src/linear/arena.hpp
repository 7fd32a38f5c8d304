// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <map>

namespace clba {

// Stride of columns that start on cache lines, and not all on the same set of the cache.
template <class Real>
int64_t padded(int64_t rows) {
    constexpr int64_t line = 64 / sizeof(Real), page = 4096 / sizeof(Real);
    const int64_t stride = (rows + line - 1) / line * line;
    return stride > 0 && stride % page == 0 ? stride + line : stride;
}

// Offsets of blocks of memory that come and go in an order known beforehand.
class Arena {
public:
    // The first gap that is wide enough.
    int64_t allocate(int64_t size) {
        int64_t begin = 0;
        for (const auto& [used, used_size] : used_) {
            if (begin + size <= used) break;
            begin = used + used_size;
        }
        if (size > 0) used_[begin] = size;
        size_ = std::max(size_, begin + size);
        return begin;
    }
    void release(int64_t begin) { used_.erase(begin); }
    int64_t size() const { return size_; }

private:
    std::map<int64_t, int64_t> used_;  // begin -> size
    int64_t size_ = 0;
};

}  // namespace clba
