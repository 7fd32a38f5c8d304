# SPDX-License-Identifier: Apache-2.0
"""Covariances against numpy's inverse, and the gauge of a state."""

from __future__ import annotations

import numpy as np
import pytest

import clba


@pytest.fixture
def solved() -> clba.Problem:
    problem, _ = clba.Problem.generate("hall", num_images=6, observations_per_image=60)
    clba.solve(problem, function_tolerance=1e-12)
    return problem


def test_equals_the_inverse_of_the_normal_equations(solved: clba.Problem) -> None:
    solved.set_constant_images(rotation=[0], position=[0, 3])
    found = solved.covariance(points=[7, 2])
    assert (found.gauge, found.num_freedoms, found.method) == ("problem", 0, "exact")
    assert found.standard_errors is None and found.relative_error == 0
    jacobian = solved.evaluate().jacobian
    assert jacobian is not None
    dense = jacobian.toarray()
    kept = np.flatnonzero(np.abs(dense).max(axis=0))
    scale = 1 / np.linalg.norm(dense[:, kept], axis=0)
    columns = dense[:, kept] * scale
    inverse = np.zeros((dense.shape[1], dense.shape[1]))
    inverse[np.ix_(kept, kept)] = np.linalg.inv(columns.T @ columns) * np.outer(scale, scale)
    poses, intrinsics, points = solved.offsets()
    for image in (1, 3, 5):
        at = slice(poses[image], poses[image] + 9)
        joint = inverse[at, at]
        size = np.sqrt(np.outer(np.diag(joint), np.diag(joint))).clip(1e-300)
        assert np.abs((found.poses_and_intrinsics[image] - joint) / size).max() < 1e-6
        np.testing.assert_array_equal(found.poses_and_intrinsics[image][:6, :6], found.poses[image])
    camera = slice(intrinsics[2], intrinsics[2] + 3)
    np.testing.assert_allclose(found.intrinsics[2], inverse[camera, camera], rtol=1e-5)
    for row, point in enumerate(found.point_indices):
        at = slice(points + 3 * point, points + 3 * point + 3)
        np.testing.assert_allclose(np.diag(found.points[row]), np.diag(inverse[at, at]), rtol=1e-6)
    assert np.all(found.poses[0] == 0) and np.all(found.centers[3] == 0)
    assert found.redundancy == dense.shape[0] - len(kept)
    assert found.variance_factor == pytest.approx(2 * found.cost / found.redundancy)


def test_gauges_and_samples(solved: clba.Problem) -> None:
    exact = solved.covariance(gauge="inner", apply_variance_factor=True)
    assert exact.points.shape == (solved.num_points, 3, 3)
    sampled = solved.covariance(
        gauge="inner",
        apply_variance_factor=True,
        method="sampled",
        num_samples=50,
        seed=3,
        points=False,
    )
    assert sampled.num_samples == 50 and sampled.points.shape == (0, 3, 3)
    assert sampled.relative_error == pytest.approx(0.2)
    assert sampled.standard_errors is not None
    ratio = (sampled.centers - exact.centers) / sampled.standard_errors.centers
    assert 0.1 < np.abs(ratio).max() < 6
    pair = solved.covariance(gauge_images=(4, 1), points=False)
    assert (pair.gauge, pair.gauge_images) == ("first_image_and_baseline", (4, 1))
    assert np.all(pair.poses[4] == 0) and np.trace(pair.poses[0]) > 0
    assert "gauge first_image_and_baseline" in repr(pair)


def test_fix_gauge(solved: clba.Problem) -> None:
    pose, cost = solved.poses[2].copy(), solved.evaluate(jacobian=False).cost
    target = pose + [0, 0, 0, 0, 1, 2, 3]
    solved.fix_gauge(images=(2, 4), pose=target, baseline=2.5)
    np.testing.assert_allclose(solved.poses[2], target, rtol=1e-14)
    assert np.linalg.norm(solved.centers[4] - solved.centers[2]) == pytest.approx(2.5)
    assert solved.evaluate(jacobian=False).cost == pytest.approx(cost, rel=1e-9)
    solved.fix_gauge(gauge="three_points", points=(0, 9, 20), xyz=np.eye(3))
    np.testing.assert_allclose(solved.points[[0, 9]], np.eye(3)[:2], atol=1e-12)
    centers = solved.centers * 3 + 1
    solved.fix_gauge(gauge="inner", centers=centers)
    np.testing.assert_allclose(solved.centers, centers, atol=1e-9)
    centers = solved.centers / 3
    centers[3] = np.nan
    solved.fix_gauge(gauge="inner", centers=centers)
    np.testing.assert_allclose(solved.centers[4:], centers[4:], atol=1e-9)


def test_refuses(solved: clba.Problem) -> None:
    with pytest.raises(ValueError, match="gauge = 'none', but it must be one of default"):
        solved.covariance(gauge="none")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="gauge_images has 1 indices, but it must have 2"):
        solved.covariance(gauge_images=[1])
    with pytest.raises(IndexError, match=r"points\[1\] = 1000000"):
        solved.covariance(points=[0, 1000000])
    with pytest.raises(clba.InvalidArgumentError, match="leaves 7 of the 7 freedoms"):
        solved.covariance(gauge="problem")
    with pytest.raises(ValueError, match=r"centers has shape \(2, 3\)"):
        solved.fix_gauge(gauge="inner", centers=np.zeros((2, 3)))
    with pytest.raises(TypeError, match="centers is None, but the gauge 'inner' needs centers"):
        solved.fix_gauge(gauge="inner")
    with pytest.raises(TypeError, match="pose is None, but the gauge 'default' needs pose and"):
        solved.fix_gauge(baseline=1)
    solved.set_constant_images(rotation=[0])
    with pytest.raises(clba.InvalidArgumentError, match="constant poses"):
        solved.fix_gauge(pose=solved.poses[0], baseline=1)
