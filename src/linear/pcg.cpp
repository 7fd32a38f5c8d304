// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg.hpp"

#include <cmath>
#include <numeric>
#include <utility>

namespace clba {
namespace {

// Sums of partials; rho alternates between the first two.
constexpr int32_t curvature_sum = 2, num_sums = 3;

}  // namespace

Pcg::Pcg(const PcgOptions& options, Queue& queue, VectorOperations& vectors, Vector p, Vector zq)
    : options_(options),
      queue_(queue),
      vectors_(vectors),
      p_(std::move(p)),
      zq_(std::move(zq)),
      num_partials_(vectors.num_partials(p_)),
      host_partials_(static_cast<size_t>(num_sums * num_partials_)) {
    partials_ = Buffer(queue, host_partials_.size() * wide_bytes(vectors.precision()), "PCG");
}

PcgResult Pcg::solve(PcgSystem& system, double lambda, const Vector& d2, Vector& r, Vector& x) {
    const auto kernel = [&](const char* name) -> Kernel& {
        return queue_.kernel("pcg.cl", name, vectors_.defines());
    };
    const auto sum = [&](int32_t which) {
        const auto first = host_partials_.begin() + which * num_partials_;
        return std::accumulate(first, first + num_partials_, 0.0);
    };
    PcgResult result;
    x.fill_zero();
    system.precondition(r, zq_);
    vectors_.dot_partials(r, zq_, partials_);
    double model = 0;  // Q
    for (int32_t k = 1; k <= options_.max_iterations; ++k) {
        const int32_t rho = (k - 1) % 2, next_rho = k % 2;
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
                          partials_, p_.part(i), zq_.part(i), x.part(i), r.part(i));
        });
        system.precondition(r, zq_);
        vectors_.dot_partials(r, zq_, partials_, next_rho * num_partials_);
        vectors_.read_wide(partials_, host_partials_, host_partials_.size());

        if (k == 1 && sum(rho) == 0) {  // b = 0, or M^-1 b = 0: every free parameter is at rest
            result.is_usable = true;
            return result;
        }
        if (!(sum(rho) > 0) || !std::isfinite(sum(rho))) return result;
        if (!(sum(curvature_sum) > 0) || !std::isfinite(sum(curvature_sum))) return result;
        result.num_iterations = k;
        // Q falls by alpha rho / 2.
        const double decrease = 0.5 * sum(rho) * (sum(rho) / sum(curvature_sum));
        model -= decrease;
        result.is_usable = std::isfinite(model);
        if (!result.is_usable) return result;
        const bool is_flat = k * decrease / -model < options_.eta;
        if (is_flat && k >= options_.min_iterations) return result;
    }
    return result;
}

}  // namespace clba
