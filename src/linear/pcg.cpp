// SPDX-License-Identifier: Apache-2.0
#include "linear/pcg.hpp"

#include <cmath>

namespace clba {

PcgResult pcg(PcgSystem& system, const PcgOptions& options, VectorOperations& vectors,
              const Vector& b, PcgWork& work, Vector& x) {
    PcgResult result;
    x.fill_zero();
    work.r.copy_from(b);
    system.precondition(work.r, work.z);
    double rho = vectors.dot(work.r, work.z);
    if (rho == 0) {  // b = 0, or M^-1 b = 0: every free parameter is at rest
        result.is_usable = true;
        return result;
    }
    if (!(rho > 0) || !std::isfinite(rho)) return result;
    work.p.copy_from(work.z);
    double model = 0;  // Q
    for (int k = 1; k <= options.max_iterations; ++k) {
        system.multiply(work.p, work.q);
        const double curvature = vectors.dot(work.p, work.q);
        if (!(curvature > 0) || !std::isfinite(curvature)) return result;
        const double alpha = rho / curvature;
        const double next_model = -0.5 * vectors.pcg_step(alpha, work.p, work.q, b, x, work.r);
        result.num_iterations = k;
        if (!std::isfinite(next_model)) {
            result.is_usable = false;
            return result;
        }
        result.is_usable = true;
        const bool is_flat = k * (next_model - model) / next_model < options.eta;
        model = next_model;
        if (is_flat && k >= options.min_iterations) return result;
        system.precondition(work.r, work.z);
        const double next_rho = vectors.dot(work.r, work.z);
        if (!(next_rho > 0) || !std::isfinite(next_rho)) return result;
        vectors.scale_and_add(1.0, work.z, next_rho / rho, work.p);
        rho = next_rho;
    }
    return result;
}

}  // namespace clba
