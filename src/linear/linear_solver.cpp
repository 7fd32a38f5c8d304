// SPDX-License-Identifier: Apache-2.0
#include "linear/linear_solver.hpp"

#include <cmath>

#include "linear/auto_solver.hpp"
#include "linear/direct_solver.hpp"
#include "linear/explicit_schur.hpp"
#include "linear/pcg_solvers.hpp"
#include "linear/prior_terms.hpp"

namespace clba {

std::unique_ptr<LinearSolver> make_linear_solver(const LinearSolverOptions& options,
                                                 const Problem& problem,
                                                 NormalEquations& equations) {
    switch (options.kind) {
        case LinearSolverKind::pcg_hessian:
            return std::make_unique<PcgHessian>(options, equations);
        case LinearSolverKind::direct_schur:
            return std::make_unique<DirectSolver>(problem, equations);
        case LinearSolverKind::explicit_schur:
            return std::make_unique<ExplicitSchur>(problem, equations);
        case LinearSolverKind::automatic:
            return std::make_unique<AutoSolver>(options, problem, equations);
        default:
            return std::make_unique<PcgSchur>(options, equations);
    }
}

void take_step(NormalEquations& equations, const Vector& gradient, const Vector& step,
               LinearSolution& solution) {
    DeviceProblem& problem = equations.problem();
    VectorOperations& vectors = problem.vectors();
    problem.update(step);
    double squared_norm = equations.jacobian.squared_norm(step);
    if (problem.priors())
        squared_norm += problem.priors()->squared_norm(step, equations.jacobian.point_step());
    solution.model_decrease = -vectors.dot(gradient, step) - 0.5 * squared_norm;
    solution.step_norm = std::sqrt(vectors.dot(step, step));
}

}  // namespace clba
