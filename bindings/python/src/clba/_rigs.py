# SPDX-License-Identifier: Apache-2.0
"""Rigs on their way into the C library and out of it."""

from __future__ import annotations

import ctypes
from ctypes import byref, c_double, c_int32
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _arrays, _ffi
from clba._arrays import Doubles, Int32s, pointer
from clba._ffi import check, lib


def set_rigs(
    handle: Any,
    num_images: int,
    frames: npt.ArrayLike,
    sensors: npt.ArrayLike,
    sensor_poses: npt.ArrayLike,
    frame_poses: npt.ArrayLike | None,
    constant_sensors: npt.ArrayLike | None,
    constant_frames: npt.ArrayLike | None,
) -> None:
    """See Problem.set_rigs."""
    poses_of_sensors = np.ascontiguousarray(
        _arrays.doubles(sensor_poses, (None, 7), "sensor_poses")
    )
    num_sensors = len(poses_of_sensors)
    of_images = [
        _indices_or_none(values, num_images, name)
        for values, name in ((frames, "frames"), (sensors, "sensors"))
    ]
    num_frames = int(of_images[0].max(initial=-1)) + 1
    poses_of_frames = None
    if frame_poses is not None:
        poses_of_frames = np.ascontiguousarray(
            _arrays.doubles(frame_poses, (num_frames, 7), "frame_poses")
        )
    flags = [
        _constants(values, count, name)
        for values, count, name in (
            (constant_sensors, num_sensors, "constant_sensors"),
            (constant_frames, num_frames, "constant_frames"),
        )
    ]
    rigs = _ffi.Rigs()
    check(lib.clba_rigs_init(byref(rigs), ctypes.sizeof(rigs)))
    rigs.num_frames, rigs.num_sensors = num_frames, num_sensors
    rigs.frames, rigs.sensors = (pointer(rows, c_int32) for rows in of_images)
    rigs.sensor_poses = pointer(poses_of_sensors, c_double)
    if poses_of_frames is not None:
        rigs.frame_poses = pointer(poses_of_frames, c_double)
    rigs.constant_sensors, rigs.constant_frames = (pointer(rows, c_int32) for rows in flags)
    check(lib.clba_problem_set_rigs(handle, byref(rigs)))


def remove_rigs(handle: Any) -> None:
    """See Problem.set_rigs."""
    check(lib.clba_problem_set_rigs(handle, None))


def poses(handle: Any, function: Any, count: int) -> Doubles:
    """Of frames or sensors."""
    rows = np.empty((count, 7))
    none = ctypes.POINTER(c_int32)()
    check(function(handle, 0, count, pointer(rows, c_double), 0, none, 0))
    return rows


def of_images(handle: Any, num_images: int) -> tuple[Int32s, Int32s]:
    """The frame and the sensor of each image."""
    frames, sensors = np.empty(num_images, np.int32), np.empty(num_images, np.int32)
    check(
        lib.clba_problem_get_image_rigs(
            handle, 0, num_images, pointer(frames, c_int32), 0, pointer(sensors, c_int32), 0
        )
    )
    return frames, sensors


def _indices_or_none(values: npt.ArrayLike, count: int, name: str) -> Int32s:
    """One a row, -1 for none; the C library looks at the rest."""
    array = np.asarray(values)
    if array.dtype.kind not in "iu" and array.size > 0:
        raise TypeError(f"{name} has dtype {array.dtype}, but it must hold integers")
    if array.shape != (count,):
        raise ValueError(f"{name} has shape {array.shape}, but it must be ({count},)")
    return np.ascontiguousarray(array, np.int32)


def _constants(which: npt.ArrayLike | None, count: int, name: str) -> Int32s:
    """CLBA_CONSTANT_*: 1 for rotations, 2 for positions."""
    if np.ndim(which) == 2:  # type: ignore[arg-type]
        both = np.asarray(which)
        if both.dtype.kind != "b" or both.shape != (count, 2):
            raise ValueError(
                f"{name} has shape {both.shape} and dtype {both.dtype}, but it must be boolean and "
                f"({count}, 2): rotation and position"
            )
    else:
        both = np.repeat(_arrays.mask(which, count, name)[:, None], 2, 1)
    return np.ascontiguousarray(both @ np.array([1, 2]), np.int32)
