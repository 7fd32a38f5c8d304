// SPDX-License-Identifier: Apache-2.0
#include "problem/visibility_tiles.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

#include "base/error.hpp"

namespace clba {
namespace {

constexpr int32_t max_tile_slots = 65536;  // slots of a tile are numbered by 16 bits
constexpr int32_t shared_intrinsics_column = num_pose_params;

template <class Integer>
Integer round_up(Integer value, Integer multiple) {
    return (value + multiple - 1) / multiple * multiple;
}

// Observations of each point, in the caller's order.
struct PointObservations {
    explicit PointObservations(const Problem& problem)
        : begin(problem.points.size() + 1, 0), rows(problem.observations.size()) {
        for (const Observation& o : problem.observations) ++begin[o.point + 1];
        std::partial_sum(begin.begin(), begin.end(), begin.begin());
        std::vector<int64_t> next(begin.begin(), begin.end() - 1);
        for (int64_t i = 0; i < problem.num_observations(); ++i)
            rows[next[problem.observations[i].point]++] = i;
    }
    std::vector<int64_t> begin;
    std::vector<int64_t> rows;
};

// Points by the middle one of the images that see them; equal ones in the caller's order. Points
// that no image sees come last.
std::vector<int32_t> ordered_points(const Problem& problem, const PointObservations& observations) {
    std::vector<int32_t> key(problem.points.size());
    std::vector<int32_t> seen_by;
    for (int32_t p = 0; p < problem.num_points(); ++p) {
        seen_by.clear();
        for (int64_t i = observations.begin[p]; i < observations.begin[p + 1]; ++i)
            seen_by.push_back(problem.observations[observations.rows[i]].image);
        if (seen_by.empty()) {
            key[p] = problem.num_images();
        } else {
            const auto middle = seen_by.begin() + static_cast<int64_t>(seen_by.size() / 2);
            std::nth_element(seen_by.begin(), middle, seen_by.end());
            key[p] = *middle;
        }
    }
    std::vector<int32_t> begin(problem.images.size() + 2, 0);
    for (int32_t k : key) ++begin[k + 1];
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    std::vector<int32_t> order(problem.points.size());
    for (int32_t p = 0; p < problem.num_points(); ++p) order[begin[key[p]]++] = p;
    return order;
}

struct Visit {
    int32_t image;
    int32_t repeat;  // how many times the image saw this point before
    uint16_t point;  // slot in the tile
    int64_t observation;
};

class Builder {
public:
    Builder(const Problem& problem, const TileOptions& options)
        : problem_(problem),
          options_(options),
          last_point_(problem.images.size(), -1),
          repeats_(problem.images.size(), 0),
          next_(problem.images.size(), 0) {
        std::vector<char> is_used(num_camera_models, 0);
        for (const Image& image : problem.images) is_used[problem.cameras[image.camera].model] = 1;
        for (int32_t model = 0; model < num_camera_models; ++model)
            if (is_used[model]) models_.push_back(model);
    }

    // Adds tiles of the ordered points until one of the chunk's buffers would outgrow the limit.
    // Returns the first point that is left.
    size_t build_chunk(const std::vector<int32_t>& order, size_t first,
                       const PointObservations& observations, Chunk& chunk) {
        for (int32_t model : models_) {
            Segment segment;
            segment.model = model;
            segment.tile_runs.push_back(0);
            segment.run_slots.push_back(0);
            chunk.segments.push_back(std::move(segment));
        }
        while (first < order.size()) {
            const size_t end =
                std::min(order.size(), first + static_cast<size_t>(options_.points_per_tile));
            const auto num_points = static_cast<int32_t>(end - first);
            collect_visits(order, first, end, observations);
            if (!tile_fits(num_points, chunk)) {
                if (chunk.num_tiles() > 0) return first;
                fail(Status::out_of_memory, "a tile of ", num_points,
                     " points does not fit one buffer of ", options_.max_buffer_bytes,
                     " bytes; raise max_allocation_bytes");
            }
            chunk.tile_points.push_back(chunk.num_point_slots);
            chunk.tile_num_points.push_back(num_points);
            const int32_t num_slots =
                round_up(num_points + options_.lanes, static_cast<int32_t>(options_.lanes));
            chunk.slot_point.insert(chunk.slot_point.end(),
                                    order.begin() + static_cast<long>(first),
                                    order.begin() + static_cast<long>(end));
            chunk.num_point_slots += num_slots;
            chunk.slot_point.resize(static_cast<size_t>(chunk.num_point_slots), -1);
            for (Segment& segment : chunk.segments) append_runs(segment, num_points);
            first = end;
        }
        return first;
    }

private:
    // Whether the tile of `visits_` fits beside what the chunk has. At worst each image has a run
    // for its first sights of points, every other sight is a run of its own, and each run is
    // padded.
    bool tile_fits(int32_t num_points, const Chunk& chunk) const {
        const auto num_visits = static_cast<int64_t>(visits_.size());
        const int64_t num_again = std::count_if(
            visits_.begin(), visits_.end(), [](const Visit& visit) { return visit.repeat > 0; });
        const int64_t num_runs =
            std::min<int64_t>(num_visits - num_again, problem_.num_images()) + num_again;
        uint64_t largest =
            static_cast<uint64_t>(chunk.num_point_slots + num_points + 2 * options_.lanes) * 6 *
            sizeof(double);  // V
        int64_t most_slots = 0;
        for (const Segment& segment : chunk.segments) {
            const int64_t slots = segment.num_slots() + num_visits + num_runs * options_.lanes;
            most_slots = std::max(most_slots, slots);
            const int64_t columns = segment.num_columns();
            const int64_t jacobian = slots * (2 * columns + 6) * options_.bytes_per_value;
            const int64_t run_blocks = (segment.num_runs() + num_runs) * columns * (columns + 1) /
                                       2 * static_cast<int64_t>(sizeof(double));
            largest = std::max(
                {largest, static_cast<uint64_t>(jacobian), static_cast<uint64_t>(run_blocks)});
        }
        return largest <= options_.max_buffer_bytes &&
               most_slots <= std::numeric_limits<int32_t>::max() / 32;
    }

