// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace clba {

enum class LossKind : int { none = 0, huber = 1, soft_l1 = 2, cauchy = 3, tukey = 4 };

// rho(s) with s the squared norm of a whitened residual; formulas in clba.h.
struct Loss {
    LossKind kind = LossKind::none;
    double scale = 1.0;  // a, in units of the whitened residual
};

}  // namespace clba
