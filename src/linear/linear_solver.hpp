// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <memory>
#include <string>

#include "base/stop_test.hpp"
#include "linear/normal_equations.hpp"
#include "problem/problem.hpp"

namespace clba {

enum class LinearSolverKind : int {
    pcg_schur = 1,
    pcg_hessian = 2,
    direct_schur = 3,
    explicit_schur = 4,
    automatic = 5
};
enum class Preconditioner : int { none = 0, block_jacobi = 1, schur_jacobi = 2 };

struct LinearSolverOptions {
    LinearSolverKind kind = LinearSolverKind::pcg_schur;
    Preconditioner preconditioner = Preconditioner::schur_jacobi;
    int min_iterations = 0;
    int max_iterations = 500;
    double eta = 0.1;  // forcing term of PCG's stopping test
};

struct LinearSolution {
    bool is_usable = false;  // false: no step, damp more
    int num_iterations = 0;
    int64_t num_indefinite_blocks = 0;
    double model_decrease = 0;  // -gradient . step - 1/2 |J step|^2, priors included
    double step_norm = 0;
    double factorization_seconds = 0;  // on the host
    StopCause stopped =
        StopCause::none;  // it was cut short: unusable, or less exact than asked for
};

// What a solver carries from one step to the next, but for what the normal equations hold.
struct LinearSolverState {
    int num_steps = 0;
    double break_even = -1;  // AutoSolver's; -1 if it is not known yet
    bool is_explicit = false;
    double explicit_lambda = 0;
    int explicit_step = 0, explicit_iterations = 0;  // at which it became explicit, and why
};

// Solves (H + lambda D^2) step = -gradient for the current normal equations, and leaves the
// state moved by the step in the problem's `trial`.
class LinearSolver {
public:
    virtual ~LinearSolver() = default;
    virtual LinearSolution solve(double lambda, const StopTest& stop = {}) = 0;
    // F and E of the last usable step.
    virtual void get_step(Vector& full) = 0;
    virtual LinearSolverKind kind() const = 0;         // the one used last
    virtual std::string reason() const { return {}; }  // why, where there was a choice
    virtual LinearSolverState state() const { return {}; }
    virtual void restore(const LinearSolverState&) {}  // of a solver of the same options
};

// Moves the trial state by a step of F and E, and completes its solution.
void take_step(NormalEquations& equations, const Vector& gradient, const Vector& step,
               LinearSolution& solution);

// problem is the host's, in the order of the device's.
std::unique_ptr<LinearSolver> make_linear_solver(const LinearSolverOptions& options,
                                                 const Problem& problem,
                                                 NormalEquations& equations);

}  // namespace clba
