// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "base/parallel.hpp"
#include "device/queue.hpp"
#include "linear/device_pose.hpp"
#include "linear/precision.hpp"
#include "linear/vector.hpp"
#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"
#include "problem/visibility_tiles.hpp"

namespace clba {

// A segment (problem/visibility_tiles.hpp) on the device.
struct DeviceSegment {
    int32_t model = 0;
    int32_t num_columns = 0;
    int32_t num_runs = 0, num_slots = 0;
    int32_t first_block = 0, num_blocks = 0;  // of its chunk's
    int32_t first_sum = 0;  // of its runs: num_columns a run, those of earlier segments before them
    Buffer tile_runs, run_image, run_slots, slot_point;
    Buffer xy;         // run by run, 2 rows of its slots
    Buffer whitening;  // run by run, 3 rows of its slots; only if there are covariances
};

// The parameter blocks that runs add to, segment by segment (kernels/reduce.cl).
struct DeviceBlocks {
    int32_t num = 0;
    Buffer offset, size, column, num_columns, first_sum, first_run, runs, matrix_offset;
};

struct DeviceChunk {
    int32_t num_tiles = 0, num_point_slots = 0;
    int32_t first_tile = 0;      // of the chunk among those of all chunks
    int32_t max_tile_slots = 0;  // point slots of a tile, at most
    Buffer tile_points, tile_num_points;
    Buffer point_scale;  // 3 rows; only if a point is constant or has an uncertainty
    std::vector<DeviceSegment> segments;
    DeviceBlocks blocks;
    const Buffer* point_scale_or_null() const { return point_scale ? &point_scale : nullptr; }
};

// WIDEs: poses (7 an image), camera parameters (most_camera_params() a camera) and points (3 rows
// over the point slots of each chunk). Single precision: poses of 10 and points of 6
// (kernels/state.cl).
struct State {
    Buffer poses, camera_params;
    std::vector<Buffer> points;
    Buffer image_records;  // what kernels over observations read of poses and cameras (state.cl)
    Buffer frames, sensors, sensor_records;  // of rigs alone (rig_tangents.hpp)
    void swap(State& other) noexcept {
        frames.swap(other.frames);
        sensors.swap(other.sensors);
        sensor_records.swap(other.sensor_records);
        image_records.swap(other.image_records);
        poses.swap(other.poses);
        camera_params.swap(other.camera_params);
        points.swap(other.points);
    }
};

class PriorTerms;
class RigTangents;

// A problem on a device: its structure in tiles, its measurements and two states. Everything that
// is laid out on the device is translated to and from the caller's order here.
class DeviceProblem {
public:
    DeviceProblem(std::shared_ptr<Context> context, const Problem& problem, Precision precision);
    ~DeviceProblem();

    Queue& queue() { return queue_; }
    Precision precision() const { return precision_; }
    const ParameterLayout& layout() const { return layout_; }
    RigTangents* rigs() const { return rigs_.get(); }  // NULL: no image's pose is composed
    // That of the F vectors that kernels over observations have: as if there were no rigs.
    const ParameterLayout& image_layout() const;
    VectorOperations& vectors() { return vectors_; }
    int64_t num_observations() const { return num_observations_; }
    int32_t num_points() const { return num_points_; }
    const std::vector<DeviceChunk>& chunks() const { return chunks_; }

    void upload_state(const Problem& problem);    // into `state`
    void download_state(Problem& problem) const;  // from `state`
    // `state` as it is on the device, with every bit: poses, camera parameters, then the rows of
    // each point in the caller's order.
    std::vector<double> state_values() const;
    size_t num_state_values() const;
    void set_state_values(const std::vector<double>& values);
    // Poses of images and the parameters of cameras, of a state.
    void download_images(const State& from, std::vector<Image>& images,
                         std::vector<Camera>& cameras) const;
    // trial = state moved by step; points only where step has an E side.
    void update(const Vector& step);
    // Launches a kernel over the tiles of a chunk for one of its segments: the arguments follow
    // TILES (kernels/tiles.clh).
    template <class... Arguments>
    void launch(Step step, const char* path, const char* name, const std::string& defines,
                const DeviceChunk& chunk, const DeviceSegment& segment,
                const Arguments&... arguments) {
        launch_groups(chunk.num_tiles, step, path, name, defines, chunk, segment, arguments...);
    }
    template <class... Arguments>
    void launch_groups(int64_t groups, Step step, const char* path, const char* name,
                       const std::string& defines, const DeviceChunk& chunk,
                       const DeviceSegment& segment, const Arguments&... arguments) {
        queue_.launch(step, queue_.kernel(path, name, defines, camera_model_path(segment.model)),
                      groups, chunk.tile_points, chunk.tile_num_points, chunk.num_point_slots,
                      segment.tile_runs, segment.run_image, segment.run_slots, segment.slot_point,
                      arguments...);
    }
    // The first n of a buffer of WIDEs.
    void read_wide(const Buffer& buffer, std::vector<double>& values, size_t n) const {
        vectors_.read_wide(buffer, values, n);
    }
    void write_wide(const std::vector<double>& values, Buffer& buffer) const;  // all of it

