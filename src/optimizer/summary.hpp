// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "device/queue.hpp"
#include "linear/linear_solver.hpp"
#include "reference/gauge.hpp"

namespace clba {

// The numbers of clba.h.
enum class Termination : int { convergence = 0, no_convergence = 1, failure = 2, user_stop = 3 };
enum class Reason : int {
    function_tolerance = 1,
    gradient_tolerance = 2,
    parameter_tolerance = 3,
    target_cost = 4,
    max_iterations = 5,
    max_seconds = 6,
    min_radius = 7,
    invalid_steps = 8,
    invalid_start = 9,
    callback = 10,
    nothing_to_do = 11,
    cancelled = 12
};

// Fields as in clba_iteration.
struct IterationRow {
    int iteration = 0;
    bool step_is_accepted = false;
    bool step_is_valid = false;
    int linear_solver_iterations = 0;
    int64_t num_behind = 0;
    double cost = 0;
    double cost_change = 0;
    double gradient_max_norm = 0;
    double step_norm = 0;
    double gain_ratio = 0;
    double trust_region_radius = 0;
    double seconds = 0;
    int remaining_iterations = -1;
    double remaining_seconds = -1;
};

// Fields as in clba_summary.
struct Summary {
    Termination termination = Termination::no_convergence;
    Reason reason = Reason::max_iterations;
    std::string message;
    LinearSolverKind linear_solver = LinearSolverKind::pcg_schur;
    Preconditioner preconditioner = Preconditioner::none;
    Damping damping = Damping::marquardt;
    Precision precision = Precision::mixed;
    JacobianForm jacobian = JacobianForm::recomputed;
    std::string choice;  // why the linear solver was chosen
    double eta = 0;
    int num_accepted_steps = 0, num_rejected_steps = 0, num_invalid_steps = 0;
    int num_linear_solver_iterations = 0;
    int64_t num_behind_initial = 0, num_behind_final = 0, num_singular = 0;
    int64_t num_indefinite_blocks = 0;
    double initial_cost = 0, final_cost = 0, reference_final_cost = 0;
    double initial_prior_cost = 0, final_prior_cost = 0;  // of the costs
    reference::GaugeState gauge;
    double total_seconds = 0, build_seconds = 0, setup_seconds = 0, linearize_seconds = 0;
    double factorization_seconds = 0;
    double linear_solver_seconds = 0, evaluate_seconds = 0, reference_seconds = 0;
    std::array<double, num_steps> step_seconds{};
    uint64_t peak_device_bytes = 0;
    std::string device;
    int resumed_iteration = 0;  // of the checkpoint
    int num_checkpoints = 0;
    std::string checkpoint_error;  // of the last one that could not be written
    std::vector<IterationRow> rows;
};

}  // namespace clba
