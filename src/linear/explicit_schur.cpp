// SPDX-License-Identifier: Apache-2.0
#include "linear/explicit_schur.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "base/stopwatch.hpp"
#include "linear/prior_terms.hpp"
#include "linear/reduced_system.hpp"
#include "linear/rig_tangents.hpp"

namespace clba {
namespace {

constexpr int64_t blocks_per_group = 16;  // of kernels/schur_pairs.cl
static_assert(num_pose_params + max_camera_params <= 20, "rows of kernels/schur_pairs.cl");

// RECORD_BYTES of kernels/schur_records.clh.
uint64_t record_bytes(int32_t max_columns, Precision precision) {
    const uint64_t image_bytes = 2 * static_cast<uint64_t>(max_columns) * real_bytes(precision);
    const uint64_t point_offset = (image_bytes + 7) / 8 * 8;
    return (point_offset + 6 * wide_bytes(precision) + 63) / 64 * 64;
}

int32_t num_columns(const Problem& problem, int32_t image) {
    return num_pose_params + problem.cameras[problem.images[image].camera].num_params();
}

// First number of each block of pairs, and their end.
std::vector<int64_t> block_offsets(const Problem& problem, const SchurStructure& structure) {
    std::vector<int64_t> offsets = {0};
    for (int32_t i = 0; i < problem.num_images(); ++i)
        for (int64_t k = structure.row_begin[i]; k < structure.row_begin[i + 1]; ++k)
            offsets.push_back(offsets.back() + int64_t{num_columns(problem, i)} *
                                                   num_columns(problem, structure.columns[k]));
    return offsets;
}

}  // namespace

SliceSize ExplicitSchur::slice_size(DeviceProblem& problem) {
    constexpr int64_t records_per_unit = 1 << 16, most_records = 1 << 20;
    const int32_t units = std::max(problem.queue().context().device().compute_units, 1);
    return {units, std::min(units * records_per_unit, most_records)};
}

ExplicitSchur::ExplicitSchur(const Problem& problem, NormalEquations& equations,
                             SchurStructure structure)
    : equations_(equations),
      structure_(std::move(structure)),
      block_offset_(block_offsets(problem, structure_)),
      pattern_(schur_pattern(problem, equations.problem().layout(), structure_)),
      cholesky_(pattern_, num_workers()),
      has_shared_cameras_(equations.problem().layout().num_shared_cameras > 0 ||
                          equations.problem().rigs() != nullptr),
      sensors_(problem.rigs.sensors) {
    DeviceProblem& device = equations.problem();
    Queue& queue = device.queue();
    const ParameterLayout& layout = device.layout();
    const auto is_constant = [](double scale) { return !(scale > 0); };
    if (std::any_of(layout.scale.begin(), layout.scale.end(), is_constant))
        std::transform(layout.scale.begin(), layout.scale.end(), std::back_inserter(is_constant_),
                       is_constant);
    if (has_shared_cameras_) list_targets(problem, pattern_);
    if (device.priors()) list_prior_targets();
    if (!is_in_place()) values_.resize(static_cast<size_t>(cholesky_.num_values()));
    std::vector<int32_t> rows, columns;
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        for (int64_t k = structure_.row_begin[i]; k < structure_.row_begin[i + 1]; ++k) {
            rows.push_back(num_columns(problem, i));
            columns.push_back(num_columns(problem, structure_.columns[k]));
            max_columns_ = std::max(max_columns_, rows.back());
        }
    }
    block_rows_ = Buffer(queue, rows, "blocks of S");
    block_columns_ = Buffer(queue, columns, "blocks of S");
    block_offsets_ = Buffer(queue, block_offset_, "blocks of S");
    const Precision precision = device.precision();
    blocks_ = Buffer(queue, static_cast<uint64_t>(block_offset_.back()) * wide_bytes(precision),
                     "the Schur complement");
    int64_t most_records = 0;
    for (size_t s = 0; s < structure_.slices().size(); ++s) {
        most_records = std::max(most_records, structure_.slices()[s].num_records);
        const SchurStructure::Pairs pairs = structure_.list_pairs(s);
        slice_buffers_.push_back({static_cast<int32_t>(pairs.blocks.size()),
                                  Buffer(queue, pairs.blocks, "pairs of observations"),
                                  Buffer(queue, pairs.block_pairs, "pairs of observations"),
                                  Buffer(queue, pairs.pairs, "pairs of observations")});
    }
    structure_.forget_pairs();
    const auto records = static_cast<uint64_t>(most_records);
    // One more, as whole vectors are read of the last one.
    records_ = Buffer(queue, (records + 1) * record_bytes(max_columns_, precision),
                      "records of observations");
    b_ = device.make_reduced_vector("the reduced camera system");
    step_ = device.make_reduced_vector("the step");
    damping_.resize(static_cast<size_t>(layout.num_f));
    right_side_.resize(static_cast<size_t>(layout.num_f));
}

