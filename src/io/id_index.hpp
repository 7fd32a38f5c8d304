// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

namespace clba {

// Rows by their ids, which are mostly small and close to each other, but need not be.
class IdIndex {
public:
    template <class IdOf>
    IdIndex(size_t count, const IdOf& id_of) {
        uint64_t largest = 0;
        for (size_t i = 0; i < count; ++i) largest = std::max<uint64_t>(largest, id_of(i));
        if (largest < 8 * uint64_t{count} + 1024) {
            dense_.assign(count ? largest + 1 : 0, -1);
            for (size_t i = 0; i < count; ++i)
                if (std::exchange(dense_[id_of(i)], static_cast<int32_t>(i)) >= 0)
                    duplicate_ = id_of(i);
        } else {
            for (size_t i = 0; i < count; ++i)
                sorted_.emplace_back(id_of(i), static_cast<int32_t>(i));
            std::sort(sorted_.begin(), sorted_.end());
            for (size_t i = 1; i < count; ++i)
                if (sorted_[i].first == sorted_[i - 1].first) duplicate_ = sorted_[i].first;
        }
    }
    // -1: none.
    int32_t row(uint64_t id) const {
        if (sorted_.empty()) return id < dense_.size() ? dense_[id] : -1;
        const auto found = std::lower_bound(sorted_.begin(), sorted_.end(), std::pair(id, 0));
        return found != sorted_.end() && found->first == id ? found->second : -1;
    }
    // An id that more than one row has.
    const std::optional<uint64_t>& duplicate() const { return duplicate_; }

private:
    std::vector<int32_t> dense_;
    std::vector<std::pair<uint64_t, int32_t>> sorted_;
    std::optional<uint64_t> duplicate_;
};

}  // namespace clba
