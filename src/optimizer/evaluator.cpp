// SPDX-License-Identifier: Apache-2.0
#include "optimizer/evaluator.hpp"

#include "base/error.hpp"
#include "linear/prior_terms.hpp"
#include "linear/rig_tangents.hpp"

namespace clba {
namespace {

constexpr int sums_per_tile = 4;   // kernels/residual.cl
constexpr int sums_per_point = 9;  // kernels/linearize.cl

}  // namespace

Evaluator::Evaluator(DeviceProblem& problem, const Loss& loss)
    : problem_(problem), queue_(problem.queue()), loss_(loss) {
    int32_t num_tiles = 0, most_slots = 0;
    for (const DeviceChunk& chunk : problem.chunks()) {
        num_tiles += chunk.num_tiles * static_cast<int32_t>(chunk.segments.size());
        most_slots = std::max(most_slots, chunk.max_tile_slots);
        num_point_sums_ = std::max(num_point_sums_, num_groups(chunk));
    }
    sums_.resize(static_cast<size_t>(sums_per_tile * num_tiles));
    const size_t bytes = wide_bytes(problem.precision());
    tile_sums_ = Buffer(queue_, sums_.size() * bytes, "cost of tiles");
    point_capacity_ = most_slots;
    point_sums_ =
        Buffer(queue_,
               static_cast<uint64_t>(sums_per_point) * bytes *
                   static_cast<uint64_t>(point_capacity_) * static_cast<uint64_t>(num_point_sums_),
               "sums of points");
}

// How many work-groups share the tiles of a chunk: they keep what its points add up to, which only
// one segment can see in a single launch.
int64_t Evaluator::num_groups(const DeviceChunk& chunk) const {
    if (chunk.segments.size() != 1) return chunk.num_tiles;
    return std::min<int64_t>(chunk.num_tiles, queue_.tuning().tile_groups);
}

std::string Evaluator::defines(const DeviceSegment& segment) const {
    return text(" -DLOSS=", static_cast<int>(loss_.kind),
                " -DWHITENED=", segment.whitening ? 1 : 0);
}

CostEvaluation Evaluator::cost(const State& state, std::vector<Buffer>* residuals) {
    problem_.update_image_records(state);
    const std::string common = problem_.defines();
    size_t index = 0;
    int32_t num_tiles = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        for (const DeviceSegment& segment : chunk.segments) {
            const Buffer* residual = residuals ? &(*residuals)[index] : nullptr;
            ++index;
            problem_.launch(Step::residual, "residual.cl", "residual", common + defines(segment),
                            chunk, segment, segment.xy,
                            segment.whitening ? &segment.whitening : nullptr, state.image_records,
                            state.points[c], loss_.scale, residual, num_tiles, tile_sums_,
                            queue_.scratch());
            num_tiles += chunk.num_tiles;
        }
    }
    CostEvaluation evaluation;
    problem_.read_wide(tile_sums_, sums_, sums_.size());
    for (size_t i = 0; i < sums_.size(); i += sums_per_tile) {
        evaluation.cost += sums_[i];
        evaluation.num_behind += static_cast<int64_t>(sums_[i + 1]);
        evaluation.num_singular += static_cast<int64_t>(sums_[i + 2]);
    }
    if (problem_.priors()) evaluation.prior_cost = problem_.priors()->cost(state);
    evaluation.cost += evaluation.prior_cost;
    return evaluation;
}

void Evaluator::linearize(NormalEquations& equations) {
    // Stages of kernels/linearize.cl.
    constexpr int zero_stage = 1, runs_stage = 2, finish_stage = 4;
    Jacobian& jacobian = equations.jacobian;
    PriorTerms* const priors = problem_.priors();
    const bool has_point_priors = priors && priors->has_points();
    const std::string of_priors = has_point_priors ? " -DPOINT_PRIORS=1" : "";
    problem_.update_image_records(problem_.state);
    equations.gradient.fill_zero();
    equations.diagonal.fill_zero();
    RigTangents* const rigs = problem_.rigs();
    Buffer& gradient = rigs ? rigs->zeroed_image_vector() : equations.gradient.f;
    size_t index = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        const PriorTerms::Points* points = has_point_priors ? &priors->points(c) : nullptr;
        for (size_t s = 0; s < chunk.segments.size(); ++s) {
            const DeviceSegment& segment = chunk.segments[s];
            const int stages = (s == 0 ? zero_stage : 0) | runs_stage |
                               (s + 1 == chunk.segments.size() ? finish_stage : 0);
            problem_.launch_groups(
                num_groups(chunk), Step::jacobian, "linearize.cl", "linearize",
                jacobian.defines(index) + defines(segment) + of_priors, chunk, segment, stages,
                chunk.num_tiles, segment.xy, segment.whitening ? &segment.whitening : nullptr,
                problem_.state.image_records, problem_.state.points[c], loss_.scale,
                chunk.point_scale_or_null(), jacobian.rows()[index], jacobian.run_sums(),
                segment.first_sum, point_capacity_, point_sums_, equations.point_roots[c],
                equations.point_gradient[c],
                equations.wide_point_gradient.empty() ? nullptr : &equations.wide_point_gradient[c],
                points ? points->num_priors : 0, points ? &points->prior_of_slot : nullptr,
                points ? &points->values : nullptr, chunk.first_tile, equations.tile_max,
                queue_.scratch());
            ++index;
        }
        jacobian.reduce_wide_runs(chunk, false, gradient);
        if (!rigs) jacobian.reduce_wide_runs(chunk, true, equations.diagonal.f);
    }
    if (rigs) {
        rigs->gather(equations.gradient.f);
        equations.take_diagonal_of_blocks();
    }
    problem_.vectors().mask_constants(problem_.scale_f, equations.gradient.f);
    if (priors) priors->linearize(equations.gradient, equations.diagonal);
    equations.update_damping();
}

}  // namespace clba
