# SPDX-License-Identifier: Apache-2.0
"""Ending solves from another thread."""

from __future__ import annotations

import ctypes
import weakref

from clba import _ffi
from clba._ffi import check, lib


class Cancellation:
    """Ends the solves that it is given to, from any thread, within a step.

    A request stays until ``reset``: later solves with it end at once. The problems hold the best
    state found.
    """

    def __init__(self) -> None:
        self._handle = ctypes.POINTER(_ffi.CancellationHandle)()
        check(lib.clba_cancellation_create(ctypes.byref(self._handle)))
        weakref.finalize(self, lib.clba_cancellation_release, self._handle)

    def request(self) -> None:
        """Asks for the end."""
        lib.clba_cancellation_request(self._handle)

    def reset(self) -> None:
        """Takes the request back."""
        lib.clba_cancellation_reset(self._handle)

    @property
    def is_requested(self) -> bool:
        """Whether the end was asked for."""
        return bool(lib.clba_cancellation_is_requested(self._handle))