    // What the problem has changed since: the owner's note. refresh() brings it up to date.
    struct {
        bool scales = false, measurements = false;
    } is_stale;
    void refresh(const Problem& problem);

    State state, trial;

    // Vectors: zero-filled, and between the caller's order (F scalars, then 3 a point) and ours.
    Vector make_vector(const std::string& label);          // F and E
    Vector make_reduced_vector(const std::string& label);  // F alone
    Buffer make_f(const ParameterLayout& layout, const std::string& label);
    std::vector<Buffer> make_point_rows(int rows, size_t value_bytes, const std::string& label);
    // One buffer a segment, in the order of chunks and their segments: rows_of(its camera model)
    // rows over its slots, run by run.
    template <class RowsOf>
    std::vector<Buffer> make_slot_rows(RowsOf&& rows_of, size_t value_bytes,
                                       const std::string& label);
    void upload(const double* values, Vector& vector) const;
    // `rows` values a point, in the caller's order, from and to rows over point slots; spare slots
    // stay.
    void read_points(const std::vector<Buffer>& buffers, int rows, double* values) const;
    void write_points(const double* values, int rows, std::vector<Buffer>& buffers) const;
    void download(const Vector& vector, double* values) const;
    // visit(observation, num_columns, value) for each observation's slot in buffers made by
    // make_slot_rows, in several threads; value(row) is a reference to what the slot has in that
    // row.
    template <class Value, class RowsOf, class Visit>
    void visit_slots(const std::vector<Buffer>& slots, RowsOf&& rows_of, Visit&& visit) const;
    // The same, to write: slots that hold no observation are 0.
    template <class Value, class RowsOf, class Visit>
    void fill_slots(std::vector<Buffer>& slots, RowsOf&& rows_of, Visit&& visit);

    const VisibilityTiles& tiles() const { return tiles_; }
    PriorTerms* priors() const { return priors_.get(); }  // NULL: there are none
    size_t num_segments() const;

    // Buffers of the F side.
    Buffer pose_offsets;                             // of each image in an F vector of images
    Buffer intrinsics_offsets;                       // of each image's camera, likewise
    Buffer scale_f;                                  // ParameterLayout::scale
    Buffer block_offset, block_size, matrix_offset;  // of ParameterLayout::blocks
    int32_t num_blocks() const { return static_cast<int32_t>(layout_.blocks.size()); }
    uint64_t matrices_bytes() const {  // packed lower triangles, WIDEs
        return static_cast<uint64_t>(layout_.num_matrix_values) * wide_bytes(precision_);
    }
    int32_t num_images() const { return num_images_; }
    int pose_values() const { return 4 + 3 * position_parts(precision_); }
    int32_t most_camera_params() const { return most_camera_params_; }  // of any camera
    // Of programs that use cameras: how many parameters each has room for, and the precision.
    std::string defines() const;
    // Fills of.image_records. Those of `state` belong to the Jacobian, which is computed from them.
    void update_image_records(const State& of);

private:
    static const std::string& camera_model_path(int32_t model);
    Buffer upload_wide(const std::vector<double>& values, const char* label);
    void upload_structure(const Problem& problem);
    DeviceSegment upload_segment(const Segment& segment);
    void upload_blocks(const Chunk& chunk, DeviceChunk& device_chunk);
    void upload_measurements(const Problem& problem, const Segment& segment,
                             DeviceSegment& device_segment);
    void upload_point_scales(const Problem& problem, const Chunk& chunk, DeviceChunk& device_chunk);
    void upload_all_measurements(const Problem& problem);
    State make_state();
    // Those of the state's values that are in no order of points.
    template <class State, class Visit>
    static void for_pose_buffers(State& of, Visit&& visit) {
        for (auto* buffer : {&of.poses, &of.camera_params, &of.frames, &of.sensors})
            if (*buffer) visit(*buffer);
    }
    template <class Wide>
    void copy_images(const Wide* poses, const Wide* params, std::vector<Image>& images,
                     std::vector<Camera>& cameras) const;
    template <class Visit>
    void for_wide(Visit&& visit) const {
        with_wide(precision_, visit);
    }

