// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg.hpp"

#include <algorithm>
#include <utility>

namespace clba {
namespace {

// Sums of partials; rho alternates between the first two.
constexpr int32_t curvature_sum = 2, num_sums = 3;

// Controls of kernels/pcg.cl.
enum Control { model, iterations, status, num_controls };
enum Status { running, converged, broken_down, not_finite };

}  // namespace

Pcg::Pcg(const PcgOptions& options, Queue& queue, VectorOperations& vectors, Vector p, Vector zq)
    : options_(options),
      queue_(queue),
      vectors_(vectors),
      p_(std::move(p)),
      zq_(std::move(zq)),
      num_partials_(vectors.num_partials(p_)),
      partials_(queue,
                static_cast<uint64_t>(num_sums * num_partials_) * wide_bytes(vectors.precision()),
                "PCG"),
      controls_(queue, 2 * num_controls * wide_bytes(vectors.precision()), "PCG"),
      host_controls_(2 * num_controls) {}

PcgResult Pcg::solve(PcgSystem& system, double lambda, const Vector& d2, Vector& r, Vector& x,
                     const StopTest& stop) {
    PcgResult result;
    const auto kernel = [&](const char* name) -> Kernel& {
        return queue_.kernel("pcg.cl", name, vectors_.defines());
    };
    x.fill_zero();
    controls_.fill_zero();
    system.precondition(r, zq_);
    vectors_.dot_partials(r, zq_, partials_);
    std::fill(host_controls_.begin(), host_controls_.end(), 0.0);
    const int32_t interval = queue_.tuning().pcg_interval;
    int32_t after = 0;
    for (int32_t k = 1; k <= options_.max_iterations; ++k) {
        const int32_t rho = (k - 1) % 2, next_rho = k % 2;
        const int32_t before = rho * num_controls;
        after = next_rho * num_controls;
        vectors_.for_each_part(p_, [&](size_t i, int64_t groups, int32_t) {
            queue_.launch(Step::vector, kernel("pcg_direction"), groups,
                          vectors_.num_values(p_.part(i)), k == 1 ? 1 : 0, num_partials_,
                          rho * num_partials_, next_rho * num_partials_, partials_, lambda,
                          d2.part(i), p_.part(i), zq_.part(i));
        });
        system.add_product(p_, zq_);
        vectors_.dot_partials(p_, zq_, partials_, curvature_sum * num_partials_);
        vectors_.for_each_part(p_, [&](size_t i, int64_t groups, int32_t) {
            queue_.launch(Step::vector, kernel("pcg_step"), groups, vectors_.num_values(p_.part(i)),
                          num_partials_, rho * num_partials_, curvature_sum * num_partials_,
                          partials_, p_.part(i), zq_.part(i), x.part(i), r.part(i), i == 0 ? 1 : 0,
                          k, options_.min_iterations, options_.eta, before, after, controls_);
        });
        if (k % interval == 0 || k == options_.max_iterations) {
            vectors_.read_wide(controls_, host_controls_, host_controls_.size());
            if (host_controls_[after + status] != running) break;
            result.stopped = stop.cause();
            if (result.stopped != StopCause::none) break;
        }
        system.precondition(r, zq_);
        vectors_.dot_partials(r, zq_, partials_, next_rho * num_partials_);
    }
    result.num_iterations = static_cast<int>(host_controls_[after + iterations]);
    result.is_usable = host_controls_[after + status] == converged ||
                       (host_controls_[after + status] != not_finite && result.num_iterations > 0);
    return result;
}

}  // namespace clba
