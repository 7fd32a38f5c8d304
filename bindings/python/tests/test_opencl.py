# SPDX-License-Identifier: Apache-2.0
"""Drivers and loaders from packages, and machines without any.

The packages are stood in for by folders with their names and the names of their files: their driver
is the system's PoCL, their loader the system's own.
"""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys

import pytest

LIST = """
import clba
print([device.platform for device in clba.devices()])
print([line.split()[-1] for line in open("/proc/self/maps") if "/libOpenCL.so" in line][:1])
"""


def system_file(name: str) -> pathlib.Path:
    """Where the dynamic linker finds a library."""
    code = f"import ctypes; ctypes.CDLL({name!r}); print(open('/proc/self/maps').read())"
    maps = subprocess.run([sys.executable, "-c", code], check=True, text=True, capture_output=True)
    stem = name.split(".so")[0]
    return next(pathlib.Path(line.split()[-1]) for line in maps.stdout.split("\n") if stem in line)


def pocl() -> pathlib.Path:
    icd = pathlib.Path("/etc/OpenCL/vendors/pocl.icd")
    if not icd.exists():
        pytest.skip("PoCL is not installed")
    return system_file(icd.read_text(encoding="utf-8").strip())


def package(folder: pathlib.Path, name: str, files: dict[str, pathlib.Path]) -> None:
    """An installed distribution with links to files."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    for path, target in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).symlink_to(target)
    (info / "RECORD").write_text("".join(f"{path},,\n" for path in files))


def listed(folder: pathlib.Path, **environment: str) -> list[str]:
    """What LIST prints where the system has no driver, and packages are in a folder."""
    (folder / "vendors").mkdir(exist_ok=True)
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    variables = {"OPENCL_VENDOR_PATH": str(folder / "vendors"), "PYTHONPATH": path, **environment}
    done = subprocess.run(
        [sys.executable, "-c", LIST],
        env={**os.environ, **variables},
        check=True,
        text=True,
        stdout=subprocess.PIPE,
    )
    return done.stdout.splitlines()


def without_loader(folder: pathlib.Path) -> dict[str, str]:
    """Files that are no libraries stand where the dynamic linker looks first."""
    hidden = folder / "no-loader"
    hidden.mkdir()
    for name in ("libOpenCL.so.1", "libOpenCL.so"):
        (hidden / name).touch()
    return {"LD_LIBRARY_PATH": str(hidden)}


def intel(folder: pathlib.Path) -> None:
    empty = folder / "libempty.so"
    subprocess.run(["cc", "-shared", "-x", "c", os.devnull, "-o", empty], check=True)
    runtime = ("libintlc.so.5", "libirng.so", "libimf.so", "libsvml.so")
    package(folder, "intel-cmplr-lib-rt", dict.fromkeys((f"lib/{n}" for n in runtime), empty))
    files = {"lib/libOpenCL.so.1": system_file("libOpenCL.so.1"), "lib/libintelocl.so": pocl()}
    package(folder, "intel-opencl-rt", files)


def test_no_driver(tmp_path: pathlib.Path) -> None:
    assert listed(tmp_path)[0] == "[]"


def test_no_loader(tmp_path: pathlib.Path) -> None:
    assert listed(tmp_path, **without_loader(tmp_path)) == ["[]", "[]"]


def test_the_driver_of_pocl_is_found(tmp_path: pathlib.Path) -> None:
    package(tmp_path, "pocl-binary-distribution", {"pyopencl/.libs/libpocl-12ab.so": pocl()})
    assert listed(tmp_path)[0] == "['Portable Computing Language']"
    # Without a linker it would end the process at the first kernel.
    assert listed(tmp_path, PATH="")[0] == "[]"


def test_the_users_choice_is_respected(tmp_path: pathlib.Path) -> None:
    package(tmp_path, "pocl-binary-distribution", {"pyopencl/.libs/libpocl-12ab.so": pocl()})
    assert listed(tmp_path, OCL_ICD_VENDORS=f"{tmp_path}/vendors/")[0] == "[]"


def test_the_systems_drivers_stay(tmp_path: pathlib.Path) -> None:
    intel(tmp_path)
    (tmp_path / "vendors").mkdir()
    (tmp_path / "vendors/system.icd").write_text(f"{pocl()}\n", encoding="utf-8")
    assert listed(tmp_path)[0] == str(["Portable Computing Language"] * 2)


def test_loader_and_driver_of_intel_are_found(tmp_path: pathlib.Path) -> None:
    intel(tmp_path)
    devices, loader = listed(tmp_path, **without_loader(tmp_path))
    assert devices == "['Portable Computing Language']"
    assert loader == str([str(system_file("libOpenCL.so.1"))])


def test_intel_without_its_runtime_libraries(tmp_path: pathlib.Path) -> None:
    package(
        tmp_path, "intel-opencl-rt", {"lib/libOpenCL.so.1": pocl(), "lib/libintelocl.so": pocl()}
    )
    assert listed(tmp_path)[0] == "[]"


def test_solve_says_what_to_install(tmp_path: pathlib.Path) -> None:
    code = (
        "import clba\np, _ = clba.Problem.generate(num_images=3, observations_per_image=20)\n"
        "try: clba.solve(p)\nexcept clba.NoDeviceError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **without_loader(tmp_path)},
        check=True,
        text=True,
        stdout=subprocess.PIPE,
    )
    assert "no OpenCL loader was found" in done.stdout
    assert "pip install intel-opencl-rt intel-cmplr-lib-rt" in done.stdout
