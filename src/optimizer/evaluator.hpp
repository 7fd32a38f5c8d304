// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "linear/device_problem.hpp"
#include "linear/normal_equations.hpp"
#include "problem/loss.hpp"

namespace clba {

struct CostEvaluation {
    double cost = 0;           // 1/2 sum rho(|r|^2), and that of priors
    double prior_cost = 0;     // of it
    int64_t num_behind = 0;    // observations of points behind their camera
    int64_t num_singular = 0;  // observations in the camera's own plane
};

// Residuals, cost and derivatives of a problem's states.
class Evaluator {
public:
    Evaluator(DeviceProblem& problem, const Loss& loss);
    Evaluator(DeviceProblem& problem, const Problem& host) : Evaluator(problem, host.loss) {}

    // residuals: NULL, or slots of 2 rows of doubles for sqrt(rho') r.
    CostEvaluation cost(const State& state, std::vector<Buffer>* residuals);
    // Jacobian, gradient, V and D^2 at problem.state.
    void linearize(NormalEquations& equations);

private:
    int64_t num_groups(const DeviceChunk& chunk) const;
    std::string defines(const DeviceSegment& segment) const;

    DeviceProblem& problem_;
    Queue& queue_;
    Loss loss_;
    std::vector<double> sums_;
    Buffer tile_sums_;
    int32_t point_capacity_ = 0;  // slots of a tile, at most
    int64_t num_point_sums_ = 0;  // work-groups that have point_sums_ of their own
    Buffer point_sums_;
};

}  // namespace clba
