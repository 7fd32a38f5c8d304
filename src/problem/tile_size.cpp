// SPDX-License-Identifier: Apache-2.0
#include "problem/tile_size.hpp"

#include <algorithm>

#include "base/parallel.hpp"

namespace clba {
namespace {

constexpr double slots_per_run = 25, slots_per_tile = 250;
constexpr int max_levels = 7;             // sizes tried, each half of the one before
constexpr int32_t smallest_tile = 16;     // points
constexpr int64_t max_sampled_tiles = 8;  // of the largest size

struct Counts {
    int64_t num_runs = 0, num_slots = 0;
};

// Counts runs and slots of tiles of `finest` points, of pairs of these, of pairs of pairs, ...
class Counter {
public:
    Counter(int32_t num_images, int num_levels, int32_t lanes)
        : lanes_(lanes), levels_(static_cast<size_t>(num_levels)) {
        for (Level& level : levels_) level.count.assign(static_cast<size_t>(num_images), 0);
    }

    // A tile of the largest size.
    void count(const Visibility& visibility, const int32_t* first, const int32_t* last,
               int32_t finest) {
        const auto num_levels = static_cast<int>(levels_.size());
        for (int64_t tile = 1; first != last; ++tile) {
            const int32_t* end = first + std::min<int64_t>(finest, last - first);
            for (; first != end; ++first)
                for (const Sight& sight : visibility.of_point(*first))
                    levels_[0].add(sight.image, 1);
            for (int k = 0; k < num_levels; ++k) {
                close(k);
                if (first != last && tile % (int64_t{2} << k) != 0) break;
            }
        }
    }
    const Counts& counts(int level) const { return levels_[level].counts; }

private:
    struct Level {
        std::vector<int32_t> count;  // of each image in the open tile
        std::vector<int32_t> seen_by;
        Counts counts;
        void add(int32_t image, int32_t number) {
            if (count[image] == 0) seen_by.push_back(image);
            count[image] += number;
        }
    };

    void close(int k) {
        Level& level = levels_[k];
        level.counts.num_runs += static_cast<int64_t>(level.seen_by.size());
        for (const int32_t image : level.seen_by) {
            const int32_t count = level.count[image];
            level.counts.num_slots += (count + lanes_ - 1) / lanes_ * lanes_;
            if (k + 1 < static_cast<int>(levels_.size())) levels_[k + 1].add(image, count);
            level.count[image] = 0;
        }
        level.seen_by.clear();
    }

    int32_t lanes_;
    std::vector<Level> levels_;
};

}  // namespace

int32_t best_tile_size(const Visibility& visibility, const std::vector<int32_t>& order,
                       int32_t num_images, const TileSizeLimits& limits) {
    const auto num_points = static_cast<int64_t>(order.size());
    const int64_t units = std::max(limits.compute_units, 1);
    const int64_t rounds = std::max<int64_t>(
        (num_points + limits.max_points * units - 1) / (limits.max_points * units), 1);
    const int64_t share =
        std::max<int64_t>((num_points + rounds * units - 1) / (rounds * units), 1);
    int num_levels = 1;
    while (num_levels < max_levels && share >> num_levels >= smallest_tile) ++num_levels;
    const int coarsest = num_levels - 1;
    const auto finest = static_cast<int32_t>(
        std::min<int64_t>(((share - 1) >> coarsest) + 1, limits.max_points >> coarsest));
    const int64_t largest = int64_t{finest} << coarsest;

    const int64_t num_largest = (num_points + largest - 1) / largest;
    const int64_t num_sampled = std::min(num_largest, max_sampled_tiles);
    std::vector<std::unique_ptr<Counter>> counters(static_cast<size_t>(num_workers()));
    parallel_for(num_sampled, [&](int64_t sample, int worker) {
        std::unique_ptr<Counter>& counter = counters[worker];
        if (!counter) counter = std::make_unique<Counter>(num_images, num_levels, limits.lanes);
        const int64_t first = largest * (sample * num_largest / num_sampled);
        counter->count(visibility, order.data() + first,
                       order.data() + std::min(first + largest, num_points), finest);
    });

    int32_t best = 1;
    double best_time = 0;
    for (int k = coarsest; k >= 0; --k) {
        double sampled = 0;
        for (const std::unique_ptr<Counter>& counter : counters) {
            if (!counter) continue;
            const Counts& counts = counter->counts(k);
            sampled += static_cast<double>(counts.num_slots) +
                       slots_per_run * static_cast<double>(counts.num_runs);
        }
        const int64_t size = int64_t{finest} << k;
        const auto num_tiles = static_cast<double>((num_points + size - 1) / size);
        const double unit_share = static_cast<double>(units) / num_tiles;
        const double work =
            sampled * static_cast<double>(num_largest) / static_cast<double>(num_sampled) +
            slots_per_tile * num_tiles;
        const double time = work * std::max(unit_share, 1 + unit_share / 2);
        if (k == coarsest || time < best_time) {
            best = static_cast<int32_t>(size);
            best_time = time;
        }
    }
    return best;
}

}  // namespace clba
