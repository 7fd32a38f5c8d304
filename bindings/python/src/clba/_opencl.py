# SPDX-License-Identifier: Apache-2.0
"""Lets the library find OpenCL drivers, and a loader, that were installed from PyPI.

The package intel-opencl-rt brings a CPU driver and a loader, pocl-binary-distribution a CPU driver.
Neither can register its driver with the system, which lists drivers in /etc/OpenCL/vendors.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.metadata
import os
import pathlib
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator

from clba._ffi import lib

_lock = threading.Lock()
_is_started = False

# What the Intel libraries need of intel-cmplr-lib-rt, each after those it needs itself. They name
# no folder to look for it in, but are content with what is loaded.
_INTEL_LIBRARIES = ("libintlc.so.5", "libirng.so", "libimf.so", "libsvml.so")


def start() -> None:
    """Starts the OpenCL loader, with the drivers of packages added to the system's.

    Nothing happens after the first call, as a loader lists its drivers once. Variables with which
    the user names the drivers to take are respected.
    """
    global _is_started
    with _lock:
        if _is_started:
            return
        _is_started = True
        if sys.platform == "linux":
            _start_with_packages()


def _start_with_packages() -> None:
    intel = _files("intel-opencl-rt", ("libOpenCL.so.1", "libintelocl.so"))
    if intel and not _load_all(_files("intel-cmplr-lib-rt", _INTEL_LIBRARIES)):
        intel = {}
    if "libOpenCL.so.1" in intel and not _can_load("libOpenCL.so.1"):
        # Having been loaded, it is what the name libOpenCL.so.1 means in this process.
        _can_load(str(intel["libOpenCL.so.1"]))
    pocl = _files("pocl-binary-distribution", ("libpocl-*.so",))
    if shutil.which("ld") is None:
        pocl = {}  # it links the kernels that it builds by ld, and ends the process without it
    drivers = [path for name, path in (*intel.items(), *pocl.items()) if "OpenCL" not in name]
    is_users_choice = "OCL_ICD_VENDORS" in os.environ or "OCL_ICD_FILENAMES" in os.environ
    if drivers and not is_users_choice:
        with _vendors(drivers):
            lib.clba_num_devices(ctypes.byref(ctypes.c_int32()))


@contextlib.contextmanager
def _vendors(drivers: list[pathlib.Path]) -> Iterator[None]:
    """OCL_ICD_VENDORS names, for a while, a folder with the system's drivers and these."""
    system = pathlib.Path(os.environ.get("OPENCL_VENDOR_PATH") or "/etc/OpenCL/vendors")
    with tempfile.TemporaryDirectory(prefix="clba-") as folder:
        for entry in sorted(system.glob("*.icd")):
            with contextlib.suppress(OSError):
                (pathlib.Path(folder) / entry.name).write_bytes(entry.read_bytes())
        for number, driver in enumerate(drivers):
            path = pathlib.Path(folder) / f"zz-package-{number}.icd"
            path.write_text(f"{driver}\n", encoding="utf-8")
        os.environ["OCL_ICD_VENDORS"] = f"{folder}/"
        try:
            yield
        finally:
            del os.environ["OCL_ICD_VENDORS"]


def _files(distribution: str, patterns: tuple[str, ...]) -> dict[str, pathlib.Path]:
    """Where an installed distribution has files of these names; empty if it lacks one."""
    try:
        files = importlib.metadata.files(distribution) or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    found = {}
    for pattern in patterns:
        for file in files:
            path = pathlib.Path(str(file.locate()))
            if path.match(pattern) and path.exists():
                found[pattern] = path.resolve()
                break
    return found if len(found) == len(patterns) else {}


def _load_all(libraries: dict[str, pathlib.Path]) -> bool:
    return bool(libraries) and all([_can_load(str(path)) for path in libraries.values()])


def _can_load(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True
