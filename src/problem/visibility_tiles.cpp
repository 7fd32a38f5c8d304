// SPDX-License-Identifier: Apache-2.0
#include "problem/visibility_tiles.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <tuple>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "problem/point_order.hpp"
#include "problem/tile_size.hpp"

namespace clba {
namespace {

constexpr int32_t max_tile_slots = 65536;  // slots of a tile are numbered by 16 bits
constexpr int32_t shared_intrinsics_column = num_pose_params;

template <class Integer>
Integer round_up(Integer value, Integer multiple) {
    return (value + multiple - 1) / multiple * multiple;
}

struct Run {
    int32_t image;
    int32_t repeat;  // how many times before the image saw these points
    int32_t num_observations;
};

// A tile's share of a segment.
struct Share {
    int64_t num_runs = 0, num_slots = 0;
    int64_t first_run = 0, first_slot = 0;
};

struct Tile {
    int32_t first = 0, end = 0;  // of the ordered points
    std::vector<Run> runs;       // by repeat, and then as the tile's points meet the images
    std::vector<Share> shares;   // one a segment
    Chunk* chunk = nullptr;
    int32_t num_points() const { return end - first; }
};

// The camera models in use, each with its segment, and the segment of each image.
struct Models {
    explicit Models(const Problem& problem) : segment_of_image(problem.images.size()) {
        std::vector<int32_t> segment_of_model(num_camera_models, -1);
        for (const Image& image : problem.images)
            segment_of_model[problem.cameras[image.camera].model] = 0;
        for (int32_t model = 0; model < num_camera_models; ++model) {
            if (segment_of_model[model] < 0) continue;
            segment_of_model[model] = static_cast<int32_t>(numbers.size());
            numbers.push_back(model);
        }
        for (size_t i = 0; i < problem.images.size(); ++i)
            segment_of_image[i] = segment_of_model[problem.cameras[problem.images[i].camera].model];
    }
    std::vector<int32_t> numbers;
    std::vector<int32_t> segment_of_image;
};

// A worker's scratch, which groups the sights of a tile's points into runs.
class TileReader {
public:
    TileReader(const Visibility& visibility, const std::vector<int32_t>& order,
               const Models& models, int32_t lanes)
        : visibility_(visibility),
          order_(order),
          lanes_(lanes),
          num_segments_(models.numbers.size()),
          images_(models.segment_of_image.size()) {
        for (size_t i = 0; i < images_.size(); ++i) images_[i].segment = models.segment_of_image[i];
    }

    void find_runs(Tile& tile) {
        for_each_first_sight(tile, [&](const Sight& sight, int32_t, OfImage& image) {
            if (image.value++ == 0) tile.runs.push_back({sight.image, 0, 0});
        });
        // Neighbours in memory are neighbours in time: of images' data, and of what runs add to
        // them.
        std::sort(tile.runs.begin(), tile.runs.end(),
                  [](const Run& a, const Run& b) { return a.image < b.image; });
        for (Run& run : tile.runs) {
            run.num_observations = images_[run.image].value;
            images_[run.image].value = 0;
        }
        for (const Again& again : again_) {
            if (tile.runs.back().repeat != again.repeat || tile.runs.back().image != again.image)
                tile.runs.push_back({again.image, again.repeat, 0});
            ++tile.runs.back().num_observations;
        }
        tile.shares.resize(num_segments_);
        for (const Run& run : tile.runs) {
            Share& share = tile.shares[images_[run.image].segment];
            ++share.num_runs;
            share.num_slots += round_up(run.num_observations, lanes_);
        }
    }

