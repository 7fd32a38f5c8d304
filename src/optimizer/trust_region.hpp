// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <algorithm>

namespace clba {

// The radius of the trust region, 1 / lambda, by Nielsen's rule ("Damping parameter in Marquardt's
// method", IMM-REP-1999-05).
class TrustRegion {
public:
    TrustRegion(double radius, double max_radius, double shrink_factor = 2)
        : radius_(radius), max_radius_(max_radius), shrink_factor_(shrink_factor) {}
    double radius() const { return radius_; }
    double lambda() const { return 1 / radius_; }
    double shrink_factor() const { return shrink_factor_; }  // of the next rejection

    void accept(double gain_ratio) {
        const double x = 2 * gain_ratio - 1;
        radius_ = std::min(max_radius_, radius_ / std::max(1.0 / 3.0, 1 - x * x * x));
        shrink_factor_ = 2;
    }
    void reject() {
        radius_ /= shrink_factor_;
        shrink_factor_ *= 2;
    }
    void limit(double radius) { radius_ = std::min(radius_, radius); }

private:
    double radius_;
    double max_radius_;
    double shrink_factor_;
};

}  // namespace clba
