# SPDX-License-Identifier: Apache-2.0
"""Arrays that are wrong, and problems that are closed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clba

WRONG: list[tuple[str, Callable[[Any], Any], type[Exception], str]] = [
    ("points", lambda a: a[:, :2], ValueError, r"points has shape \(40, 2\), .* \(any, 3\)"),
    ("points", lambda a: a.ravel(), ValueError, r"points has shape \(120,\)"),
    ("points", lambda a: a.astype(complex), TypeError, "points has dtype complex128"),
    ("points", lambda a: a.astype(str), TypeError, "points has dtype <U32"),
    ("points", lambda a: a.astype(object), TypeError, "points has dtype object"),
    ("points", lambda a: a > 0, TypeError, "points has dtype bool"),
    ("points", lambda a: [[1, 2, 3], [4, 5]], ValueError, "points is ragged"),
    ("points", lambda a: None, TypeError, "points has dtype object"),
    ("points", lambda a: np.where(a == a[7], np.nan, a), ValueError, r"points\[7\]\[0\] = nan"),
    ("points", lambda a: a[:39], IndexError, r"point_indices\[39\] = 39, but there are 39 points"),
    ("poses", lambda a: a[:, :6], ValueError, r"poses has shape \(10, 6\), .* \(any, 7\)"),
    ("poses", lambda a: a * 0, ValueError, r"poses\[0\] has a quaternion of squared norm 0"),
    ("poses", lambda a: a[:8], ValueError, r"camera_indices has shape \(10,\), .* \(8,\)"),
    ("pixels", lambda a: a[1:], ValueError, r"pixels has shape \(399, 2\), .* \(400, 2\)"),
    ("pixels", lambda a: a.T, ValueError, r"pixels has shape \(2, 400\)"),
    ("pixels", lambda a: np.full_like(a, np.inf), ValueError, r"pixels\[0\] = \(inf, inf\)"),
    ("image_indices", lambda a: a + 1, IndexError, r"image_indices\[360\] = 10, but there are 10"),
    ("image_indices", lambda a: a - 1, IndexError, r"image_indices\[0\] = -1"),
    (
        "image_indices",
        lambda a: a + np.int64(2**40),
        IndexError,
        r"image_indices\[0\] = 1099511627776",
    ),
    ("image_indices", lambda a: a * 1.0, TypeError, "image_indices has dtype float64"),
    ("image_indices", lambda a: a[:, None], ValueError, r"image_indices has shape \(400, 1\)"),
    ("point_indices", lambda a: a[1:], ValueError, r"point_indices has shape \(399,\)"),
    ("camera_indices", lambda a: a + 1, IndexError, r"camera_indices\[4\] = 5, but there are 5"),
    ("camera_indices", lambda a: None, ValueError, "there are 5 cameras for 10 images"),
    (
        "camera_models",
        lambda a: "fisheye",
        ValueError,
        r"camera_models\[0\] = 'fisheye', .* opencv, ",
    ),
    ("camera_models", lambda a: [*a[:4], 5], TypeError, r"camera_models\[4\] = 5"),
    ("camera_models", lambda a: a[:4], ValueError, "camera_params has shape"),
    (
        "camera_models",
        lambda a: "pinhole",
        ValueError,
        "rows of 8 numbers, but pinhole has 4: fx, ",
    ),
    ("camera_params", lambda a: [[np.nan, *row[1:]] for row in a], ValueError, "camera_params"),
    ("camera_params", lambda a: 800.0, ValueError, r"camera_params has shape \(\)"),
    ("camera_params", lambda a: [["f"] * 8] * 5, TypeError, "camera_params has dtype <U1"),
]


@pytest.mark.parametrize(("name", "change", "error", "message"), WRONG)
def test_wrong_arrays(
    arrays: dict[str, Any],
    name: str,
    change: Callable[[Any], Any],
    error: type[Exception],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        clba.Problem.from_arrays(**{**arrays, name: change(arrays[name])})


def test_wrong_arrays_of_setters_change_nothing(
    problem: clba.Problem, arrays: dict[str, Any]
) -> None:
    cost = problem.evaluate(jacobian=False).cost
    with pytest.raises(ValueError, match=r"points has shape \(39, 3\), but it must be \(40, 3\)"):
        problem.points = arrays["points"][1:]
    with pytest.raises(ValueError, match=r"poses has shape \(9, 7\)"):
        problem.poses = arrays["poses"][1:]
    with pytest.raises(ValueError, match="rows of 3 numbers, but opencv has 8"):
        problem.camera_params = problem.camera_params[:, :3]
    with pytest.raises(ValueError, match=r"camera_params\[0\]\[1\] = inf"):
        problem.camera_params = np.where(np.arange(8) == 1, np.inf, problem.camera_params)
    with pytest.raises(ValueError, match=r"sigmas has shape \(3,\), but it must be \(400,\)"):
        problem.set_sigmas(np.ones(3))
    with pytest.raises(ValueError, match=r"sigmas\[0\] = -1"):
        problem.set_sigmas(-1)
    with pytest.raises(ValueError, match=r"covariances\[0\] = \(1, 2, 1\)"):
        problem.set_covariances(np.tile([1.0, 2, 1], (400, 1)))
    with pytest.raises(ValueError, match="loss = 'l2', but it must be one of none, huber"):
        problem.set_loss("l2")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="scale = 0"):
        problem.set_loss("huber", 0)
    with pytest.raises(TypeError, match="scale = 'wide'"):
        problem.set_loss("huber", "wide")  # type: ignore[arg-type]
    with pytest.raises(IndexError, match=r"points\[1\] = 40, but there are 40 rows"):
        problem.set_constant_points([3, 40])
    with pytest.raises(ValueError, match=r"rotation has shape \(3,\), but it must be \(10,\)"):
        problem.set_constant_images(rotation=np.ones(3, dtype=bool))
    with pytest.raises(ValueError, match="params has 'k9', but these cameras have cx"):
        problem.set_constant_cameras(params=["k9"])
    with pytest.raises(TypeError, match="params = 'cx', but it must be a sequence of names"):
        problem.set_constant_cameras(params="cx")
    with pytest.raises(ValueError, match=r"it must be boolean and \(5, 8\)"):
        problem.set_constant_cameras(np.ones((5, 8)))
    with pytest.raises(ValueError, match=r"step has shape \(3,\), but it must be \(\d+,\)"):
        problem.apply_step(np.zeros(3))
    with pytest.raises(ValueError, match=r"step\[0\] = nan"):
        problem.apply_step(np.full(problem.num_parameters, np.nan))
    assert problem.evaluate(jacobian=False).cost == cost


def test_sigmas_and_covariances_exclude_each_other(arrays: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="give one of them"):
        clba.Problem.from_arrays(**arrays, sigmas=np.ones(400), covariances=np.ones((400, 3)))


def test_use_after_close(problem: clba.Problem, tmp_path: Any) -> None:
    problem.close()
    uses: list[Callable[[], Any]] = [
        lambda: problem.num_images,
        lambda: problem.points,
        lambda: setattr(problem, "points", np.zeros((40, 3))),
        lambda: problem.set_loss("huber"),
        lambda: problem.evaluate(),
        lambda: problem.apply_step([]),
        lambda: problem.to_ply(tmp_path / "points.ply"),
        lambda: problem.compare(problem),
        lambda: problem.__enter__(),
        lambda: clba.solve(problem),
    ]
    for use in uses:
        with pytest.raises(ValueError, match="the problem is closed"):
            use()


def test_a_context_that_is_closed(problem: clba.Problem) -> None:
    context = clba.Context()
    context.close()
    with pytest.raises(ValueError, match="the context is closed"):
        problem.evaluate(device=context)
    with pytest.raises(ValueError, match="the context is closed"):
        _ = context.device
