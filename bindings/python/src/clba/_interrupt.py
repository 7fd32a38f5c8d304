# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C while the C library works."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class DeferredInterrupt:
    """Notes SIGINT within a block and acts on it at the end of the block.

    An exception that Python's own handler raised inside a callback from C could be lost: ctypes
    prints and ignores those that are raised before the callback's code can catch them.
    """

    def __init__(self) -> None:
        self.is_pending = False
        self._frame: FrameType | None = None
        self._handler: Any = None

    def __enter__(self) -> DeferredInterrupt:
        handler = signal.getsignal(signal.SIGINT)
        # Only the main thread may set handlers, and only Python's own are deferred.
        if threading.current_thread() is threading.main_thread() and callable(handler):
            signal.signal(signal.SIGINT, self._note)
            self._handler = handler
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.is_pending = True
        self._frame = frame

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._handler is None:
            return
        signal.signal(signal.SIGINT, self._handler)
        if self.is_pending:
            self._handler(signal.SIGINT, self._frame)
