# SPDX-License-Identifier: Apache-2.0
"""Finding the library."""

from __future__ import annotations

import os
import pathlib
import shutil
import subprocess
import sys

import clba
from clba import _ffi


def import_with(**environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "import clba; print(clba._ffi.lib._name)"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def stub(folder: pathlib.Path, code: str) -> pathlib.Path:
    source, library = folder / "stub.c", folder / "libstub.so"
    source.write_text(code, encoding="utf-8")
    subprocess.run(["cc", "-shared", "-fPIC", source, "-o", library], check=True)
    return library


def test_the_variable_names_the_library(tmp_path: pathlib.Path) -> None:
    copy = tmp_path / "libother.so"
    shutil.copy(_ffi.lib._name, copy)
    done = import_with(
        CLBA_LIBRARY=str(copy),
        LD_LIBRARY_PATH=str(pathlib.Path(clba.__file__).parents[1] / "clba.libs"),
    )
    assert done.stdout == f"{copy}\n", done.stderr


def test_a_path_that_is_wrong_is_named(tmp_path: pathlib.Path) -> None:
    done = import_with(CLBA_LIBRARY=str(tmp_path / "missing.so"))
    assert done.returncode == 1
    assert "ImportError: the library libclba cannot be loaded; tried" in done.stderr
    assert f"{tmp_path}/missing.so: " in done.stderr
    assert "CLBA_LIBRARY must name" in done.stderr


def test_all_places_are_named(tmp_path: pathlib.Path) -> None:
    shutil.copytree(
        pathlib.Path(clba.__file__).parent, tmp_path / "clba", ignore=shutil.ignore_patterns("lib")
    )
    environment = {"CLBA_LIBRARY": "", "PYTHONPATH": str(tmp_path)}
    done = import_with(**environment)
    assert done.returncode == 1
    assert f"{tmp_path}/clba/lib/libclba.so: " in done.stderr
    assert "\n  libclba.so.0: " in done.stderr
    assert "install a wheel" in done.stderr


def test_another_version_is_refused(tmp_path: pathlib.Path) -> None:
    library = stub(tmp_path, "unsigned clba_version(void) { return 1203; }")
    done = import_with(CLBA_LIBRARY=str(library))
    assert f"ImportError: {library} is libclba 0.12.3, but this package needs 0.1.x" in done.stderr


def test_another_library_is_refused(tmp_path: pathlib.Path) -> None:
    library = stub(tmp_path, "int other(void) { return 0; }")
    done = import_with(CLBA_LIBRARY=str(library))
    assert f"ImportError: {library} is not libclba" in done.stderr


def test_versions_agree() -> None:
    major, minor, patch = (int(part) for part in clba.__version__.split("."))
    assert _ffi.lib.clba_version() == 10000 * major + 100 * minor + patch
