# SPDX-License-Identifier: Apache-2.0
"""Problems in files, and what files hold beside them."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from ctypes import byref, c_uint8, c_uint64
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _ffi, _names
from clba._arrays import UInt64s, pointer
from clba._ffi import check, lib


def read(
    path: str | os.PathLike[str],
    format: str,
    progress: Callable[[float], bool | None] | None,
) -> Any:
    """The handle of a new problem; see Problem.read."""
    options = _ffi.ReadOptions()
    check(lib.clba_read_options_init(byref(options), ctypes.sizeof(options)))
    options.format = _names.value_of(_names.FORMATS, format, "format")
    raised: list[BaseException] = []

    def on_progress(fraction: float, _user_data: object) -> int:
        try:
            return int(progress is not None and bool(progress(fraction)))
        except BaseException as error:
            raised.append(error)
            return 1

    if progress is not None:
        options.on_progress = _ffi.ProgressFunction(on_progress)
    handle = ctypes.POINTER(_ffi.ProblemHandle)()
    status = lib.clba_problem_read(os.fsencode(path), byref(options), byref(handle))
    if raised:
        raise raised[0]
    check(status)
    return handle


def write(handle: Any, path: str | os.PathLike[str], format: str, accept_loss: bool) -> None:
    """See Problem.write."""
    check(lib.clba_problem_write(handle, os.fsencode(path), byref(_options(format, accept_loss))))


def check_write(handle: Any, path: str | os.PathLike[str], format: str, accept_loss: bool) -> None:
    """See Problem.check_write."""
    options = _options(format, accept_loss)
    check(lib.clba_problem_check_write(handle, os.fsencode(path), byref(options)))


def _options(format: str, accept_loss: bool) -> _ffi.WriteOptions:
    options = _ffi.WriteOptions()
    check(lib.clba_write_options_init(byref(options), ctypes.sizeof(options)))
    options.format = _names.value_of(_names.FORMATS, format, "format")
    options.accept_loss = int(bool(accept_loss))
    return options


def image_ids(handle: Any, count: int) -> UInt64s:
    """(count,)"""
    ids = np.empty(count, np.uint64)
    check(lib.clba_problem_get_image_ids(handle, 0, count, pointer(ids, c_uint64), 0))
    return ids


def camera_info(handle: Any, count: int) -> tuple[UInt64s, UInt64s]:
    """ids (count,), sizes (count, 2)"""
    ids, sizes = np.empty(count, np.uint64), np.empty((count, 2), np.uint64)
    check(
        lib.clba_problem_get_camera_info(
            handle, 0, count, pointer(ids, c_uint64), 0, pointer(sizes, c_uint64), 0
        )
    )
    return ids, sizes


def point_info(handle: Any, count: int) -> tuple[UInt64s, npt.NDArray[np.uint8]]:
    """ids (count,), colours (count, 3)"""
    ids, colors = np.empty(count, np.uint64), np.empty((count, 3), np.uint8)
    check(
        lib.clba_problem_get_point_info(
            handle, 0, count, pointer(ids, c_uint64), 0, pointer(colors, c_uint8), 0
        )
    )
    return ids, colors
