// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "covariance/covariance.hpp"
#include "covariance/gauge_transform.hpp"
#include "linear/explicit_schur.hpp"
#include "linear/normal_equations.hpp"

namespace clba {

// The normal equations at the device's state, points factored without damping, and how their gauge
// is taken away.
struct UndampedSystem {
    const Problem& problem;
    DeviceProblem& device;
    NormalEquations& equations;
    const Similarities& similarities;
    const GaugeTransform& gauge;
    const IsObserved& is_observed;
    const std::vector<double>& diagonal;  // of J_F^T J_F and priors
    const std::vector<std::array<double, 6>>& point_factors;
};

// Both fill the blocks of images, cameras and points, whose sizes are set, and what they report.

// From S^-1 at the blocks of S (BlockInverse). Throws an invalid_argument error where S is singular
// beyond its gauge.
void find_exact_covariances(const UndampedSystem& system, SchurStructure structure,
                            Covariance& covariance);

// From samples H^-1 J^T e with e standard normal, whose covariance is H^-1 (Papandreou and Yuille,
// "Gaussian sampling by local perturbations", 2010), by conjugate gradients on S, which may be
// singular: J^T e is in its range, and the gauge takes away what the solution leaves open.
void sample_covariances(const UndampedSystem& system, const CovarianceOptions& options,
                        Covariance& covariance);

}  // namespace clba
