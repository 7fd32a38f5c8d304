// SPDX-License-Identifier: Apache-2.0
#include "optimizer/evaluator.hpp"

#include "base/error.hpp"

namespace clba {
namespace {

constexpr int sums_per_tile = 4;  // kernels/residual.cl

}  // namespace

Evaluator::Evaluator(DeviceProblem& problem, const Loss& loss)
    : problem_(problem), queue_(problem.queue()), loss_(loss) {
    uint64_t most_gradients = 0;
    for (const DeviceChunk& chunk : problem.chunks())
        for (const DeviceSegment& segment : chunk.segments)
            most_gradients =
                std::max(most_gradients, static_cast<uint64_t>(segment.num_runs) *
                                             static_cast<uint64_t>(segment.num_columns));
    sums_.resize(static_cast<size_t>(sums_per_tile * problem.max_tiles_per_chunk()));
    tile_sums_ = Buffer(queue_, sums_.size() * sizeof(double), "cost of tiles");
    run_gradient_ = Buffer(queue_, most_gradients * sizeof(double), "gradients of runs");
}

Kernel& Evaluator::kernel(const char* path, const char* name, const DeviceSegment& segment) {
    const std::string defines =
        text("-DREAL=", real_type(problem_.precision()), " -DLOSS=", static_cast<int>(loss_.kind),
             " -DWHITENED=", segment.whitening ? 1 : 0, " -DIMAGE_RECORD=", 12 + max_camera_params);
    return queue_.kernel(path, name, defines,
                         text("camera_models/", camera_models[segment.model].name, ".clh"));
}

CostEvaluation Evaluator::cost(const State& state, std::vector<Buffer>* residuals) {
    CostEvaluation evaluation;
    problem_.update_image_records(state);
    size_t index = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        for (const DeviceSegment& segment : chunk.segments) {
            const Buffer* residual = residuals ? &(*residuals)[index] : nullptr;
            ++index;
            queue_.launch(Step::residual, kernel("residual.cl", "residual", segment),
                          chunk.num_tiles, chunk.tile_points, chunk.tile_num_points,
                          segment.tile_runs, segment.run_image, segment.run_slots,
                          segment.slot_point, segment.xy,
                          segment.whitening ? &segment.whitening : nullptr, problem_.image_records,
                          chunk.num_point_slots, state.points[c], loss_.scale, residual, tile_sums_,
                          queue_.scratch());
            const size_t num_sums = static_cast<size_t>(sums_per_tile * chunk.num_tiles);
            tile_sums_.read(sums_.data(), num_sums * sizeof(double));
            for (size_t i = 0; i < num_sums; i += sums_per_tile) {
                evaluation.cost += sums_[i];
                evaluation.num_behind += static_cast<int64_t>(sums_[i + 1]);
                evaluation.num_singular += static_cast<int64_t>(sums_[i + 2]);
            }
        }
    }
    return evaluation;
}

void Evaluator::linearize(NormalEquations& equations) {
    problem_.update_image_records(problem_.state);
    equations.gradient.fill_zero();
    size_t index = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        for (const DeviceSegment& segment : chunk.segments) {
            queue_.launch(Step::jacobian, kernel("jacobian.cl", "jacobian", segment),
                          chunk.num_tiles, chunk.tile_points, chunk.tile_num_points,
                          segment.tile_runs, segment.run_image, segment.run_slots,
                          segment.slot_point, segment.xy,
                          segment.whitening ? &segment.whitening : nullptr, problem_.image_records,
                          chunk.num_point_slots, problem_.state.points[c], loss_.scale,
                          equations.jacobian.blocks()[index++], run_gradient_,
                          equations.gradient.e[c], queue_.scratch());
            equations.jacobian.reduce_runs(Step::jacobian, segment, run_gradient_, true,
                                           equations.gradient.f);
        }
        if (chunk.point_scale)
            problem_.vectors().mask_constants(chunk.point_scale, equations.gradient.e[c]);
    }
    problem_.vectors().mask_constants(problem_.scale_f, equations.gradient.f);
}

}  // namespace clba
