# SPDX-License-Identifier: Apache-2.0
"""Runs the programs that the study compares, each with the threads asked for."""
import json
import os
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent


class Programs:
    """build: the build folder, whose bench/ holds the programs."""

    def __init__(self, build):
        self.bench = pathlib.Path(build).resolve() / "bench"
        self.ceres = self.bench / "peers_ceres"

    def has_ceres(self):
        return self.ceres.exists()

    @staticmethod
    def run(command, threads):
        environment = dict(os.environ, OPENBLAS_NUM_THREADS=str(threads),
                           OMP_NUM_THREADS=str(threads), POCL_MAX_PTHREAD_COUNT=str(threads))
        processors = sorted(os.sched_getaffinity(0))[:threads]
        result = subprocess.run(
            [str(part) for part in command], stdout=subprocess.PIPE, check=False, text=True,
            env=environment, preexec_fn=lambda: os.sched_setaffinity(0, processors))
        if result.returncode != 0:
            raise SystemExit(f"{' '.join(map(str, command))} failed with {result.returncode}")
        return result.stdout

    def clba(self, spec, method, threads, repetitions=1, endless=False):
        command = [sys.executable, HERE / "worker.py", json.dumps(spec), method, "--repetitions",
                   repetitions]
        return json.loads(self.run(command + ["--endless"] * endless, threads))

    def baseline(self, path, output, solver, max_iterations=60):
        """The paper's baseline, in one thread; the solved problem is written to output."""
        command = [self.bench / "paper_baseline", path, output, solver, max_iterations, 1e-6]
        answer = json.loads(self.run(command, 1))
        return {"runs": [{"seconds": answer["total_seconds"],
                          "rows": [[row["seconds"], row["cost"]] for row in answer["rows"]]}],
                "num_iterations": len(answer["rows"]) - 1,
                "num_rejected_steps": sum(not row["is_accepted"] for row in answer["rows"]),
                "final_cost": answer["final_cost"]}

    def solve_by_ceres(self, path, linear_solver, threads):
        command = [self.ceres, path, "--linear-solver", linear_solver, "--preconditioner",
                   "schur_jacobi", "--threads", threads, "--max-iterations", 60]
        events = [json.loads(line) for line in self.run(command, threads).splitlines()]
        rows = [[event["seconds"], event["cost"]] for event in events if event["event"] == "row"]
        # Its own tolerance is tighter; the run counts up to where one of 1e-6 would have ended it.
        end = next((i for i in range(1, len(rows))
                    if 0 < rows[i - 1][1] - rows[i][1] <= 1e-6 * rows[i - 1][1]), len(rows) - 1)
        return {"runs": [{"seconds": rows[end][0], "rows": rows[: end + 1]}],
                "num_iterations": end, "final_cost": rows[end][1]}
