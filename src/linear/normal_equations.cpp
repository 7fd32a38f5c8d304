// SPDX-License-Identifier: Apache-2.0
#include "linear/normal_equations.hpp"

#include <algorithm>
#include <numeric>

#include "base/error.hpp"
#include "linear/prior_terms.hpp"
#include "linear/rig_tangents.hpp"

namespace clba {

NormalEquations::NormalEquations(DeviceProblem& problem, const DampingOptions& damping,
                                 JacobianForm form, const Loss& loss)
    : jacobian(problem, form, loss), problem_(problem), queue_(problem.queue()), options_(damping) {
    const Precision precision = problem.precision();
    int32_t max_block = 1;
    for (const ParameterBlock& block : problem.layout().blocks)
        max_block = std::max(max_block, block.size);
    bool has_point_scales = false;
    for (const DeviceChunk& chunk : problem.chunks())
        has_point_scales = has_point_scales || chunk.point_scale;
    defines_ = text(precision_defines(precision), " -DMAX_BLOCK=", max_block,
                    " -DDAMPING=", static_cast<int>(damping.policy),
                    " -DSCALED_POINTS=", has_point_scales ? 1 : 0);
    gradient = problem.make_reduced_vector("the gradient");
    diagonal = problem.make_reduced_vector("the diagonal");
    point_gradient = problem.make_point_rows(3, real_bytes(precision), "the gradient");
    point_roots = problem.make_point_rows(6, real_bytes(precision), "point blocks");
    point_factors_ = problem.make_point_rows(6, real_bytes(precision), "point block factors");
    int64_t num_tiles = 0;
    for (const DeviceChunk& chunk : problem.chunks()) num_tiles += chunk.num_tiles;
    tile_max = Buffer(queue_, static_cast<uint64_t>(num_tiles) * wide_bytes(precision),
                      "the gradient of tiles");
    d2_ = problem.make_reduced_vector("the damping");
    if (options_.policy == Damping::levenberg)
        fixed_point_damping_ = problem.make_point_rows(3, wide_bytes(precision), "the damping");
    image_factors_ = Buffer(queue_, problem.matrices_bytes(), "image block factors");
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

void NormalEquations::take_diagonal_of_blocks() {
    if (!u_) u_ = Buffer(queue_, problem_.matrices_bytes(), "image blocks");
    jacobian.image_blocks(u_);
    problem_.rigs()->get_diagonal(u_, diagonal.f);
}

void NormalEquations::update_damping() {
    has_u_ = false;
    has_wide_gradient_ = !wide_point_gradient.empty();
    const bool is_first = !has_damping_;
    has_damping_ = true;
    if (options_.policy == Damping::levenberg && !is_first) return;
    const int32_t n = problem_.layout().num_f;
    queue_.launch(Step::preconditioner, kernel("image_damping"), num_groups(n),
                  options_.min_diagonal, options_.max_diagonal, n, diagonal.f, problem_.scale_f,
                  d2_.f);
    if (options_.policy == Damping::levenberg) update_point_damping(fixed_point_damping_);
}

void NormalEquations::update_point_damping(std::vector<Buffer>& d2) {
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        queue_.launch(Step::preconditioner, kernel("point_damping"),
                      num_groups(chunk.num_point_slots), options_.min_diagonal,
                      options_.max_diagonal, chunk.num_point_slots, point_roots[c],
                      chunk.point_scale_or_null(), d2[c]);
    }
}

void NormalEquations::keep_wide_gradient() {
    wide_point_gradient =
        problem_.make_point_rows(3, wide_bytes(problem_.precision()), "the gradient");
}

void NormalEquations::get_gradient(Vector& full) {
    full.f.copy_from(gradient.f);
    for (size_t c = 0; c < full.e.size(); ++c) {
        if (!has_wide_gradient_)
            problem_.vectors().from_real(point_gradient[c], full.e[c]);
        else
            full.e[c].copy_from(wide_point_gradient[c]);
    }
}

double NormalEquations::gradient_max_norm() {
    std::vector<double> largest(tile_max.bytes() / wide_bytes(problem_.precision()));
    problem_.read_wide(tile_max, largest, largest.size());
    return std::accumulate(largest.begin(), largest.end(), problem_.vectors().max_abs(gradient),
                           [](double a, double b) { return std::max(a, b); });
}

const Buffer& NormalEquations::u() {
    if (!u_) u_ = Buffer(queue_, problem_.matrices_bytes(), "image blocks");
    if (!has_u_) {
        jacobian.image_blocks(u_);
        if (problem_.priors()) problem_.priors()->add_image_blocks(u_);
    }
    has_u_ = true;
    return u_;
}

void NormalEquations::get_damping(Vector& full) {
    full.f.copy_from(d2_.f);
    if (options_.policy != Damping::levenberg) {
        update_point_damping(full.e);
        return;
    }
    for (size_t c = 0; c < full.e.size(); ++c) full.e[c].copy_from(fixed_point_damping_[c]);
}

std::vector<double> NormalEquations::fixed_damping() {
    if (options_.policy != Damping::levenberg) return {};
    Vector full = problem_.make_vector("the damping");
    get_damping(full);
    std::vector<double> values(static_cast<size_t>(problem_.layout().num_f) +
                               3 * static_cast<size_t>(problem_.num_points()));
    problem_.download(full, values.data());
    return values;
}

void NormalEquations::set_fixed_damping(const std::vector<double>& values) {
    const auto num_f = static_cast<std::ptrdiff_t>(problem_.layout().num_f);
    problem_.write_wide({values.begin(), values.begin() + num_f}, d2_.f);
    problem_.write_points(values.data() + num_f, 3, fixed_point_damping_);
}

int64_t NormalEquations::read_failures(int64_t groups) {
    std::vector<int32_t> counts(static_cast<size_t>(groups * queue_.tuning().work_group_size));
    failures_.read(counts.data(), counts.size() * sizeof(int32_t));
    return std::accumulate(counts.begin(), counts.end(), int64_t{0});
}

int64_t NormalEquations::factor_points(double lambda) {
    return launch_point_factors(lambda, defines_);
}

void NormalEquations::factor_undamped_points() {
    launch_point_factors(0, defines_ + " -DLEAST_PIVOT_SHARE=1e-12");
}

int64_t NormalEquations::launch_point_factors(double lambda, const std::string& defines) {
    int64_t failures = 0;
    for (size_t c = 0; c < problem_.chunks().size(); ++c) {
        const DeviceChunk& chunk = problem_.chunks()[c];
        const int64_t groups = num_groups(chunk.num_point_slots);
        queue_.launch(Step::preconditioner,
                      queue_.kernel("factors.cl", "factor_point_blocks", defines), groups,
                      options_.min_diagonal, options_.max_diagonal, lambda, chunk.num_point_slots,
                      point_roots[c], chunk.point_scale_or_null(),
                      fixed_point_damping_.empty() ? nullptr : &fixed_point_damping_[c],
                      point_factors_[c], failures_);
        failures += read_failures(groups);
    }
    return failures;
}

int64_t NormalEquations::factor_image_blocks(double lambda) {
    image_factors_.copy_from(u());
    return factor_images(lambda);
}

int64_t NormalEquations::factor_schur_blocks(double lambda) {
    jacobian.schur_blocks(point_factors_, image_factors_);
    if (problem_.priors()) problem_.priors()->add_image_blocks(image_factors_);
    return factor_images(lambda);
}

// Of the blocks that image_factors_ holds.
int64_t NormalEquations::factor_images(double lambda) {
    const int64_t groups = num_groups(problem_.num_blocks());
    queue_.launch(Step::preconditioner, kernel("factor_image_blocks"), groups, lambda,
                  problem_.num_blocks(), problem_.block_offset, problem_.block_size,
                  problem_.matrix_offset, image_factors_, problem_.scale_f, d2_.f, failures_);
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
