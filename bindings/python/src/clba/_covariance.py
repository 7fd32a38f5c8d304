# SPDX-License-Identifier: Apache-2.0
"""Covariances of poses, intrinsics and points."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _arrays, _ffi, _names
from clba._arrays import Doubles, Int32s, pointer
from clba._ffi import check, lib

_POSE, _CENTER, _INTRINSICS, _JOINT, _POINT = 1, 2, 3, 4, 5


@dataclass(frozen=True, repr=False)
class StandardErrors:
    """Of each entry of the arrays of a ``Covariance``, which have the same shapes."""

    poses: Doubles
    centers: Doubles
    intrinsics: list[Doubles]
    poses_and_intrinsics: list[Doubles]
    points: Doubles


@dataclass(frozen=True, repr=False)
class Covariance:
    """What ``Problem.covariance`` computed: symmetric matrices.

    Infinite variances, with covariances of 0, stand for what no observation determines; constant
    parameters, and those that the gauge holds, have zeros.

    Attributes:
        poses: (num_images, 6, 6), rotation (rad) and position (world units) along the camera's own
            axes: the tangent space of ``Problem.apply_step``.
        centers: (num_images, 3, 3), of camera centres in world coordinates.
        intrinsics: one (n, n) a camera.
        poses_and_intrinsics: one (6 + n, 6 + n) an image, with its camera's intrinsics.
        points: (number asked for, 3, 3), in world coordinates.
        point_indices: which points those are.
        gauge: what took the freedoms of a similarity away.
        gauge_images, gauge_points: that the gauge holds; empty if it holds none.
        num_freedoms: how many of the 7 freedoms the gauge took away.
        method: "exact" or "sampled".
        num_samples: 0 if exact.
        relative_error: standard error of each variance, relatively; 0 if exact.
        standard_errors: of each entry; None if exact.
        variance_factor: a posteriori, 2 cost / redundancy; NaN where nothing is redundant.
        variance_factor_is_applied: whether the covariances are multiplied by it.
        redundancy: residuals less determined parameters, plus num_freedoms.
        num_undetermined_parameters: of poses and intrinsics, without observations.
        num_undetermined_points: of all points, without parallax.
        cost: at the state.
        total_seconds: of the call.
    """

    poses: Doubles
    centers: Doubles
    intrinsics: list[Doubles]
    poses_and_intrinsics: list[Doubles]
    points: Doubles
    point_indices: Int32s
    gauge: str
    gauge_images: tuple[int, ...]
    gauge_points: tuple[int, ...]
    num_freedoms: int
    method: str
    num_samples: int
    relative_error: float
    standard_errors: StandardErrors | None
    variance_factor: float
    variance_factor_is_applied: bool
    redundancy: int
    num_undetermined_parameters: int
    num_undetermined_points: int
    cost: float
    total_seconds: float

    def __repr__(self) -> str:
        return (
            f"<clba.Covariance: {self.method}, {len(self.poses)} images, {len(self.points)} "
            f"points, gauge {self.gauge}>"
        )


def make_options(
    num_points: int,
    *,
    points: npt.ArrayLike | bool,
    gauge: str,
    gauge_images: Sequence[int] | None,
    gauge_points: Sequence[int] | None,
    method: str,
    apply_variance_factor: bool,
    **numbers: Any,
) -> tuple[_ffi.CovarianceOptions, Int32s]:
    """The C library's options, and the points, which must live as long as these."""
    options = _ffi.CovarianceOptions()
    check(lib.clba_covariance_options_init(ctypes.byref(options), ctypes.sizeof(options)))
    options.gauge = _names.value_of(_names.GAUGE_CHOICES, gauge, "gauge")
    options.method = _names.value_of(_names.COVARIANCE_METHODS, method, "method")
    options.apply_variance_factor = int(apply_variance_factor)
    _set_indices(options.gauge_images, gauge_images, "gauge_images")
    _set_indices(options.gauge_points, gauge_points, "gauge_points")
    if points is True:
        indices = np.arange(num_points, dtype=np.int32)
    elif points is False:
        indices = np.empty(0, np.int32)
    else:
        indices = np.ascontiguousarray(
            _arrays.indices(points, None, num_points, "points", "points")
        )
    options.points = pointer(indices, ctypes.c_int32)
    options.num_points = len(indices)
    for name, value in numbers.items():
        _ffi.set_number(options, name, value)
    return options, indices


