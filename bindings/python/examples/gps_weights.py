# SPDX-License-Identifier: Apache-2.0
"""Camera positions that GPS has measured well, by way of uncertainties.

Reprojection errors do not fix where a scene is, how it is turned and how large it is. Uncertainties
tell the damping which parameters of the start are known well: these give way least, and the scene
stays where the GPS put it. They are no priors (gps_priors.py): given enough iterations, the cost
alone decides what it can decide.
"""

from __future__ import annotations

import numpy as np

import clba

GPS_SIGMA = 0.02  # of camera centres, world units


def start() -> tuple[clba.Problem, clba.Problem]:
    """Calibrated cameras at their GPS positions; rotations and points are known badly."""
    problem, truth = clba.Problem.generate(
        "landmark", num_images=20, seed=5, rotation_noise=1.0, position_noise=0, point_noise=0.03
    )
    random = np.random.default_rng(0)
    gps = truth.centers + GPS_SIGMA * random.normal(size=truth.centers.shape)
    poses = problem.poses
    poses[:, 4:] -= np.einsum("nij,nj->ni", rotations(poses), gps - problem.centers)
    problem.poses = poses
    problem.camera_params = truth.camera_params
    problem.set_constant_cameras()
    return problem, truth


def rotations(poses: np.ndarray) -> np.ndarray:
    """Matrices of the quaternions w, x, y, z."""
    w, x, y, z = poses[:, :4].T
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def main() -> dict[str, tuple[float, float]]:
    """Final cost, and median distance of camera centres from the truth, without aligning them."""
    results = {}
    for name in ("marquardt", "uncertainty"):
        problem, truth = start()
        if name == "uncertainty":
            problem.set_uncertainties(
                images=[0.02, 0.02, 0.02, GPS_SIGMA, GPS_SIGMA, GPS_SIGMA],  # rad, world units
                points=1.0,
            )
        summary = clba.solve(
            problem, damping=name, linear_solver="explicit_schur", max_num_iterations=100
        )
        distance = np.median(np.linalg.norm(problem.centers - truth.centers, axis=1))
        results[name] = summary.final_cost, float(distance)
        print(f"{name:12} cost {summary.final_cost:.6e}, {distance:.4f} from the truth")
    return results


if __name__ == "__main__":
    main()
