// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "linear/linear_solver.hpp"
#include "linear/normal_equations.hpp"
#include "optimizer/summary.hpp"

namespace clba {

// What the path of a solve depends on besides its state; a solve that goes on must have the same.
struct CheckpointKey {
    uint64_t fingerprint = 0;  // of the problem
    LinearSolverKind linear_solver = LinearSolverKind::automatic;
    Preconditioner preconditioner = Preconditioner::none;
    Damping damping = Damping::marquardt;
    Precision precision = Precision::mixed;
    JacobianForm jacobian = JacobianForm::recomputed;
};

// The state of a solve between two iterations: with it the solve goes on to the same bits as if it
// had never ended. Everything else is computed again from it. docs/control.md has the file.
struct Checkpoint {
    CheckpointKey key;
    double radius = 1, shrink_factor = 2;  // TrustRegion
    LinearSolverState linear_solver;
    int consecutive_invalid_steps = 0;
    double model_decrease = 0;
    // Of Summary: rows, counts and initial values.
    std::vector<IterationRow> rows;
    int num_accepted_steps = 0, num_rejected_steps = 0, num_invalid_steps = 0;
    int num_linear_solver_iterations = 0;
    int64_t num_behind_initial = 0, num_indefinite_blocks = 0;
    double initial_cost = 0;
    // Of the device: DeviceProblem::state_values(), and D^2 where the first linearisation fixes it.
    std::vector<double> state, fixed_damping;
};

// Throws Status::file.
void write_checkpoint(const Checkpoint& checkpoint, const std::string& path);
// Throws Status::file where it cannot be read, Status::format where it is damaged or of another
// version, Status::invalid_argument where it belongs to another problem or other options.
Checkpoint read_checkpoint(const std::string& path, const CheckpointKey& expected);

}  // namespace clba
