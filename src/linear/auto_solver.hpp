// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <memory>
#include <optional>
#include <string>

#include "linear/explicit_schur.hpp"
#include "linear/pcg_solvers.hpp"

namespace clba {

// pcg_schur, until a step takes more iterations than forming and factoring the Schur complement
// would cost; explicit_schur from then on, for steps of so small a lambda: the larger it is, the
// fewer iterations a step takes. Exact steps of a path-like scene replace hundreds of iterations,
// while most scenes need a few. Decides by counts alone, so that equal input gives equal bits.
class AutoSolver : public LinearSolver {
public:
    AutoSolver(const LinearSolverOptions& options, const Problem& problem,
               NormalEquations& equations);
    LinearSolution solve(double lambda, const StopTest& stop) override;
    void get_step(Vector& full) override;
    LinearSolverKind kind() const override;
    std::string reason() const override { return reason_; }
    LinearSolverState state() const override;
    void restore(const LinearSolverState& state) override;

private:
    double break_even_iterations();
    void find_break_even();
    bool make_explicit();  // false: no memory

    const Problem& problem_;
    NormalEquations& equations_;
    PcgSchur pcg_;
    int max_iterations_;
    std::unique_ptr<ExplicitSchur> explicit_;
    LinearSolver* last_ = &pcg_;               // that took a step
    std::optional<double> break_even_;         // iterations that cost as much as an explicit step
    std::optional<SchurStructure> structure_;  // found on the way to it
    double explicit_lambda_ = 0;               // the largest for which pcg_schur took too long
    int num_steps_ = 0;
    int explicit_step_ = 0, explicit_iterations_ = 0;  // the step that took too long, first
    std::string reason_;
};

}  // namespace clba
