# SPDX-License-Identifier: Apache-2.0
"""Camera positions that GPS has measured, as priors.

Reprojection errors do not fix where a scene is, how it is turned and how large it is, and let a
long path bend. Priors add what GPS knows to the cost, each measurement by its uncertainty: the
result is in the GPS's world, and better than each measurement.
"""

from __future__ import annotations

import numpy as np

import clba

GPS_SIGMAS = np.array([0.05, 0.05, 0.1])  # world units


def main() -> dict[str, float]:
    """Root mean square distance of camera centres from the truth, without aligning them."""
    problem, truth = clba.Problem.generate(
        "street", num_images=30, observations_per_image=100, seed=4, position_noise=0.02
    )
    random = np.random.default_rng(0)
    gps = truth.centers + GPS_SIGMAS * random.normal(size=truth.centers.shape)
    results = {"gps": error(gps, truth), "start": error(problem.centers, truth)}
    poses, points, params = problem.poses, problem.points, problem.camera_params
    for name in ("without", "with"):
        problem.poses, problem.points, problem.camera_params = poses, points, params
        if name == "with":
            problem.set_position_priors(np.arange(len(gps)), gps, sigmas=GPS_SIGMAS)
        summary = clba.solve(problem, linear_solver="explicit_schur")
        results[name] = error(problem.centers, truth)
        print(f"{name:7} GPS: {results[name]:.4f} from the truth, gauge {summary.gauge}")
    print(f"GPS alone: {results['gps']:.4f}")
    return results


def error(centers: np.ndarray, truth: clba.Problem) -> float:
    return float(np.sqrt(np.mean(np.sum((centers - truth.centers) ** 2, axis=1))))


if __name__ == "__main__":
    main()
