// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "problem/problem.hpp"

namespace clba {

// The number of observations; throws where it is beyond 32 bits.
int64_t require_countable(const Problem& problem);

// An observation of a point: who sees it, and the caller's row.
struct Sight {
    int32_t image;
    int32_t observation;
};

// The sights of each point, in the caller's order.
class Visibility {
public:
    explicit Visibility(const Problem& problem);

    struct Sights {
        const Sight *first, *last;
        const Sight* begin() const { return first; }
        const Sight* end() const { return last; }
    };
    Sights of_point(int32_t point) const {
        return {sights_.get() + begin_[point], sights_.get() + begin_[point + 1]};
    }
    int32_t num_points() const { return static_cast<int32_t>(begin_.size()) - 1; }
    int64_t num_sights() const { return begin_.back(); }

private:
    std::unique_ptr<Sight[]> sights_;
    std::vector<int32_t> begin_;
};

// A rank for each image, so that images which see the same points have ranks close together: the
// caller's order, or if it keeps the images of a point less close, as in unordered collections, the
// breadth-first order of the graph in which images and points are joined by observations. It starts
// at an end of each component (where a search from its first image arrives last), and among the
// images found from one image those come first that share more points with it (Cuthill and McKee).
// A sample of the points, 16 observations an image, is enough.
std::vector<int32_t> image_ranks(const Visibility& visibility, int32_t num_images);

// Points by the lowest, then by the highest rank of the images that see them, equal ones in the
// caller's order; those that no image sees come last. Points next to each other are seen by the
// same images.
std::vector<int32_t> ordered_points(const Visibility& visibility,
                                    const std::vector<int32_t>& image_rank);

}  // namespace clba
