#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the reduced form of bench/paper and holds its findings that do not depend on the machine's speed.

  paper_test.py STUDY BUILD
"""
import json
import pathlib
import subprocess
import sys
import tempfile

SKIPPED = 77


def errors(rows, method):
    return [row["rmse"] for row in rows if row["method"] == method]


def check(rule, what):
    if not rule:
        raise SystemExit(f"paper_test: {what}")


def main():
    study, build = sys.argv[1:]
    try:
        import matplotlib  # noqa: F401
        import numpy  # noqa: F401
    except ImportError as error:
        print(f"paper_test: skipped, {error}; scripts/install-test-packages installs it")
        return SKIPPED
    with tempfile.TemporaryDirectory() as folder:
        measured = pathlib.Path(folder, "results.json")
        subprocess.run([sys.executable, study, "--build", build, "--output", folder, "--json",
                        str(measured), "--reduced"], check=True)
        names = sorted(path.name for path in pathlib.Path(folder).iterdir())
        check(names == ["paper-growth.svg", "paper-model.svg", "paper-weights.svg", "paper.md",
                        "results.json"], f"the files are {names}")
        text = pathlib.Path(folder, "paper.md").read_text(encoding="utf-8")
        results = json.loads(measured.read_text(encoding="utf-8"))
    for heading in ("Table 1", "Table 2", "Table 3", "Figs. 2 and 3"):
        check(f"## {heading}" in text, f"paper.md has no {heading}")

    premise = results["premise"]
    for plain, weighted in zip(errors(premise, "paper_marquardt"),
                               errors(premise, "paper_marquardt_weighted")):
        check(abs(weighted / plain - 1) < 1e-3,
              f"weights changed an error under Marquardt's damping: {plain} to {weighted}")
    for before, after in zip(errors(premise, "start"),
                             errors(premise, "robust_constant_intrinsics")):
        check(after < before / 2, f"with all that is known {before} became {after}")
    by_scene = {}
    for row in results["growth"]:
        by_scene.setdefault(row["images"], {})[row["name"]] = row["final_cost"]
    for images, costs in by_scene.items():
        for name in ("clba", "normal", "paper, one thread"):
            check(abs(costs[name] / costs["schur"] - 1) < 1e-5,
                  f"{images} images: {name} ends at {costs[name]}, the baseline at {costs['schur']}")
    for row in results["steps"]:
        if row["method"] == "paper_marquardt":
            check(all(row["steps"][step] > 0 for step in
                      ("residual", "jacobian", "preconditioner", "jx", "jty")),
                  f"a step of the paper took no time: {row['steps']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
