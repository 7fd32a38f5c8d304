# SPDX-License-Identifier: Apache-2.0
"""_ffi.py is clba.h: parsed, and compared with a compiled probe."""

from __future__ import annotations

import ctypes
import pathlib
import re
import subprocess

import pytest

from clba import _ffi, _names

HEADER = pathlib.Path(__file__).resolve().parents[3] / "include/clba/clba.h"
TEXT = re.sub(r"/\*.*?\*/", "", HEADER.read_text(encoding="utf-8"), flags=re.S)

SCALARS = {
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "int64_t": ctypes.c_int64,
    "uint64_t": ctypes.c_uint64,
    "double": ctypes.c_double,
    "size_t": ctypes.c_size_t,
    "clba_status": ctypes.c_int32,
    "uint8_t": ctypes.c_uint8,
    "clba_iteration_fn": _ffi.IterationFunction,
    "clba_progress_fn": _ffi.ProgressFunction,
}
STRUCTS = {
    **_ffi.STRUCTS,
    "clba_context": _ffi.ContextHandle,
    "clba_problem": _ffi.ProblemHandle,
    "clba_result": _ffi.ResultHandle,
    "clba_covariance": _ffi.CovarianceHandle,
    "clba_cancellation": _ffi.CancellationHandle,
}


def ctype_of(declared: str) -> object:
    """The ctypes type of a C type, as "const clba_problem*"."""
    text = declared.replace("const", "").strip()
    stars = text.count("*")
    name = text.replace("*", "").strip()
    if name == "void":
        return ctypes.c_void_p if stars else None
    if name == "char":
        assert stars == 1
        return ctypes.c_char_p
    ctype = SCALARS.get(name) or STRUCTS[name]
    for _ in range(stars):
        ctype = ctypes.POINTER(ctype)
    return ctype


def functions() -> dict[str, tuple[object, list[object]]]:
    found = {}
    for result, name, arguments in re.findall(
        r"CLBA_API\s+([^;(]*?)\b(clba_\w+)\s*\(([^)]*)\)\s*;", TEXT
    ):
        types = []
        for argument in arguments.split(","):
            declared = re.fullmatch(r"\s*(.*?)\s*\b(\w+)\s*", argument, re.S)
            assert declared, argument
            if argument.strip() != "void":
                types.append(ctype_of(declared[1]))
        found[name] = (ctype_of(result), types)
    return found


def structs() -> dict[str, list[str]]:
    found = {}
    for name, body in re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", TEXT, re.S):
        found[name] = [
            field
            for declaration in body.split(";")
            for field in re.findall(r"(\w+)(?:\[\d+\])?\s*(?:,|$)", declaration.strip())
        ]
    return found


def test_every_function_is_declared_as_in_the_header() -> None:
    assert len(functions()) > 50
    assert _ffi.PROTOTYPES == functions()
    for name, (restype, argtypes) in _ffi.PROTOTYPES.items():
        function = getattr(_ffi.lib, name)
        assert function.restype is restype
        assert function.argtypes == argtypes


def test_every_struct_has_the_fields_of_the_header() -> None:
    assert {
        name: [field[0] for field in struct._fields_] for name, struct in _ffi.STRUCTS.items()
    } == (structs())


def test_sizes_and_offsets_are_those_of_c(tmp_path: pathlib.Path) -> None:
    lines = []
    for name, fields in structs().items():
        lines.append(f'printf("{name} %zu\\n", sizeof({name}));')
        lines += [
            f'printf("{name}.{field} %zu %zu\\n", offsetof({name}, {field}), '
            f"sizeof((({name}*)0)->{field}));"
            for field in fields
        ]
    for generated in ("clba_export.h", "clba_version.h"):
        (tmp_path / "clba").mkdir(exist_ok=True)
        (tmp_path / "clba" / generated).write_text("#define CLBA_API\n", encoding="utf-8")
    source = tmp_path / "probe.c"
    source.write_text(
        "#include <clba/clba.h>\n#include <stddef.h>\n#include <stdio.h>\n"
        "int main(void) {\n" + "\n".join(lines) + "\nreturn 0;\n}\n",
        encoding="utf-8",
    )
    probe = tmp_path / "probe"
    include = HEADER.parent.parent
    subprocess.run(["cc", "-I", tmp_path, "-I", include, source, "-o", probe], check=True)
    found = subprocess.run([probe], check=True, text=True, stdout=subprocess.PIPE).stdout.split(
        "\n"
    )
    expected = []
    for name, struct in _ffi.STRUCTS.items():
        expected.append(f"{name} {ctypes.sizeof(struct)}")
        for field in struct._fields_:
            place = getattr(struct, field[0])
            expected.append(f"{name}.{field[0]} {place.offset} {place.size}")
    assert sorted(found) == sorted([*expected, ""])


def enumeration(prefix: str) -> dict[str, int]:
    return {
        name.lower(): int(value)
        for name, value in re.findall(rf"\bCLBA_{prefix}_([A-Z0-9_]+)\s*=\s*(-?\d+)", TEXT)
    }


@pytest.mark.parametrize(
    ("prefix", "names", "literal"),
    [
        ("CAMERA", _names.CAMERA_MODELS, _names.CameraModel),
        ("LOSS", _names.LOSSES, _names.Loss),
        ("LINEAR_SOLVER", _names.LINEAR_SOLVERS, _names.LinearSolver),
        ("PRECONDITIONER", _names.PRECONDITIONERS, _names.Preconditioner),
        ("DAMPING", _names.DAMPINGS, _names.Damping),
        ("PRECISION", _names.PRECISIONS, _names.Precision),
        ("JACOBIAN", _names.JACOBIANS, _names.JacobianForm),
        ("GAUGE_STATE", _names.GAUGES, None),
        ("COVARIANCE", _names.COVARIANCE_METHODS, _names.CovarianceMethod),
        ("SCENE", _names.SCENES, _names.Scene),
        ("UNIT", _names.ERROR_UNITS, _names.ErrorUnit),
        ("DEVICE", _names.DEVICE_TYPES, None),
        ("REASON", _names.REASONS, None),
    ],
)
def test_names_are_those_of_the_header(prefix: str, names: dict[str, int], literal: object) -> None:
    assert names == enumeration(prefix)
    if literal is not None:
        assert set(literal.__args__) == set(names)  # type: ignore[attr-defined]


def test_formats_are_those_of_the_header() -> None:
    declared = enumeration("FORMAT")
    assert set(_names.Format.__args__) == set(declared)  # type: ignore[attr-defined]
    assert _names.FORMATS.items() <= declared.items()


def test_gauges_are_those_of_the_header() -> None:
    declared = enumeration("GAUGE")
    for name, value in _names.GAUGE_CHOICES.items():
        assert declared[name] == value
    assert set(_names.GaugeChoice.__args__) == set(_names.GAUGE_CHOICES)  # type: ignore[attr-defined]


def test_terminations_are_those_of_the_header() -> None:
    for name, value in _names.TERMINATIONS.items():
        assert re.search(rf"\bCLBA_{name.upper()} = {value}\b", TEXT)


def test_every_error_status_has_its_exception() -> None:
    assert set(enumeration("ERROR").values()) == set(_ffi.BY_STATUS)
    for status, error in _ffi.BY_STATUS.items():
        with pytest.raises(error):
            _ffi.check(status)
