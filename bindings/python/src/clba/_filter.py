# SPDX-License-Identifier: Apache-2.0
"""Removing outliers."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import byref, c_int32, c_int64
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _ffi
from clba._arrays import Int32s, pointer
from clba._ffi import check, lib

_ARRAYS = ("observation_rows", "point_rows", "unobserved_images")


@dataclass(frozen=True)
class FilterReport:
    """What was removed.

    Attributes:
        num_observations_removed: in all; the next four add up to it.
        num_behind: of points behind their camera, or in its own plane.
        num_large_error: of a large reprojection error.
        num_few_views, num_small_angle: of points seen by too few images, or under too small angles.
        num_points_few_views, num_points_small_angle: these points.
        num_points_unobserved: points that lost all their observations.
        num_points_removed: points without observations, also those that had none before.
        num_images_unobserved: images that lost all their observations.
        unobserved_images: these images.
        observation_rows: (num_observations before,), the row now, -1 if removed.
        point_rows: (num_points before,), likewise.
    """

    num_observations_removed: int
    num_behind: int
    num_large_error: int
    num_few_views: int
    num_small_angle: int
    num_points_few_views: int
    num_points_small_angle: int
    num_points_unobserved: int
    num_points_removed: int
    num_images_unobserved: int
    unobserved_images: npt.NDArray[np.int64] = field(repr=False, compare=False)
    observation_rows: npt.NDArray[np.int64] = field(repr=False, compare=False)
    point_rows: Int32s = field(repr=False, compare=False)


def options(
    *,
    error_unit: int,
    max_reprojection_error: float,
    min_triangulation_angle: float,
    min_num_views: int,
    remove_behind: bool,
    remove_points: bool,
) -> _ffi.FilterOptions:
    """clba_filter_options."""
    made = _ffi.FilterOptions()
    check(lib.clba_filter_options_init(byref(made), ctypes.sizeof(made)))
    made.error_unit = error_unit
    _ffi.set_number(made, "max_reprojection_error", max_reprojection_error)
    _ffi.set_number(made, "min_triangulation_angle", min_triangulation_angle)
    _ffi.set_number(made, "min_num_views", min_num_views)
    made.remove_behind = bool(remove_behind)
    made.remove_points = bool(remove_points)
    return made


def run(info: _ffi.ProblemInfo, call: Callable[[Any], int]) -> FilterReport:
    """The report of a call that fills a clba_filter_report."""
    observations = np.empty(info.num_observations, np.int64)
    points = np.empty(info.num_points, np.int32)
    images = np.empty(info.num_images, np.int32)
    report = _ffi.sized(_ffi.FilterReport)
    report.observation_rows = pointer(observations, c_int64)
    report.point_rows = pointer(points, c_int32)
    report.unobserved_images = pointer(images, c_int32)
    check(call(byref(report)))
    counts = {name: value for name, value in _ffi.fields(report).items() if name not in _ARRAYS}
    return FilterReport(
        **counts,
        unobserved_images=np.flatnonzero(images),
        observation_rows=observations,
        point_rows=points,
    )
