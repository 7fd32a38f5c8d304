// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <vector>

#include "base/stop_test.hpp"
#include "linear/vector.hpp"

namespace clba {

// A symmetric positive definite system A + lambda D^2 on the device, as conjugate gradients see it.
class PcgSystem {
public:
    virtual ~PcgSystem() = default;
    virtual void add_product(const Vector& p, Vector& q) = 0;   // q += A p
    virtual void precondition(const Vector& r, Vector& z) = 0;  // z = M^-1 r
};

struct PcgOptions {
    int min_iterations = 0;
    int max_iterations = 500;
    double eta = 0.1;
};

struct PcgResult {
    bool is_usable = false;
    int num_iterations = 0;
    StopCause stopped = StopCause::none;
};

// Preconditioned conjugate gradients. The device decides where they end: the host looks whether
// they have once an iteration, or less often where a look costs more than an iteration.
class Pcg {
public:
    // p and zq: working space, vectors with the parts of the system's.
    Pcg(const PcgOptions& options, Queue& queue, VectorOperations& vectors, Vector p, Vector zq);

    void limit_iterations(int max_iterations) { options_.max_iterations = max_iterations; }
    // Solves (A + lambda D^2) x = b from x = 0; r is b before, and the residual after. Stops when
    // iteration k improves the quadratic model Q(x) = 1/2 x^T A x - b^T x by a share less than eta
    // / k: k (Q_k - Q_k-1) / Q_k < eta (Nash and Sofer, "Assessing a search direction within a
    // truncated-Newton method", 1990). On negative curvature, or a number that is not finite, what
    // was found before is kept; it is usable if there was an iteration. So it is where `stop`,
    // asked whenever the host looks, ends the iterations.
    PcgResult solve(PcgSystem& system, double lambda, const Vector& d2, Vector& r, Vector& x,
                    const StopTest& stop = {});

private:
    PcgOptions options_;
    Queue& queue_;
    VectorOperations& vectors_;
    Vector p_, zq_;  // the direction; the preconditioned residual, then the product with p
    int32_t num_partials_ = 0;
    Buffer partials_;  // of rho, of rho before and of the curvature
    Buffer controls_;
    std::vector<double> host_controls_;
};

}  // namespace clba
