# SPDX-License-Identifier: Apache-2.0
"""Reprojection errors and the removal of outliers."""

from __future__ import annotations

import numpy as np
import pytest

import clba


def scene_with_outliers() -> clba.Problem:
    return clba.Problem.generate("hall", num_images=8, observations_per_image=60, seed=1)[1]


def test_errors_are_the_lengths_of_the_residuals() -> None:
    problem = scene_with_outliers()
    problem.set_loss("huber", 0.1)
    problem.set_sigmas(2.0)
    residuals = problem.evaluate(gradient=False, jacobian=False, apply_loss=False).residuals
    lengths = np.linalg.norm(residuals, axis=1)
    np.testing.assert_allclose(problem.reprojection_errors("sigmas"), lengths, rtol=1e-9)
    np.testing.assert_allclose(problem.reprojection_errors(), 2 * lengths, rtol=1e-9)
    with pytest.raises(ValueError, match="unit = 'metres'"):
        problem.reprojection_errors("metres")  # type: ignore[arg-type]


def test_outliers_go_and_rows_are_mapped() -> None:
    problem = scene_with_outliers()
    sigmas = np.linspace(1, 3, problem.num_observations)
    problem.set_sigmas(sigmas)
    pixels, errors = problem.pixels, problem.reprojection_errors("sigmas")
    largest = float(np.sort(errors)[-5])
    report = problem.filter(
        max_reprojection_error=largest,
        unit="sigmas",
        min_triangulation_angle=0,
        min_num_views=0,
    )
    assert report.num_large_error == report.num_observations_removed == 4
    kept = report.observation_rows >= 0
    np.testing.assert_array_equal(kept, errors <= largest)
    np.testing.assert_array_equal(problem.pixels, pixels[kept])
    np.testing.assert_array_equal(problem.reprojection_errors("sigmas"), errors[kept])
    assert report.observation_rows[kept].tolist() == list(range(problem.num_observations))
    assert problem.filter(max_reprojection_error=np.inf, min_num_views=0).num_large_error == 0


def test_observations_of_ones_own_choice() -> None:
    problem = scene_with_outliers()
    of_image = problem.image_indices == 3
    before = problem.num_points
    report = problem.remove_observations(of_image, remove_points=True)
    assert report.num_observations_removed == of_image.sum()
    assert report.unobserved_images.tolist() == [3]
    assert problem.num_points == before - report.num_points_removed
    assert (report.point_rows >= 0).sum() == problem.num_points
    assert problem.remove_observations([0, 1]).num_observations_removed == 2
    with pytest.raises(IndexError):
        problem.remove_observations([problem.num_observations])


def test_wrong_options() -> None:
    problem = scene_with_outliers()
    with pytest.raises(ValueError, match="min_triangulation_angle = 200"):
        problem.filter(min_triangulation_angle=200)
    with pytest.raises(TypeError, match="min_num_views"):
        problem.filter(min_num_views=1.5)  # type: ignore[arg-type]
