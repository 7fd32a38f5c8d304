// SPDX-License-Identifier: Apache-2.0
#include "linear/schur_structure.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include "base/error.hpp"
#include "base/parallel.hpp"

namespace clba {
namespace {

constexpr int64_t images_per_task = 16;

struct Sight {
    int32_t image, record;
};

// The observations of a chunk, by image and by point.
struct ChunkSights {
    std::vector<int64_t> image_begin, point_begin;
    struct OfImage {
        int32_t point, record;
    };
    std::vector<OfImage> of_image;
    std::vector<Sight> of_point;  // by ascending record

    ChunkSights(const Chunk& chunk, int32_t num_images, std::vector<int32_t>& first_record,
                int64_t& num_records)
        : image_begin(static_cast<size_t>(num_images) + 1, 0),
          point_begin(static_cast<size_t>(chunk.num_point_slots) + 1, 0) {
        num_records = 0;
        for (const Segment& segment : chunk.segments) {
            require(num_records <= std::numeric_limits<int32_t>::max(),
                    "explicit_schur numbers observations of a chunk by 31 bits; use pcg_schur");
            first_record.push_back(static_cast<int32_t>(num_records));
            num_records += segment.num_slots();
        }
        for_each_sight(chunk, first_record, [&](int32_t image, int32_t point, int32_t) {
            ++image_begin[image + 1];
            ++point_begin[point + 1];
        });
        std::partial_sum(image_begin.begin(), image_begin.end(), image_begin.begin());
        std::partial_sum(point_begin.begin(), point_begin.end(), point_begin.begin());
        of_image.resize(static_cast<size_t>(image_begin.back()));
        of_point.resize(static_cast<size_t>(point_begin.back()));
        std::vector<int64_t> next_image(image_begin.begin(), image_begin.end() - 1);
        std::vector<int64_t> next_point(point_begin.begin(), point_begin.end() - 1);
        for_each_sight(chunk, first_record, [&](int32_t image, int32_t point, int32_t record) {
            of_image[next_image[image]++] = {point, record};
            of_point[next_point[point]++] = {image, record};
        });
    }

    template <class Visit>
    static void for_each_sight(const Chunk& chunk, const std::vector<int32_t>& first_record,
                               Visit&& visit) {
        for (size_t s = 0; s < chunk.segments.size(); ++s) {
            const Segment& segment = chunk.segments[s];
            for (int32_t tile = 0; tile < chunk.num_tiles(); ++tile) {
                for (int32_t run = segment.tile_runs[tile]; run < segment.tile_runs[tile + 1];
                     ++run) {
                    for (int32_t slot = segment.run_slots[run]; slot < segment.run_slots[run + 1];
                         ++slot) {
                        if (segment.slot_observation[slot] < 0) break;
                        visit(segment.run_image[run],
                              chunk.tile_points[tile] + segment.slot_point[slot],
                              first_record[s] + slot);
                    }
                }
            }
        }
    }

