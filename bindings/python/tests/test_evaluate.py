# SPDX-License-Identifier: Apache-2.0
"""Residuals, gradient and Jacobian agree with each other and with steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import scene

import clba


def with_own_cameras() -> clba.Problem:
    """The first images have cameras of their own; those of the rest are shared or unused."""
    arrays = scene(num_images=6, num_points=30)
    arrays["camera_indices"] = np.array([0, 1, 2, 3, 3, 3], np.int32)
    return clba.Problem.from_arrays(**arrays)


@pytest.mark.parametrize(
    "make",
    [
        with_own_cameras,
        lambda: clba.Problem.from_arrays(**scene()),
        lambda: clba.Problem.generate(num_images=4, observations_per_image=30)[0],
    ],
    ids=["own and shared", "shared", "own"],
)
def test_jacobian_is_the_derivative(make: Any) -> None:
    problem = make()
    at = problem.evaluate()
    assert at.jacobian is not None and at.residuals is not None and at.gradient is not None
    assert at.jacobian.shape == (2 * problem.num_observations, problem.num_parameters)
    assert at.jacobian.has_canonical_format
    np.testing.assert_allclose(
        at.jacobian.T @ at.residuals.ravel(), at.gradient, atol=1e-9 * abs(at.gradient).max()
    )
    assert at.cost == pytest.approx(0.5 * np.sum(at.residuals**2), rel=1e-12)

    random = np.random.default_rng(0)
    state = problem.poses, problem.camera_params, problem.points
    direction = random.normal(size=problem.num_parameters)
    residuals = []
    h = 1e-6
    for sign in (1, -1):
        problem.apply_step(sign * h * direction)
        residuals.append(problem.evaluate(gradient=False, jacobian=False).residuals.ravel())
        problem.poses, problem.camera_params, problem.points = state
    difference = (residuals[0] - residuals[1]) / (2 * h)
    derivative = at.jacobian @ direction
    np.testing.assert_allclose(difference, derivative, atol=2e-6 * abs(derivative).max())


def test_parts_that_were_not_asked_for_are_none(problem: clba.Problem) -> None:
    at = problem.evaluate(residuals=False, gradient=False, jacobian=False)
    assert (at.residuals, at.gradient, at.jacobian) == (None, None, None)
    assert repr(at) == f"<clba.Evaluation: cost {at.cost:.6e}>"


def test_mixed_precision_is_near(problem: clba.Problem) -> None:
    mixed, double = problem.evaluate(precision="mixed"), problem.evaluate()
    assert mixed.cost == pytest.approx(double.cost, rel=1e-6)
    assert mixed.jacobian is not None and double.jacobian is not None
    assert abs(mixed.jacobian - double.jacobian).max() < 1e-4 * abs(double.jacobian).max()
    with pytest.raises(ValueError, match="precision = 0, but auto is for solves alone"):
        problem.evaluate(precision="auto")


def test_a_gauss_newton_step_by_scipy_is_that_of_the_solver(hall: clba.Problem) -> None:
    """One step with hardly any damping, computed outside."""
    import scipy.sparse.linalg

    other, _ = clba.Problem.generate("hall", num_images=6, observations_per_image=60)
    radius = 1e4
    clba.solve(
        other,
        max_num_iterations=1,
        linear_solver="explicit_schur",
        precision="double",
        initial_trust_region_radius=radius,
    )
    at = hall.evaluate()
    assert at.jacobian is not None and at.gradient is not None
    hessian = (at.jacobian.T @ at.jacobian).tocsc()
    damping = scipy.sparse.diags_array(np.clip(hessian.diagonal(), 1e-6, 1e32) / radius)
    hall.apply_step(-scipy.sparse.linalg.spsolve((hessian + damping).tocsc(), at.gradient))
    np.testing.assert_allclose(hall.points, other.points, atol=1e-6)
    np.testing.assert_allclose(hall.poses, other.poses, atol=1e-6)


def test_an_empty_problem() -> None:
    at = clba.Problem().evaluate()
    assert at.cost == 0
    assert at.jacobian is not None and at.jacobian.shape == (0, 0)
