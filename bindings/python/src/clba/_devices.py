# SPDX-License-Identifier: Apache-2.0
"""OpenCL devices, and contexts: a device with the kernels built for it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from clba import _ffi, _names, _opencl
from clba._errors import NoDeviceError
from clba._ffi import check, lib


@dataclass(frozen=True)
class Device:
    """An OpenCL device.

    Attributes:
        index: position in the list of all devices of all platforms; ``device=`` takes it.
        type: "cpu", "gpu", "accelerator" or "other".
        has_double: fp64 in kernels, which the precisions "double" and "mixed" need.
        has_unified_memory: it shares its memory with the host.
        max_allocation_bytes: the largest single buffer.
    """

    index: int
    type: str
    has_double: bool
    compute_units: int
    has_unified_memory: bool
    global_memory_bytes: int
    max_allocation_bytes: int
    local_memory_bytes: int
    platform: str
    name: str
    vendor: str
    version: str
    driver: str


def _device(info: _ffi.DeviceInfo) -> Device:
    values: dict[str, Any] = _ffi.fields(info)
    values["type"] = _names.name_of(_names.DEVICE_TYPES, values["type"])
    values["has_double"] = bool(values["has_double"])
    values["has_unified_memory"] = bool(values["has_unified_memory"])
    return Device(**values)


def devices() -> list[Device]:
    """All OpenCL devices; empty where there is no OpenCL loader, driver or device."""
    _opencl.start()
    count = ctypes.c_int32()
    check(lib.clba_num_devices(ctypes.byref(count)))
    found = []
    for index in range(count.value):
        info = _ffi.sized(_ffi.DeviceInfo)
        check(lib.clba_get_device(index, ctypes.byref(info)))
        found.append(_device(info))
    return found


class Context:
    """A device with the kernels built for it. Threads may share it.

    ``solve`` and ``evaluate`` make one for each device and keep it, so that one is needed only to
    name the kernel cache or to limit memory.

    Args:
        device: an index, or a part of a platform's or device's name in any case; by default the
            environment variable CLBA_DEVICE, else the best device: GPUs before CPUs, fp64 before
            not, then compute units.
        cache_dir: folder of compiled kernels; "" keeps none; by default the environment variable
            CLBA_CACHE_DIR, else ``~/.cache/clba``.
        max_allocation_bytes: limit on one buffer; 0 is the device's own limit.

    Raises:
        NoDeviceError: no OpenCL, or no such device.
    """

    def __init__(
        self,
        device: int | str | None = None,
        *,
        cache_dir: str | os.PathLike[str] | None = None,
        max_allocation_bytes: int = 0,
    ) -> None:
        _opencl.start()
        options = _ffi.ContextOptions()
        check(lib.clba_context_options_init(ctypes.byref(options), ctypes.sizeof(options)))
        if device is not None:
            options.device = str(device).encode()
        if cache_dir is not None:
            options.cache_dir = os.fsencode(cache_dir)
        options.max_allocation_bytes = max_allocation_bytes
        handle = ctypes.POINTER(_ffi.ContextHandle)()
        try:
            check(lib.clba_context_create(ctypes.byref(options), ctypes.byref(handle)))
        except NoDeviceError as error:
            raise NoDeviceError(f"{error}{_package_remedy()}") from None
        self._handle = handle
        # At the end of the process at the latest: a context writes the kernels it compiled to the
        # cache when it is released.
        self._release = weakref.finalize(self, lib.clba_context_release, handle)

    @property
    def device(self) -> Device:
        """The device it works on."""
        info = _ffi.sized(_ffi.DeviceInfo)
        with self._use() as handle:
            check(lib.clba_context_get_device(handle, ctypes.byref(info)))
        return _device(info)

    def close(self) -> None:
        """Releases it; problems that were solved with it keep the device for themselves."""
        self._release()

    @contextlib.contextmanager
    def _use(self) -> Iterator[Any]:
        """The handle, not freed before the end of the block."""
        if not self._release.alive:
            raise ValueError("the context is closed; make another")
        lib.clba_context_retain(self._handle)
        try:
            yield self._handle
        finally:
            lib.clba_context_release(self._handle)

    def __enter__(self) -> Context:
        with self._use():
            return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        if not self._release.alive:
            return "<clba.Context, closed>"
        return f"<clba.Context on {self.device.name} ({self.device.platform})>"


def _package_remedy() -> str:
    if devices():
        return ""
    return "; for x86 CPUs also: pip install intel-opencl-rt intel-cmplr-lib-rt"


_contexts: dict[str | None, Context] = {}
_contexts_lock = threading.Lock()


def context_of(device: int | str | Context | None) -> Context:
    """The context itself, or the one that is kept for the device."""
    if isinstance(device, Context):
        return device
    if device is not None and not isinstance(device, (int, str)) or isinstance(device, bool):
        raise TypeError(
            f"device = {device!r}, but it must be an index, a part of a name, or a clba.Context"
        )
    name = os.environ.get("CLBA_DEVICE") if device is None else str(device)
    with _contexts_lock:
        if name not in _contexts:
            _contexts[name] = Context(name)
        return _contexts[name]
