# SPDX-License-Identifier: Apache-2.0
"""The Python code of README.md runs, and the project's README.md begins with the same."""

from __future__ import annotations

import os
import pathlib
import re
import subprocess
import sys


def blocks(path: pathlib.Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", path.read_text(encoding="utf-8"), re.M | re.S)


def test_code_runs(package: pathlib.Path, tmp_path: pathlib.Path) -> None:
    found = blocks(package / "README.md")
    assert len(found) >= 4
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(found)],
        cwd=tmp_path,
        env=dict(os.environ),
        check=False,
        text=True,
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    assert "Termination                  convergence" in done.stdout


def test_the_first_code_is_that_of_the_project(package: pathlib.Path) -> None:
    assert blocks(package / "README.md")[0] == blocks(package.parent.parent / "README.md")[0]