    void collect_visits(const std::vector<int32_t>& order, size_t first, size_t end,
                        const PointObservations& observations) {
        visits_.clear();
        for (size_t i = first; i < end; ++i) {
            const int32_t point = order[i];
            for (int64_t k = observations.begin[point]; k < observations.begin[point + 1]; ++k) {
                const int64_t row = observations.rows[k];
                const int32_t image = problem_.observations[row].image;
                repeats_[image] = last_point_[image] == point ? repeats_[image] + 1 : 0;
                last_point_[image] = point;
                visits_.push_back({image, repeats_[image], static_cast<uint16_t>(i - first), row});
            }
        }
        // The same tile may be collected again, for the next chunk.
        for (const Visit& visit : visits_) last_point_[visit.image] = -1;
    }

    // Groups the tile's visits by (repeat, image): counting sort for the first time an image sees a
    // point, and a stable sort for the few that it sees again.
    void append_runs(Segment& segment, int32_t num_points) {
        touched_.clear();
        again_.clear();
        int64_t num_first = 0;
        for (const Visit& visit : visits_) {
            if (problem_.cameras[problem_.images[visit.image].camera].model != segment.model)
                continue;
            if (visit.repeat > 0) {
                again_.push_back(visit);
                continue;
            }
            if (next_[visit.image]++ == 0) touched_.push_back(visit.image);
            ++num_first;
        }
        std::sort(touched_.begin(), touched_.end());
        sorted_.resize(static_cast<size_t>(num_first));
        int64_t begin = 0;
        for (int32_t image : touched_) {
            const int64_t count = next_[image];
            next_[image] = begin;
            begin += count;
        }
        for (const Visit& visit : visits_)
            if (visit.repeat == 0 &&
                problem_.cameras[problem_.images[visit.image].camera].model == segment.model)
                sorted_[static_cast<size_t>(next_[visit.image]++)] = visit;
        for (int32_t image : touched_) next_[image] = 0;
        std::stable_sort(again_.begin(), again_.end(), [](const Visit& a, const Visit& b) {
            return a.repeat != b.repeat ? a.repeat < b.repeat : a.image < b.image;
        });
        sorted_.insert(sorted_.end(), again_.begin(), again_.end());

        for (size_t i = 0; i < sorted_.size();) {
            size_t end = i;
            while (end < sorted_.size() && sorted_[end].image == sorted_[i].image &&
                   sorted_[end].repeat == sorted_[i].repeat)
                ++end;
            segment.run_image.push_back(sorted_[i].image);
            for (; i < end; ++i) {
                segment.slot_point.push_back(sorted_[i].point);
                segment.slot_observation.push_back(sorted_[i].observation);
            }
            for (int32_t spare = num_points; segment.slot_point.size() % options_.lanes != 0;
                 ++spare) {
                segment.slot_point.push_back(static_cast<uint16_t>(spare));
                segment.slot_observation.push_back(-1);
            }
            segment.run_slots.push_back(static_cast<int32_t>(segment.slot_point.size()));
        }
        segment.tile_runs.push_back(segment.num_runs());
    }

    const Problem& problem_;
    const TileOptions& options_;
    std::vector<int32_t> models_;  // in use
    // Scratch, by image.
    std::vector<int32_t> last_point_, repeats_;
    std::vector<int64_t> next_;
    // Scratch, by tile.
    std::vector<Visit> visits_, sorted_, again_;
    std::vector<int32_t> touched_;
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
    require(options.lanes >= 1 && options.points_per_tile >= 1 &&
                options.points_per_tile + 2 * options.lanes <= max_tile_slots,
            "points_per_tile = ", options.points_per_tile, ", but a tile has 1 to ",
            max_tile_slots - 2 * options.lanes, " points");
    const PointObservations observations(problem);
    const std::vector<int32_t> order = ordered_points(problem, observations);
    Builder builder(problem, options);
    for (size_t first = 0; first < order.size();) {
        chunks.emplace_back();
        first = builder.build_chunk(order, first, observations, chunks.back());
    }

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
