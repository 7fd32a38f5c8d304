# SPDX-License-Identifier: Apache-2.0
"""Cost, residuals, gradient and Jacobian at a state."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clba import _ffi
from clba._arrays import Doubles, Int32s, pointer
from clba._ffi import check, lib

if TYPE_CHECKING:
    import scipy.sparse


@dataclass(frozen=True, repr=False)
class Evaluation:
    """What ``Problem.evaluate`` computed; what it was not asked for is None.

    Attributes:
        cost: 1/2 sum rho(|r|^2).
        num_behind: observations of points behind their camera.
        num_singular: observations in the camera's own plane.
        residuals: (num_observations, 2).
        gradient: (num_parameters,), J^T r.
        jacobian: (2 num_observations, num_parameters), sparse; rows 2 i and 2 i + 1 are those of
            observation i, and columns of constant parameters are 0.
    """

    cost: float
    num_behind: int
    num_singular: int
    residuals: Doubles | None
    gradient: Doubles | None
    jacobian: scipy.sparse.csr_array | None

    def __repr__(self) -> str:
        parts = [
            f"{name} {part.shape}"
            for name in ("residuals", "gradient", "jacobian")
            if (part := getattr(self, name)) is not None
        ]
        return f"<clba.Evaluation: {', '.join([f'cost {self.cost:.6e}', *parts])}>"


@dataclass(frozen=True)
class Structure:
    """Which blocks of the Jacobian are not 0."""

    pose_offsets: npt.NDArray[np.int64]
    intrinsics_offsets: npt.NDArray[np.int64]
    num_params: npt.NDArray[np.int64]
    camera_indices: Int32s
    image_indices: Int32s
    point_indices: Int32s


def evaluate(
    problem: Any,
    context: Any,
    info: _ffi.ProblemInfo,
    *,
    precision: int,
    apply_loss: bool,
    residuals: bool,
    gradient: bool,
    structure: Structure | None,
) -> Evaluation:
    """Calls the library; a structure asks for the Jacobian."""
    request = _ffi.Evaluation()
    check(lib.clba_evaluation_init(ctypes.byref(request), ctypes.sizeof(request)))
    request.precision = precision
    request.apply_loss = int(apply_loss)
    count = info.num_observations
    arrays: dict[str, Doubles] = {}
    if residuals:
        arrays["residuals"] = np.empty((count, 2))
    if gradient:
        arrays["gradient"] = np.empty(info.num_parameters)
    if structure:
        arrays["jacobian_images"] = np.empty((count, 2, info.num_parameters_per_image_block))
        arrays["jacobian_points"] = np.empty((count, 2, 3))
    for name, array in arrays.items():
        setattr(request, name, pointer(array, ctypes.c_double))
    check(lib.clba_problem_evaluate(problem, context, ctypes.byref(request)))
    jacobian = None
    if structure:
        jacobian = _sparse(arrays["jacobian_images"], arrays["jacobian_points"], structure, info)
    return Evaluation(
        cost=request.cost,
        num_behind=request.num_behind,
        num_singular=request.num_singular,
        residuals=arrays.get("residuals"),
        gradient=arrays.get("gradient"),
        jacobian=jacobian,
    )


def _sparse(
    image_blocks: Doubles, point_blocks: Doubles, structure: Structure, info: _ffi.ProblemInfo
) -> scipy.sparse.csr_array:
    """Compressed sparse rows from the blocks of observations.

    An observation's columns are its pose (6), its camera's intrinsics and its point (3), which rise
    in this order; image blocks are padded with zeros where a camera has fewer parameters than
    another.
    """
    import scipy.sparse

    count, _, width = image_blocks.shape
    most_params = width - 6
    cameras = structure.camera_indices[structure.image_indices]
    num_params = structure.num_params[cameras]
    columns = np.empty((count, width + 3), np.int64)
    columns[:, :6] = structure.pose_offsets[structure.image_indices, None] + np.arange(6)
    columns[:, 6:width] = structure.intrinsics_offsets[cameras, None] + np.arange(most_params)
    columns[:, width:] = (
        info.num_image_camera_parameters
        + 3 * structure.point_indices[:, None].astype(np.int64)
        + np.arange(3)
    )
    values = np.concatenate([image_blocks, point_blocks], axis=2)
    columns = np.repeat(columns[:, None, :], 2, axis=1)
    lengths = np.repeat(6 + num_params + 3, 2)
    if np.any(num_params != most_params):
        is_used = np.ones((count, 1, width + 3), dtype=bool)
        is_used[:, 0, 6:width] = np.arange(most_params) < num_params[:, None]
        is_used = np.repeat(is_used, 2, axis=1)
        values, columns = values[is_used], columns[is_used]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    index_type = np.int32 if max(starts[-1], info.num_parameters) < 2**31 else np.int64
    return scipy.sparse.csr_array(
        (values.ravel(), columns.ravel().astype(index_type), starts.astype(index_type)),
        shape=(2 * count, info.num_parameters),
    )
