// SPDX-License-Identifier: Apache-2.0
#include "linear/device_problem.hpp"

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "linear/prior_terms.hpp"
#include "linear/rig_tangents.hpp"

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

VisibilityTiles make_tiles(const Problem& problem, const ParameterLayout& layout,
                           const TileOptions& options) {
    if (layout.composed.empty()) return VisibilityTiles(problem, layout, options);
    return VisibilityTiles(problem, ParameterLayout::of_images(problem), options);
}

int32_t most_params(const Problem& problem) {
    int32_t most = 1;
    for (const Camera& camera : problem.cameras) most = std::max(most, camera.num_params());
    return most;
}

void require_double(const Context& context) {
    if (!context.device().has_double)
        fail(Status::no_device, context.device().name,
             " has no double precision, which the precisions double and mixed need; precision "
             "single does without");
}

}  // namespace

DeviceProblem::DeviceProblem(std::shared_ptr<Context> context, const Problem& problem,
                             Precision precision)
    : queue_(context),
      precision_(precision),
      layout_(problem),
      tiles_(make_tiles(problem, layout_, tile_options(*context, precision))),
      vectors_(queue_, precision),
      num_observations_(problem.num_observations()),
      num_images_(problem.num_images()),
      num_cameras_(problem.num_cameras()),
      num_points_(problem.num_points()),
      most_camera_params_(most_params(problem)) {
    if (precision == Precision::single)
        queue_.pass_floats();
    else
        require_double(*context);
    if (!layout_.composed.empty()) rigs_ = std::make_unique<RigTangents>(*this, problem);
    upload_structure(problem);
    state = make_state();
    trial = make_state();
    if (!problem.priors.empty()) priors_ = std::make_unique<PriorTerms>(*this, problem);
}

DeviceProblem::~DeviceProblem() = default;

const ParameterLayout& DeviceProblem::image_layout() const {
    return rigs_ ? rigs_->image_layout() : layout_;
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

Buffer DeviceProblem::upload_wide(const std::vector<double>& values, const char* label) {
    Buffer buffer(queue_, values.size() * wide_bytes(precision_), label);
    write_wide(values, buffer);
    return buffer;
}

void DeviceProblem::write_wide(const std::vector<double>& values, Buffer& buffer) const {
    for_wide([&](auto wide) {
        const std::vector<decltype(wide)> converted(values.begin(), values.end());
        buffer.write(converted.data(), buffer.bytes());
    });
}

void DeviceProblem::upload_structure(const Problem& problem) {
    std::vector<int32_t> image_camera, image_intrinsics, camera_num_params;
    for (const Image& image : problem.images) {
        image_camera.push_back(image.camera);
        image_intrinsics.push_back(image_layout().intrinsics_offset[image.camera]);
    }
    for (const Camera& camera : problem.cameras) camera_num_params.push_back(camera.num_params());
    pose_offsets = Buffer(queue_, image_layout().pose_offset, "pose offsets");
    intrinsics_offsets = Buffer(queue_, image_intrinsics, "intrinsics offsets");
    scale_f = upload_wide(layout_.scale, "image-camera scales");
    image_camera_ = Buffer(queue_, image_camera, "cameras of images");
    camera_num_params_ = Buffer(queue_, camera_num_params, "camera sizes");
    camera_offsets_ = Buffer(queue_, layout_.intrinsics_offset, "camera offsets");

    std::vector<int32_t> offset, size, matrix;
    for (const ParameterBlock& block : layout_.blocks) {
        offset.push_back(block.offset);
        size.push_back(block.size);
        matrix.push_back(block.matrix);
    }
    block_offset = Buffer(queue_, offset, "block offsets");
    block_size = Buffer(queue_, size, "block sizes");
    matrix_offset = Buffer(queue_, matrix, "matrix offsets");

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
        device_chunk.tile_points = Buffer(queue_, chunk.tile_points, "tiles");
        device_chunk.tile_num_points = Buffer(queue_, chunk.tile_num_points, "tiles");
        upload_point_scales(problem, chunk, device_chunk);
        for (const Segment& segment : chunk.segments)
            device_chunk.segments.push_back(upload_segment(segment));
        upload_blocks(chunk, device_chunk);
        chunks_.push_back(std::move(device_chunk));
    }
    upload_all_measurements(problem);
}

