// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "linear/block_pattern.hpp"
#include "problem/problem.hpp"
#include "problem/visibility_tiles.hpp"

namespace clba {

// How many tiles make a slice: at least so many, and so many more as bring it to num_records.
struct SliceSize {
    int32_t num_tiles = 1;
    int64_t num_records = 0;
};

// Which images see points in common or have a prior of their relative pose: the blocks of
// U - W V^-1 W^T, an image a block row, and the pairs of observations that add to each block, slice
// by slice.
class SchurStructure {
public:
    SchurStructure(const Problem& problem, const VisibilityTiles& tiles, const SliceSize& size);

    // Block (i, j) with j <= i for each such pair of images, and (i, i) for all.
    std::vector<int64_t> row_begin;  // first block of each image's row, and end
    std::vector<int32_t> columns;    // ascending in a row
    int64_t num_blocks() const { return static_cast<int64_t>(columns.size()); }

    // A range of tiles of a chunk. The record of a slot of segment s is first_record[s] + slot.
    struct Slice {
        int32_t chunk = 0, first_tile = 0, num_tiles = 0;
        std::vector<int32_t> first_record;
        int64_t num_records = 0;
    };
    const std::vector<Slice>& slices() const { return slices_; }

    // Pairs (a, b) of a slice's records: a by the image of the block's row, b by that of its
    // column, of one point.
    struct Pairs {
        std::vector<int32_t> blocks;       // that the slice adds to, ascending
        std::vector<int64_t> block_pairs;  // first pair of each, and end
        std::vector<std::array<int32_t, 2>> pairs;
    };
    Pairs list_pairs(size_t slice) const;
    // Frees what list_pairs needs.
    void forget_pairs() { sights_ = {}; }

private:
    // The observations of a slice, by image and by point.
    struct Sights {
        Sights(const Chunk& chunk, const Slice& slice, int32_t num_images);
        template <class Visit>
        void for_each_pair(int32_t image, Visit&& visit) const;

        std::vector<int64_t> image_begin, point_begin;
        struct OfImage {
            int32_t point, record;
        };
        struct OfPoint {
            int32_t image, record;
        };
        std::vector<OfImage> of_image;
        std::vector<OfPoint> of_point;  // by ascending record
    };
    void make_slices(const VisibilityTiles& tiles, const SliceSize& size);
    template <class Visit>
    void for_each_row(Visit&& visit) const;

    int32_t num_images_;
    std::vector<Slice> slices_;
    std::vector<Sights> sights_;  // of each slice
};

// The pairs that SchurStructure would list: sum over the points of k (k - 1) / 2 + k for k
// observations, more where an image sees a point repeatedly.
int64_t count_pairs(const Problem& problem);

// Blocks of the reduced camera system: parameter blocks of the layout that meet in a block of
// pairs.
BlockPattern schur_pattern(const Problem& problem, const ParameterLayout& layout,
                           const SchurStructure& structure);

}  // namespace clba