// Where an image has its camera to itself its block of S is the block of its pairs; else pose and
// intrinsics are parts of two, and the pose of an image in a rig is part of its frame's and its
// sensor's.
void ExplicitSchur::list_targets(const Problem& problem, const BlockPattern& pattern) {
    const ParameterLayout& layout = equations_.problem().layout();
    const auto parts_of = [&](int32_t image) {
        std::vector<ImagePart> parts(ParameterLayout::max_image_parts);
        parts.resize(static_cast<size_t>(
            layout.parts_of(image, problem.images[image].camera, parts.data())));
        return parts;
    };
    const auto sensor_of = [&](int32_t image, const ImagePart& part) {
        return part.is_of_frame ? layout.image_sensor[image] : -1;
    };
    for (int32_t i = 0; i < problem.num_images(); ++i) {
        for (int64_t k = structure_.row_begin[i]; k < structure_.row_begin[i + 1]; ++k) {
            const int32_t j = structure_.columns[k], stride = num_columns(problem, j);
            for (const ImagePart& a : parts_of(i)) {
                for (const ImagePart& b : parts_of(j)) {
                    // A block of an image with itself has its upper triangle in its lower one.
                    if (i == j && a.block < b.block) continue;
                    const int32_t row = std::max(a.block, b.block);
                    const auto begin = pattern.columns.begin() + pattern.row_begin[row];
                    const auto end = pattern.columns.begin() + pattern.row_begin[row + 1];
                    const auto entry = std::lower_bound(begin, end, std::min(a.block, b.block)) -
                                       pattern.columns.begin();
                    targets_.push_back(
                        {block_offset_[k] + int64_t{a.first_column} * stride + b.first_column,
                         cholesky_.value_offset(entry), stride, a.size, b.size, a.block < b.block,
                         i != j && a.block == b.block, sensor_of(i, a), sensor_of(j, b)});
                }
            }
        }
    }
}

// P has no entry outside of the blocks of S: its diagonal blocks, and those of two poses with a
// prior of their relative pose.
void ExplicitSchur::list_prior_targets() {
    const ParameterLayout& layout = equations_.problem().layout();
    const reference::ImagePriors& priors = equations_.problem().priors()->image_priors();
    std::vector<int32_t> block_of(static_cast<size_t>(layout.num_f));
    for (int32_t b = 0; b < pattern_.num_blocks(); ++b)
        std::fill_n(block_of.begin() + layout.blocks[b].offset, layout.blocks[b].size, b);
    for (size_t i = 0; i < priors.rows().size(); ++i) {
        const int32_t row = block_of[priors.rows()[i]];
        const int32_t r = priors.rows()[i] - layout.blocks[row].offset;
        const auto begin = pattern_.columns.begin() + pattern_.row_begin[row];
        const auto end = pattern_.columns.begin() + pattern_.row_begin[row + 1];
        for (int32_t k = priors.row_begin()[i]; k < priors.row_begin()[i + 1]; ++k) {
            const int32_t column = block_of[priors.columns()[k]];
            if (column > row) continue;
            const int64_t entry = std::lower_bound(begin, end, column) - pattern_.columns.begin();
            const int32_t c = priors.columns()[k] - layout.blocks[column].offset;
            prior_targets_.push_back(
                {cholesky_.value_offset(entry) + int64_t{r} * layout.blocks[column].size + c, k});
        }
    }
}

