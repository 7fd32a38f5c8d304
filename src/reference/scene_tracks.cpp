// SPDX-License-Identifier: Apache-2.0
#include "reference/scene_tracks.hpp"

#include <algorithm>
#include <utility>

namespace clba::scene {
namespace {

class TrackMaker {
public:
    TrackMaker(const Place& place, const std::vector<View>& views, Random& random)
        : place_(place), views_(views), random_(random), last_draw_(views.size(), 0) {}

    Tracks make(int64_t num_points, double mean_length) {
        const auto num_images = static_cast<int64_t>(views_.size());
        Tracks tracks;
        tracks.points.reserve(static_cast<size_t>(num_points));
        tracks.anchors.reserve(static_cast<size_t>(num_points));
        tracks.begin.reserve(static_cast<size_t>(num_points) + 1);
        tracks.images.reserve(static_cast<size_t>(1.05 * mean_length * num_points));
        for (int64_t p = 0; p < num_points; ++p) {
            const auto anchor = static_cast<int32_t>(p * num_images / num_points);
            SurfacePoint point;
            // Tracks that end at the limits of what can be seen are made up for by later ones.
            const double missing =
                mean_length * static_cast<double>(p) - static_cast<double>(tracks.images.size());
            const double aim = mean_length + missing / 200;
            if (!draw(anchor, std::clamp(aim, 2.0, 2 * mean_length), point)) continue;
            tracks.points.push_back(point);
            tracks.anchors.push_back(anchor);
            tracks.images.insert(tracks.images.end(), track_.begin(), track_.end());
            tracks.begin.push_back(static_cast<int64_t>(tracks.images.size()));
        }
        return fill_up(std::move(tracks));
    }

private:
    // A point that the anchor sees, with its track; false if no try met two images.
    bool draw(int32_t anchor, double mean_length, SurfacePoint& point) {
        constexpr int most_tries = 100;
        for (int i = 0; i < most_tries; ++i) {
            if (!place_.draw_point(anchor, views_[anchor], random_, point)) continue;
            if (!views_[anchor].sees(point)) continue;
            const int64_t length =
                std::min<int64_t>(2 + random_.geometric(mean_length - 2), views_.size());
            track_.assign(1, anchor);
            last_draw_[anchor] = ++draw_;
            for (int64_t left = 8 * length + 16;
                 left > 0 && static_cast<int64_t>(track_.size()) < length; --left) {
                const int32_t image = place_.draw_neighbour(anchor, random_);
                if (last_draw_[image] == draw_ || !views_[image].sees(point)) continue;
                last_draw_[image] = draw_;
                track_.push_back(image);
            }
            std::sort(track_.begin(), track_.end());
            if (track_.size() >= 2) return true;
        }
        return false;
    }

    // Lengthens tracks by the images that have too few observations.
    Tracks fill_up(Tracks tracks) {
        std::vector<int32_t> counts(views_.size());
        for (int32_t image : tracks.images) ++counts[image];
        std::vector<std::pair<int32_t, int32_t>> added;  // point, image
        for (int32_t image = 0; image < static_cast<int32_t>(views_.size()); ++image)
            if (counts[image] < least_observations)
                add_observations(tracks, image, least_observations - counts[image], added);
        if (added.empty()) return tracks;
        std::sort(added.begin(), added.end());

        Tracks filled;
        auto next = added.begin();
        for (int32_t p = 0; p < tracks.num_points(); ++p) {
            track_.assign(tracks.images.begin() + tracks.begin[p],
                          tracks.images.begin() + tracks.begin[p + 1]);
            for (; next != added.end() && next->first == p; ++next) track_.push_back(next->second);
            std::sort(track_.begin(), track_.end());
            filled.images.insert(filled.images.end(), track_.begin(), track_.end());
            filled.begin.push_back(static_cast<int64_t>(filled.images.size()));
        }
        filled.points = std::move(tracks.points);
        filled.anchors = std::move(tracks.anchors);
        return filled;
    }

    void add_observations(const Tracks& tracks, int32_t image, int missing,
                          std::vector<std::pair<int32_t, int32_t>>& added) {
        constexpr int most_tries = 1000;
        std::vector<int32_t> own;
        for (int i = 0; i < most_tries && static_cast<int>(own.size()) < missing; ++i) {
            const int32_t anchor = place_.draw_neighbour(image, random_);
            const auto [first, last] =
                std::equal_range(tracks.anchors.begin(), tracks.anchors.end(), anchor);
            if (first == last) continue;
            const auto p = static_cast<int32_t>(first - tracks.anchors.begin()) +
                           random_.below(static_cast<int32_t>(last - first));
            const bool is_observed =
                std::binary_search(tracks.images.begin() + tracks.begin[p],
                                   tracks.images.begin() + tracks.begin[p + 1], image) ||
                std::find(own.begin(), own.end(), p) != own.end();
            if (is_observed || !views_[image].sees(tracks.points[p])) continue;
            own.push_back(p);
            added.emplace_back(p, image);
        }
    }

    const Place& place_;
    const std::vector<View>& views_;
    Random& random_;
    std::vector<int32_t> track_;
    int64_t draw_ = 0;
    std::vector<int64_t> last_draw_;  // the last draw that put the image into its track
};

}  // namespace

Tracks make_tracks(const Place& place, const std::vector<View>& views, int64_t num_points,
                   double mean_length, Random& random) {
    return TrackMaker(place, views, random).make(num_points, mean_length);
}

}  // namespace clba::scene