def compute(
    problem: Any,
    context: Any,
    options: _ffi.CovarianceOptions,
    indices: Int32s,
    num_params: Sequence[int],
    camera_indices: Int32s,
) -> Covariance:
    """Calls the library."""
    handle = ctypes.POINTER(_ffi.CovarianceHandle)()
    check(
        lib.clba_problem_covariance(problem, context, ctypes.byref(options), ctypes.byref(handle))
    )
    try:
        info = _ffi.sized(_ffi.CovarianceInfo)
        check(lib.clba_covariance_get_info(handle, ctypes.byref(info)))
        blocks = _blocks(handle, info, num_params, camera_indices)
    finally:
        lib.clba_covariance_release(handle)
    is_sampled = info.num_samples > 0
    return Covariance(
        **{name: values for name, (values, _) in blocks.items()},
        point_indices=indices,
        gauge=_names.name_of(_names.GAUGE_CHOICES, info.gauge),
        gauge_images=tuple(image for image in info.gauge_images if image >= 0),
        gauge_points=tuple(point for point in info.gauge_points if point >= 0),
        num_freedoms=info.num_freedoms,
        method=_names.name_of(_names.COVARIANCE_METHODS, info.method),
        num_samples=info.num_samples,
        relative_error=info.relative_error,
        standard_errors=StandardErrors(**{name: errors for name, (_, errors) in blocks.items()})
        if is_sampled
        else None,
        variance_factor=info.variance_factor,
        variance_factor_is_applied=bool(info.variance_factor_is_applied),
        redundancy=info.redundancy,
        num_undetermined_parameters=info.num_undetermined_parameters,
        num_undetermined_points=info.num_undetermined_points,
        cost=info.cost,
        total_seconds=info.total_seconds,
    )


def set_gauge(
    problem: Any,
    num_images: int,
    *,
    gauge: str,
    images: Sequence[int] | None,
    points: Sequence[int] | None,
    pose: npt.ArrayLike | None,
    baseline: float | None,
    xyz: npt.ArrayLike | None,
    centers: npt.ArrayLike | None,
) -> None:
    """Calls the library."""
    target = _ffi.GaugeTarget()
    check(lib.clba_gauge_target_init(ctypes.byref(target), ctypes.sizeof(target)))
    target.gauge = _names.value_of(_names.GAUGE_CHOICES, gauge, "gauge")
    _set_indices(target.images, images, "images")
    _set_indices(target.points, points, "points")
    _ffi.set_number(target, "baseline", baseline)
    needed = {"three_points": ("xyz",), "inner": ("centers",), "problem": ()}.get(
        gauge, ("pose", "baseline")
    )
    arrays = []
    for name, values, shape in (
        ("pose", pose, (7,)),
        ("xyz", xyz, (3, 3)),
        ("centers", centers, (num_images, 3)),
    ):
        if values is None and name in needed:
            raise TypeError(f"{name} is None, but the gauge {gauge!r} needs {' and '.join(needed)}")
        if values is None:
            continue
        arrays.append(np.array(values, dtype=np.float64, order="C"))
        if arrays[-1].shape != shape:
            raise ValueError(f"{name} has shape {arrays[-1].shape}, but it must be {shape}")
        setattr(target, name, pointer(arrays[-1], ctypes.c_double))
    check(lib.clba_problem_fix_gauge(problem, ctypes.byref(target)))


def _set_indices(field: Any, values: Sequence[int] | None, name: str) -> None:
    if values is None:
        return
    if len(values) != len(field):
        raise ValueError(f"{name} has {len(values)} indices, but it must have {len(field)}")
    for k, value in enumerate(values):
        field[k] = _ffi.number(f"{name}[{k}]", value, int)


def _blocks(
    handle: Any, info: _ffi.CovarianceInfo, num_params: Sequence[int], camera_indices: Int32s
) -> dict[str, tuple[Any, Any]]:
    """Values and standard errors by the names that ``Covariance`` has for them."""

    def fixed(block: int, count: int, size: int) -> tuple[Doubles, Doubles]:
        values, errors = np.empty((count, size, size)), np.empty((count, size, size))
        _get(handle, block, 0, count, values, errors)
        return values, errors

    def ragged(block: int, sizes: Sequence[int]) -> tuple[list[Doubles], list[Doubles]]:
        values = [np.empty((size, size)) for size in sizes]
        errors = [np.empty((size, size)) for size in sizes]
        for row, (value, error) in enumerate(zip(values, errors, strict=True)):
            _get(handle, block, row, 1, value, error)
        return values, errors

    return {
        "poses": fixed(_POSE, info.num_images, 6),
        "centers": fixed(_CENTER, info.num_images, 3),
        "intrinsics": ragged(_INTRINSICS, num_params),
        "poses_and_intrinsics": ragged(
            _JOINT, [6 + num_params[camera] for camera in camera_indices]
        ),
        "points": fixed(_POINT, info.num_points, 3),
    }


def _get(handle: Any, block: int, first: int, count: int, values: Doubles, errors: Doubles) -> None:
    check(
        lib.clba_covariance_get(
            handle,
            block,
            first,
            count,
            pointer(values, ctypes.c_double),
            pointer(errors, ctypes.c_double),
            0,
        )
    )
