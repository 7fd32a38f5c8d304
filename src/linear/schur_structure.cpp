// SPDX-License-Identifier: Apache-2.0
#include "linear/schur_structure.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <numeric>

#include "base/error.hpp"
#include "base/parallel.hpp"

namespace clba {
namespace {

constexpr int64_t images_per_task = 16;

// visit(image, point slot, record) for the observations of a slice. Point slots are counted from
// the slice's first.
template <class Visit>
void for_each_sight(const Chunk& chunk, const SchurStructure::Slice& slice, Visit&& visit) {
    const int32_t first_point = chunk.tile_points[slice.first_tile];
    for (size_t s = 0; s < chunk.segments.size(); ++s) {
        const Segment& segment = chunk.segments[s];
        for (int32_t tile = slice.first_tile; tile < slice.first_tile + slice.num_tiles; ++tile) {
            for (int32_t run = segment.tile_runs[tile]; run < segment.tile_runs[tile + 1]; ++run) {
                for (int32_t slot = segment.run_slots[run]; slot < segment.run_slots[run + 1];
                     ++slot) {
                    if (segment.slot_observation[slot] < 0) break;
                    visit(segment.run_image[run],
                          chunk.tile_points[tile] + segment.slot_point[slot] - first_point,
                          slice.first_record[s] + slot);
                }
            }
        }
    }
}

}  // namespace

SchurStructure::Sights::Sights(const Chunk& chunk, const Slice& slice, int32_t num_images) {
    const int32_t end_tile = slice.first_tile + slice.num_tiles;
    const int32_t end_point =
        end_tile < chunk.num_tiles() ? chunk.tile_points[end_tile] : chunk.num_point_slots;
    const auto num_points = static_cast<size_t>(end_point - chunk.tile_points[slice.first_tile]);
    image_begin.assign(static_cast<size_t>(num_images) + 1, 0);
    point_begin.assign(num_points + 1, 0);
    for_each_sight(chunk, slice, [&](int32_t image, int32_t point, int32_t) {
        ++image_begin[image + 1];
        ++point_begin[point + 1];
    });
    std::partial_sum(image_begin.begin(), image_begin.end(), image_begin.begin());
    std::partial_sum(point_begin.begin(), point_begin.end(), point_begin.begin());
    of_image.resize(static_cast<size_t>(image_begin.back()));
    of_point.resize(static_cast<size_t>(point_begin.back()));
    std::vector<int64_t> next_image(image_begin.begin(), image_begin.end() - 1);
    std::vector<int64_t> next_point(point_begin.begin(), point_begin.end() - 1);
    for_each_sight(chunk, slice, [&](int32_t image, int32_t point, int32_t record) {
        of_image[next_image[image]++] = {point, record};
        of_point[next_point[point]++] = {image, record};
    });
}

// visit(record a, image of b, record b) for the pairs of image i and images up to i.
template <class Visit>
void SchurStructure::Sights::for_each_pair(int32_t image, Visit&& visit) const {
    for (int64_t k = image_begin[image]; k < image_begin[image + 1]; ++k) {
        const OfImage& a = of_image[k];
        for (int64_t m = point_begin[a.point]; m < point_begin[a.point + 1]; ++m)
            if (of_point[m].image <= image) visit(a.record, of_point[m].image, of_point[m].record);
    }
}

void SchurStructure::make_slices(const VisibilityTiles& tiles, const SliceSize& size) {
    for (size_t c = 0; c < tiles.chunks.size(); ++c) {
        const Chunk& chunk = tiles.chunks[c];
        const auto first_slot = [&](const Segment& segment, int32_t tile) {
            return segment.run_slots[segment.tile_runs[tile]];
        };
        for (int32_t first = 0; first < chunk.num_tiles();) {
            const auto num_records = [&](int32_t end) {
                int64_t count = 0;
                for (const Segment& segment : chunk.segments)
                    count += first_slot(segment, end) - first_slot(segment, first);
                return count;
            };
            int32_t end = std::min(first + size.num_tiles, chunk.num_tiles());
            while (end < chunk.num_tiles() && num_records(end + 1) <= size.num_records) ++end;
            Slice slice;
            slice.chunk = static_cast<int32_t>(c);
            slice.first_tile = first;
            slice.num_tiles = end - first;
            for (const Segment& segment : chunk.segments) {
                slice.first_record.push_back(
                    static_cast<int32_t>(slice.num_records - first_slot(segment, first)));
                slice.num_records += first_slot(segment, end) - first_slot(segment, first);
                require(slice.num_records <= std::numeric_limits<int32_t>::max(),
                        "explicit_schur numbers observations of a slice by 31 bits; use pcg_schur");
            }
            slices_.push_back(std::move(slice));
            first = end;
        }
    }
}

// visit(image, numbers), in several threads; numbers: one of each image, 0 before and after.
template <class Visit>
void SchurStructure::for_each_row(Visit&& visit) const {
    std::vector<std::vector<int64_t>> numbers(static_cast<size_t>(num_workers()));
    const int64_t num_tasks = (num_images_ + images_per_task - 1) / images_per_task;
    parallel_for(num_tasks, [&](int64_t task, int worker) {
        std::vector<int64_t>& of_worker = numbers[static_cast<size_t>(worker)];
        of_worker.resize(static_cast<size_t>(num_images_), 0);
        const auto end = std::min<int64_t>(num_images_, (task + 1) * images_per_task);
        for (int64_t i = task * images_per_task; i < end; ++i)
            visit(static_cast<int32_t>(i), of_worker);
    });
}

SchurStructure::SchurStructure(const Problem& problem, const VisibilityTiles& tiles,
                               const SliceSize& size)
    : num_images_(problem.num_images()) {
    make_slices(tiles, size);
    std::vector<std::unique_ptr<Sights>> sights(slices_.size());
    parallel_for(static_cast<int64_t>(slices_.size()), [&](int64_t s, int) {
        sights[s] =
            std::make_unique<Sights>(tiles.chunks[slices_[s].chunk], slices_[s], num_images_);
    });
    for (const std::unique_ptr<Sights>& of_slice : sights) sights_.push_back(std::move(*of_slice));

    std::vector<std::vector<int32_t>> rows(static_cast<size_t>(num_images_));
    for_each_row([&](int32_t i, std::vector<int64_t>& is_seen) {
        std::vector<int32_t>& row = rows[i];
        is_seen[i] = 1;
        row.push_back(i);
        for (const Sights& of_slice : sights_)
            of_slice.for_each_pair(i, [&](int32_t, int32_t j, int32_t) {
                if (!is_seen[j]) row.push_back(j);
                is_seen[j] = 1;
            });
        for (int32_t j : row) is_seen[j] = 0;
        std::sort(row.begin(), row.end());
    });
    for (const RelativePosePrior& prior : problem.priors.relative_poses) {
        std::vector<int32_t>& row = rows[std::max(prior.first, prior.second)];
        const int32_t column = std::min(prior.first, prior.second);
        const auto at = std::lower_bound(row.begin(), row.end(), column);
        if (at == row.end() || *at != column) row.insert(at, column);
    }
    row_begin.assign(static_cast<size_t>(num_images_) + 1, 0);
    for (int32_t i = 0; i < num_images_; ++i)
        row_begin[i + 1] = row_begin[i] + static_cast<int64_t>(rows[i].size());
    require(row_begin.back() <= std::numeric_limits<int32_t>::max(),
            "explicit_schur numbers blocks by 31 bits; use pcg_schur");
    columns.resize(static_cast<size_t>(row_begin.back()));
    for (int32_t i = 0; i < num_images_; ++i)
        std::copy(rows[i].begin(), rows[i].end(), columns.begin() + row_begin[i]);
}

SchurStructure::Pairs SchurStructure::list_pairs(size_t slice) const {
    const Sights& sights = sights_[slice];
    struct Touched {
        int32_t block;
        int64_t num_pairs;
    };
    std::vector<std::vector<Touched>> rows(static_cast<size_t>(num_images_));
    for_each_row([&](int32_t i, std::vector<int64_t>& num_pairs) {
        if (sights.image_begin[i] == sights.image_begin[i + 1]) return;
        sights.for_each_pair(i, [&](int32_t, int32_t j, int32_t) { ++num_pairs[j]; });
        for (int64_t block = row_begin[i]; block < row_begin[i + 1]; ++block) {
            int64_t& of_block = num_pairs[columns[block]];
            if (of_block > 0) rows[i].push_back({static_cast<int32_t>(block), of_block});
            of_block = 0;
        }
    });
    Pairs list;
    std::vector<size_t> first_of_row;
    list.block_pairs.push_back(0);
    for (const std::vector<Touched>& row : rows) {
        first_of_row.push_back(list.blocks.size());
        for (const Touched& touched : row) {
            list.blocks.push_back(touched.block);
            list.block_pairs.push_back(list.block_pairs.back() + touched.num_pairs);
        }
    }
    list.pairs.resize(static_cast<size_t>(list.block_pairs.back()));
    for_each_row([&](int32_t i, std::vector<int64_t>& next) {
        for (size_t k = 0; k < rows[i].size(); ++k)
            next[columns[rows[i][k].block]] = list.block_pairs[first_of_row[i] + k];
        sights.for_each_pair(i, [&](int32_t a, int32_t j, int32_t b) {
            list.pairs[next[j]++] = {a, b};
        });
        for (const Touched& touched : rows[i]) next[columns[touched.block]] = 0;
    });
    return list;
}

int64_t count_pairs(const Problem& problem) {
    std::vector<int32_t> views(problem.points.size(), 0);
    int64_t count = 0;
    for (const Observation& observation : problem.observations) count += ++views[observation.point];
    return count;
}

BlockPattern schur_pattern(const Problem& problem, const ParameterLayout& layout,
                           const SchurStructure& structure) {
    const auto num_blocks = static_cast<int32_t>(layout.blocks.size());
    BlockPattern pattern;
    for (const ParameterBlock& block : layout.blocks) pattern.block_size.push_back(block.size);
    std::vector<std::vector<int32_t>> rows(static_cast<size_t>(num_blocks));
    for (int32_t b = 0; b < num_blocks; ++b) rows[b].push_back(b);
    ImagePart of_i[ParameterLayout::max_image_parts], of_j[ParameterLayout::max_image_parts];
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int num_of_i = layout.parts_of(i, problem.images[i].camera, of_i);
        for (int64_t k = structure.row_begin[i]; k < structure.row_begin[i + 1]; ++k) {
            const int32_t j = structure.columns[k];
            const int num_of_j = layout.parts_of(j, problem.images[j].camera, of_j);
            for (int a = 0; a < num_of_i; ++a)
                for (int b = 0; b < num_of_j; ++b)
                    if (of_i[a].block != of_j[b].block)
                        rows[std::max(of_i[a].block, of_j[b].block)].push_back(
                            std::min(of_i[a].block, of_j[b].block));
        }
    }
    pattern.row_begin.push_back(0);
    for (std::vector<int32_t>& row : rows) {
        std::sort(row.begin(), row.end());
        row.erase(std::unique(row.begin(), row.end()), row.end());
        pattern.columns.insert(pattern.columns.end(), row.begin(), row.end());
        pattern.row_begin.push_back(static_cast<int64_t>(pattern.columns.size()));
    }
    return pattern;
}

}  // namespace clba
