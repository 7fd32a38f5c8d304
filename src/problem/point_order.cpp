// SPDX-License-Identifier: Apache-2.0
#include "problem/point_order.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/error.hpp"
#include "problem/counting_sort.hpp"

namespace clba {
namespace {

struct RankRange {
    int32_t lowest, highest;  // number of images and -1 where there is none
};

RankRange rank_range(const Visibility::Sights& sights, const std::vector<int32_t>& image_rank) {
    RankRange range{static_cast<int32_t>(image_rank.size()), -1};
    for (const Sight& sight : sights) {
        range.lowest = std::min(range.lowest, image_rank[sight.image]);
        range.highest = std::max(range.highest, image_rank[sight.image]);
    }
    return range;
}

// The graph of images and sampled points (tracks).
class CovisibilitySearch {
public:
    CovisibilitySearch(const Visibility& visibility, int32_t num_images)
        : visibility_(visibility),
          image_mark_(static_cast<size_t>(num_images), 0),
          shared_(static_cast<size_t>(num_images), 0) {
        constexpr int64_t sights_per_image = 16;
        stride_ = std::max<int64_t>(
            visibility.num_sights() / (sights_per_image * std::max(num_images, 1)), 1);
        num_tracks_ = static_cast<int32_t>((visibility.num_points() + stride_ - 1) / stride_);
        track_mark_.assign(static_cast<size_t>(num_tracks_), 0);
        first_track_.assign(static_cast<size_t>(num_images) + 1, 0);
        for_each_sight([&](int32_t, int32_t image) { ++first_track_[image + 1]; });
        std::partial_sum(first_track_.begin(), first_track_.end(), first_track_.begin());
        tracks_.resize(static_cast<size_t>(first_track_.back()));
        std::vector<int32_t> next(first_track_.begin(), first_track_.end() - 1);
        for_each_sight([&](int32_t track, int32_t image) { tracks_[next[image]++] = track; });
    }

    // Appends the images that can be reached from `first` to `reached`, nearest first. mark tells
    // one search from those before.
    void search(int32_t first, uint8_t mark, std::vector<int32_t>& reached) {
        size_t next = reached.size();
        image_mark_[first] = mark;
        reached.push_back(first);
        for (; next < reached.size(); ++next) {
            const int32_t image = reached[next];
            const size_t first_new = reached.size();
            for (int32_t k = first_track_[image]; k < first_track_[image + 1]; ++k) {
                const int32_t track = tracks_[k];
                if (track_mark_[track] == mark) continue;  // all its images are reached
                track_mark_[track] = mark;
                for (const Sight& sight : sights_of(track)) {
                    if (image_mark_[sight.image] == mark && shared_[sight.image] == 0) continue;
                    image_mark_[sight.image] = mark;
                    if (shared_[sight.image]++ == 0) reached.push_back(sight.image);
                }
            }
            const auto begin = reached.begin() + static_cast<int64_t>(first_new);
            std::sort(begin, reached.end(), [&](int32_t a, int32_t b) {
                return shared_[a] != shared_[b] ? shared_[a] > shared_[b] : a < b;
            });
            for (auto found = begin; found != reached.end(); ++found) shared_[*found] = 0;
        }
    }
    uint8_t mark_of(int32_t image) const { return image_mark_[image]; }

    // Mean logarithm of how many ranks the images of a track span.
    double mean_span(const std::vector<int32_t>& rank) const {
        double sum = 0;
        for (int32_t track = 0; track < num_tracks_; ++track) {
            const RankRange range = rank_range(sights_of(track), rank);
            if (range.highest >= 0) sum += std::log(1 + range.highest - range.lowest);
        }
        return sum / std::max(num_tracks_, 1);
    }

private:
    Visibility::Sights sights_of(int32_t track) const {
        return visibility_.of_point(static_cast<int32_t>(track * stride_));
    }
    template <class Visit>
    void for_each_sight(Visit&& visit) const {
        for (int32_t track = 0; track < num_tracks_; ++track)
            for (const Sight& sight : sights_of(track)) visit(track, sight.image);
    }

    const Visibility& visibility_;
    int64_t stride_ = 1;  // of the sampled points
    int32_t num_tracks_ = 0;
    std::vector<int32_t> first_track_, tracks_;  // of each image
    std::vector<uint8_t> track_mark_, image_mark_;
    std::vector<int32_t> shared_;  // points shared with the image at work; 0 if not found from it
};

}  // namespace

int64_t require_countable(const Problem& problem) {
    constexpr int64_t most = std::numeric_limits<int32_t>::max();
    require(problem.num_observations() <= most, "there are ", problem.num_observations(),
            " observations, but a problem on a device has at most ", most);
    return problem.num_observations();
}

Visibility::Visibility(const Problem& problem)
    : sights_(new Sight[static_cast<size_t>(require_countable(problem))]),
      begin_(counting_sort(
          problem.num_observations(), problem.num_points(),
          [&](int64_t i) { return problem.observations[i].point; },
          [&](int64_t i, int32_t position) {
              sights_[position] = {problem.observations[i].image, static_cast<int32_t>(i)};
          })) {}

std::vector<int32_t> image_ranks(const Visibility& visibility, int32_t num_images) {
    constexpr uint8_t explored = 1, ranked = 2;
    CovisibilitySearch search(visibility, num_images);
    std::vector<int32_t> order, component;
    order.reserve(static_cast<size_t>(num_images));
    for (int32_t image = 0; image < num_images; ++image) {
        if (search.mark_of(image) == ranked) continue;
        component.clear();
        search.search(image, explored, component);
        search.search(component.back(), ranked, order);
    }
    std::vector<int32_t> rank(static_cast<size_t>(num_images)), given(rank.size());
    for (int32_t i = 0; i < num_images; ++i) rank[order[i]] = i;
    std::iota(given.begin(), given.end(), 0);
    return search.mean_span(rank) < search.mean_span(given) ? rank : given;
}

std::vector<int32_t> ordered_points(const Visibility& visibility,
                                    const std::vector<int32_t>& image_rank) {
    constexpr int64_t grain = 1 << 13;
    const auto num_points = visibility.num_points();
    const auto num_images = static_cast<int32_t>(image_rank.size());
    const std::unique_ptr<RankRange[]> ranges(new RankRange[static_cast<size_t>(num_points)]);
    parallel_ranges(num_points, grain, [&](int64_t begin, int64_t end) {
        for (int64_t p = begin; p < end; ++p)
            ranges[p] = rank_range(visibility.of_point(static_cast<int32_t>(p)), image_rank);
    });
    std::vector<int32_t> by_highest(static_cast<size_t>(num_points));
    counting_sort(
        num_points, num_images + 1, [&](int64_t p) { return ranges[p].highest + 1; },
        [&](int64_t p, int32_t position) { by_highest[position] = static_cast<int32_t>(p); });
    std::vector<int32_t> order(static_cast<size_t>(num_points));
    counting_sort(
        num_points, num_images + 1, [&](int64_t i) { return ranges[by_highest[i]].lowest; },
        [&](int64_t i, int32_t position) { order[position] = by_highest[i]; });
    return order;
}

}  // namespace clba