    // Writes the tile's runs and slots into its chunk.
    void write_runs(const Tile& tile) {
        std::vector<Segment>& segments = tile.chunk->segments;
        std::vector<Share> next = tile.shares;
        std::vector<int64_t> first_again;  // slots of runs with a repeat
        for (const Run& run : tile.runs) {
            Segment& segment = segments[images_[run.image].segment];
            Share& share = next[images_[run.image].segment];
            const int64_t first = share.first_slot;
            segment.run_image[share.first_run] = run.image;
            segment.run_slots[share.first_run] = static_cast<int32_t>(first);
            ++share.first_run;
            share.first_slot += round_up(run.num_observations, lanes_);
            for (int64_t slot = first + run.num_observations, spare = tile.num_points();
                 slot < share.first_slot; ++slot, ++spare) {
                segment.slot_point[slot] = static_cast<uint16_t>(spare);
                segment.slot_observation[slot] = -1;
            }
            if (run.repeat == 0)
                images_[run.image].value = static_cast<int32_t>(first);
            else
                first_again.push_back(first);
        }
        const auto write = [&](Segment& segment, int64_t slot, int32_t point, int32_t observation) {
            segment.slot_point[slot] = static_cast<uint16_t>(point);
            segment.slot_observation[slot] = observation;
        };
        for_each_first_sight(tile, [&](const Sight& sight, int32_t point, OfImage& image) {
            write(segments[image.segment], image.value++, point, sight.observation);
        });
        auto again = again_.begin();
        auto first = first_again.begin();
        for (const Run& run : tile.runs) {
            images_[run.image].value = 0;
            if (run.repeat == 0) continue;
            for (int32_t k = 0; k < run.num_observations; ++k, ++again)
                write(segments[images_[run.image].segment], *first + k, again->point,
                      again->observation);
            ++first;
        }
    }

private:
    struct OfImage {
        uint32_t last_visit = 0;
        int32_t repeat = 0;
        int32_t value = 0;  // observations so far, or the next slot; 0 between calls
        int32_t segment = 0;
    };
    struct Again {
        int32_t repeat, image, point, observation;
    };

    // visit(sight, point in the tile, image) for the first sight of each pair of an image and a
    // point. The others go to again_, by repeat and image.
    template <class Visit>
    void for_each_first_sight(const Tile& tile, Visit&& visit) {
        again_.clear();
        for (int32_t i = tile.first; i < tile.end; ++i) {
            ++visit_;
            for (const Sight& sight : visibility_.of_point(order_[i])) {
                OfImage& image = images_[sight.image];
                if (image.last_visit != visit_) {
                    image.last_visit = visit_;
                    image.repeat = 0;
                    visit(sight, i - tile.first, image);
                } else {
                    again_.push_back(
                        {++image.repeat, sight.image, i - tile.first, sight.observation});
                }
            }
        }
        std::stable_sort(again_.begin(), again_.end(), [](const Again& a, const Again& b) {
            return std::tie(a.repeat, a.image) < std::tie(b.repeat, b.image);
        });
    }

    const Visibility& visibility_;
    const std::vector<int32_t>& order_;
    const int32_t lanes_;
    const size_t num_segments_;
    std::vector<OfImage> images_;
    std::vector<Again> again_;
    uint32_t visit_ = 0;  // counts the points looked at
};

class Builder {
public:
    Builder(const Problem& problem, const TileOptions& options)
        : options_(options),
          models_(problem),
          visibility_(problem),
          order_(ordered_points(visibility_, image_ranks(visibility_, problem.num_images()))),
          readers_(static_cast<size_t>(num_workers())) {}

    void build(std::vector<Chunk>& chunks) {
        if (order_.empty()) return;
        const bool may_choose = options_.points_per_tile == 0;
        int32_t size = options_.points_per_tile;
        if (may_choose)
            size = best_tile_size(
                visibility_, order_, static_cast<int32_t>(models_.segment_of_image.size()),
                {options_.max_points_per_tile, options_.compute_units, options_.lanes});
        find_tiles(size);
        while (may_choose && size > 1 && !all_fit()) find_tiles(size = (size + 1) / 2);
        fill_chunks(chunks);
        parallel_for(static_cast<int64_t>(tiles_.size()),
                     [&](int64_t t, int worker) { reader(worker).write_runs(tiles_[t]); });
    }

private:
    TileReader& reader(int worker) {
        std::unique_ptr<TileReader>& reader = readers_[worker];
        if (!reader)
            reader = std::make_unique<TileReader>(visibility_, order_, models_, options_.lanes);
        return *reader;
    }

