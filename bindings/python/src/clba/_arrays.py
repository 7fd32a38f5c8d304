# SPDX-License-Identifier: Apache-2.0
"""Arrays on their way into the C library, which takes rows of any stride without a copy."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]
Int32s = npt.NDArray[np.int32]
UInt64s = npt.NDArray[np.uint64]


def doubles(values: npt.ArrayLike, shape: tuple[int | None, ...], name: str) -> Doubles:
    """values as float64 of this shape, in which None is any length.

    Arrays of float64 whose rows are without gaps are not copied; others are.

    Raises:
        TypeError: values are not real numbers.
        ValueError: values have another shape.
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise ValueError(f"{name} is ragged, but its rows must be of equal length") from None
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} has dtype {array.dtype}, but it must hold real numbers")
    _check_shape(array, shape, name)
    return _rows(array.astype(np.float64, copy=False))


def indices(values: npt.ArrayLike, count: int | None, limit: int, name: str, rows: str) -> Int32s:
    """values as int32, each of which is an index into `limit` rows.

    Raises:
        TypeError: values are not integers.
        ValueError: values have another shape.
        IndexError: a value is no index.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "iu":
        if array.size > 0:
            raise TypeError(f"{name} has dtype {array.dtype}, but it must hold integers")
        array = array.astype(np.int32)
    _check_shape(array, (count,), name)
    if array.size > 0 and (array.min() < 0 or array.max() >= limit):
        first = int(np.flatnonzero((array < 0) | (array >= limit))[0])
        raise IndexError(f"{name}[{first}] = {array[first]}, but there are {limit} {rows}")
    return _rows(array.astype(np.int32, copy=False))


def mask(which: npt.ArrayLike | None, count: int, name: str) -> npt.NDArray[np.bool_]:
    """Rows by a boolean array, by indices, or all (True) or none (False, None) of them."""
    if which is None or isinstance(which, (bool, np.bool_)):
        return np.full(count, bool(which))
    array = np.asarray(which)
    if array.dtype.kind == "b":
        _check_shape(array, (count,), name)
        return array
    chosen = np.zeros(count, dtype=bool)
    chosen[indices(array, None, count, name, "rows")] = True
    return chosen


def pointer(array: npt.NDArray[Any], c_type: Any) -> Any:
    """A pointer to the data of an array, which it keeps alive."""
    return array.ctypes.data_as(ctypes.POINTER(c_type))


def stride(array: npt.NDArray[Any]) -> int:
    """The distance in bytes from one row to the next."""
    return array.strides[0]


def _check_shape(array: npt.NDArray[Any], shape: tuple[int | None, ...], name: str) -> None:
    matches = array.ndim == len(shape) and all(
        wanted is None or wanted == length
        for wanted, length in zip(shape, array.shape, strict=True)
    )
    if not matches:
        lengths = ", ".join("any" if wanted is None else str(wanted) for wanted in shape)
        comma = "," if len(shape) == 1 else ""
        raise ValueError(f"{name} has shape {array.shape}, but it must be ({lengths}{comma})")


def _rows(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The array itself if its rows are without gaps and follow each other forwards."""
    within = array.ndim == 1 or array.strides[-1] == array.itemsize
    row_bytes = array.itemsize * (1 if array.ndim == 1 else array.shape[-1])
    if within and array.shape[0] > 0 and array.strides[0] >= row_bytes:
        return array
    return np.array(array, order="C")


def broadcast(values: npt.ArrayLike, shape: tuple[int, ...], name: str) -> Doubles:
    """values as float64 of this shape, repeated where numpy would repeat them.

    Raises:
        TypeError: values are not real numbers.
        ValueError: they cannot be broadcast to the shape.
    """
    try:
        array = np.broadcast_to(np.asarray(values), shape)
    except ValueError:
        raise ValueError(
            f"{name} has shape {np.shape(values)}, but it must be {shape}, or broadcast to it"
        ) from None
    return doubles(array, shape, name)


def required(values: npt.ArrayLike | None, name: str) -> npt.ArrayLike:
    if values is None:
        raise TypeError(f"{name} is None, but it is needed")
    return values
