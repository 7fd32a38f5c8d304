// SPDX-License-Identifier: Apache-2.0
#pragma once
#include "linear/vector.hpp"

namespace clba {

// A symmetric positive definite system on the device, as conjugate gradients see it.
class PcgSystem {
public:
    virtual ~PcgSystem() = default;
    virtual void multiply(const Vector& p, Vector& q) = 0;      // q = A p
    virtual void precondition(const Vector& r, Vector& z) = 0;  // z = M^-1 r
};

struct PcgOptions {
    int min_iterations = 0;
    int max_iterations = 500;
    double eta = 0.1;
};

struct PcgWork {
    Vector r, z, p, q;
};

struct PcgResult {
    bool is_usable = false;
    int num_iterations = 0;
};

// Solves A x = b from x = 0 by preconditioned conjugate gradients. Stops when iteration k improves
// the quadratic model Q(x) = 1/2 x^T A x - b^T x by a share less than eta / k: k (Q_k - Q_k-1) /
// Q_k < eta (Nash and Sofer, "Assessing a search direction within a truncated-Newton method",
// 1990). On negative curvature, or a number that is not finite, what was found before is kept; it
// is usable if there was an iteration.
PcgResult pcg(PcgSystem& system, const PcgOptions& options, VectorOperations& vectors,
              const Vector& b, PcgWork& work, Vector& x);

}  // namespace clba
