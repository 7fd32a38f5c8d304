# SPDX-License-Identifier: Apache-2.0
"""python -m clba"""

from __future__ import annotations

import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

import clba


def run(*arguments: object, **options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "clba", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **options},
    )


@pytest.fixture
def file(hall: clba.Problem, tmp_path: pathlib.Path) -> pathlib.Path:
    path = tmp_path / "hall.txt"
    hall.to_bal(path)
    return path


def test_solve_writes_what_it_is_asked_for(file: pathlib.Path, tmp_path: pathlib.Path) -> None:
    outputs = {"-o": "out.txt.bz2", "--ply": "out.ply", "--json": "out.json"}
    arguments = [word for option, name in outputs.items() for word in (option, tmp_path / name)]
    done = run("solve", file, *arguments, "--loss", "huber", "--loss-scale", 2)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Solver summary (clba ")
    summary = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    solved = clba.Problem.from_bal(tmp_path / "out.txt.bz2")
    solved.set_loss("huber", 2)
    assert solved.evaluate(jacobian=False).cost == pytest.approx(summary["final_cost"], rel=1e-5)
    assert (tmp_path / "out.ply").read_bytes().startswith(b"ply\n")


def test_quiet(file: pathlib.Path) -> None:
    done = run("solve", file, "--quiet", "--max-iterations", 1)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_errors(file: pathlib.Path, tmp_path: pathlib.Path) -> None:
    for code, message, arguments in (
        (4, "missing.txt", ["solve", tmp_path / "missing.txt"]),
        (4, "its folder does not exist", ["solve", file, "-o", tmp_path / "none/out.txt"]),
        (5, "'warp drive'", ["solve", file, "--device", "warp drive"]),
        (2, "invalid choice: 'qr'", ["solve", file, "--linear-solver", "qr"]),
        (2, "scale = 0", ["solve", file, "--loss", "huber", "--loss-scale", 0]),
        (2, "COMMAND", []),
    ):
        done = run(*arguments)
        assert (done.returncode, done.stdout) == (code, ""), done
        assert message in done.stderr
    assert run("--version").stdout == f"{clba.__version__}\n"


def test_devices() -> None:
    done = run("devices")
    assert done.returncode == 0
    assert clba.devices()[0].name in done.stdout
    assert run("devices", OCL_ICD_VENDORS="/nonexistent/").returncode == 5


def test_interrupt_writes_the_best_state(tmp_path: pathlib.Path) -> None:
    start, _ = clba.Problem.generate("hall", num_images=60)
    start.to_bal(tmp_path / "hall.txt")
    process = subprocess.Popen(
        [sys.executable, "-m", "clba", "solve", tmp_path / "hall.txt", "-o", tmp_path / "out.txt"]
        + ["--json", tmp_path / "out.json", "--function-tolerance", "0"]
        + ["--max-iterations", "1000000"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    assert process.stderr is not None
    shown = b""
    while b"cost=" not in shown:  # the first iteration is done
        shown += process.stderr.read1()
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    process.communicate()
    # It may have converged by the gradient before the signal.
    assert process.returncode in (130, 0)
    assert (tmp_path / "out.txt").exists()
    final = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["final_cost"]
    solved = clba.Problem.from_bal(tmp_path / "out.txt").evaluate(jacobian=False).cost
    assert solved == pytest.approx(final, rel=1e-5)
