# SPDX-License-Identifier: Apache-2.0
"""The examples run and show what they say."""

from __future__ import annotations

import importlib.util
import pathlib
import sys
from typing import Any

import pytest

import clba


def run(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch, name: str, *arguments: str) -> Any:
    path = package / "examples" / f"{name}.py"
    monkeypatch.setattr(sys, "argv", [str(path), *arguments])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main()


def test_refine_bal(
    package: pathlib.Path, monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path
) -> None:
    assert run(package, monkeypatch, "refine_bal").converged
    start, _ = clba.Problem.generate("street", num_images=6, observations_per_image=60)
    start.to_bal(tmp_path / "in.txt")
    paths = str(tmp_path / "in.txt"), str(tmp_path / "out.txt.gz")
    summary = run(package, monkeypatch, "refine_bal", *paths)
    refined = clba.Problem.from_bal(paths[1]).evaluate(jacobian=False).cost
    assert refined == pytest.approx(summary.final_cost, rel=1e-5)
    assert refined < 0.01 * summary.initial_cost


def test_refine_colmap(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pycolmap").set_random_seed(1)
    ours, theirs = run(package, monkeypatch, "refine_colmap")
    assert ours == pytest.approx(theirs, rel=1e-6)


def test_robust_loss(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    errors = run(package, monkeypatch, "robust_loss")
    assert errors["huber"] < errors["none"] / 3
    assert errors["cauchy"] < errors["none"] / 10


def test_gps_weights(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = run(package, monkeypatch, "gps_weights")
    (cost, distance), (gps_cost, gps_distance) = results["marquardt"], results["uncertainty"]
    assert gps_cost == pytest.approx(cost, rel=1e-4)
    assert gps_distance < distance / 3


def test_gps_priors(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    errors = run(package, monkeypatch, "gps_priors")
    assert errors["with"] < 0.7 * errors["gps"]
    assert errors["with"] < errors["without"]


def test_own_loop(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, theirs = run(package, monkeypatch, "own_loop")
    assert mine == pytest.approx(theirs, rel=1e-6)


def test_incremental(package: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracked, local, everything = run(package, monkeypatch, "incremental", "16")
    assert local < tracked / 3
    assert everything < tracked / 3
