# SPDX-License-Identifier: Apache-2.0
"""Cameras, images, points and observations on their way into the C library and out of it."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref, c_double, c_int32
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _arrays, _ffi, _names
from clba._arrays import Doubles, Int32s, pointer, stride
from clba._ffi import check, lib

NO_INTS = ctypes.POINTER(c_int32)()
NO_DOUBLES = ctypes.POINTER(c_double)()


def problem_info(handle: Any) -> _ffi.ProblemInfo:
    info = _ffi.sized(_ffi.ProblemInfo)
    check(lib.clba_problem_get_info(handle, byref(info)))
    return info


def camera_rows(camera_models: str | Sequence[str], camera_params: Any) -> tuple[Int32s, Doubles]:
    """Models and rows of parameters, padded to equal length if their models differ."""
    rows = camera_params if isinstance(camera_params, np.ndarray) else _padded(camera_params)
    if isinstance(camera_models, str):
        if rows.ndim == 1:
            rows = rows[None, :]
        camera_models = [camera_models] * len(rows)
    models = np.array(
        [
            _names.value_of(_names.CAMERA_MODELS, name, f"camera_models[{i}]")
            for i, name in enumerate(camera_models)
        ],
        np.int32,
    )
    params = _arrays.doubles(rows, (len(models), None), "camera_params")
    check_num_params(models, params)
    return models, params


def _padded(rows: Any) -> npt.NDArray[Any]:
    """An array of rows that may differ in length."""
    if not isinstance(rows, Sequence):
        return np.asarray(rows)
    lengths = {len(row) if np.ndim(row) == 1 else 0 for row in rows}
    if len(lengths) > 1:
        most = max(lengths)
        rows = [np.append(row, np.full(most - np.size(row), np.nan)) for row in rows]
    return np.asarray(rows) if lengths else np.empty((0, 0))


def check_num_params(models: Int32s, params: Doubles) -> None:
    """The longest model decides how long a row is."""
    used = [_names.name_of(_names.CAMERA_MODELS, model) for model in np.unique(models)]
    longest = max(used, key=lambda name: len(_names.PARAM_NAMES[name]), default=None)
    if longest is None:
        return
    names = _names.PARAM_NAMES[longest]
    if params.shape[1] != len(names):
        raise ValueError(
            f"camera_params has rows of {params.shape[1]} numbers, but {longest} has {len(names)}: "
            f"{', '.join(names)}"
        )


def default_camera_indices(num_cameras: int, num_images: int) -> Int32s:
    if num_cameras == 1:
        return np.zeros(num_images, np.int32)
    if num_cameras == num_images:
        return np.arange(num_images, dtype=np.int32)
    raise ValueError(
        f"camera_indices is None, but there are {num_cameras} cameras for {num_images} images; "
        "say which image has which"
    )


def set_cameras(
    handle: Any,
    models: Int32s,
    params: Doubles,
    function: Any = lib.clba_problem_set_cameras,  # or add
) -> None:
    check(
        function(
            handle,
            len(models),
            pointer(models, c_int32),
            stride(models),
            pointer(params, c_double),
            stride(params),
        ),
        params="camera_params",
        models="camera_models",
    )


def set_images(
    handle: Any,
    cameras: Int32s,
    poses: Doubles,
    function: Any = lib.clba_problem_set_images,  # or add
) -> None:
    check(
        function(
            handle,
            len(poses),
            pointer(cameras, c_int32),
            stride(cameras),
            pointer(poses, c_double),
            stride(poses),
        )
    )


def set_points(
    handle: Any,
    points: Doubles,
    function: Any = lib.clba_problem_set_points,  # or add
) -> None:
    check(function(handle, len(points), pointer(points, c_double), stride(points)), xyz="points")


def models_of(handle: Any) -> Int32s:
    models = np.empty(problem_info(handle).num_cameras, np.int32)
    check(
        lib.clba_problem_get_cameras(
            handle, 0, len(models), pointer(models, c_int32), 0, NO_DOUBLES, 0
        )
    )
    return models


def params_of(handle: Any) -> Doubles:
    models = models_of(handle)
    lengths = [lib.clba_camera_model_num_params(model) for model in models]
    params = np.full((len(models), max(lengths, default=0)), np.nan)
    check(
        lib.clba_problem_get_cameras(
            handle, 0, len(models), NO_INTS, 0, pointer(params, c_double), stride(params)
        )
    )
    return params


def images_of(handle: Any) -> tuple[Int32s, Doubles]:
    count = problem_info(handle).num_images
    cameras, poses = np.empty(count, np.int32), np.empty((count, 7))
    check(
        lib.clba_problem_get_images(
            handle, 0, count, pointer(cameras, c_int32), 0, pointer(poses, c_double), 0
        )
    )
    return cameras, poses


def constants_of(handle: Any, function: Any, count: int) -> Int32s:
    """(count,) flags."""
    flags = np.empty(count, np.int32)
    check(function(handle, 0, count, pointer(flags, c_int32), 0))
    return flags


def bits_of(flags: Int32s, count: int) -> npt.NDArray[np.bool_]:
    """(len(flags), count), the lowest bit first."""
    bits: npt.NDArray[np.int32] = np.right_shift(flags[:, None], np.arange(count)) & 1
    return bits.astype(np.bool_)


def get_observations(
    handle: Any,
    count: int,
    *,
    images: Int32s | None = None,
    points: Int32s | None = None,
    pixels: Doubles | None = None,
) -> None:
    """Fills the arrays that are given."""
    check(
        lib.clba_problem_get_observations(
            handle,
            0,
            count,
            NO_INTS if images is None else pointer(images, c_int32),
            0,
            NO_INTS if points is None else pointer(points, c_int32),
            0,
            NO_DOUBLES if pixels is None else pointer(pixels, c_double),
            0,
        )
    )