    void find_tiles(int32_t size) {
        tiles_.clear();
        for (int64_t first = 0; first < visibility_.num_points(); first += size) {
            Tile& tile = tiles_.emplace_back();
            tile.first = static_cast<int32_t>(first);
            tile.end =
                static_cast<int32_t>(std::min<int64_t>(first + size, visibility_.num_points()));
        }
        parallel_for(static_cast<int64_t>(tiles_.size()),
                     [&](int64_t t, int worker) { reader(worker).find_runs(tiles_[t]); });
    }

    int32_t num_point_slots(const Tile& tile) const {
        return round_up<int32_t>(tile.num_points() + options_.lanes, options_.lanes);
    }

    // Whether a chunk of so many point slots, and runs and slots of each segment, has buffers that
    // are small enough and whose elements can be numbered.
    bool fits(int64_t point_slots, const std::vector<Share>& shares) const {
        uint64_t largest = static_cast<uint64_t>(point_slots) * 6 * sizeof(double);  // V
        int64_t most_slots = point_slots;
        int64_t run_sums = 0;
        for (size_t s = 0; s < shares.size(); ++s) {
            const int64_t columns = num_pose_params + camera_models[models_.numbers[s]].num_params;
            const int64_t jacobian =
                shares[s].num_slots * (2 * columns + 6) * options_.bytes_per_value;
            const int64_t whitening =
                shares[s].num_slots * 3 * static_cast<int64_t>(sizeof(double));
            // A gradient and a diagonal of all segments, or the triangle of a block of one.
            run_sums += shares[s].num_runs * 2 * columns * static_cast<int64_t>(sizeof(double));
            const int64_t run_blocks =
                shares[s].num_runs * columns * (columns + 1) / 2 * options_.bytes_per_value;
            largest = std::max(largest, static_cast<uint64_t>(
                                            std::max({jacobian, whitening, run_sums, run_blocks})));
            most_slots = std::max(most_slots, shares[s].num_slots);
        }
        return largest <= options_.max_buffer_bytes &&
               most_slots <= std::numeric_limits<int32_t>::max() / 32;
    }
    bool all_fit() const {
        return std::all_of(tiles_.begin(), tiles_.end(), [&](const Tile& tile) {
            return fits(num_point_slots(tile), tile.shares);
        });
    }

    // Deals the tiles out to chunks and gives each its place.
    void fill_chunks(std::vector<Chunk>& chunks) {
        for (size_t first = 0; first < tiles_.size();) {
            std::vector<Share> sums(models_.numbers.size());
            int64_t point_slots = 0;
            size_t end = first;
            for (; end < tiles_.size(); ++end) {
                std::vector<Share> grown = sums;
                for (size_t s = 0; s < sums.size(); ++s) {
                    grown[s].num_runs += tiles_[end].shares[s].num_runs;
                    grown[s].num_slots += tiles_[end].shares[s].num_slots;
                }
                if (!fits(point_slots + num_point_slots(tiles_[end]), grown)) break;
                for (size_t s = 0; s < sums.size(); ++s) {
                    tiles_[end].shares[s].first_run = sums[s].num_runs;
                    tiles_[end].shares[s].first_slot = sums[s].num_slots;
                }
                point_slots += num_point_slots(tiles_[end]);
                sums = std::move(grown);
            }
            if (end == first)
                fail(Status::out_of_memory, "a tile of ", tiles_[first].num_points(),
                     " points does not fit one buffer of ", options_.max_buffer_bytes,
                     " bytes; raise max_allocation_bytes");
            chunks.push_back(make_chunk(first, end, point_slots, sums));
            first = end;
        }
        auto tile = tiles_.begin();
        for (Chunk& chunk : chunks)
            for (int32_t t = 0; t < chunk.num_tiles(); ++t) (tile++)->chunk = &chunk;
    }

