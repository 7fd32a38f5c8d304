# SPDX-License-Identifier: Apache-2.0
"""Refines a BAL file.

refine_bal.py [IN OUT]    without arguments: a generated hall, in a temporary folder
"""

from __future__ import annotations

import pathlib
import sys
import tempfile

import clba


def refine(source: pathlib.Path, target: pathlib.Path) -> clba.Summary:
    problem = clba.Problem.from_bal(source)
    print(problem)
    summary = clba.solve(problem, progress=True)
    problem.to_bal(target)
    return summary


def main() -> clba.Summary:
    if len(sys.argv) == 3:
        summary = refine(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            start, _ = clba.Problem.generate("hall", num_images=20)
            start.to_bal(folder / "hall.txt.bz2")
            summary = refine(folder / "hall.txt.bz2", folder / "refined.txt.bz2")
    print(summary.report())
    return summary


if __name__ == "__main__":
    main()
