// SPDX-License-Identifier: Apache-2.0
#include "linear/normal_equations.hpp"

#include <algorithm>
#include <numeric>

#include "base/error.hpp"

namespace clba {

NormalEquations::NormalEquations(DeviceProblem& problem, const DampingOptions& damping)
    : jacobian(problem), problem_(problem), queue_(problem.queue()), options_(damping) {
    int32_t max_block = 1;
    for (const ParameterBlock& block : problem.layout().blocks)
        max_block = std::max(max_block, block.size);
    defines_ = text("-DREAL=", real_type(problem.precision()), " -DMAX_BLOCK=", max_block);
    gradient = problem.make_vector("the gradient");
    u_ = Buffer(queue_, problem.matrices_bytes(), "image blocks");
    v_ = problem.make_point_rows(6, sizeof(double), "point blocks");
    d2_ = problem.make_vector("the damping");
    if (options_.policy == Damping::levenberg)
        initial_diagonal_ = problem.make_vector("the initial diagonal");
    image_factors_ = Buffer(queue_, problem.matrices_bytes(), "image block factors");
    point_factors_ =
        problem.make_point_rows(6, real_bytes(problem.precision()), "point block factors");
    failures_ = Buffer(queue_,
                       sizeof(int32_t) * static_cast<uint64_t>(queue_.tuning().vector_groups *
                                                               queue_.tuning().work_group_size),
                       "failure counts");
}

Kernel& NormalEquations::kernel(const char* name) {
    return queue_.kernel("factors.cl", name, defines_);
}

int64_t NormalEquations::num_groups(int64_t n) const {
    return std::min<int64_t>(queue_.tuning().vector_groups, n);
}

void NormalEquations::update_blocks() {
    jacobian.image_blocks(u_);
    jacobian.point_blocks(v_);
    const bool is_levenberg = options_.policy == Damping::levenberg;
    const auto policy = static_cast<int32_t>(options_.policy);
    const int32_t is_first = is_first_ ? 1 : 0;
    queue_.launch(Step::preconditioner, kernel("image_damping"), num_groups(problem_.num_blocks()),
                  policy, options_.min_diagonal, options_.max_diagonal, problem_.num_blocks(),
                  problem_.block_offset, problem_.block_size, problem_.matrix_offset, u_,
                  problem_.scale_f, is_levenberg ? &initial_diagonal_.f : nullptr, is_first, d2_.f);
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        queue_.launch(Step::preconditioner, kernel("point_damping"),
                      num_groups(chunk.num_point_slots), policy, options_.min_diagonal,
                      options_.max_diagonal, chunk.num_point_slots, v_[c],
                      chunk.point_scale_or_null(), is_levenberg ? &initial_diagonal_.e[c] : nullptr,
                      is_first, d2_.e[c]);
    }
    is_first_ = false;
}

int64_t NormalEquations::read_failures(int64_t groups) {
    std::vector<int32_t> counts(static_cast<size_t>(groups * queue_.tuning().work_group_size));
    failures_.read(counts.data(), counts.size() * sizeof(int32_t));
    return std::accumulate(counts.begin(), counts.end(), int64_t{0});
}

int64_t NormalEquations::factor_points(double lambda) {
    int64_t failures = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        const int64_t groups = num_groups(chunk.num_point_slots);
        queue_.launch(Step::preconditioner, kernel("factor_point_blocks"), groups, lambda,
                      chunk.num_point_slots, v_[c], chunk.point_scale_or_null(), d2_.e[c],
                      point_factors_[c], failures_);
        failures += read_failures(groups);
    }
    return failures;
}

int64_t NormalEquations::factor_images(double lambda, const Buffer& matrices) {
    const int64_t groups = num_groups(problem_.num_blocks());
    queue_.launch(Step::preconditioner, kernel("factor_image_blocks"), groups, lambda,
                  problem_.num_blocks(), problem_.block_offset, problem_.block_size,
                  problem_.matrix_offset, matrices, problem_.scale_f, d2_.f, image_factors_,
                  failures_);
    return read_failures(groups);
}

void NormalEquations::apply_image_factors(const Vector& r, Vector& z) {
    queue_.launch(Step::preconditioner, kernel("apply_image_factors"),
                  num_groups(problem_.num_blocks()), problem_.num_blocks(), problem_.block_offset,
                  problem_.block_size, problem_.matrix_offset, image_factors_, r.f, z.f);
}

void NormalEquations::apply_point_factors(const Vector& r, Vector& z) {
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const int32_t n = problem_.chunks()[c].num_point_slots;
        queue_.launch(Step::preconditioner, kernel("apply_point_factors"), num_groups(n), n,
                      point_factors_[c], r.e[c], z.e[c]);
    }
}

}  // namespace clba
