# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C while the C library works."""

from __future__ import annotations

import os
import signal
import socket
import threading
from types import FrameType, TracebackType
from typing import Any

from clba._cancellation import Cancellation


class DeferredInterrupt:
    """Notes SIGINT within a block, asks for the end of the solve, and acts on it after the block.

    An exception that Python's own handler raised inside a callback from C could be lost: ctypes
    prints and ignores those that are raised before the callback's code can catch them. And while
    the main thread is inside the library it runs no handler at all, so a thread waits for what the
    interpreter writes to the wakeup file descriptor when the signal comes.
    """

    def __init__(self, cancellation: Cancellation) -> None:
        self.is_pending = False
        self._cancellation = cancellation
        self._frame: FrameType | None = None
        self._handler: Any = None

    def __enter__(self) -> DeferredInterrupt:
        handler = signal.getsignal(signal.SIGINT)
        # Only the main thread may set handlers, and only Python's own are deferred.
        if threading.current_thread() is threading.main_thread() and callable(handler):
            self._receiver, self._sender = socket.socketpair()
            self._sender.setblocking(False)
            self._wakeup = signal.set_wakeup_fd(self._sender.fileno(), warn_on_full_buffer=False)
            self._watcher = threading.Thread(target=self._watch, daemon=True)
            self._watcher.start()
            signal.signal(signal.SIGINT, self._note)
            self._handler = handler
        return self

    def _watch(self) -> None:
        while numbers := self._receiver.recv(64):
            if signal.SIGINT in numbers:
                self._cancellation.request()
            if self._wakeup != -1:
                os.write(self._wakeup, numbers)

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
        signal.set_wakeup_fd(self._wakeup)
        self._sender.close()
        self._watcher.join()
        self._receiver.close()
        if self.is_pending:
            self._cancellation.reset()
            self._handler(signal.SIGINT, self._frame)
