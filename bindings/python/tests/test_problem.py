# SPDX-License-Identifier: Apache-2.0
"""What goes into a problem comes out of it."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pytest
from conftest import MODELS, PARAMS, scene

import clba
from clba import _arrays

FLOATS = ("poses", "points", "pixels")
INTEGERS = ("camera_indices", "image_indices", "point_indices")


def assert_equal(problem: clba.Problem, arrays: dict[str, Any]) -> None:
    for name in (*FLOATS, *INTEGERS):
        np.testing.assert_allclose(getattr(problem, name), arrays[name], rtol=1e-15, atol=1e-15)
    assert problem.camera_models == MODELS
    for row, params in zip(problem.camera_params, PARAMS, strict=True):
        np.testing.assert_array_equal(row[: len(params)], params)
        assert np.isnan(row[len(params) :]).all()


def test_arrays_come_out_as_they_went_in(arrays: dict[str, Any]) -> None:
    problem = clba.Problem.from_arrays(**arrays)
    assert (problem.num_cameras, problem.num_images) == (5, 10)
    assert (problem.num_points, problem.num_observations) == (40, 400)
    assert problem.num_parameters == 6 * 10 + sum(map(len, PARAMS)) + 3 * 40
    assert_equal(problem, arrays)
    assert repr(problem) == "<clba.Problem: 10 images, 5 cameras, 40 points, 400 observations>"


@pytest.mark.parametrize("layout", ["fortran", "backwards", "strided", "wider rows", "big endian"])
def test_any_layout_is_read(arrays: dict[str, Any], layout: str) -> None:
    change = {
        "fortran": np.asfortranarray,
        "backwards": lambda a: a[::-1].copy()[::-1],
        "strided": lambda a: np.repeat(a, 3, axis=0)[::3],
        "wider rows": lambda a: np.hstack([a, a])[:, : a.shape[1]] if a.ndim == 2 else a,
        "big endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    }[layout]
    changed = {name: change(arrays[name]) for name in (*FLOATS, *INTEGERS)}
    assert_equal(clba.Problem.from_arrays(**{**arrays, **changed}), arrays)


def test_other_types_are_converted(arrays: dict[str, Any]) -> None:
    changed = {name: arrays[name].astype(np.float32) for name in FLOATS}
    changed |= {name: arrays[name].astype(np.uint64) for name in INTEGERS}
    problem = clba.Problem.from_arrays(**{**arrays, **changed})
    np.testing.assert_array_equal(problem.points, changed["points"].astype(np.float64))
    np.testing.assert_array_equal(problem.point_indices, arrays["point_indices"])
    lists = {name: arrays[name].tolist() for name in (*FLOATS, *INTEGERS)}
    assert_equal(clba.Problem.from_arrays(**{**arrays, **lists}), arrays)


def test_rows_without_gaps_are_not_copied(arrays: dict[str, Any]) -> None:
    wide = np.hstack([arrays["pixels"], arrays["pixels"]])
    for array in (arrays["pixels"], wide[:, 1:3], wide[::2, :2]):
        assert np.shares_memory(_arrays.doubles(array, (None, 2), "pixels"), array)
    indices = np.repeat(arrays["image_indices"], 2)[::2]
    assert np.shares_memory(_arrays.indices(indices, None, 10, "image_indices", "images"), indices)


def test_one_model_for_all_cameras() -> None:
    one: dict[str, Any] = {
        "poses": [[1, 0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 1, 0, 0]],
        "points": [[0, 0, 5]],
        "image_indices": [0, 1],
        "point_indices": [0, 0],
        "pixels": [[320, 240], [480, 240]],
    }
    shared = clba.Problem.from_arrays(
        camera_models="pinhole", camera_params=[800, 800, 320, 240], **one
    )
    assert shared.camera_indices.tolist() == [0, 0]
    assert shared.evaluate().cost == 0
    own = clba.Problem.from_arrays(
        camera_models="pinhole", camera_params=np.tile([800, 800, 320, 240], (2, 1)), **one
    )
    assert own.camera_indices.tolist() == [0, 1]


def test_state_can_be_set(problem: clba.Problem, arrays: dict[str, Any]) -> None:
    problem.points = problem.points + 1
    np.testing.assert_allclose(problem.points, arrays["points"] + 1)
    poses = problem.poses
    poses[:, 4:] *= 2
    problem.poses = poses
    np.testing.assert_allclose(problem.poses, poses)
    params = problem.camera_params
    params[:, 0] += 5
    problem.camera_params = params
    np.testing.assert_array_equal(problem.camera_params[:, 0], params[:, 0])
    assert problem.num_observations == 400


def test_centers(problem: clba.Problem) -> None:
    from scipy.spatial.transform import Rotation

    poses = problem.poses
    rotations = Rotation.from_quat(poses[:, [1, 2, 3, 0]])
    np.testing.assert_allclose(problem.centers, -rotations.inv().apply(poses[:, 4:]), atol=1e-12)


def test_projection_is_that_of_the_header() -> None:
    """Without noise every residual is 0, for each model."""
    residuals = clba.Problem.from_arrays(**scene(noise=0)).evaluate().residuals
    assert residuals is not None
    assert np.abs(residuals).max() < 1e-9


def test_sigmas_divide_residuals(problem: clba.Problem) -> None:
    plain = problem.evaluate().residuals
    assert plain is not None
    sigmas = np.linspace(0.5, 3, problem.num_observations)
    problem.set_sigmas(sigmas)
    np.testing.assert_allclose(problem.evaluate().residuals, plain / sigmas[:, None], rtol=1e-9)
    problem.set_sigmas(2)
    np.testing.assert_allclose(problem.evaluate().residuals, plain / 2, rtol=1e-9)
    problem.set_sigmas(None)
    np.testing.assert_allclose(problem.evaluate().residuals, plain, rtol=1e-9)


def test_covariances_whiten_residuals(problem: clba.Problem) -> None:
    plain = problem.evaluate().residuals
    assert plain is not None
    covariance = np.array([[4.0, 1.0], [1.0, 2.0]])
    problem.set_covariances(np.tile([4.0, 1.0, 2.0], (problem.num_observations, 1)))
    cost = 0.5 * np.einsum("ni,ij,nj->", plain, np.linalg.inv(covariance), plain)
    assert problem.evaluate().cost == pytest.approx(cost, rel=1e-10)
    problem.set_covariances(None)
    assert problem.evaluate().cost == pytest.approx(0.5 * np.sum(plain**2), rel=1e-10)


def test_from_arrays_takes_sigmas_or_covariances(arrays: dict[str, Any]) -> None:
    plain = clba.Problem.from_arrays(**arrays).evaluate().cost
    sigmas = clba.Problem.from_arrays(**arrays, sigmas=np.full(400, 2.0))
    assert sigmas.evaluate().cost == pytest.approx(plain / 4)
    covariances = clba.Problem.from_arrays(**arrays, covariances=np.tile([4.0, 0, 4], (400, 1)))
    assert covariances.evaluate().cost == pytest.approx(plain / 4)


def test_huber_loss(problem: clba.Problem) -> None:
    plain = problem.evaluate().residuals
    assert plain is not None
    s = np.sum(plain**2, axis=1)
    a = 0.5
    problem.set_loss("huber", a)
    rho = np.where(s <= a * a, s, 2 * a * np.sqrt(s) - a * a)
    assert problem.evaluate().cost == pytest.approx(0.5 * rho.sum(), rel=1e-10)
    assert problem.evaluate(apply_loss=False).cost == pytest.approx(0.5 * s.sum(), rel=1e-10)


def constant_columns(problem: clba.Problem) -> set[int]:
    jacobian = problem.evaluate().jacobian
    assert jacobian is not None
    return set(np.flatnonzero(abs(jacobian).sum(axis=0) == 0).tolist())


def test_constants(problem: clba.Problem) -> None:
    poses, intrinsics, points = problem.offsets()
    assert constant_columns(problem) == set()
    problem.set_constant_points([3, 5])
    problem.set_constant_images(rotation=np.arange(10) == 2, position=[4])
    problem.set_constant_cameras([1, 3], ("cx", "k1", "fy"))
    expected = {points + 3 * point + k for point in (3, 5) for k in range(3)}
    expected |= {poses[2] + k for k in range(3)} | {poses[4] + 3 + k for k in range(3)}
    # pinhole: fx, fy, cx, cy; radial: f, cx, cy, k1, k2
    expected |= {intrinsics[1] + 1, intrinsics[1] + 2, intrinsics[3] + 1, intrinsics[3] + 3}
    assert constant_columns(problem) == expected
    assert np.flatnonzero(problem.constant_points).tolist() == [3, 5]
    assert np.argwhere(problem.constant_images).tolist() == [[2, 0], [4, 1]]
    assert np.argwhere(problem.constant_cameras).tolist() == [[1, 1], [1, 2], [3, 1], [3, 3]]
    problem.set_constant_points(None)
    problem.set_constant_images()
    problem.set_constant_cameras(None)
    assert constant_columns(problem) == set()
    mask = np.zeros((5, 8), dtype=bool)
    mask[0, 0] = mask[4, 7] = True
    problem.set_constant_cameras(mask)
    assert constant_columns(problem) == {intrinsics[0], intrinsics[4] + 7}
    assert (problem.constant_cameras == mask).all()
    problem.set_constant_points()
    problem.set_constant_images(rotation=True, position=True)
    problem.set_constant_cameras()
    assert len(constant_columns(problem)) == problem.num_parameters


def test_uncertainties_shape_the_step(hall: clba.Problem) -> None:
    """The step moves a certain parameter less, and None undoes it."""

    def moved() -> Any:
        before = hall.points
        clba.solve(
            hall,
            damping="uncertainty",
            max_num_iterations=1,
            linear_solver="explicit_schur",
            initial_trust_region_radius=1e-3,
        )
        step = np.linalg.norm(hall.points - before, axis=1)
        hall.points = before
        return step

    start = hall.poses, hall.camera_params
    values = np.ones((hall.num_points, 3))
    values[: hall.num_points // 2] = 1e-6
    hall.set_uncertainties(points=values)
    halves = np.split(moved(), [hall.num_points // 2])
    assert halves[0].max() < 1e-3 * np.median(halves[1])
    hall.poses, hall.camera_params = start
    hall.set_uncertainties()
    halves = np.split(moved(), [hall.num_points // 2])
    assert 0.1 < np.median(halves[0]) / np.median(halves[1]) < 10


def test_uncertainties_are_broadcast(hall: clba.Problem) -> None:
    hall.set_uncertainties(images=[0.1, 0.1, 0.1, 2, 2, 2], cameras=[10, 1, 1], points=0.5)
    with pytest.raises(ValueError, match=r"images has shape \(5,\), but it must be \(6, 6\)"):
        hall.set_uncertainties(images=np.ones(5))
    with pytest.raises(ValueError, match=r"points\[0\]\[0\] = 0"):
        hall.set_uncertainties(points=0)


def test_bal_round_trip(hall: clba.Problem, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "hall.txt.bz2"
    hall.to_bal(path)
    again = clba.Problem.from_bal(path)
    np.testing.assert_array_equal(again.pixels, hall.pixels)
    np.testing.assert_array_equal(again.points, hall.points)
    signs = np.sign(np.sum(again.poses[:, :4] * hall.poses[:, :4], axis=1))
    turned = again.poses * np.hstack([np.tile(signs[:, None], 4), np.ones((6, 3))])
    np.testing.assert_allclose(turned, hall.poses, atol=1e-12)
    hall.to_ply(tmp_path / "hall.ply")
    assert (tmp_path / "hall.ply").read_bytes().startswith(b"ply\n")


def test_bal_errors(problem: clba.Problem, tmp_path: pathlib.Path) -> None:
    with pytest.raises(OSError, match=r"missing\.txt"):
        clba.Problem.from_bal(tmp_path / "missing.txt")
    (tmp_path / "wrong.txt").write_text("1 2 three\n", encoding="utf-8")
    with pytest.raises(clba.FormatError, match=r"wrong\.txt"):
        clba.Problem.from_bal(tmp_path / "wrong.txt")
    with pytest.raises(ValueError, match="snavely"):
        problem.to_bal(tmp_path / "out.txt")
    assert not (tmp_path / "out.txt").exists()


def test_generate() -> None:
    start, truth = clba.Problem.generate("street", num_images=8, pixel_noise=0, seed=3)
    assert truth.evaluate(jacobian=False).cost < 1e-12
    assert start.evaluate(jacobian=False).cost > 1
    again, _ = clba.Problem.generate("street", num_images=8, pixel_noise=0, seed=3)
    np.testing.assert_array_equal(start.pixels, again.pixels)
    other, _ = clba.Problem.generate("street", num_images=8, pixel_noise=0, seed=4)
    assert other.points.shape != start.points.shape or not np.array_equal(
        other.points, start.points
    )
    with pytest.raises(ValueError, match="scene = 'cave', but it must be one of hall, street"):
        clba.Problem.generate("cave")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="num_images = 1"):
        clba.Problem.generate(num_images=1)
    with pytest.raises(ValueError, match="must fit into 64 bits"):
        clba.Problem.generate(seed=2**64)


def test_compare(problem: clba.Problem, arrays: dict[str, Any]) -> None:
    assert problem.compare(problem).max_center_distance < 1e-9
    other = clba.Problem.from_arrays(**{**arrays, "points": arrays["points"] + [0.5, 0, 0]})
    comparison = problem.compare(other)
    assert comparison.median_point_distance == pytest.approx(0.5, rel=1e-6)
    assert comparison.scale == pytest.approx(1)
    with pytest.raises(TypeError, match=r"must be a clba\.Problem"):
        problem.compare(3)  # type: ignore[arg-type]


def test_close(problem: clba.Problem) -> None:
    with problem as same:
        assert same is problem
    assert repr(problem) == "<clba.Problem, closed>"
    problem.close()
