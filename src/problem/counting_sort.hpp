// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "base/parallel.hpp"

namespace clba {

// Stable sort by key in parallel: key(i), below num_keys, of each of at most 2^31 - 1 items, then
// place(i, position) for each. Returns the first position of each key, and the end.
template <class Key, class Place>
std::vector<int32_t> counting_sort(int64_t num_items, int64_t num_keys, Key&& key, Place&& place) {
    constexpr int64_t grain = 1 << 14;
    // A part of the items has counts of its own for all keys.
    const int64_t num_parts = std::clamp<int64_t>(num_items / std::max(num_keys, grain), 1,
                                                  static_cast<int64_t>(num_workers()));
    std::vector<int32_t> next(static_cast<size_t>(num_parts * num_keys), 0);
    const auto for_part_items = [&](auto&& visit) {
        parallel_for(num_parts, [&](int64_t part, int) {
            int32_t* of_part = next.data() + part * num_keys;
            const int64_t end = num_items * (part + 1) / num_parts;
            for (int64_t i = num_items * part / num_parts; i < end; ++i) visit(i, of_part[key(i)]);
        });
    };
    for_part_items([](int64_t, int32_t& count) { ++count; });
    std::vector<int32_t> begin(static_cast<size_t>(num_keys + 1));
    int32_t position = 0;
    for (int64_t k = 0; k < num_keys; ++k) {
        begin[k] = position;
        for (int64_t part = 0; part < num_parts; ++part) {
            int32_t& count = next[part * num_keys + k];
            const int32_t first = position;
            position += count;
            count = first;
        }
    }
    begin[num_keys] = position;
    for_part_items([&](int64_t i, int32_t& slot) { place(i, slot++); });
    return begin;
}

}  // namespace clba
