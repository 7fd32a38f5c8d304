# SPDX-License-Identifier: Apache-2.0
"""Refines a COLMAP reconstruction, and compares with COLMAP's own bundle adjustment.

refine_colmap.py [IN OUT]    folders of a model; without arguments: a synthetic one

Needs pycolmap.
"""

from __future__ import annotations

import copy
import sys

import pycolmap

import clba


def synthetic() -> pycolmap.Reconstruction:
    """Two cameras shared by six images each, and noise."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_frames_per_rig = 6
    options.num_points3D = 300
    reconstruction = pycolmap.synthesize_dataset(options)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = 0.7
    noise.point3D_stddev = 0.05
    noise.rig_from_world_translation_stddev = 0.02
    noise.rig_from_world_rotation_stddev = 0.5
    pycolmap.synthesize_noise(noise, reconstruction)
    return reconstruction


def cost(reconstruction: pycolmap.Reconstruction) -> float:
    problem = clba.Problem.from_pycolmap(reconstruction)
    return problem.evaluate(residuals=False, gradient=False, jacobian=False).cost


def main() -> tuple[float, float]:
    is_given = len(sys.argv) == 3
    reconstruction = pycolmap.Reconstruction(sys.argv[1]) if is_given else synthetic()
    theirs = copy.deepcopy(reconstruction)

    problem = clba.Problem.from_pycolmap(reconstruction)
    summary = clba.solve(problem, function_tolerance=1e-10)
    problem.update_pycolmap(reconstruction)
    print(summary)

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.bundle_adjustment(theirs, options)

    costs = cost(reconstruction), cost(theirs)
    print(f"cost by clba {costs[0]:.9e}, by COLMAP {costs[1]:.9e}")
    print(f"mean reprojection error {reconstruction.compute_mean_reprojection_error():.4f} pixels")
    if is_given:
        reconstruction.write(sys.argv[2])
    return costs


if __name__ == "__main__":
    main()
