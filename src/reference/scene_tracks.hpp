// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "reference/scene_places.hpp"

namespace clba::scene {

constexpr int least_observations = 8;  // of an image

// The images of point p are images[begin[p]] to images[begin[p + 1] - 1], ascending.
struct Tracks {
    std::vector<SurfacePoint> points;
    std::vector<int32_t> anchors;  // the image that each point was drawn in, ascending
    std::vector<int64_t> begin{0};
    std::vector<int32_t> images;
    int32_t num_points() const { return static_cast<int32_t>(points.size()); }
};

// About num_points points of the place's surface, drawn evenly from the views, with tracks of
// mean_length images on average where so many see them.
Tracks make_tracks(const Place& place, const std::vector<View>& views, int64_t num_points,
                   double mean_length, Random& random);

}  // namespace clba::scene
