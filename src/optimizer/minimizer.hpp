// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <atomic>
#include <functional>
#include <limits>
#include <optional>
#include <string>

#include "linear/device_problem.hpp"
#include "linear/linear_solver.hpp"
#include "optimizer/checkpoint.hpp"
#include "optimizer/summary.hpp"

namespace clba {

// Fields as in clba_solver_options.
struct MinimizerOptions {
    LinearSolverOptions linear_solver;
    DampingOptions damping;
    JacobianForm jacobian = JacobianForm::recomputed;
    int max_iterations = 50;
    int max_consecutive_invalid_steps = 5;
    double initial_radius = 1e4;
    double max_radius = 1e16;
    double min_radius = 1e-32;
    double min_relative_decrease = 1e-3;
    double function_tolerance = 1e-6;
    double gradient_tolerance = 1e-10;
    double parameter_tolerance = 1e-8;
    double target_cost = 0;
    double max_seconds = std::numeric_limits<double>::infinity();
    std::function<bool(const IterationRow&)> on_iteration;  // true: go on
    const std::atomic<bool>* cancelled = nullptr;
    std::string checkpoint_path;  // empty: none is written
    int checkpoint_every = 10;    // iterations; 0: only at the end
    std::string resume_path;      // empty: from the start
};

// Minimises the cost by Levenberg-Marquardt from device.state, or from a checkpoint of the key,
// which holds the best state found at the end, and fills the summary's rows, counts and times but
// for what surrounds the loop. `host` has the problem's structure. start_seconds: wall time that
// passed before.
void minimize(const MinimizerOptions& options, const Problem& host, DeviceProblem& device,
              const CheckpointKey& key, const std::optional<Checkpoint>& resumed,
              double start_seconds, Summary& summary);

}  // namespace clba
