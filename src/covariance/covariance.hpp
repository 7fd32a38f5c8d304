// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <vector>

#include "covariance/gauge.hpp"
#include "linear/device_problem.hpp"
#include "problem/problem.hpp"

namespace clba {

enum class CovarianceMethod : int { automatic = 0, exact = 1, sampled = 2 };  // clba.h

struct CovarianceOptions {
    GaugeChoice gauge;
    CovarianceMethod method = CovarianceMethod::automatic;
    bool apply_variance_factor = false;
    bool all_points = false;
    std::vector<int32_t> points;  // unless all_points
    // Of `sampled`.
    int32_t num_samples = 0;  // 0: so many as relative_error asks for
    double relative_error = 0.1;
    uint64_t seed = 0;
    int32_t max_linear_solver_iterations = 20000;
    // Of `automatic`: more than the exact method may take; 0: half of the host's memory.
    uint64_t max_bytes = 0;
};

// Covariance blocks, row-major, in the tangent space of clba.h. Infinite on the diagonal, 0 beside
// it: no observation says anything about the parameter. 0: constant, or held by the gauge.
struct Covariance {
    GaugeChoice gauge;     // the one used, with its images
    int num_freedoms = 0;  // that the gauge holds
    CovarianceMethod method = CovarianceMethod::exact;
    int32_t num_samples = 0;     // 0 if exact
    double variance_factor = 0;  // NaN where nothing is redundant
    double cost = 0;
    int64_t redundancy = 0;
    int64_t num_undetermined_parameters = 0;  // poses and intrinsics
    int64_t num_undetermined_points = 0;      // of all points
    int64_t num_linear_solver_iterations = 0;
    uint64_t bytes = 0;  // of S, its factor and inverse
    double form_seconds = 0, factor_seconds = 0, inverse_seconds = 0, point_seconds = 0;

    std::vector<int32_t> image_size;   // 6 + intrinsics
    std::vector<int64_t> image_begin;  // pose and intrinsics of each image
    std::vector<double> images;
    std::vector<int32_t> camera_size;
    std::vector<int64_t> camera_begin;
    std::vector<double> cameras;
    std::vector<int32_t> points;  // their indices, and 9 numbers each
    std::vector<double> point_values;
    std::vector<std::array<double, 9>> rotations;  // of the images: centres' covariance R^T P R
};

// (J^T J)^-1 at the device's state, its gauge taken away, where J has the residuals' loss and
// covariances in it. The device must work in double precision.
Covariance compute_covariance(const Problem& problem, DeviceProblem& device,
                              const CovarianceOptions& options);

}  // namespace clba
