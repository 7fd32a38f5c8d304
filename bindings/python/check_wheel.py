#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks a wheel: what it holds, what its libraries need, and that it loads without OpenCL.

check_wheel.py WHEEL
"""

from __future__ import annotations

import os
import pathlib
import re
import subprocess
import sys
import tempfile
import venv
import zipfile

# Python, the library, and the copy of bzip2 that it needs; nothing else, and so nothing of CHOLMOD.
HELD = re.compile(
    r"clba/\w+\.(py|html)|clba/py\.typed|clba/(lib/)?|clba/lib/libclba\.so"
    r"|clba\.libs/(libbz2-\w+\.so[.\d]*)?|clba-[\d.]+\.dist-info/.*"
)
# Of the libraries that PEP 599 and its successors allow.
NEEDED = re.compile(
    r"libc\.so\.6|libm\.so\.6|libgcc_s\.so\.1|libstdc\+\+\.so\.6|libz\.so\.1|ld-linux-[\w-]+\.so\.2"
    r"|libbz2-\w+\.so[.\d]*"
)

WITHOUT_OPENCL = """
import clba
assert clba.devices() == [], clba.devices()
problem, _ = clba.Problem.generate("hall", num_images=3, observations_per_image=20)
try:
    clba.solve(problem)
except clba.NoDeviceError as error:
    assert "install" in str(error), error
    print(f"without OpenCL: {error}")
else:
    raise SystemExit("it solved without OpenCL")
"""


def check_contents(wheel: zipfile.ZipFile) -> None:
    names = wheel.namelist()
    for name in names:
        if not HELD.fullmatch(name):
            raise SystemExit(f"the wheel holds {name}, which is not of its parts")
    for wanted in ("clba/lib/libclba.so", "clba/py.typed"):
        if wanted not in names:
            raise SystemExit(f"the wheel lacks {wanted}")
    licences = [name for name in names if re.search(r"/licenses/LICENSE[.\w]*$", name)]
    if len(licences) != 2:
        raise SystemExit(
            f"the wheel holds the licences {licences}, but must hold clba's and bzip2's"
        )


def check_libraries(folder: pathlib.Path) -> None:
    libraries = [path for path in folder.rglob("*.so*") if path.is_file()]
    assert libraries
    for path in libraries:
        dynamic = _output("readelf", "--dynamic", "--wide", path)
        for name in re.findall(r"\(NEEDED\).*\[(.*)\]", dynamic):
            if not NEEDED.fullmatch(name):
                raise SystemExit(f"{path.name} needs {name}, which the wheel may not rely on")
        symbols = _output("readelf", "--dyn-syms", "--wide", path)
        if re.search(r"\bcholmod_", symbols):
            raise SystemExit(f"{path.name} has symbols of CHOLMOD, whose supernodal module is GPL")


def check_loading(wheel: str, folder: pathlib.Path) -> None:
    """Files that are no libraries stand in for a loader that is missing, if the machine has one."""
    for name in ("libOpenCL.so.1", "libOpenCL.so"):
        (folder / name).touch()
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv/bin/python"
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, wheel], check=True)
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("CLBA_LIBRARY", "PYTHONPATH", "LD_PRELOAD")
    }
    environment["LD_LIBRARY_PATH"] = str(folder)
    subprocess.run([python, "-c", WITHOUT_OPENCL], check=True, env=environment, cwd=folder)


def _output(*command: str | pathlib.Path) -> str:
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE).stdout


def main() -> None:
    (path,) = sys.argv[1:]
    with tempfile.TemporaryDirectory() as name, zipfile.ZipFile(path) as wheel:
        folder = pathlib.Path(name)
        check_contents(wheel)
        wheel.extractall(folder / "wheel")
        check_libraries(folder / "wheel")
        check_loading(path, folder)
    print(f"{pathlib.Path(path).name}: good")


if __name__ == "__main__":
    main()
