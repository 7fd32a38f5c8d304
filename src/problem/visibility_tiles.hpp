// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"

namespace clba {

struct TileOptions {
    int32_t points_per_tile = 0;             // 0: chosen by best_tile_size (tile_size.hpp)
    int32_t max_points_per_tile = 16384;     // of a chosen size
    int32_t compute_units = 1;               // that share the tiles
    int lanes = 16;                          // runs and tiles are padded to a multiple of this
    int64_t bytes_per_value = 8;             // of a stored Jacobian
    uint64_t max_buffer_bytes = UINT64_MAX;  // a chunk's largest buffer stays below this
};

// The observations that one image makes of one tile's points, no point twice: slots
// [run_slots[r], run_slots[r + 1]) of its segment.
//
// A segment is what a chunk's images of one camera model see. Its slots hold its observations run
// by run, padded so that each run starts at a multiple of `lanes`; a padding slot refers to one of
// the tile's spare point slots, a different one for each lane, and to no observation.
struct Segment {
    int32_t model = 0;
    std::vector<int32_t> tile_runs;  // first run of each tile of the chunk, and end
    std::vector<int32_t> run_image;
    std::vector<int32_t> run_slots;         // first slot of each run, and end
    std::vector<uint16_t> slot_point;       // counted from the tile's first point slot
    std::vector<int32_t> slot_observation;  // the caller's row, -1 for padding
    // For each parameter block that the segment touches: where it is, from which column of a run's
    // sums it takes its part (0: pose, or pose with intrinsics; 6: shared intrinsics), and its
    // runs.
    std::vector<int32_t> block;  // index into ParameterLayout::blocks
    std::vector<int32_t> block_column;
    std::vector<int32_t> block_runs;  // first entry of each block in `runs`, and end
    std::vector<int32_t> runs;

    int32_t num_runs() const { return static_cast<int32_t>(run_image.size()); }
    int32_t num_slots() const { return run_slots.empty() ? 0 : run_slots.back(); }
    int num_columns() const { return num_pose_params + camera_models[model].num_params; }
};

// A contiguous range of tiles whose buffers fit the device's largest allocation. Point vectors of a
// chunk have num_point_slots entries; a tile's points are followed by `lanes` or more spare slots.
struct Chunk {
    std::vector<int32_t> tile_points;      // first point slot of each tile
    std::vector<int32_t> tile_num_points;  // real points of each tile
    int32_t num_point_slots = 0;
    std::vector<int32_t> slot_point;  // the caller's point of each point slot, -1 for spare ones
    std::vector<Segment> segments;
    int32_t num_tiles() const { return static_cast<int32_t>(tile_points.size()); }
};

// The order in which a device works through a problem. Points are ordered so that a tile, a range
// of that order, is seen by few images and runs are long (point_order.hpp). Two facts make products
// over tiles fast: within a run the image is the same for all observations, and as no point occurs
// twice in it, lanes may scatter to the tile's points without conflict. The result does not depend
// on the number of threads that build it.
struct VisibilityTiles {
    VisibilityTiles(const Problem& problem, const ParameterLayout& layout,
                    const TileOptions& options);

    std::vector<Chunk> chunks;
    int64_t num_slots = 0;  // of all segments, padding included
};

}  // namespace clba
