# SPDX-License-Identifier: Apache-2.0
"""A loop of one's own: Levenberg-Marquardt by scipy, on clba's residuals and Jacobian."""

from __future__ import annotations

import scipy.sparse
import scipy.sparse.linalg

import clba


def minimize(problem: clba.Problem, num_iterations: int = 30) -> float:
    damping = 1e-4
    at = problem.evaluate()
    for iteration in range(num_iterations):
        state = problem.poses, problem.camera_params, problem.points
        hessian = at.jacobian.T @ at.jacobian
        diagonal = scipy.sparse.diags_array(hessian.diagonal())
        step = scipy.sparse.linalg.spsolve((hessian + damping * diagonal).tocsc(), -at.gradient)
        problem.apply_step(step)
        trial = problem.evaluate()
        print(f"{iteration:3} cost {at.cost:.9e} -> {trial.cost:.9e}, damping {damping:.1e}")
        if trial.cost < at.cost:
            has_converged = at.cost - trial.cost < 1e-9 * at.cost
            at, damping = trial, damping / 3
            if has_converged:
                break
        else:
            problem.poses, problem.camera_params, problem.points = state
            damping *= 4
    return at.cost


def main() -> tuple[float, float]:
    mine, _ = clba.Problem.generate("hall", num_images=8, observations_per_image=100)
    cost = minimize(mine)
    theirs, _ = clba.Problem.generate("hall", num_images=8, observations_per_image=100)
    summary = clba.solve(theirs, function_tolerance=1e-9, precision="double")
    print(f"this loop: {cost:.9e}; clba.solve: {summary.final_cost:.9e}")
    return cost, summary.final_cost


if __name__ == "__main__":
    main()
