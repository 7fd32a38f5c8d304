# SPDX-License-Identifier: Apache-2.0
"""scikit-build-core, but a source distribution gets the C sources from outside this folder."""

from __future__ import annotations

import pathlib
import shutil
from collections.abc import Mapping

from scikit_build_core.build import *  # noqa: F403
from scikit_build_core.build import build_sdist as build_sdist_of_folder

_FOLDER = pathlib.Path(__file__).resolve().parent
_NATIVE = _FOLDER / "native"
_PARTS = ("CMakeLists.txt", "LICENSE", "cmake", "include", "kernels", "src")


def build_sdist(
    sdist_directory: str, config_settings: Mapping[str, list[str] | str] | None = None
) -> str:
    """A source distribution of this folder with the C sources in native/."""
    if _NATIVE.exists():  # this is an unpacked source distribution
        return build_sdist_of_folder(sdist_directory, config_settings)
    repository = _FOLDER.parent.parent
    try:
        for part in _PARTS:
            if (repository / part).is_dir():
                shutil.copytree(repository / part, _NATIVE / part)
            else:
                _NATIVE.mkdir(exist_ok=True)
                shutil.copy2(repository / part, _NATIVE / part)
        return build_sdist_of_folder(sdist_directory, config_settings)
    finally:
        shutil.rmtree(_NATIVE, ignore_errors=True)
