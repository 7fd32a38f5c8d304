# SPDX-License-Identifier: Apache-2.0
"""A part of a map that is refined while the rest stays."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _arrays, _ffi
from clba._ffi import check, lib


@dataclass(frozen=True)
class Window:
    """What is free in a local bundle adjustment.

    Attributes:
        images: their indices, each once.
        points: indices; by default all that the images see.
        refine_shared_cameras: refine also cameras that images outside the window use.
    """

    images: npt.ArrayLike
    points: npt.ArrayLike | None = None
    refine_shared_cameras: bool = False


class Rows:
    """The clba_window of a Window, with the arrays that it points to."""

    def __init__(self, window: Window, info: _ffi.ProblemInfo) -> None:
        self.struct = _ffi.Window()
        check(lib.clba_window_init(ctypes.byref(self.struct), ctypes.sizeof(self.struct)))
        self.struct.refine_shared_cameras = bool(window.refine_shared_cameras)
        self._images = _row_indices(window.images, info.num_images, "images")
        self.struct.num_images = len(self._images)
        self.struct.images = _arrays.pointer(self._images, ctypes.c_int32)
        if window.points is not None:
            self._points = _row_indices(window.points, info.num_points, "points")
            self.struct.num_points = len(self._points)
            self.struct.points = _arrays.pointer(self._points, ctypes.c_int32)


def _row_indices(values: npt.ArrayLike, limit: int, name: str) -> npt.NDArray[Any]:
    indices = _arrays.indices(values, None, limit, f"window.{name}", name)
    return np.ascontiguousarray(indices)