void ExplicitSchur::form_blocks() {
    DeviceProblem& device = equations_.problem();
    Queue& queue = device.queue();
    Jacobian& jacobian = equations_.jacobian;
    blocks_.fill_zero();
    const std::string max_columns = text(" -DMAX_COLUMNS=", max_columns_);
    const std::string defines = precision_defines(device.precision()) + max_columns;
    std::vector<size_t> first_segment = {0};  // of each chunk
    for (const DeviceChunk& chunk : device.chunks())
        first_segment.push_back(first_segment.back() + chunk.segments.size());
    for (size_t k = 0; k < slice_buffers_.size(); ++k) {
        if (slice_buffers_[k].num_blocks == 0) continue;
        const SchurStructure::Slice& slice = structure_.slices()[k];
        const DeviceChunk& chunk = device.chunks()[slice.chunk];
        for (size_t s = 0; s < chunk.segments.size(); ++s) {
            const size_t index = first_segment[slice.chunk] + s;
            device.launch_groups(slice.num_tiles, Step::preconditioner, "schur_records.cl",
                                 "schur_records", jacobian.defines(index) + max_columns, chunk,
                                 chunk.segments[s], device.state.image_records,
                                 jacobian.rows()[index], equations_.point_factors()[slice.chunk],
                                 slice.first_tile, slice.first_record[s], records_);
        }
        const SliceBuffers& buffers = slice_buffers_[k];
        queue.launch(Step::preconditioner, queue.kernel("schur_pairs.cl", "schur_pairs", defines),
                     (buffers.num_blocks + blocks_per_group - 1) / blocks_per_group,
                     buffers.num_blocks, buffers.blocks, block_rows_, block_columns_,
                     block_offsets_, buffers.block_pairs, buffers.pairs, records_, blocks_);
    }
}

void ExplicitSchur::leave_out(const std::vector<char>& is_left_out, double* values) const {
    const ParameterLayout& layout = equations_.problem().layout();
    for (int32_t row = 0; row < pattern_.num_blocks(); ++row) {
        const ParameterBlock& block = layout.blocks[row];
        for (int64_t entry = pattern_.row_begin[row]; entry < pattern_.row_begin[row + 1];
             ++entry) {
            const ParameterBlock& other = layout.blocks[pattern_.columns[entry]];
            double* at = values + cholesky_.value_offset(entry);
            for (int32_t r = 0; r < block.size; ++r)
                for (int32_t c = 0; c < other.size; ++c)
                    if (is_left_out[block.offset + r] || is_left_out[other.offset + c])
                        at[r * other.size + c] = block.offset + r == other.offset + c ? 1.0 : 0.0;
        }
    }
}

// Adds priors and lambda D^2, and leaves constants out.
void ExplicitSchur::finish_values(double lambda, double* values) {
    const ParameterLayout& layout = equations_.problem().layout();
    for (const PriorTarget& target : prior_targets_)
        values[target.value] += equations_.problem().priors()->values()[target.source];
    for (int32_t row = 0; row < pattern_.num_blocks(); ++row) {
        const ParameterBlock& block = layout.blocks[row];
        double* diagonal = values + cholesky_.value_offset(pattern_.row_begin[row + 1] - 1);
        for (int32_t k = 0; k < block.size; ++k)
            diagonal[k * (block.size + 1)] += lambda * damping_[block.offset + k];
    }
    if (!is_constant_.empty()) leave_out(is_constant_, values);
}