    Queue queue_;
    Precision precision_;
    ParameterLayout layout_;
    VisibilityTiles tiles_;
    VectorOperations vectors_;
    int64_t num_observations_ = 0;
    int32_t num_images_ = 0, num_cameras_ = 0, num_points_ = 0, most_camera_params_ = 0;
    std::vector<DeviceChunk> chunks_;
    Buffer image_camera_, camera_num_params_, camera_offsets_;
    std::unique_ptr<RigTangents> rigs_;
    std::unique_ptr<PriorTerms> priors_;
};

template <class RowsOf>
std::vector<Buffer> DeviceProblem::make_slot_rows(RowsOf&& rows_of, size_t value_bytes,
                                                  const std::string& label) {
    std::vector<Buffer> buffers;
    for (const DeviceChunk& chunk : chunks_)
        for (const DeviceSegment& segment : chunk.segments)
            buffers.emplace_back(queue_,
                                 static_cast<uint64_t>(segment.num_slots) *
                                     static_cast<uint64_t>(rows_of(camera_models[segment.model])) *
                                     value_bytes,
                                 label);
    return buffers;
}

namespace detail {

// visit(first slot, number of slots, number of observations) for each run, in several threads. A
// run's padding follows its observations.
template <class Visit>
void walk_runs(const Segment& segment, Visit&& visit) {
    constexpr int64_t slots_per_grain = 1 << 14;
    const int64_t grain =
        std::max<int64_t>(slots_per_grain * segment.num_runs() / (segment.num_slots() + 1), 1);
    parallel_ranges(segment.num_runs(), grain, [&](int64_t first_run, int64_t end_run) {
        for (int64_t run = first_run; run < end_run; ++run) {
            const int64_t first = segment.run_slots[run];
            const int64_t n = segment.run_slots[run + 1] - first;
            int64_t num_observations = n;
            while (segment.slot_observation[first + num_observations - 1] < 0) --num_observations;
            visit(first, n, num_observations);
        }
    });
}

// visit(observation, num_columns, value) for the observations of a segment, in several threads;
// base points to the segment's rows.
template <class Value, class Visit>
void walk_slots(const Segment& segment, int rows, Value* base, Visit&& visit) {
    walk_runs(segment, [&](int64_t first, int64_t n, int64_t num_observations) {
        for (int64_t l = 0; l < num_observations; ++l)
            visit(int64_t{segment.slot_observation[first + l]}, segment.num_columns(),
                  [&](int row) -> Value& { return base[rows * first + row * n + l]; });
    });
}

// Sets the slots that hold no observation to 0.
template <class Value>
void clear_padding(const Segment& segment, int rows, Value* base) {
    walk_runs(segment, [&](int64_t first, int64_t n, int64_t num_observations) {
        for (int row = 0; row < rows; ++row)
            std::fill_n(base + rows * first + row * n + num_observations, n - num_observations,
                        Value{0});
    });
}

}  // namespace detail

template <class Value, class RowsOf, class Visit>
void DeviceProblem::visit_slots(const std::vector<Buffer>& slots, RowsOf&& rows_of,
                                Visit&& visit) const {
    size_t index = 0;
    for (const Chunk& chunk : tiles_.chunks) {
        for (const Segment& segment : chunk.segments) {
            const auto mapping = slots[index++].map_read<Value>();
            detail::walk_slots(segment, rows_of(camera_models[segment.model]), mapping.data(),
                               visit);
        }
    }
}

template <class Value, class RowsOf, class Visit>
void DeviceProblem::fill_slots(std::vector<Buffer>& slots, RowsOf&& rows_of, Visit&& visit) {
    size_t index = 0;
    for (const Chunk& chunk : tiles_.chunks) {
        for (const Segment& segment : chunk.segments) {
            const auto mapping = slots[index++].map_write<Value>();
            detail::walk_slots(segment, rows_of(camera_models[segment.model]), mapping.data(),
                               visit);
            detail::clear_padding(segment, rows_of(camera_models[segment.model]), mapping.data());
        }
    }
}

}  // namespace clba
