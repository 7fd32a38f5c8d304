# SPDX-License-Identifier: Apache-2.0
"""Problems that grow, and windows of them."""

from __future__ import annotations

import numpy as np
import pytest

import clba


def hall() -> clba.Problem:
    return clba.Problem.generate("hall", num_images=8, observations_per_image=60, seed=1)[0]


def beginning(problem: clba.Problem, num_images: int) -> tuple[clba.Problem, np.ndarray]:
    """The first images with all points, and a mask of the observations that are left out."""
    left_out = problem.image_indices >= num_images
    kept = ~left_out
    first = clba.Problem.from_arrays(
        camera_models="snavely",
        camera_params=problem.camera_params[:num_images],
        poses=problem.poses[:num_images],
        points=problem.points,
        image_indices=problem.image_indices[kept],
        point_indices=problem.point_indices[kept],
        pixels=problem.pixels[kept],
    )
    return first, left_out


def test_appended_rows_follow_the_others() -> None:
    whole = hall()
    problem, left_out = beginning(whole, 6)
    before = problem.num_observations
    assert problem.add_cameras("snavely", whole.camera_params[6:]) == range(6, 8)
    assert problem.add_images(whole.poses[6:], [6, 7]) == range(6, 8)
    added = problem.add_observations(
        whole.image_indices[left_out],
        whole.point_indices[left_out],
        whole.pixels[left_out],
        covariances=np.tile([4.0, 0.0, 4.0], (left_out.sum(), 1)),
    )
    assert added == range(before, whole.num_observations)
    np.testing.assert_allclose(problem.poses, whole.poses, rtol=1e-15)
    ratio = problem.reprojection_errors() / problem.reprojection_errors("sigmas")
    np.testing.assert_allclose(ratio[:before], 1)
    np.testing.assert_allclose(ratio[before:], 2)
    assert problem.add_points([[0, 0, 1]]) == range(whole.num_points, whole.num_points + 1)
    with pytest.raises(IndexError, match="camera_indices"):
        problem.add_images(whole.poses[:1], [8])
    with pytest.raises(ValueError, match="covariances"):
        problem.add_observations([0], [0], [[1, 2]], covariances=[[1, 2]])


def test_a_window_moves_its_images_alone() -> None:
    problem = hall()
    poses, points = problem.poses, problem.points
    summary = clba.solve(problem, window=clba.Window(images=[2, 3]))
    assert summary.converged
    moved = np.any(problem.poses != poses, axis=1)
    assert np.flatnonzero(moved).tolist() == [2, 3]
    seen = np.unique(problem.point_indices[np.isin(problem.image_indices, [2, 3])])
    assert set(np.flatnonzero(np.any(problem.points != points, axis=1))) <= set(seen.tolist())
    before = problem.points
    clba.solve(problem, window=clba.Window(images=[4], points=[int(seen[0])]))
    assert set(np.flatnonzero(np.any(problem.points != before, axis=1))) <= {int(seen[0])}
    with pytest.raises(IndexError, match=r"window.images\[0\] = 8"):
        clba.solve(problem, window=clba.Window(images=[8]))
    with pytest.raises(ValueError, match="twice"):
        clba.solve(problem, window=clba.Window(images=[1, 1]))
    with pytest.raises(TypeError, match=r"clba\.Window"):
        clba.solve(problem, window=[1])  # type: ignore[arg-type]
