# SPDX-License-Identifier: Apache-2.0
"""Finds and loads the C library."""

from __future__ import annotations

import ctypes
import os
import pathlib
import sys

from clba._version import __version__


def load() -> ctypes.CDLL:
    """The library that CLBA_LIBRARY names; else the wheel's own; else the system's.

    Raises:
        ImportError: none can be loaded, or it is of another version. It lists the paths tried.
    """
    named = os.environ.get("CLBA_LIBRARY")
    candidates = [named] if named else _candidates()
    failures = []
    for path in candidates:
        try:
            library = ctypes.CDLL(path)
        except OSError as error:
            failures.append(f"  {path}: {error}")
            continue
        _check_version(library, path)
        return library
    remedy = (
        "CLBA_LIBRARY must name the library libclba"
        if named
        else "install a wheel of clba, which holds it, or set CLBA_LIBRARY to its path"
    )
    raise ImportError(
        "the library libclba cannot be loaded; tried\n" + "\n".join(failures) + f"\n{remedy}"
    )


def _candidates() -> list[str]:
    folder = pathlib.Path(__file__).parent / "lib"
    if sys.platform == "darwin":
        return [str(folder / "libclba.dylib"), "libclba.0.dylib"]
    return [str(folder / "libclba.so"), "libclba.so.0"]


def _check_version(library: ctypes.CDLL, path: str) -> None:
    try:
        function = library.clba_version
    except AttributeError:
        raise ImportError(f"{path} is not libclba: it has no function clba_version") from None
    function.restype = ctypes.c_uint32
    function.argtypes = []
    version = function()
    found = f"{version // 10000}.{version // 100 % 100}.{version % 100}"
    # Before 1.0 a minor version may break the interface.
    if found.split(".")[:2] != __version__.split(".")[:2]:
        raise ImportError(
            f"{path} is libclba {found}, but this package needs {__version__.rsplit('.', 1)[0]}.x; "
            "install them in the same version, or set CLBA_LIBRARY to another library"
        )
