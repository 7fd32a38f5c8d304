// SPDX-License-Identifier: Apache-2.0
#include "linear/device_problem.hpp"

#include "base/error.hpp"
#include "base/parallel.hpp"

namespace clba {
namespace {

TileOptions tile_options(const Context& context, Precision precision) {
    TileOptions options;
    options.max_points_per_tile = context.tuning.points_per_tile;
    options.compute_units = context.device().compute_units;
    options.lanes = context.tuning.lanes;
    options.bytes_per_value = static_cast<int64_t>(real_bytes(precision));
    options.max_buffer_bytes = context.max_allocation_bytes();
    return options;
}

// In several threads.
template <class Visit>
void for_slots(int64_t num_slots, Visit&& visit) {
    constexpr int64_t grain = 1 << 14;
    parallel_ranges(num_slots, grain, [&](int64_t begin, int64_t end) {
        for (int64_t slot = begin; slot < end; ++slot) visit(slot);
    });
}

void require_double(const Context& context) {
    if (!context.device().has_double)
        fail(Status::no_device, context.device().name,
             " has no double precision, which the precisions double and mixed need");
}

}  // namespace

DeviceProblem::DeviceProblem(std::shared_ptr<Context> context, const Problem& problem,
                             Precision precision)
    : queue_((require_double(*context), context)),
      precision_(precision),
      layout_(problem),
      tiles_(problem, layout_, tile_options(*context, precision)),
      vectors_(queue_, real_type(precision)),
      num_observations_(problem.num_observations()),
      num_images_(problem.num_images()),
      num_cameras_(problem.num_cameras()),
      num_points_(problem.num_points()) {
    upload_structure(problem);
    state = make_state();
    trial = make_state();
}

const std::string& DeviceProblem::camera_model_path(int32_t model) {
    static const std::vector<std::string> paths = [] {
        std::vector<std::string> made;
        for (const CameraModel& camera_model : camera_models)
            made.push_back(text("camera_models/", camera_model.name, ".clh"));
        return made;
    }();
    return paths[static_cast<size_t>(model)];
}

template <class Value>
Buffer DeviceProblem::upload_values(const std::vector<Value>& values, const char* label) {
    Buffer buffer(queue_, values.size() * sizeof(Value), label);
    buffer.write(values.data(), buffer.bytes());
    return buffer;
}

void DeviceProblem::upload_structure(const Problem& problem) {
    std::vector<int32_t> image_camera, image_intrinsics, camera_num_params;
    for (const Image& image : problem.images) {
        image_camera.push_back(image.camera);
        image_intrinsics.push_back(layout_.intrinsics_offset[image.camera]);
    }
    for (const Camera& camera : problem.cameras) camera_num_params.push_back(camera.num_params());
    pose_offsets = upload_values(layout_.pose_offset, "pose offsets");
    intrinsics_offsets = upload_values(image_intrinsics, "intrinsics offsets");
    scale_f = upload_values(layout_.scale, "image-camera scales");
    image_camera_ = upload_values(image_camera, "cameras of images");
    camera_num_params_ = upload_values(camera_num_params, "camera sizes");
    camera_offsets_ = upload_values(layout_.intrinsics_offset, "camera offsets");

    std::vector<int32_t> offset, size, matrix;
    for (const ParameterBlock& block : layout_.blocks) {
        offset.push_back(block.offset);
        size.push_back(block.size);
        matrix.push_back(block.matrix);
    }
    block_offset = upload_values(offset, "block offsets");
    block_size = upload_values(size, "block sizes");
    matrix_offset = upload_values(matrix, "matrix offsets");

    for (const Chunk& chunk : tiles_.chunks) {
        DeviceChunk device_chunk;
        device_chunk.num_tiles = chunk.num_tiles();
        device_chunk.num_point_slots = chunk.num_point_slots;
        if (!chunks_.empty())
            device_chunk.first_tile = chunks_.back().first_tile + chunks_.back().num_tiles;
        for (int32_t tile = 0; tile < chunk.num_tiles(); ++tile) {
            const int32_t end =
                tile + 1 < chunk.num_tiles() ? chunk.tile_points[tile + 1] : chunk.num_point_slots;
            device_chunk.max_tile_slots =
                std::max(device_chunk.max_tile_slots, end - chunk.tile_points[tile]);
        }
        device_chunk.tile_points = upload_values(chunk.tile_points, "tiles");
        device_chunk.tile_num_points = upload_values(chunk.tile_num_points, "tiles");
        if (has_point_scales(problem)) {
            const int64_t n = chunk.num_point_slots;
            std::vector<double> scale(static_cast<size_t>(3 * n), 1.0);
            for (int64_t slot = 0; slot < n; ++slot) {
                if (chunk.slot_point[slot] < 0) continue;
                const auto of_point = point_scale(problem, chunk.slot_point[slot]);
                for (int k = 0; k < 3; ++k) scale[k * n + slot] = of_point[k];
            }
            device_chunk.point_scale = upload_values(scale, "point scales");
        }
        for (const Segment& segment : chunk.segments)
            device_chunk.segments.push_back(upload_segment(problem, segment));
        chunks_.push_back(std::move(device_chunk));
    }
}

DeviceSegment DeviceProblem::upload_segment(const Problem& problem, const Segment& segment) {
    DeviceSegment device_segment;
    device_segment.model = segment.model;
    device_segment.num_columns = segment.num_columns();
    device_segment.num_runs = segment.num_runs();
    device_segment.num_slots = segment.num_slots();
    device_segment.num_blocks = static_cast<int32_t>(segment.block.size());
    device_segment.tile_runs = upload_values(segment.tile_runs, "runs");
    device_segment.run_image = upload_values(segment.run_image, "runs");
    device_segment.run_slots = upload_values(segment.run_slots, "runs");
    device_segment.slot_point = upload_values(segment.slot_point, "observations' points");

    std::vector<int32_t> offset, size, matrix;
    for (int32_t block : segment.block) {
        offset.push_back(layout_.blocks[block].offset);
        size.push_back(layout_.blocks[block].size);
        matrix.push_back(layout_.blocks[block].matrix);
    }
    device_segment.block_offset = upload_values(offset, "block offsets");
    device_segment.block_size = upload_values(size, "block sizes");
    device_segment.matrix_offset = upload_values(matrix, "matrix offsets");
    device_segment.block_column = upload_values(segment.block_column, "block columns");
    device_segment.block_runs = upload_values(segment.block_runs, "block runs");
    device_segment.runs = upload_values(segment.runs, "block runs");

    const auto fill = [&](Buffer& buffer, int rows, auto&& value) {
        buffer = Buffer(queue_, sizeof(double) * static_cast<uint64_t>(rows * segment.num_slots()),
                        "observations");
        const auto mapping = buffer.map_write<double>();
        detail::walk_slots(segment, rows, mapping.data(),
                           [&](int64_t observation, int, auto&& slot) {
                               for (int row = 0; row < rows; ++row)
                                   slot(row) = value(observation, row);
                           });
        detail::clear_padding(segment, rows, mapping.data());
    };
    fill(device_segment.xy, 2, [&](int64_t observation, int row) {
        const Observation& o = problem.observations[observation];
        return row == 0 ? o.x : o.y;
    });
    if (!problem.whitening.empty())
        fill(device_segment.whitening, 3,
             [&](int64_t observation, int row) { return problem.whitening[observation][row]; });
    return device_segment;
}

State DeviceProblem::make_state() {
    State made;
    made.poses = Buffer(queue_, static_cast<uint64_t>(num_images_) * 7 * sizeof(double), "poses");
    made.camera_params =
        Buffer(queue_, static_cast<uint64_t>(num_cameras_) * max_camera_params * sizeof(double),
               "camera parameters");
    made.points = make_point_rows(3, sizeof(double), "points");
    made.image_records = Buffer(
        queue_, static_cast<uint64_t>(num_images_) * (12 + max_camera_params) * sizeof(double),
        "image records");
    return made;
}

std::vector<Buffer> DeviceProblem::make_point_rows(int rows, size_t value_bytes,
                                                   const std::string& label) {
    std::vector<Buffer> buffers;
    for (const Chunk& chunk : tiles_.chunks) {
        buffers.emplace_back(queue_,
                             static_cast<uint64_t>(chunk.num_point_slots) *
                                 static_cast<uint64_t>(rows) * value_bytes,
                             label);
        buffers.back().fill_zero();
    }
    return buffers;
}

Vector DeviceProblem::make_reduced_vector(const std::string& label) {
    Vector vector;
    vector.f = Buffer(queue_, static_cast<uint64_t>(layout_.num_f) * sizeof(double), label);
    vector.f.fill_zero();
    return vector;
}

Vector DeviceProblem::make_vector(const std::string& label) {
    Vector vector = make_reduced_vector(label);
    vector.e = make_point_rows(3, sizeof(double), label);
    return vector;
}

void DeviceProblem::upload_state(const Problem& problem) {
    {
        const auto poses = state.poses.map_write<double>();
        for (int32_t i = 0; i < num_images_; ++i) {
            const Pose& pose = problem.images[i].pose;
            std::copy(pose.rotation.begin(), pose.rotation.end(), &poses[7 * int64_t{i}]);
            std::copy(pose.translation.begin(), pose.translation.end(), &poses[7 * int64_t{i} + 4]);
        }
        const auto params = state.camera_params.map_write<double>();
        for (int32_t c = 0; c < num_cameras_; ++c)
            std::copy(problem.cameras[c].params.begin(), problem.cameras[c].params.end(),
                      &params[max_camera_params * int64_t{c}]);
    }
    for (size_t c = 0; c < chunks_.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        const auto rows = state.points[c].map_write<double>();
        for_slots(n, [&](int64_t slot) {
            for (int k = 0; k < 3; ++k)
                rows[k * n + slot] =
                    slot_point[slot] < 0 ? 0.0 : problem.points[slot_point[slot]][k];
        });
    }
}

void DeviceProblem::download_state(Problem& problem) const {
    // All is mapped before the first value is written, so that an error leaves the state whole.
    using Rows = Buffer::Mapping<const double>;
    const Rows poses = state.poses.map_read<double>();
    const Rows params = state.camera_params.map_read<double>();
    std::vector<std::unique_ptr<const Rows>> points(chunks_.size());
    for (size_t c = 0; c < chunks_.size(); ++c)
        points[c].reset(new Rows(state.points[c].map_read<double>()));

    for (int32_t i = 0; i < num_images_; ++i) {
        Pose& pose = problem.images[i].pose;
        std::copy_n(&poses[7 * int64_t{i}], 4, pose.rotation.begin());
        std::copy_n(&poses[7 * int64_t{i} + 4], 3, pose.translation.begin());
    }
    for (int32_t c = 0; c < num_cameras_; ++c)
        std::copy_n(&params[max_camera_params * int64_t{c}], max_camera_params,
                    problem.cameras[c].params.begin());
    for (size_t c = 0; c < chunks_.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        for_slots(n, [&](int64_t slot) {
            if (slot_point[slot] >= 0)
                for (int k = 0; k < 3; ++k)
                    problem.points[slot_point[slot]][k] = (*points[c])[k * n + slot];
        });
    }
}

void DeviceProblem::upload(const double* values, Vector& vector) const {
    vector.f.write(values, vector.f.bytes());
    for (size_t c = 0; c < vector.e.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        const auto rows = vector.e[c].map_write<double>();
        for_slots(n, [&](int64_t slot) {
            for (int k = 0; k < 3; ++k)
                rows[k * n + slot] =
                    slot_point[slot] < 0
                        ? 0.0
                        : values[layout_.num_f + 3 * int64_t{slot_point[slot]} + k];
        });
    }
}

void DeviceProblem::download(const Vector& vector, double* values) const {
    vector.f.read(values, vector.f.bytes());
    for (size_t c = 0; c < vector.e.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        const auto rows = vector.e[c].map_read<double>();
        for_slots(n, [&](int64_t slot) {
            if (slot_point[slot] >= 0)
                for (int k = 0; k < 3; ++k)
                    values[layout_.num_f + 3 * int64_t{slot_point[slot]} + k] = rows[k * n + slot];
        });
    }
}

void DeviceProblem::update(const Vector& step) {
    const auto launch_rows = [&](const char* name, int64_t rows, const auto&... arguments) {
        queue_.launch(
            Step::vector,
            queue_.kernel("state.cl", name, text("-DMAX_CAMERA_PARAMS=", max_camera_params)),
            std::min<int64_t>(queue_.tuning().vector_groups, rows), arguments...);
    };
    launch_rows("update_images", num_images_, num_images_, pose_offsets, step.f, state.poses,
                trial.poses);
    launch_rows("update_cameras", num_cameras_, num_cameras_, camera_offsets_, camera_num_params_,
                step.f, state.camera_params, trial.camera_params);
    for (size_t c = 0; c < step.e.size(); ++c) {
        const int32_t n = 3 * chunks_[c].num_point_slots;
        launch_rows("update_points", n, n, step.e[c], state.points[c], trial.points[c]);
    }
}

void DeviceProblem::update_image_records(const State& of) {
    queue_.launch(
        Step::vector,
        queue_.kernel("state.cl", "image_records", text("-DMAX_CAMERA_PARAMS=", max_camera_params)),
        std::min<int64_t>(queue_.tuning().vector_groups, num_images_), num_images_, of.poses,
        image_camera_, of.camera_params, of.image_records);
}

}  // namespace clba