    // visit(record a, image of b, record b) for the pairs of image i and images up to i.
    template <class Visit>
    void for_each_pair(int32_t image, Visit&& visit) const {
        for (int64_t k = image_begin[image]; k < image_begin[image + 1]; ++k) {
            const OfImage& a = of_image[k];
            for (int64_t m = point_begin[a.point]; m < point_begin[a.point + 1]; ++m)
                if (of_point[m].image <= image)
                    visit(a.record, of_point[m].image, of_point[m].record);
        }
    }
};

}  // namespace

SchurStructure::SchurStructure(const Problem& problem, const VisibilityTiles& tiles) {
    const int32_t num_images = problem.num_images();
    std::vector<ChunkSights> sights;
    chunks.resize(tiles.chunks.size());
    for (size_t c = 0; c < chunks.size(); ++c)
        sights.emplace_back(tiles.chunks[c], num_images, chunks[c].first_record,
                            chunks[c].num_records);

    // What a thread knows of the row it is at: where in the row each column is.
    std::vector<std::vector<int32_t>> places(static_cast<size_t>(num_workers()));
    const auto for_each_row = [&](auto&& visit) {
        const int64_t num_tasks = (num_images + images_per_task - 1) / images_per_task;
        parallel_for(num_tasks, [&](int64_t task, int worker) {
            std::vector<int32_t>& place = places[static_cast<size_t>(worker)];
            place.resize(static_cast<size_t>(num_images), -1);
            const auto end = std::min<int64_t>(num_images, (task + 1) * images_per_task);
            for (int64_t i = task * images_per_task; i < end; ++i)
                visit(static_cast<int32_t>(i), place);
        });
    };

    std::vector<std::vector<int32_t>> rows(static_cast<size_t>(num_images));
    for_each_row([&](int32_t i, std::vector<int32_t>& place) {
        std::vector<int32_t>& row = rows[i];
        place[i] = 0;
        row.push_back(i);
        for (const ChunkSights& of_chunk : sights)
            of_chunk.for_each_pair(i, [&](int32_t, int32_t j, int32_t) {
                if (place[j] < 0) row.push_back(j);
                place[j] = 0;
            });
        for (int32_t j : row) place[j] = -1;
        std::sort(row.begin(), row.end());
    });
    row_begin.assign(static_cast<size_t>(num_images) + 1, 0);
    for (int32_t i = 0; i < num_images; ++i)
        row_begin[i + 1] = row_begin[i] + static_cast<int64_t>(rows[i].size());
    columns.resize(static_cast<size_t>(row_begin.back()));
    for (int32_t i = 0; i < num_images; ++i)
        std::copy(rows[i].begin(), rows[i].end(), columns.begin() + row_begin[i]);

    for (size_t c = 0; c < chunks.size(); ++c) {
        ChunkPairs& pairs = chunks[c];
        pairs.block_pairs.assign(columns.size() + 1, 0);
        const auto with_places = [&](int32_t i, std::vector<int32_t>& place, auto&& visit) {
            for (size_t k = 0; k < rows[i].size(); ++k) place[rows[i][k]] = static_cast<int32_t>(k);
            sights[c].for_each_pair(
                i, [&](int32_t a, int32_t j, int32_t b) { visit(row_begin[i] + place[j], a, b); });
            for (int32_t j : rows[i]) place[j] = -1;
        };
        for_each_row([&](int32_t i, std::vector<int32_t>& place) {
            with_places(i, place,
                        [&](int64_t block, int32_t, int32_t) { ++pairs.block_pairs[block + 1]; });
        });
        std::partial_sum(pairs.block_pairs.begin(), pairs.block_pairs.end(),
                         pairs.block_pairs.begin());
        pairs.pairs.resize(static_cast<size_t>(pairs.block_pairs.back()));
        std::vector<int64_t> next(pairs.block_pairs.begin(), pairs.block_pairs.end() - 1);
        for_each_row([&](int32_t i, std::vector<int32_t>& place) {
            with_places(i, place, [&](int64_t block, int32_t a, int32_t b) {
                pairs.pairs[next[block]++] = {a, b};
            });
        });
    }
}

int64_t SchurStructure::num_pairs() const {
    int64_t count = 0;
    for (const ChunkPairs& chunk : chunks) count += static_cast<int64_t>(chunk.pairs.size());
    return count;
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
    std::vector<int32_t> block_of_image(problem.images.size(), -1);
    std::vector<int32_t> shared_block(problem.cameras.size(), -1);
    for (int32_t b = 0; b < num_blocks; ++b) {
        const ParameterBlock& block = layout.blocks[b];
        pattern.block_size.push_back(block.size);
        if (block.image >= 0)
            block_of_image[block.image] = b;
        else
            shared_block[block.camera] = b;
    }
    std::vector<std::vector<int32_t>> rows(static_cast<size_t>(num_blocks));
    for (int32_t b = 0; b < num_blocks; ++b) rows[b].push_back(b);
    const auto add = [&](int32_t a, int32_t b) {
        if (a >= 0 && b >= 0 && a != b) rows[std::max(a, b)].push_back(std::min(a, b));
    };
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        const int32_t camera = shared_block[problem.images[i].camera];
        for (int64_t k = structure.row_begin[i]; k < structure.row_begin[i + 1]; ++k) {
            const int32_t j = structure.columns[k];
            const int32_t other_camera = shared_block[problem.images[j].camera];
            add(block_of_image[i], block_of_image[j]);
            add(block_of_image[i], other_camera);
            add(camera, block_of_image[j]);
            add(camera, other_camera);
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
