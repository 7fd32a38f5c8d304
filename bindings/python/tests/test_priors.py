# SPDX-License-Identifier: Apache-2.0
"""Priors: what they add to cost and gradient, shapes, errors, and what a solve makes of them."""

from __future__ import annotations

import numpy as np
import pytest

import clba


@pytest.fixture
def problem() -> clba.Problem:
    start, _ = clba.Problem.generate("hall", num_images=6, observations_per_image=60)
    return start


def added(problem: clba.Problem, bare: float) -> float:
    return problem.evaluate(jacobian=False).cost - bare


def test_costs(problem: clba.Problem) -> None:
    bare = problem.evaluate(jacobian=False).cost
    close = {"abs": 1e-12 * bare}
    images = np.array([0, 4])
    problem.set_position_priors(images, problem.centers[images] + 2.0, sigmas=2.0)
    assert added(problem, bare) == pytest.approx(3.0, **close)
    covariance = [[4, 2, 0], [2, 5, 0], [0, 0, 9]]
    problem.set_position_priors(images, problem.centers[images] - [2, 5, 3], covariance)
    assert added(problem, bare) == pytest.approx(6.0, **close)
    problem.set_position_priors(None)
    assert added(problem, bare) == 0

    problem.set_point_priors([5], problem.points[[5]] - [2, 5, 3], [covariance])
    assert added(problem, bare) == pytest.approx(3.0, **close)
    problem.set_point_priors(None)

    poses = problem.poses[images]
    poses[:, 6] += 3
    problem.set_pose_priors(images, poses, sigmas=[1, 1, 1, 3, 3, 3])
    assert added(problem, bare) == pytest.approx(1.0, **close)
    problem.set_pose_priors(None)

    params = problem.camera_params[[1]] + [6, 100, 0]
    problem.set_intrinsics_priors([1], params, sigmas=[2, np.inf, 1e-3])
    assert added(problem, bare) == pytest.approx(4.5, **close)
    problem.set_intrinsics_priors(None)

    problem.poses = problem.poses[[0, 0, 2, 3, 4, 5]]
    bare = problem.evaluate(jacobian=False).cost
    problem.set_relative_pose_priors([[0, 1], [1, 0]], [[1, 0, 0, 0, 0, 0, 3]] * 2, np.eye(6))
    assert added(problem, bare) == pytest.approx(9.0, abs=1e-12 * bare)
    problem.set_relative_pose_priors(None)
    assert added(problem, bare) == 0


def test_gradient_of_the_cost(problem: clba.Problem) -> None:
    problem.set_position_priors([0, 3], problem.centers[[0, 3]] + 0.1, sigmas=0.05)
    problem.set_point_priors([2], problem.points[[2]] + 0.1, sigmas=0.05)
    problem.set_relative_pose_priors([[1, 4]], [[1, 0, 0, 0, 1, 2, 3]], sigmas=0.1)
    at = problem.evaluate()
    assert at.jacobian is not None
    of_observations = at.jacobian.T @ at.residuals.ravel()
    changed = np.flatnonzero(np.abs(at.gradient - of_observations) > 1e-6)
    poses, _, points = problem.offsets()
    wanted = [poses[0] + 3, poses[3] + 3, poses[1], poses[4], points + 6]
    assert set(wanted) <= set(changed)
    assert poses[0] not in changed
    assert poses[2] not in changed


def test_cameras_of_different_models() -> None:
    start, _ = clba.Problem.generate("hall", num_images=6, observations_per_image=60)
    params: list[list[float]] = [[700.0, 0, 0, 0.1], *[[700.0, 0, 0]] * 5]
    problem = clba.Problem.from_arrays(
        camera_models=["simple_radial", *["snavely"] * 5],
        camera_params=params,
        poses=start.poses,
        points=start.points,
        image_indices=start.image_indices,
        point_indices=start.point_indices,
        pixels=start.pixels,
    )
    bare = problem.evaluate(jacobian=False).cost
    targets = problem.camera_params[[3, 0]]
    targets[0, 0] += 2
    targets[1, 3] += 0.2
    problem.set_intrinsics_priors([3, 0], targets, sigmas=[1, 1, 1, 0.1])
    assert added(problem, bare) == pytest.approx(4.0, abs=1e-12 * bare)


def test_a_solve(problem: clba.Problem) -> None:
    images = np.arange(6)
    problem.set_position_priors(images, problem.centers, sigmas=0.1)
    summary = clba.solve(problem)
    assert (summary.gauge, summary.num_gauge_freedoms) == ("fixed_by_priors", 0)
    assert summary.initial_prior_cost == pytest.approx(0, abs=1e-9)
    assert 0 < summary.final_prior_cost < summary.final_cost
    problem.set_position_priors(None)
    assert clba.solve(problem).gauge == "free"


def test_errors(problem: clba.Problem) -> None:
    centers = problem.centers
    with pytest.raises(TypeError, match="either covariances or sigmas"):
        problem.set_position_priors([0], centers[:1])
    with pytest.raises(TypeError, match="either covariances or sigmas"):
        problem.set_position_priors([0], centers[:1], np.eye(3), sigmas=1.0)
    with pytest.raises(TypeError, match="positions is None"):
        problem.set_position_priors([0], sigmas=1.0)
    with pytest.raises(ValueError, match=r"positions has shape \(2, 3\)"):
        problem.set_position_priors([0], centers[:2], sigmas=1.0)
    with pytest.raises(ValueError, match=r"sigmas\[0\]\[1\] = -1"):
        problem.set_position_priors([0], centers[:1], sigmas=[1, -1, 1])
    with pytest.raises(IndexError, match=r"images\[0\] = 6"):
        problem.set_position_priors([6], centers[:1], sigmas=1.0)
    with pytest.raises(clba.InvalidArgumentError, match=r"images\[1\] = 2"):
        problem.set_position_priors([2, 2], centers[:2], sigmas=1.0)
    with pytest.raises(clba.InvalidArgumentError, match="positive definite"):
        problem.set_position_priors([2], centers[:1], [[1, 2, 0], [2, 1, 0], [0, 0, 1]])
    with pytest.raises(ValueError, match=r"pairs has shape \(2,\)"):
        problem.set_relative_pose_priors([0, 1], problem.poses[:1], sigmas=1.0)