template <class Wide>
void ExplicitSchur::add_targets(const Wide* blocks) {
    using Tangent = Eigen::Matrix<double, num_pose_params, num_pose_params, Eigen::RowMajor>;
    std::vector<Tangent> tangents;
    for (const Pose& sensor : sensors_)
        tangents.push_back(Eigen::Map<const Tangent>(frame_tangent(sensor).data()));
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> part;
    std::fill(values_.begin(), values_.end(), 0.0);
    for (const Target& target : targets_) {
        const Wide* from = blocks + target.source;
        double* to = values_.data() + target.value;
        const int32_t stride = target.is_transposed ? target.rows : target.columns;
        const auto add = [&](auto&& value_at) {
            for (int32_t r = 0; r < target.rows; ++r) {
                for (int32_t c = 0; c < target.columns; ++c) {
                    const double value = value_at(r, c);
                    to[target.is_transposed ? c * stride + r : r * stride + c] += value;
                    if (target.is_added_both_ways) to[c * stride + r] += value;
                }
            }
        };
        const auto source = [&](int32_t r, int32_t c) {
            return static_cast<double>(from[r * target.source_stride + c]);
        };
        if (target.row_sensor < 0 && target.column_sensor < 0) {
            add(source);
            continue;
        }
        part.resize(target.rows, target.columns);
        for (int32_t r = 0; r < target.rows; ++r)
            for (int32_t c = 0; c < target.columns; ++c) part(r, c) = source(r, c);
        if (target.row_sensor >= 0) part = (tangents[target.row_sensor].transpose() * part).eval();
        if (target.column_sensor >= 0) part = (part * tangents[target.column_sensor]).eval();
        add([&](int32_t r, int32_t c) { return part(r, c); });
    }
}

void ExplicitSchur::use_values(double lambda, const std::function<void(double*)>& use) {
    DeviceProblem& device = equations_.problem();
    device.read_wide(equations_.damping().f, damping_, damping_.size());
    if (const RigTangents* rigs = device.rigs())
        sensors_ = rigs->download_sensors(device.state, sensors_);
    if (is_in_place()) {
        const auto blocks = blocks_.map_update<double>();
        finish_values(lambda, blocks.data());
        return use(blocks.data());
    }
    with_wide(device.precision(), [&](auto wide) {
        const auto blocks = blocks_.map_read<decltype(wide)>();
        if (!has_shared_cameras_) {
            std::copy_n(blocks.data(), values_.size(), values_.begin());
            return;
        }
        add_targets(blocks.data());
    });
    finish_values(lambda, values_.data());
    use(values_.data());
}

LinearSolution ExplicitSchur::solve(double lambda, const StopTest& stop) {
    LinearSolution solution;
    solution.num_iterations = 1;
    solution.num_indefinite_blocks = equations_.factor_points(lambda);
    if (solution.num_indefinite_blocks > 0) return solution;
    form_blocks();
    bool is_definite = false;
    use_values(lambda, [&](const double* values) {
        const Stopwatch watch;
        is_definite = cholesky_.factorize(values, stop);
        solution.factorization_seconds = watch.seconds();
    });
    if (!is_definite) {
        solution.stopped = stop.cause();
        solution.num_indefinite_blocks = solution.stopped == StopCause::none;
        return solution;
    }
    step_.fill_zero();
    reduced_right_side(equations_, step_, b_);
    DeviceProblem& device = equations_.problem();
    device.read_wide(b_.f, right_side_, right_side_.size());
    const ParameterLayout& layout = device.layout();
    for (int32_t k = 0; k < layout.num_f; ++k)
        if (!(layout.scale[k] > 0)) right_side_[k] = 0;
    const Stopwatch watch;
    cholesky_.solve(right_side_.data(), right_side_.data());
    solution.factorization_seconds += watch.seconds();
    device.write_wide(right_side_, step_.f);
    solution.is_usable = std::all_of(right_side_.begin(), right_side_.end(),
                                     [](double x) { return std::isfinite(x); });
    if (solution.is_usable) take_reduced_step(equations_, step_, solution);
    return solution;
}

void ExplicitSchur::get_step(Vector& full) {
    get_reduced_step(equations_, step_, full);
}

}  // namespace clba
