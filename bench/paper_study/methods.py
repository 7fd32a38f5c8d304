# SPDX-License-Identifier: Apache-2.0
"""The methods that the study compares: how a problem is prepared, and how it is solved."""
import dataclasses
from collections.abc import Callable
from typing import Any

import clba

from scenes import INTRINSICS_NOISE, WEIGHT

MAX_ITERATIONS = 60  # the paper's
# Tong et al. (2013): conjugate gradients on the damped Hessian, a stored Jacobian, block Jacobi.
PAPER = {"linear_solver": "pcg_hessian", "preconditioner": "block_jacobi", "jacobian": "stored"}


def nothing(problem, scene):
    pass


def paper_weights(problem, scene):
    problem.set_uncertainties(images=WEIGHT, cameras=1, points=WEIGHT)


def true_weights(problem, scene):
    rotation, position, point = scene.uncertainties
    problem.set_uncertainties(images=[rotation] * 3 + [position] * 3,
                              cameras=INTRINSICS_NOISE * problem.camera_params[:1].clip(1),
                              points=point)


def constant_intrinsics(problem, scene):
    problem.set_constant_cameras(True)


def sigmas(problem, scene):
    problem.set_sigmas(scene.sigmas)


def robust(problem, scene):
    problem.set_loss("cauchy", 2.0)


def robust_sigmas(problem, scene):
    sigmas(problem, scene)
    robust(problem, scene)


def robust_constant_intrinsics(problem, scene):
    if scene.sigmas is not None:
        sigmas(problem, scene)
    robust(problem, scene)
    constant_intrinsics(problem, scene)


@dataclasses.dataclass(frozen=True)
class Method:
    label: str
    prepare: Callable[[clba.Problem, Any], None] = nothing
    options: dict = dataclasses.field(default_factory=dict)
    needs_truth: bool = False  # of the scene's noise


def paper(label, damping, prepare=nothing, needs_truth=False, **options):
    return Method(label, prepare, {**PAPER, "damping": damping, **options}, needs_truth)


WITHOUT_WEIGHTS = {
    f"paper_{damping}": paper(f"paper's algorithm, {damping}", damping)
    for damping in ("marquardt", "levenberg", "uncertainty")
}
WITH_WEIGHTS = {
    f"paper_{damping}_weighted": paper(f"the same with weights of {WEIGHT}:1, {damping}", damping,
                                       paper_weights)
    for damping in ("marquardt", "levenberg", "uncertainty")
}
# With lambda 1 the damping of the first step is that of a prior of these standard deviations.
TRUE_WEIGHTS = {
    "paper_uncertainty_true": paper(
        "the same with the true standard deviations, uncertainty, lambda from 1 on", "uncertainty",
        true_weights, True, initial_trust_region_radius=1.0),
}
PAPERS = {**WITHOUT_WEIGHTS, **WITH_WEIGHTS, **TRUE_WEIGHTS}
OURS = {
    "default": Method("clba, defaults"),
    "constant_intrinsics": Method("clba, intrinsics held constant", constant_intrinsics),
    "sigmas": Method("clba, observations with their covariances", sigmas, {}, True),
    "robust": Method("clba, Cauchy loss of 2", robust),
    "robust_sigmas": Method("clba, covariances and Cauchy loss", robust_sigmas, {}, True),
    "robust_constant_intrinsics": Method(
        "clba, the same and intrinsics held constant", robust_constant_intrinsics, {}, True),
}
ALL = {**PAPERS, **OURS}


def solve(method, scene, *, stops_at_rejection=False, max_num_iterations=MAX_ITERATIONS, **options):
    """Solves a copy of the scene's start; returns it and the summary."""
    start = scene.start
    problem = clba.Problem.from_arrays(
        camera_models=start.camera_models, camera_params=start.camera_params, poses=start.poses,
        points=start.points, camera_indices=start.camera_indices,
        image_indices=start.image_indices, point_indices=start.point_indices, pixels=start.pixels)
    method.prepare(problem, scene)

    def is_rejected(row):
        return not row.step_is_accepted and row.iteration > 0

    summary = clba.solve(problem, **{**method.options, **options},
                         max_num_iterations=max_num_iterations,
                         callback=is_rejected if stops_at_rejection else None)
    return problem, summary
