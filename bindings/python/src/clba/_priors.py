# SPDX-License-Identifier: Apache-2.0
"""Priors on their way into the C library."""

from __future__ import annotations

from ctypes import c_double, c_int32
from typing import Any

import numpy as np
import numpy.typing as npt

from clba import _arrays, _rows
from clba._arrays import Doubles, pointer, stride
from clba._ffi import check, lib
from clba._rows import NO_DOUBLES, NO_INTS, problem_info


def set_priors(
    handle: Any,
    function: Any,
    subjects: tuple[str, npt.ArrayLike | None, int],
    targets: tuple[str, npt.ArrayLike | None, int],
    uncertainty: tuple[npt.ArrayLike | None, npt.ArrayLike | None, int],
) -> None:
    """All priors but those of intrinsics.

    subjects: their name, indices, and how many of these a row has; targets likewise; uncertainty:
    covariances or sigmas, and their dimension.
    """
    name, given, per_row = subjects
    target_name, target, width = targets
    covariances, sigmas, n = uncertainty
    if given is None:
        check(function(handle, 0, NO_INTS, 0, NO_DOUBLES, 0, NO_DOUBLES, 0))
        return
    kind = "points" if name == "points" else "images"
    limit = getattr(problem_info(handle), f"num_{kind}")
    indices = np.ascontiguousarray(_arrays.indices(given, None, limit, name, kind))
    count = len(indices) // per_row
    rows = _arrays.doubles(_arrays.required(target, target_name), (count, width), target_name)
    matrices = _covariances(covariances, sigmas, count, n)
    check(
        function(
            handle,
            count,
            pointer(indices, c_int32),
            0,
            pointer(rows, c_double),
            stride(rows),
            pointer(matrices, c_double),
            0,
        )
    )


def set_intrinsics_priors(
    handle: Any,
    cameras: npt.ArrayLike | None,
    params: npt.ArrayLike | None,
    covariances: npt.ArrayLike | None,
    sigmas: npt.ArrayLike | None,
) -> None:
    """See Problem.set_intrinsics_priors."""
    function = lib.clba_problem_set_intrinsics_priors
    if cameras is None:
        check(function(handle, 0, NO_INTS, 0, NO_DOUBLES, 0, NO_DOUBLES, 0))
        return
    models = _rows.models_of(handle)
    most = _rows.params_of(handle).shape[1]
    chosen = _arrays.indices(cameras, None, len(models), "cameras", "cameras")
    targets = _arrays.doubles(_arrays.required(params, "params"), (len(chosen), most), "params")
    rows = _covariances(covariances, sigmas, len(chosen), most)
    # Rows of the library are n x n numbers for cameras of n parameters.
    packed = np.zeros((len(chosen), most * most))
    for i, camera in enumerate(chosen):
        n = lib.clba_camera_model_num_params(models[camera])
        packed[i, : n * n] = rows[i, :n, :n].ravel()
    check(
        function(
            handle,
            len(chosen),
            pointer(chosen, c_int32),
            stride(chosen),
            pointer(targets, c_double),
            stride(targets),
            pointer(packed, c_double),
            stride(packed),
        )
    )


def _covariances(
    covariances: npt.ArrayLike | None, sigmas: npt.ArrayLike | None, count: int, n: int
) -> Doubles:
    """(count, n, n), without gaps, from either of the two."""
    if (covariances is None) == (sigmas is None):
        raise TypeError("priors need either covariances or sigmas")
    if covariances is not None:
        return np.ascontiguousarray(_arrays.broadcast(covariances, (count, n, n), "covariances"))
    deviations = _arrays.broadcast(np.asarray(sigmas), (count, n), "sigmas")
    if not np.all(deviations > 0):
        row, column = np.argwhere(~(deviations > 0))[0]
        raise ValueError(f"sigmas[{row}][{column}] = {deviations[row, column]}, but it must be > 0")
    rows = np.zeros((count, n, n))
    rows[:, np.arange(n), np.arange(n)] = deviations**2
    return rows
