// SPDX-License-Identifier: Apache-2.0
#include "linear/stored_jacobian.hpp"

#include <cmath>

#include "base/error.hpp"

namespace clba {
namespace {

constexpr int all_schur_stages = 1 | 2 | 4 | 8;  // kernels/products.cl
constexpr int zero_stage = 1, forward_stage = 2, points_stage = 4, backward_stage = 8;

}  // namespace

StoredJacobian::StoredJacobian(DeviceProblem& problem)
    : problem_(problem), queue_(problem.queue()) {
    const size_t bytes = real_bytes(problem.precision());
    blocks_ = problem.make_slot_rows(num_rows, bytes, "the Jacobian");
    product_ = problem.make_slot_rows(num_product_rows, bytes, "a product with the Jacobian");
    point_real_ = problem.make_point_rows(3, bytes, "points in products");
    uint64_t most_sums = 0, most_blocks = 0;
    for (const DeviceChunk& chunk : problem.chunks()) {
        for (const DeviceSegment& segment : chunk.segments) {
            const auto runs = static_cast<uint64_t>(segment.num_runs);
            const auto columns = static_cast<uint64_t>(segment.num_columns);
            most_sums = std::max(most_sums, runs * columns);
            most_blocks = std::max(most_blocks, runs * columns * (columns + 1) / 2);
        }
    }
    run_sums_ = Buffer(queue_, most_sums * bytes, "sums of runs");
    run_blocks_ = Buffer(queue_, most_blocks * sizeof(double), "blocks of runs");
}

std::string StoredJacobian::defines(int num_columns) const {
    return text("-DREAL=", real_type(problem_.precision()), " -DCOLUMNS=", num_columns);
}

template <class Visit>
void StoredJacobian::for_each_segment(Visit&& visit) {
    size_t index = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c)
        for (const DeviceSegment& segment : problem_.chunks()[c].segments)
            visit(problem_.chunks()[c], segment, c, index++);
}

void StoredJacobian::reduce_runs(Step step, const DeviceSegment& segment, const Buffer& run_sums,
                                 bool is_double, Buffer& f) {
    const std::string options =
        text("-DCOLUMNS=", segment.num_columns,
             " -DRUN_REAL=", is_double ? "double" : real_type(problem_.precision()));
    queue_.launch(step, queue_.kernel("reduce.cl", "reduce_runs", options), segment.num_blocks,
                  segment.block_offset, segment.block_size, segment.block_column,
                  segment.block_runs, segment.runs, run_sums, f);
}

void StoredJacobian::multiply(const Vector& x) {
    for (size_t c = 0; c < point_real_.size(); ++c)
        problem_.vectors().to_real(x.e[c], point_real_[c]);
    for_each_segment([&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c,
                         size_t i) {
        queue_.launch(Step::jx, queue_.kernel("products.cl", "jx", defines(segment.num_columns)),
                      chunk.num_tiles, chunk.tile_points, segment.tile_runs, segment.run_image,
                      segment.run_slots, segment.slot_point, problem_.pose_offsets,
                      problem_.intrinsics_offsets, blocks_[i], x.f, chunk.num_point_slots,
                      point_real_[c], product_[i]);
    });
}

double StoredJacobian::squared_norm(const Vector& x) {
    multiply(x);
    return problem_.vectors().squared_norm(product_);
}

void StoredJacobian::multiply_transposed(Vector& x) {
    x.f.fill_zero();
    for (Buffer& e : point_real_) e.fill_zero();
    for_each_segment([&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c,
                         size_t i) {
        queue_.launch(Step::jty, queue_.kernel("products.cl", "jty", defines(segment.num_columns)),
                      chunk.num_tiles, chunk.tile_points, segment.tile_runs, segment.run_slots,
                      segment.slot_point, blocks_[i], product_[i], chunk.num_point_slots,
                      point_real_[c], run_sums_, queue_.scratch());
        reduce_runs(Step::jty, segment, run_sums_, false, x.f);
    });
    for (size_t c = 0; c < x.e.size(); ++c) problem_.vectors().from_real(point_real_[c], x.e[c]);
}