void DeviceProblem::upload_point_scales(const Problem& problem, const Chunk& chunk,
                                        DeviceChunk& device_chunk) {
    device_chunk.point_scale = Buffer();
    if (!has_point_scales(problem)) return;
    const int64_t n = chunk.num_point_slots;
    std::vector<double> scale(static_cast<size_t>(3 * n), 1.0);
    for (int64_t slot = 0; slot < n; ++slot) {
        if (chunk.slot_point[slot] < 0) continue;
        const auto of_point = point_scale(problem, chunk.slot_point[slot]);
        for (int k = 0; k < 3; ++k) scale[k * n + slot] = of_point[k];
    }
    device_chunk.point_scale = upload_wide(scale, "point scales");
}

void DeviceProblem::upload_all_measurements(const Problem& problem) {
    for (size_t c = 0; c < chunks_.size(); ++c)
        for (size_t s = 0; s < chunks_[c].segments.size(); ++s)
            upload_measurements(problem, tiles_.chunks[c].segments[s], chunks_[c].segments[s]);
}

void DeviceProblem::refresh(const Problem& problem) {
    if (is_stale.scales) {
        layout_ = ParameterLayout(problem);
        write_wide(layout_.scale, scale_f);
        for (size_t c = 0; c < chunks_.size(); ++c)
            upload_point_scales(problem, tiles_.chunks[c], chunks_[c]);
        if (priors_) priors_ = std::make_unique<PriorTerms>(*this, problem);
        is_stale.scales = false;
    }
    if (is_stale.measurements) {
        upload_all_measurements(problem);
        is_stale.measurements = false;
    }
}

DeviceSegment DeviceProblem::upload_segment(const Segment& segment) {
    DeviceSegment device_segment;
    device_segment.model = segment.model;
    device_segment.num_columns = segment.num_columns();
    device_segment.num_runs = segment.num_runs();
    device_segment.num_slots = segment.num_slots();
    device_segment.tile_runs = Buffer(queue_, segment.tile_runs, "runs");
    device_segment.run_image = Buffer(queue_, segment.run_image, "runs");
    device_segment.run_slots = Buffer(queue_, segment.run_slots, "runs");
    device_segment.slot_point = Buffer(queue_, segment.slot_point, "observations' points");
    return device_segment;
}

void DeviceProblem::upload_blocks(const Chunk& chunk, DeviceChunk& device_chunk) {
    std::vector<int32_t> offset, size, column, num_columns, first_sum, first_run{0}, runs, matrix;
    int32_t next_sum = 0;
    for (size_t s = 0; s < chunk.segments.size(); ++s) {
        const Segment& segment = chunk.segments[s];
        DeviceSegment& device_segment = device_chunk.segments[s];
        device_segment.first_block = static_cast<int32_t>(offset.size());
        device_segment.num_blocks = static_cast<int32_t>(segment.block.size());
        device_segment.first_sum = next_sum;
        for (size_t b = 0; b < segment.block.size(); ++b) {
            const ParameterBlock& block = image_layout().blocks[segment.block[b]];
            offset.push_back(block.offset);
            size.push_back(block.size);
            matrix.push_back(block.matrix);
            column.push_back(segment.block_column[b]);
            num_columns.push_back(segment.num_columns());
            first_sum.push_back(next_sum);
            runs.insert(runs.end(), segment.runs.begin() + segment.block_runs[b],
                        segment.runs.begin() + segment.block_runs[b + 1]);
            first_run.push_back(static_cast<int32_t>(runs.size()));
        }
        next_sum += segment.num_runs() * segment.num_columns();
    }
    DeviceBlocks& blocks = device_chunk.blocks;
    blocks.num = static_cast<int32_t>(offset.size());
    blocks.offset = Buffer(queue_, offset, "block offsets");
    blocks.size = Buffer(queue_, size, "block sizes");
    blocks.column = Buffer(queue_, column, "block columns");
    blocks.num_columns = Buffer(queue_, num_columns, "block columns");
    blocks.first_sum = Buffer(queue_, first_sum, "block runs");
    blocks.first_run = Buffer(queue_, first_run, "block runs");
    blocks.runs = Buffer(queue_, runs, "block runs");
    blocks.matrix_offset = Buffer(queue_, matrix, "matrix offsets");
}

