// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cmath>

#include "problem/loss.hpp"

namespace clba::reference {

// rho(s) by the formulas in clba.h, in forms that keep their digits where s is far below a^2.
inline double rho(const Loss& loss, double s) {
    const double a2 = loss.scale * loss.scale;
    const double q = s / a2;
    switch (loss.kind) {
        case LossKind::none:
            return s;
        case LossKind::huber:
            return s <= a2 ? s : 2 * loss.scale * std::sqrt(s) - a2;
        case LossKind::soft_l1:
            return 2 * s / (std::sqrt(1 + q) + 1);
        case LossKind::cauchy:
            return a2 * std::log1p(q);
        case LossKind::tukey:
            return s <= a2 ? s * (1 - q + q * q / 3) : a2 / 3;
    }
    return s;
}

// d rho / d s.
inline double rho_derivative(const Loss& loss, double s) {
    const double a2 = loss.scale * loss.scale;
    const double q = s / a2;
    switch (loss.kind) {
        case LossKind::none:
            return 1;
        case LossKind::huber:
            return s <= a2 ? 1 : loss.scale / std::sqrt(s);
        case LossKind::soft_l1:
            return 1 / std::sqrt(1 + q);
        case LossKind::cauchy:
            return 1 / (1 + q);
        case LossKind::tukey:
            return s <= a2 ? (1 - q) * (1 - q) : 0;
    }
    return 1;
}

}  // namespace clba::reference