    Chunk make_chunk(size_t first, size_t end, int64_t point_slots,
                     const std::vector<Share>& sums) const {
        Chunk chunk;
        chunk.slot_point.assign(static_cast<size_t>(point_slots), -1);
        for (size_t t = first; t < end; ++t) {
            const Tile& tile = tiles_[t];
            chunk.tile_points.push_back(chunk.num_point_slots);
            chunk.tile_num_points.push_back(tile.num_points());
            std::copy(order_.begin() + tile.first, order_.begin() + tile.end,
                      chunk.slot_point.begin() + chunk.num_point_slots);
            chunk.num_point_slots += num_point_slots(tile);
        }
        for (size_t s = 0; s < sums.size(); ++s) {
            Segment& segment = chunk.segments.emplace_back();
            segment.model = models_.numbers[s];
            for (size_t t = first; t < end; ++t)
                segment.tile_runs.push_back(static_cast<int32_t>(tiles_[t].shares[s].first_run));
            segment.tile_runs.push_back(static_cast<int32_t>(sums[s].num_runs));
            segment.run_image.resize(static_cast<size_t>(sums[s].num_runs));
            segment.run_slots.resize(static_cast<size_t>(sums[s].num_runs + 1));
            segment.run_slots.back() = static_cast<int32_t>(sums[s].num_slots);
            segment.slot_point.resize(static_cast<size_t>(sums[s].num_slots));
            segment.slot_observation.resize(static_cast<size_t>(sums[s].num_slots));
        }
        return chunk;
    }

    const TileOptions& options_;
    const Models models_;
    const Visibility visibility_;
    const std::vector<int32_t> order_;
    std::vector<std::unique_ptr<TileReader>> readers_;
    std::vector<Tile> tiles_;
};

// Inverts run -> blocks, keeping the order of the runs within each block.
void list_block_runs(const ParameterLayout& layout, const std::vector<int32_t>& block_of_image,
                     const std::vector<int32_t>& shared_block_of_image, Segment& segment) {
    std::vector<int32_t> count(layout.blocks.size(), 0);
    const auto for_each_block = [&](auto&& visit) {
        for (int32_t run = 0; run < segment.num_runs(); ++run) {
            const int32_t image = segment.run_image[run];
            visit(block_of_image[image], run);
            if (shared_block_of_image[image] >= 0) visit(shared_block_of_image[image], run);
        }
    };
    for_each_block([&](int32_t block, int32_t) { ++count[block]; });
    segment.block_runs.push_back(0);
    std::vector<int32_t> next(layout.blocks.size(), 0);
    for (int32_t b = 0; b < static_cast<int32_t>(layout.blocks.size()); ++b) {
        if (count[b] == 0) continue;
        next[b] = segment.block_runs.back();
        segment.block.push_back(b);
        segment.block_column.push_back(layout.blocks[b].image >= 0 ? 0 : shared_intrinsics_column);
        segment.block_runs.push_back(segment.block_runs.back() + count[b]);
    }
    segment.runs.resize(static_cast<size_t>(segment.block_runs.back()));
    for_each_block([&](int32_t block, int32_t run) { segment.runs[next[block]++] = run; });
}

}  // namespace

VisibilityTiles::VisibilityTiles(const Problem& problem, const ParameterLayout& layout,
                                 const TileOptions& options) {
    const auto require_tile_size = [&](int32_t size, int32_t smallest, const char* name) {
        require(
            options.lanes >= 1 && size >= smallest && size + 2 * options.lanes <= max_tile_slots,
            name, " = ", size, ", but a tile has 1 to ", max_tile_slots - 2 * options.lanes,
            " points");
    };
    require_tile_size(options.points_per_tile, 0, "points_per_tile");
    require_tile_size(options.max_points_per_tile, 1, "max_points_per_tile");
    Builder(problem, options).build(chunks);

    std::vector<int32_t> block_of_image(problem.images.size(), -1);
    std::vector<int32_t> block_of_camera(problem.cameras.size(), -1);
    for (int32_t b = 0; b < static_cast<int32_t>(layout.blocks.size()); ++b) {
        const ParameterBlock& block = layout.blocks[b];
        if (block.image >= 0) block_of_image[block.image] = b;
        if (block.image < 0) block_of_camera[block.camera] = b;
    }
    std::vector<int32_t> shared_block_of_image(problem.images.size());
    for (int32_t i = 0; i < problem.num_images(); ++i)
        shared_block_of_image[i] = block_of_camera[problem.images[i].camera];
    for (Chunk& chunk : chunks) {
        for (Segment& segment : chunk.segments) {
            list_block_runs(layout, block_of_image, shared_block_of_image, segment);
            num_slots += segment.num_slots();
        }
    }
}

}  // namespace clba