void DeviceProblem::upload_measurements(const Problem& problem, const Segment& segment,
                                        DeviceSegment& device_segment) {
    const auto fill = [&](Buffer& buffer, int rows, auto&& value) {
        if (!buffer)
            buffer = Buffer(queue_,
                            wide_bytes(precision_) * static_cast<uint64_t>(rows) *
                                static_cast<uint64_t>(segment.num_slots()),
                            "observations");
        for_wide([&](auto wide) {
            using Wide = decltype(wide);
            const auto mapping = buffer.map_write<Wide>();
            detail::walk_slots(segment, rows, mapping.data(),
                               [&](int64_t observation, int, auto&& slot) {
                                   for (int row = 0; row < rows; ++row)
                                       slot(row) = static_cast<Wide>(value(observation, row));
                               });
            detail::clear_padding(segment, rows, mapping.data());
        });
    };
    fill(device_segment.xy, 2, [&](int64_t observation, int row) {
        const Observation& o = problem.observations[observation];
        return row == 0 ? o.x : o.y;
    });
    if (problem.whitening.empty())
        device_segment.whitening = Buffer();
    else
        fill(device_segment.whitening, 3,
             [&](int64_t observation, int row) { return problem.whitening[observation][row]; });
}

State DeviceProblem::make_state() {
    State made;
    const size_t bytes = wide_bytes(precision_);
    made.poses = Buffer(
        queue_, static_cast<uint64_t>(num_images_) * static_cast<uint64_t>(pose_values()) * bytes,
        "poses");
    made.camera_params = Buffer(
        queue_,
        static_cast<uint64_t>(num_cameras_) * static_cast<uint64_t>(most_camera_params_) * bytes,
        "camera parameters");
    made.points = make_point_rows(3 * position_parts(precision_), bytes, "points");
    made.image_records =
        Buffer(queue_,
               static_cast<uint64_t>(num_images_) * bytes *
                   static_cast<uint64_t>(9 + 3 * position_parts(precision_) + most_camera_params_),
               "image records");
    if (rigs_) rigs_->add_buffers(made);
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

Buffer DeviceProblem::make_f(const ParameterLayout& layout, const std::string& label) {
    Buffer f(queue_, static_cast<uint64_t>(layout.num_f) * wide_bytes(precision_), label);
    f.fill_zero();
    return f;
}

Vector DeviceProblem::make_reduced_vector(const std::string& label) {
    Vector vector;
    vector.f = make_f(layout_, label);
    return vector;
}

Vector DeviceProblem::make_vector(const std::string& label) {
    Vector vector = make_reduced_vector(label);
    vector.e = make_point_rows(3, wide_bytes(precision_), label);
    return vector;
}

void DeviceProblem::upload_state(const Problem& problem) {
    for_wide([&](auto wide) {
        using Wide = decltype(wide);
        {
            const auto poses = state.poses.map_write<Wide>();
            for (int32_t i = 0; i < num_images_; ++i)
                upload_pose(problem.images[i].pose, &poses[int64_t{pose_values()} * i]);
            const auto params = state.camera_params.map_write<Wide>();
            for (int32_t c = 0; c < num_cameras_; ++c)
                for (int32_t k = 0; k < most_camera_params_; ++k)
                    params[most_camera_params_ * int64_t{c} + k] =
                        static_cast<Wide>(problem.cameras[c].params[k]);
        }
        for (size_t c = 0; c < chunks_.size(); ++c) {
            const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
            const auto n = static_cast<int64_t>(slot_point.size());
            const auto rows = state.points[c].map_write<Wide>();
            for_slots(n, [&](int64_t slot) {
                for (int k = 0; k < 3; ++k)
                    split_position(slot_point[slot] < 0 ? 0.0 : problem.points[slot_point[slot]][k],
                                   &rows[k * n + slot], 3 * n);
            });
        }
    });
    if (rigs_) rigs_->upload(problem, state);
}

void DeviceProblem::download_state(Problem& problem) const {
    for_wide([&](auto wide) {
        using Wide = decltype(wide);
        // All is mapped before the first value is written, so that an error leaves the state whole.
        using Rows = Buffer::Mapping<const Wide>;
        const Rows poses = state.poses.map_read<Wide>();
        const Rows params = state.camera_params.map_read<Wide>();
        std::vector<std::unique_ptr<const Rows>> points(chunks_.size());
        for (size_t c = 0; c < chunks_.size(); ++c)
            points[c].reset(new Rows(state.points[c].map_read<Wide>()));

        copy_images(poses.data(), params.data(), problem.images, problem.cameras);
        take_frames_of_images(layout_.composed, problem);
        if (rigs_) rigs_->download(state, problem);
        for (size_t c = 0; c < chunks_.size(); ++c) {
            const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
            const auto n = static_cast<int64_t>(slot_point.size());
            for_slots(n, [&](int64_t slot) {
                if (slot_point[slot] >= 0)
                    for (int k = 0; k < 3; ++k)
                        join_position(&(*points[c])[k * n + slot], 3 * n,
                                      problem.points[slot_point[slot]][k]);
            });
        }
    });
}

size_t DeviceProblem::num_state_values() const {
    uint64_t bytes = 0;
    for_pose_buffers(state, [&](const Buffer& buffer) { bytes += buffer.bytes(); });
    return static_cast<size_t>(bytes) / wide_bytes(precision_) +
           3 * static_cast<size_t>(position_parts(precision_)) * static_cast<size_t>(num_points_);
}

std::vector<double> DeviceProblem::state_values() const {
    std::vector<double> values(num_state_values());
    double* next = values.data();
    for_wide([&](auto wide) {
        for_pose_buffers(state, [&](const Buffer& buffer) {
            const auto mapping = buffer.map_read<decltype(wide)>();
            next = std::copy_n(mapping.data(), buffer.bytes() / sizeof wide, next);
        });
    });
    read_points(state.points, 3 * position_parts(precision_), next);
    return values;
}

void DeviceProblem::set_state_values(const std::vector<double>& values) {
    const double* next = values.data();
    for_wide([&](auto wide) {
        using Wide = decltype(wide);
        for_pose_buffers(state, [&](Buffer& buffer) {
            const auto mapping = buffer.map_write<Wide>();
            const size_t count = buffer.bytes() / sizeof wide;
            std::transform(next, next + count, mapping.data(),
                           [](double value) { return static_cast<Wide>(value); });
            next += count;
        });
    });
    write_points(next, 3 * position_parts(precision_), state.points);
}

void DeviceProblem::read_points(const std::vector<Buffer>& buffers, int rows,
                                double* values) const {
    for (size_t c = 0; c < buffers.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        for_wide([&](auto wide) {
            const auto mapping = buffers[c].map_read<decltype(wide)>();
            for_slots(n, [&](int64_t slot) {
                for (int k = 0; slot_point[slot] >= 0 && k < rows; ++k)
                    values[rows * int64_t{slot_point[slot]} + k] = mapping[k * n + slot];
            });
        });
    }
}

void DeviceProblem::write_points(const double* values, int rows,
                                 std::vector<Buffer>& buffers) const {
    for (size_t c = 0; c < buffers.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        for_wide([&](auto wide) {
            using Wide = decltype(wide);
            const auto mapping = buffers[c].map_update<Wide>();
            for_slots(n, [&](int64_t slot) {
                for (int k = 0; slot_point[slot] >= 0 && k < rows; ++k)
                    mapping[k * n + slot] =
                        static_cast<Wide>(values[rows * int64_t{slot_point[slot]} + k]);
            });
        });
    }
}

template <class Wide>
void DeviceProblem::copy_images(const Wide* poses, const Wide* params, std::vector<Image>& images,
                                std::vector<Camera>& cameras) const {
    for (int32_t i = 0; i < num_images_; ++i)
        download_pose(&poses[int64_t{pose_values()} * i], images[i].pose);
    for (int32_t c = 0; c < num_cameras_; ++c) {
        for (int32_t k = 0; k < most_camera_params_; ++k) {
            const Wide value = params[most_camera_params_ * int64_t{c} + k];
            double& kept = cameras[c].params[k];
            if (value != static_cast<Wide>(kept)) kept = value;
        }
    }
}

void DeviceProblem::download_images(const State& from, std::vector<Image>& images,
                                    std::vector<Camera>& cameras) const {
    for_wide([&](auto wide) {
        const auto poses = from.poses.map_read<decltype(wide)>();
        const auto params = from.camera_params.map_read<decltype(wide)>();
        copy_images(poses.data(), params.data(), images, cameras);
    });
}

void DeviceProblem::upload(const double* values, Vector& vector) const {
    write_wide(std::vector<double>(values, values + layout_.num_f), vector.f);
    for (size_t c = 0; c < vector.e.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        for_wide([&](auto wide) {
            using Wide = decltype(wide);
            const auto rows = vector.e[c].map_write<Wide>();
            for_slots(n, [&](int64_t slot) {
                const int64_t from = layout_.num_f + 3 * int64_t{slot_point[slot]};
                for (int k = 0; k < 3; ++k)
                    rows[k * n + slot] =
                        slot_point[slot] < 0 ? Wide(0) : static_cast<Wide>(values[from + k]);
            });
        });
    }
}

void DeviceProblem::download(const Vector& vector, double* values) const {
    std::vector<double> f(static_cast<size_t>(layout_.num_f));
    read_wide(vector.f, f, f.size());
    std::copy(f.begin(), f.end(), values);
    for (size_t c = 0; c < vector.e.size(); ++c) {
        const std::vector<int32_t>& slot_point = tiles_.chunks[c].slot_point;
        const auto n = static_cast<int64_t>(slot_point.size());
        for_wide([&](auto wide) {
            const auto rows = vector.e[c].template map_read<decltype(wide)>();
            for_slots(n, [&](int64_t slot) {
                const int64_t to = layout_.num_f + 3 * int64_t{slot_point[slot]};
                if (slot_point[slot] >= 0)
                    for (int k = 0; k < 3; ++k) values[to + k] = rows[k * n + slot];
            });
        });
    }
}

std::string DeviceProblem::defines() const {
    return precision_defines(precision_) + text(" -DMAX_CAMERA_PARAMS=", most_camera_params_);
}

void DeviceProblem::update(const Vector& step) {
    const auto launch_rows = [&](const char* name, int64_t rows, const auto&... arguments) {
        queue_.launch(Step::vector, queue_.kernel("state.cl", name, defines()),
                      std::min<int64_t>(queue_.tuning().vector_groups, rows), arguments...);
    };
    launch_rows("update_images", num_images_, num_images_,
                rigs_ ? rigs_->step_offsets() : pose_offsets, step.f, state.poses, trial.poses);
    if (rigs_) rigs_->move(step, state, trial);
    launch_rows("update_cameras", num_cameras_, num_cameras_, camera_offsets_, camera_num_params_,
                step.f, state.camera_params, trial.camera_params);
    for (size_t c = 0; c < step.e.size(); ++c) {
        const int32_t n = 3 * chunks_[c].num_point_slots;
        launch_rows("update_points", n, n, step.e[c], state.points[c], trial.points[c]);
    }
}

void DeviceProblem::update_image_records(const State& of) {
    queue_.launch(Step::vector, queue_.kernel("state.cl", "image_records", defines()),
                  std::min<int64_t>(queue_.tuning().vector_groups, num_images_), num_images_,
                  of.poses, image_camera_, of.camera_params, of.image_records);
    if (rigs_) rigs_->update_records(of);
}

}  // namespace clba
