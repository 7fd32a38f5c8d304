// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "problem/parameter_layout.hpp"
#include "problem/problem.hpp"
#include "reference/bundle.hpp"

namespace clba::reference {

// Solves the damped normal equations (H + diag(damping)) delta = -g on the host, in one thread,
// with H = J^T J and what priors add to it, by eliminating the points:
//   V = J_E^T J_E + A + D_E = L L^T for each point, Z = W L^-T for each block that observes it,
//   S = U + D_F - sum Z Z^T,  b = -g_F - sum Z y,  y = L^-1 (-g_E),
//   S delta_F = b,  delta_E = L^-T (y - sum Z^T delta_F),
// with U = J_F^T J_F + P, P and A by priors (priors.hpp), W = J_F^T J_E and a sparse Cholesky
// factorisation of S by the plug-in clba_cholmod. Constant parameters are left out and get delta 0.
class DirectSchur {
public:
    // The structure of S and its symbolic factorisation, for the problem's observations, priors and
    // constants. Throws a no_plugin error where the plug-in is missing.
    DirectSchur(const Problem& problem, const ParameterLayout& layout);
    ~DirectSchur();

    // The Jacobian has the same observations, and the sensors if there are rigs. gradient, damping
    // (lambda D^2, the diagonal) and delta have num_parameters numbers; image_priors are the values
    // of P in the pattern of ImagePriors. False: some V or S is not positive definite, or the
    // result is not finite; delta is not to be used then.
    bool solve(const Jacobian& jacobian, const double* gradient, const double* damping,
               const std::vector<double>& image_priors, double* delta);

    // Blocks that were not positive definite in the last solve: points, or S counted as one.
    int64_t num_indefinite() const;
    int64_t num_schur_nonzeros() const;   // lower triangle of S
    int64_t num_factor_nonzeros() const;  // of its Cholesky factor

private:
    struct Structure;
    struct Numbers;
    std::unique_ptr<const Structure> structure_;
    std::unique_ptr<Numbers> numbers_;
};

}  // namespace clba::reference
