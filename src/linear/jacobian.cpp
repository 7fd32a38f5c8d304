// SPDX-License-Identifier: Apache-2.0
#include "linear/jacobian.hpp"

#include <algorithm>

#include "base/error.hpp"
#include "linear/rig_tangents.hpp"

namespace clba {
namespace {

// Stages of kernels/products.cl.
constexpr int zero_stage = 1, forward_stage = 2, points_stage = 4, backward_stage = 8;
constexpr int all_stages = zero_stage | forward_stage | points_stage | backward_stage;

constexpr int sums_per_tile = 3;

}  // namespace

Jacobian::Jacobian(DeviceProblem& problem, JacobianForm form, const Loss& loss)
    : problem_(problem),
      queue_(problem.queue()),
      form_(form),
      has_loss_(loss.kind != LossKind::none),
      sums_options_(text(precision_defines(problem.precision()),
                         " -DRUN_REAL=", real_type(problem.precision()))),
      wide_sums_options_(text(precision_defines(problem.precision()),
                              " -DRUN_PARTS=2 -DRUN_REAL=", wide_type(problem.precision()))) {
    const size_t bytes = real_bytes(problem.precision());
    int most_tiles = 0;
    uint64_t most_sums = 0;
    for (const DeviceChunk& chunk : problem.chunks()) {
        most_tiles += 2 * chunk.num_tiles * static_cast<int>(chunk.segments.size());
        uint64_t wide_sums = 0;
        for (const DeviceSegment& segment : chunk.segments) {
            programs_.push_back(programs_of(segment));
            const CameraModel& model = camera_models[segment.model];
            const int rows = form == JacobianForm::stored
                                 ? num_block_rows(model)
                                 : num_view_rows(model, static_cast<bool>(segment.whitening));
            rows_.emplace_back(
                queue_,
                static_cast<uint64_t>(segment.num_slots) * static_cast<uint64_t>(rows) * bytes,
                "the Jacobian");
            // A gradient and a diagonal of all segments, or the triangle of a block of one.
            const auto n = static_cast<uint64_t>(segment.num_columns);
            const auto runs = static_cast<uint64_t>(segment.num_runs);
            wide_sums += 2 * n * runs * wide_bytes(problem.precision());
            most_sums = std::max(most_sums, n * (n + 1) / 2 * runs * bytes);
        }
        most_sums = std::max(most_sums, wide_sums);
    }
    point_real_ = problem.make_point_rows(3, bytes, "points in products");
    run_sums_ = Buffer(queue_, most_sums, "sums of runs");
    host_sums_.resize(static_cast<size_t>(sums_per_tile * most_tiles));
    tile_sums_ =
        Buffer(queue_, host_sums_.size() * wide_bytes(problem.precision()), "sums of tiles");
}

Jacobian::Programs Jacobian::programs_of(const DeviceSegment& segment) const {
    const Precision precision = problem_.precision();
    const std::string common = precision_defines(precision);
    const int columns = segment.num_columns;
    Programs programs;
    programs.rows = text(problem_.defines(), " -DSTORED=", form_ == JacobianForm::stored ? 1 : 0,
                         " -DWEIGHT_ROWS=",
                         segment.whitening ? 3
                         : has_loss_       ? 1
                                           : 0);
    programs.run_blocks = text(common, " -DCOLUMNS=", columns);
    return programs;
}

template <class Visit>
void Jacobian::for_each_segment(Visit&& visit) {
    size_t index = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c)
        for (const DeviceSegment& segment : problem_.chunks()[c].segments)
            visit(problem_.chunks()[c], segment, c, index++);
}

void Jacobian::reduce(Step step, const DeviceChunk& chunk, const std::string& options, int part,
                      Buffer& f) {
    const DeviceBlocks& blocks = chunk.blocks;
    if (blocks.num == 0) return;
    queue_.launch(step, queue_.kernel("reduce.cl", "reduce_runs", options), blocks.num,
                  blocks.offset, blocks.size, blocks.column, blocks.num_columns, blocks.first_sum,
                  blocks.first_run, blocks.runs, part, run_sums_, f);
}

