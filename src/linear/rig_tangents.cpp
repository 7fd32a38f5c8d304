// SPDX-License-Identifier: Apache-2.0
#include "linear/rig_tangents.hpp"

#include <algorithm>
#include <numeric>

#include "base/error.hpp"
#include "problem/counting_sort.hpp"

namespace clba {
namespace {

constexpr int sensor_record_values = 12;  // kernels/rigs.cl
constexpr int pose_triangle = num_pose_params * (num_pose_params + 1) / 2;

int triangle(int rows) {
    return rows * (rows + 1) / 2;
}

std::vector<int32_t> offsets_of(const std::vector<int32_t>& blocks, const ParameterLayout& layout) {
    std::vector<int32_t> offsets;
    for (const int32_t block : blocks) offsets.push_back(layout.blocks[block].offset);
    return offsets;
}

std::vector<int32_t> matrices_of(const std::vector<int32_t>& blocks,
                                 const ParameterLayout& layout) {
    std::vector<int32_t> matrices;
    for (const int32_t block : blocks) matrices.push_back(layout.blocks[block].matrix);
    return matrices;
}

}  // namespace

RigTangents::RigTangents(DeviceProblem& device, const Problem& problem)
    : device_(device),
      queue_(device.queue()),
      image_layout_(ParameterLayout::of_images(problem)),
      num_images_(static_cast<int32_t>(device.layout().composed.size())) {
    list_offsets(problem);
    list_moves();
    expanded_ = device.make_f(image_layout_, "rigs");
    sums_ = device.make_f(image_layout_, "rigs");
    image_blocks_ = Buffer(
        queue_,
        static_cast<uint64_t>(image_layout_.num_matrix_values) * wide_bytes(device.precision()),
        "image blocks");
}

void RigTangents::list_offsets(const Problem& problem) {
    const ParameterLayout& layout = device_.layout();
    const Rigs& rigs = problem.rigs;
    std::vector<int32_t> frame_blocks, sensor_blocks, sensor_place(rigs.sensors.size(), -1);
    for (size_t s = 0; s < rigs.sensors.size(); ++s) {
        if (layout.sensor_block[s] < 0) continue;
        sensor_place[s] = static_cast<int32_t>(sensors_.size());
        sensors_.push_back(static_cast<int32_t>(s));
        sensor_blocks.push_back(layout.sensor_block[s]);
    }
    num_sensors_ = static_cast<int32_t>(sensors_.size());
    std::vector<int32_t> image_blocks, frame_of_image, sensor_of_image, first_images;
    for (int32_t k = 0; k < num_images_; ++k) {
        const int32_t image = layout.composed[k], frame = rigs.image_frame[image];
        if (frames_.empty() || frames_.back() != frame) {
            frames_.push_back(frame);
            frame_blocks.push_back(layout.pose_block[image]);
            first_images.push_back(k);
        }
        image_frame_.push_back(static_cast<int32_t>(frames_.size()) - 1);
        image_sensor_.push_back(sensor_place[rigs.image_sensor[image]]);
        image_blocks.push_back(image_layout_.pose_block[image]);
        frame_of_image.push_back(frame_blocks.back());
        sensor_of_image.push_back(sensor_blocks[image_sensor_.back()]);
    }
    first_images.push_back(num_images_);
    std::vector<int32_t> by_sensor(image_sensor_.size());
    const std::vector<int32_t> sensor_begin = counting_sort(
        num_images_, num_sensors_, [&](int64_t k) { return image_sensor_[k]; },
        [&](int64_t k, int32_t slot) { by_sensor[slot] = static_cast<int32_t>(k); });

    const auto upload = [&](const std::vector<int32_t>& values) {
        return Buffer(queue_, values, "rigs");
    };
    images_ = upload(layout.composed);
    device_image_frame_ = upload(image_frame_);
    device_image_sensor_ = upload(image_sensor_);
    image_offset_ = upload(offsets_of(image_blocks, image_layout_));
    frame_offset_ = upload(offsets_of(frame_of_image, layout));
    sensor_offset_ = upload(offsets_of(sensor_of_image, layout));
    frame_images_ = upload(first_images);
    frame_step_offset_ = upload(offsets_of(frame_blocks, layout));
    sensor_step_offset_ = upload(offsets_of(sensor_blocks, layout));
    sensor_images_ = upload(sensor_begin);
    images_by_sensor_ = upload(by_sensor);
    frame_matrix_ = upload(matrices_of(frame_blocks, layout));
    sensor_matrix_ = upload(matrices_of(sensor_blocks, layout));
    image_matrix_ = upload(matrices_of(image_blocks, image_layout_));
    step_offsets_ = upload(layout.pose_offset);
}

RigTangents::Moves RigTangents::make_moves(const std::vector<int32_t>& from,
                                           const std::vector<int32_t>& to) {
    return {static_cast<int32_t>(from.size()), Buffer(queue_, from, "rigs"),
            Buffer(queue_, to, "rigs")};
}

void RigTangents::list_moves() {
    const ParameterLayout& layout = device_.layout();
    std::vector<int32_t> of_parameters, of_images, from_matrix, to_matrix, diagonal, scalars;
    const auto add = [&](int32_t parameter, int32_t image, int size) {
        for (int k = 0; k < size; ++k) {
            of_parameters.push_back(parameter + k);
            of_images.push_back(image + k);
        }
    };
    for (const ParameterBlock& block : layout.blocks) {
        for (int r = 0; r < block.size; ++r) {
            diagonal.push_back(block.matrix + triangle(r) + r);
            scalars.push_back(block.offset + r);
        }
        if (block.frame >= 0 || block.sensor >= 0) continue;
        const int32_t image_block = block.image >= 0 ? image_layout_.pose_block[block.image]
                                                     : image_layout_.intrinsics_block[block.camera];
        const ParameterBlock& of_image = image_layout_.blocks[image_block];
        // The intrinsics of a composed image's own camera come after its pose.
        const int first = of_image.size - block.size;
        add(block.offset, of_image.offset + first, block.size);
        for (int r = 0; r < block.size; ++r) {
            for (int c = 0; c <= r; ++c) {
                from_matrix.push_back(of_image.matrix + triangle(first + r) + first + c);
                to_matrix.push_back(block.matrix + triangle(r) + c);
            }
        }
    }
    values_ = make_moves(of_parameters, of_images);
    gathered_ = make_moves(of_images, of_parameters);
    matrices_ = make_moves(from_matrix, to_matrix);
    diagonal_ = make_moves(diagonal, scalars);
}

Kernel& RigTangents::kernel(const char* name, const char* more) {
    return queue_.kernel("rigs.cl", name, precision_defines(device_.precision()) + more);
}

template <class... Arguments>
void RigTangents::launch(Step step, const char* name, int64_t rows, const Arguments&... arguments) {
    queue_.launch(step, kernel(name), std::min<int64_t>(queue_.tuning().vector_groups, rows),
                  static_cast<int32_t>(rows), arguments...);
}

void RigTangents::add_buffers(State& state) const {
    const auto poses = [&](const std::vector<int32_t>& rows) {
        return Buffer(queue_,
                      rows.size() * static_cast<uint64_t>(device_.pose_values()) *
                          wide_bytes(device_.precision()),
                      "poses of rigs");
    };
    state.frames = poses(frames_);
    state.sensors = poses(sensors_);
    state.sensor_records = Buffer(
        queue_, sensors_.size() * sensor_record_values * wide_bytes(device_.precision()), "rigs");
}

void RigTangents::upload(const Problem& problem, State& state) {
    const int64_t stride = device_.pose_values();
    with_wide(device_.precision(), [&](auto wide) {
        using Wide = decltype(wide);
        const auto frames = state.frames.map_write<Wide>();
        for (size_t k = 0; k < frames_.size(); ++k)
            upload_pose(problem.rigs.frames[frames_[k]], &frames[stride * static_cast<int64_t>(k)]);
        const auto sensors = state.sensors.map_write<Wide>();
        for (size_t k = 0; k < sensors_.size(); ++k)
            upload_pose(problem.rigs.sensors[sensors_[k]],
                        &sensors[stride * static_cast<int64_t>(k)]);
    });
    compose(state);
}

void RigTangents::download(const State& state, Problem& problem) const {
    const int64_t stride = device_.pose_values();
    with_wide(device_.precision(), [&](auto wide) {
        const auto frames = state.frames.map_read<decltype(wide)>();
        for (size_t k = 0; k < frames_.size(); ++k)
            download_pose(&frames[stride * static_cast<int64_t>(k)],
                          problem.rigs.frames[frames_[k]]);
    });
    problem.rigs.sensors = download_sensors(state, problem.rigs.sensors);
    compose_images(problem.rigs, problem.images);
}

std::vector<Pose> RigTangents::download_sensors(const State& state,
                                                const std::vector<Pose>& before) const {
    std::vector<Pose> poses = before;
    const int64_t stride = device_.pose_values();
    with_wide(device_.precision(), [&](auto wide) {
        const auto sensors = state.sensors.map_read<decltype(wide)>();
        for (size_t k = 0; k < sensors_.size(); ++k)
            download_pose(&sensors[stride * static_cast<int64_t>(k)], poses[sensors_[k]]);
    });
    return poses;
}

void RigTangents::update_records(const State& of) {
    launch(Step::vector, "sensor_records", num_sensors_, of.sensors, of.sensor_records);
}

void RigTangents::compose(State& of) {
    launch(Step::vector, "compose_images", num_images_, images_, device_image_frame_,
           device_image_sensor_, of.frames, of.sensors, of.poses);
}

void RigTangents::move(const Vector& step, const State& from, State& to) {
    const auto move_poses = [&](int64_t count, const Buffer& offsets, const Buffer& poses,
                                const Buffer& moved) {
        queue_.launch(Step::vector, queue_.kernel("state.cl", "update_images", device_.defines()),
                      std::min<int64_t>(queue_.tuning().vector_groups, count),
                      static_cast<int32_t>(count), offsets, step.f, poses, moved);
    };
    move_poses(static_cast<int64_t>(frames_.size()), frame_step_offset_, from.frames, to.frames);
    move_poses(num_sensors_, sensor_step_offset_, from.sensors, to.sensors);
    compose(to);
}

const Buffer& RigTangents::expand(const Buffer& x) {
    if (values_.count > 0)
        launch(Step::vector, "move_values", values_.count, values_.from, values_.to, int32_t{0}, x,
               expanded_);
    launch(Step::vector, "expand_poses", num_images_, image_offset_, frame_offset_, sensor_offset_,
           device_image_sensor_, device_.state.sensor_records, x, expanded_);
    return expanded_;
}

Buffer& RigTangents::zeroed_image_vector() {
    sums_.fill_zero();
    return sums_;
}

void RigTangents::gather(Buffer& x) {
    if (gathered_.count > 0)
        launch(Step::vector, "move_values", gathered_.count, gathered_.from, gathered_.to,
               int32_t{1}, sums_, x);
    launch(Step::vector, "gather_frames", static_cast<int64_t>(frames_.size()), frame_images_,
           frame_offset_, image_offset_, device_image_sensor_, device_.state.sensor_records, sums_,
           x);
    queue_.launch(Step::vector, kernel("gather_sensors"), num_sensors_, sensor_images_,
                  images_by_sensor_, sensor_step_offset_, image_offset_, sums_, x,
                  queue_.scratch());
}

Buffer& RigTangents::image_matrices() {
    return image_blocks_;
}

void RigTangents::transform_blocks(Buffer& matrices) {
    static_assert(pose_triangle == 21, "triangles of kernels/rigs.cl");
    matrices.fill_zero();
    if (matrices_.count > 0)
        launch(Step::preconditioner, "move_values", matrices_.count, matrices_.from, matrices_.to,
               int32_t{0}, image_blocks_, matrices);
    launch(Step::preconditioner, "frame_blocks", static_cast<int64_t>(frames_.size()),
           frame_images_, frame_matrix_, image_matrix_, device_image_sensor_,
           device_.state.sensor_records, image_blocks_, matrices);
    queue_.launch(Step::preconditioner, kernel("gather_sensors", " -DSENSOR_VALUES=21"),
                  num_sensors_, sensor_images_, images_by_sensor_, sensor_matrix_, image_matrix_,
                  image_blocks_, matrices, queue_.scratch());
}

void RigTangents::get_diagonal(const Buffer& matrices, Buffer& diagonal) {
    launch(Step::preconditioner, "move_values", diagonal_.count, diagonal_.from, diagonal_.to,
           int32_t{0}, matrices, diagonal);
}

}  // namespace clba
