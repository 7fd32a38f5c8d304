# SPDX-License-Identifier: Apache-2.0
"""A robust loss on a scene of which 10 % of the observations are wrong."""

from __future__ import annotations

import clba


def main() -> dict[str, float]:
    """How far cameras are from the truth, as a share of the scene, without a loss and with one."""
    errors = {}
    for loss in ("none", "huber", "cauchy"):
        problem, truth = clba.Problem.generate("hall", num_images=20, outlier_share=0.1, seed=2)
        problem.set_loss(loss, scale=1.0)  # pixels
        summary = clba.solve(problem, max_num_iterations=100)
        comparison = truth.compare(problem)
        errors[loss] = comparison.median_center_distance / comparison.extent
        print(
            f"{loss:8} {summary.num_iterations:3} iterations, "
            f"camera centres {100 * errors[loss]:.4f} % of the scene from the truth"
        )
    return errors


if __name__ == "__main__":
    main()