void Jacobian::reduce_runs(Step step, const DeviceChunk& chunk, Buffer& f) {
    reduce(step, chunk, sums_options_, 0, f);
}

void Jacobian::reduce_wide_runs(const DeviceChunk& chunk, bool is_second, Buffer& f) {
    reduce(Step::jacobian, chunk, wide_sums_options_, is_second ? 1 : 0, f);
}

std::vector<Buffer>& Jacobian::product() {
    if (product_.empty())
        product_ = problem_.make_slot_rows(num_product_rows, real_bytes(problem_.precision()),
                                           "a product with the Jacobian");
    return product_;
}

std::vector<Buffer> Jacobian::blocks() {
    std::vector<Buffer> blocks = problem_.make_slot_rows(
        num_block_rows, real_bytes(problem_.precision()), "blocks of the Jacobian");
    for_each_segment([&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t, size_t i) {
        problem_.launch(Step::jacobian, "blocks.cl", "jacobian_rows", defines(i), chunk, segment,
                        problem_.state.image_records, rows_[i], blocks[i]);
    });
    return blocks;
}

// An F vector of parameters as kernels over observations read it.
const Buffer& Jacobian::of_images(const Buffer& f) {
    return problem_.rigs() ? problem_.rigs()->expand(f) : f;
}

// f += what add(sums) adds to an F vector of images.
template <class Add>
void Jacobian::add_of_images(Buffer& f, Add&& add) {
    RigTangents* const rigs = problem_.rigs();
    add(rigs ? rigs->zeroed_image_vector() : f);
    if (rigs) rigs->gather(f);
}

void Jacobian::multiply(const Vector& x) {
    const Buffer& f = of_images(x.f);
    for (size_t c = 0; c < point_real_.size(); ++c)
        problem_.vectors().to_real(x.e[c], point_real_[c]);
    product();
    for_each_segment(
        [&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c, size_t i) {
            problem_.launch(Step::jx, "products.cl", "jx", defines(i), chunk, segment,
                            problem_.pose_offsets, problem_.intrinsics_offsets,
                            problem_.state.image_records, rows_[i], f, point_real_[c], product_[i]);
        });
}

double Jacobian::squared_norm(const Vector& x) {
    multiply(x);
    return problem_.vectors().squared_norm(product_);
}

void Jacobian::add_transposed(Vector& x) {
    for (Buffer& e : point_real_) e.fill_zero();
    product();
    add_of_images(x.f, [&](Buffer& f) {
        size_t i = 0;
        for (size_t c = 0; c < point_real_.size(); ++c) {
            const DeviceChunk& chunk = problem_.chunks()[c];
            for (const DeviceSegment& segment : chunk.segments) {
                problem_.launch(Step::jty, "products.cl", "jty", defines(i), chunk, segment,
                                problem_.state.image_records, rows_[i], product_[i], point_real_[c],
                                run_sums_, segment.first_sum, queue_.scratch());
                ++i;
            }
            reduce_runs(Step::jty, chunk, f);
        }
    });
    for (size_t c = 0; c < x.e.size(); ++c) problem_.vectors().add_real(point_real_[c], x.e[c]);
}

// launch(stages, chunk, segment, c, i), then finish(chunk). The points of a chunk must have seen
// all of its segments before any goes through backward_stage: the last segment does all stages at
// once, the others go before it and again after it.
template <class Launch, class Finish>
void Jacobian::launch_in_stages(Launch&& launch, Finish&& finish) {
    size_t first = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        const size_t n = chunk.segments.size();
        for (size_t s = 0; s < n; ++s)
            launch((s == 0 ? zero_stage : 0) | forward_stage |
                       (s == n - 1 ? points_stage | backward_stage : 0),
                   chunk, chunk.segments[s], c, first + s);
        for (size_t s = 0; s + 1 < n; ++s)
            launch(backward_stage, chunk, chunk.segments[s], c, first + s);
        finish(chunk);
        first += n;
    }
}