void StoredJacobian::schur_multiply(const Vector& x, const std::vector<Buffer>& point_factors,
                                    Vector& y) {
    y.f.fill_zero();
    const auto launch = [&](int stages, const DeviceChunk& chunk, const DeviceSegment& segment,
                            size_t c, size_t i) {
        queue_.launch(Step::schur,
                      queue_.kernel("products.cl", "schur_product", defines(segment.num_columns)),
                      chunk.num_tiles, stages, chunk.tile_points, chunk.tile_num_points,
                      segment.tile_runs, segment.run_image, segment.run_slots, segment.slot_point,
                      problem_.pose_offsets, problem_.intrinsics_offsets, blocks_[i], x.f,
                      chunk.num_point_slots, point_factors[c], point_real_[c], run_sums_,
                      queue_.scratch());
        if (stages & backward_stage) reduce_runs(Step::schur, segment, run_sums_, false, y.f);
    };
    size_t first = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        const size_t n = chunk.segments.size();
        if (n == 1) {
            launch(all_schur_stages, chunk, chunk.segments[0], c, first);
        } else if (n > 1) {
            for (size_t s = 0; s < n; ++s)
                launch((s == 0 ? zero_stage : 0) | forward_stage | (s == n - 1 ? points_stage : 0),
                       chunk, chunk.segments[s], c, first + s);
            for (size_t s = 0; s < n; ++s)
                launch(backward_stage, chunk, chunk.segments[s], c, first + s);
        }
        first += n;
    }
}

void StoredJacobian::point_blocks(std::vector<Buffer>& v) {
    for (Buffer& rows : v) rows.fill_zero();
    for_each_segment(
        [&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c, size_t i) {
            queue_.launch(Step::preconditioner,
                          queue_.kernel("blocks.cl", "point_blocks", defines(segment.num_columns)),
                          chunk.num_tiles, chunk.tile_points, segment.tile_runs, segment.run_slots,
                          segment.slot_point, blocks_[i], chunk.num_point_slots, v[c]);
        });
}

void StoredJacobian::sum_image_blocks(std::vector<Buffer>* weights, Buffer& matrices) {
    matrices.fill_zero();
    for_each_segment([&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t, size_t i) {
        const std::string options = defines(segment.num_columns);
        const Buffer* segment_weights = weights ? &(*weights)[i] : nullptr;
        queue_.launch(Step::preconditioner, queue_.kernel("blocks.cl", "image_blocks", options),
                      chunk.num_tiles, segment.tile_runs, segment.run_slots, blocks_[i],
                      segment_weights, run_blocks_, queue_.scratch());
        queue_.launch(Step::preconditioner,
                      queue_.kernel("reduce.cl", "reduce_run_blocks",
                                    text("-DCOLUMNS=", segment.num_columns)),
                      segment.num_blocks, segment.block_size, segment.block_column,
                      segment.block_runs, segment.runs, segment.matrix_offset, run_blocks_,
                      matrices);
    });
}

void StoredJacobian::image_blocks(Buffer& u) {
    sum_image_blocks(nullptr, u);
}

void StoredJacobian::schur_blocks(const std::vector<Buffer>& point_factors, Buffer& blocks) {
    if (weights_.empty())
        weights_ = problem_.make_slot_rows([](int) { return 3; }, real_bytes(problem_.precision()),
                                           "Schur weights");
    for_each_segment(
        [&](const DeviceChunk& chunk, const DeviceSegment& segment, size_t c, size_t i) {
            queue_.launch(Step::preconditioner,
                          queue_.kernel("blocks.cl", "schur_weights", defines(segment.num_columns)),
                          chunk.num_tiles, chunk.tile_points, segment.tile_runs, segment.run_slots,
                          segment.slot_point, blocks_[i], chunk.num_point_slots, point_factors[c],
                          weights_[i]);
        });
    sum_image_blocks(&weights_, blocks);
}

}  // namespace clba
