// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "linear/normal_equations.hpp"
#include "problem/problem.hpp"

namespace clba {

// G of each point, V^-1 = G^T G (kernels/factors.cl), in the caller's order.
std::vector<std::array<double, 6>> download_point_factors(const NormalEquations& equations,
                                                          const DeviceProblem& device);
int rank_of(const std::array<double, 6>& factor);  // coordinates that are not left out
Eigen::Matrix3d inverse_of(const std::array<double, 6>& factor);

// What a point's covariance needs: V^-1, and V^-1 W^T block by block of the F side.
struct PointSights {
    struct Part {
        int32_t block = 0;  // of ParameterLayout::blocks
        Eigen::Matrix<double, 3, Eigen::Dynamic> gain;
    };
    Eigen::Matrix3d inverse;
    std::vector<Part> parts;
};
// Of the listed points.
std::vector<PointSights> make_point_sights(const Problem& problem, DeviceProblem& device,
                                           NormalEquations& equations,
                                           const std::vector<std::array<double, 6>>& factors,
                                           const std::vector<int32_t>& points);

}  // namespace clba