// `stages` leaves out the others of all_stages.
void Jacobian::schur_stages(int stages, const Vector& x, const std::vector<Buffer>& point_factors,
                            Vector& y) {
    const Buffer& of_x = of_images(x.f);
    add_of_images(y.f, [&](Buffer& f) {
        launch_in_stages(
            [&](int of_segment, const DeviceChunk& chunk, const DeviceSegment& segment, size_t c,
                size_t i) {
                const int wanted = stages & of_segment;
                if (wanted == 0) return;
                problem_.launch(Step::schur, "products.cl", "schur_product", defines(i), chunk,
                                segment, wanted, problem_.pose_offsets, problem_.intrinsics_offsets,
                                problem_.state.image_records, rows_[i], of_x, point_factors[c],
                                point_real_[c], run_sums_, segment.first_sum, queue_.scratch());
            },
            [&](const DeviceChunk& chunk) { reduce_runs(Step::schur, chunk, f); });
    });
}

void Jacobian::add_schur_product(const Vector& x, const std::vector<Buffer>& point_factors,
                                 Vector& y) {
    schur_stages(all_stages, x, point_factors, y);
}

void Jacobian::eliminate(const Vector& zero, const std::vector<Buffer>& point_gradient,
                         const std::vector<Buffer>& point_factors, Vector& y) {
    for (size_t c = 0; c < point_real_.size(); ++c) point_real_[c].copy_from(point_gradient[c]);
    y.fill_zero();
    schur_stages(points_stage | backward_stage, zero, point_factors, y);
}

BackSubstitution Jacobian::back_substitute(const Vector& step,
                                           const std::vector<Buffer>& point_gradient,
                                           const std::vector<Buffer>& point_factors) {
    int32_t num_tiles = 0;
    const Buffer& of_step = of_images(step.f);
    launch_in_stages(
        [&](int stages, const DeviceChunk& chunk, const DeviceSegment& segment, size_t c,
            size_t i) {
            problem_.launch(Step::schur, "products.cl", "back_substitute", defines(i), chunk,
                            segment, stages, problem_.pose_offsets, problem_.intrinsics_offsets,
                            problem_.state.image_records, rows_[i], of_step, point_factors[c],
                            point_gradient[c], problem_.state.points[c], point_real_[c],
                            problem_.trial.points[c], num_tiles, tile_sums_, queue_.scratch());
            // A later stage of the same segment takes up where an earlier one left the points.
            num_tiles += chunk.num_tiles;
        },
        [](const DeviceChunk&) {});
    BackSubstitution result;
    const auto n = static_cast<size_t>(sums_per_tile * num_tiles);
    problem_.read_wide(tile_sums_, host_sums_, n);
    for (size_t i = 0; i < n; i += sums_per_tile) {
        result.squared_norm += host_sums_[i];
        result.slope += host_sums_[i + 1];
        result.squared_point_steps += host_sums_[i + 2];
    }
    return result;
}

void Jacobian::sum_image_blocks(const std::vector<Buffer>* point_factors, Buffer& matrices) {
    RigTangents* const rigs = problem_.rigs();
    Buffer& of_images = rigs ? rigs->image_matrices() : matrices;
    of_images.fill_zero();
    for_each_segment(
        [&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c, size_t i) {
            const Buffer* factors = point_factors ? &(*point_factors)[c] : nullptr;
            problem_.launch(Step::preconditioner, "blocks.cl", "image_blocks", defines(i), chunk,
                            segment, problem_.state.image_records, rows_[i], factors, run_sums_,
                            queue_.scratch());
            queue_.launch(Step::preconditioner,
                          queue_.kernel("reduce.cl", "reduce_run_blocks", programs_[i].run_blocks),
                          segment.num_blocks, segment.first_block, chunk.blocks.size,
                          chunk.blocks.column, chunk.blocks.first_run, chunk.blocks.runs,
                          chunk.blocks.matrix_offset, run_sums_, of_images);
        });
    if (rigs) rigs->transform_blocks(matrices);
}

void Jacobian::image_blocks(Buffer& u) {
    sum_image_blocks(nullptr, u);
}

void Jacobian::schur_blocks(const std::vector<Buffer>& point_factors, Buffer& blocks) {
    sum_image_blocks(&point_factors, blocks);
}

}  // namespace clba
