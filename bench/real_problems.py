#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Solves every real problem by every linear solver and precision and writes docs/results.md.

  bench/real_problems.py CLBA [-o docs/results.md] [--only NAME]

CLBA is the built command. The problems are looked for in the folder CLBA_TEST_DATA (default:
../shared/data beside the project); without it nothing is measured and nothing is written.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

PROJECT = pathlib.Path(__file__).resolve().parent.parent

# File below the data folder, cost of Ceres (sparse_schur, fp64, up to 200 iterations), and whether
# Ceres had converged: if not, a lower cost is right.
PROBLEMS = [
    ("bal/problem-16-22106-pre", 18033.9035, True),
    ("bal/problem-21-11315-pre", 30378.6358, True),
    ("bal/problem-49-7776-pre", 13344.2439, False),
    ("real/olsson-Cherub", 108496.01, True),
    ("real/olsson-Cherub-perturbed", 108496.01, True),
    ("real/olsson-De_Guerre-perturbed", 9163.83088, True),
    ("real/dbat-roma-60", 15156.7221, True),
    ("real/colmap-gtsfm_set1_lund_door", 10852.6522, True),
    ("real/colmap-softmurata", 233155.914, False),
    ("real/libmv-problem_02", 4798.93253, True),
    ("real/kitti-2011_09_30_drive_0027-stereo-deadreckoned", 113146.592, False),
    ("real/malaga-170-gtpose-clean", 2874.24871, False),
    ("real/strecha-Herz-Jesus-P25", 28309.891, True),
    ("real/strecha-fountain-P11", 8278.65767, True),
]
# Gross outliers: a robust loss, judged by the median residual.
ROBUST = "real/fakepile-47"
SOLVERS = [
    ("auto", None),
    ("explicit_schur", None),
    ("pcg_schur", "schur_jacobi"),
    ("pcg_schur", "block_jacobi"),
    ("pcg_hessian", "block_jacobi"),
    ("direct_schur", None),
]
# The factorisation of direct_schur is in fp64 in any precision.
RUNS = [(solver, preconditioner, precision) for solver, preconditioner in SOLVERS
        for precision in ("mixed", "double") if (solver, precision) != ("direct_schur", "mixed")]


def solve(clba, path, solver, preconditioner, precision, extra=()):
    with tempfile.TemporaryDirectory() as folder:
        summary = os.path.join(folder, "summary.json")
        command = [clba, "solve", path, "--quiet", "--json", summary, "--linear-solver", solver,
                   "--precision", precision, *extra]
        if preconditioner:
            command += ["--preconditioner", preconditioner]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with open(summary, encoding="utf-8") as file:
            return json.load(file)


def sizes(summary):
    return f"{summary['images']} / {summary['points']} / {summary['observations']}"


def row(name, reference, converged, solver, preconditioner, precision, summary):
    cost = summary["reference_final_cost"]
    excess = cost / reference - 1
    bound = 1e-3 if converged else 1e-2
    return (f"| {name} | {solver}{' ' + preconditioner if preconditioner else ''} | {precision} "
            f"| {cost:.9g} | {excess:+.1e} | {'yes' if excess <= bound else 'NO'} "
            f"| {summary['num_iterations']} | {summary['num_linear_solver_iterations']} "
            f"| {summary['solve_seconds']:.2f} | {summary['reason']} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clba")
    parser.add_argument("-o", "--output", default=str(PROJECT / "docs" / "results.md"))
    parser.add_argument("--only", default="", help="problems whose name has this in it")
    arguments = parser.parse_args()
    data = pathlib.Path(os.environ.get("CLBA_TEST_DATA", PROJECT.parent / "shared" / "data"))
    if not data.is_dir():
        print(f"real_problems: skipped, there is no folder {data}; set CLBA_TEST_DATA")
        return 77

    # The first solve of each kind compiles its kernels; its time is not to be taken for the solver's.
    problems = [problem for problem in PROBLEMS if arguments.only in problem[0]]
    for run in RUNS:
        solve(arguments.clba, str(data / "real/strecha-fountain-P11.txt.bz2"), *run)
    device = None
    lines = []
    table_of_problems = []
    for name, reference, converged in problems:
        path = str(data / (name + ".txt.bz2"))
        for run in RUNS:
            summary = solve(arguments.clba, path, *run)
            device = summary["device"]
            lines.append(row(os.path.basename(name), reference, converged, *run, summary))
            print(lines[-1], flush=True)
        table_of_problems.append(
            f"| {os.path.basename(name)} | {sizes(summary)} | {summary['initial_cost']:.9g} "
            f"| {reference:.9g}{'' if converged else ' (not converged)'} |")
    robust_lines = []
    if arguments.only in ROBUST:
        path = str(data / (ROBUST + ".txt.bz2"))
        for loss, scale in (("huber", "0.1"), ("cauchy", "0.1"), ("soft_l1", "0.1")):
            for solver, preconditioner in SOLVERS:
                summary = solve(arguments.clba, path, solver, preconditioner, "mixed",
                                ("--loss", loss, "--loss-scale", scale))
                robust_lines.append(
                    f"| {loss} {scale} | {solver}{' ' + preconditioner if preconditioner else ''} "
                    f"| {summary['reference_final_cost']:.6g} "
                    f"| {summary['median_residual']:.3f} | {summary['num_iterations']} "
                    f"| {summary['reason']} |")
                print(robust_lines[-1], flush=True)

    with open(arguments.output, "w", encoding="utf-8") as file:
        file.write(f"""# Results on real problems

Made by `bench/real_problems.py build/release/src/cli/clba` on {device}.

The cost is 1/2 sum |r|^2 without a loss, all nine parameters of each image free, evaluated by the
serial fp64 reference. Excess is against Ceres (sparse_schur, fp64, up to 200 iterations). A solve is
held to be right if it ends within 1e-3 of Ceres or below it, within 1e-2 where Ceres had not
converged. All is at its defaults, of which 50 iterations are one. Seconds are of one run on a shared machine with two cores, without compiling kernels:
read them as orders of size.

The default is auto in mixed. Solvers that are not within met a limit on iterations on an ill-conditioned
path of a vehicle: exact steps (explicit_schur, direct_schur) converge more slowly there than inexact
ones, and block_jacobi meets the limit of 500 iterations of conjugate gradients in nearly every step.

| problem | images / points / observations | start | Ceres |
|---|---|---|---|
""" + "\n".join(table_of_problems) + """

| problem | solver | precision | final cost | excess | within | iterations | PCG iterations | seconds | ended by |
|---|---|---|---|---|---|---|---|---|---|
""" + "\n".join(lines) + """

## fakepile-47: gross outliers

A robust loss with a scale of 0.1 pixels, judged by the median of |r|, which is 0.07 pixels at a good
solution; the cost is that of the loss.

| loss | solver | cost | median residual | iterations | ended by |
|---|---|---|---|---|---|
""" + "\n".join(robust_lines) + "\n")
    print(f"wrote {arguments.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
