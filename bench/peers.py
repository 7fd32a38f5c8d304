#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs clba and its peers on the same problems with as many threads and compares them.

  bench/peers.py BUILD [--problems real|generated|all] [--solvers SOLVER ...] [--resume]

BUILD is the build folder: its bench/peers_clba, bench/peers_ceres (built where Ceres is installed,
see scripts/install-bench-packages) and src/cli/clba are run. Real problems are looked for in the
folder CLBA_TEST_DATA (default: ../shared/data beside the project); without it they are reported as
skipped. pycolmap is a peer if --pycolmap-python is given. Writes the raw runs (--raw), docs/peers.md
and docs/peers-profile.svg, after each problem.

A solver is named PROGRAM:LINEAR_SOLVER[:WORD...], where a word is a preconditioner or a precision
by its name, or option=value for any other option of the program:
  clba:pcg_schur:schur_jacobi:mixed    ceres:iterative_schur:jacobi    clba:auto:double:eta=0.01
"""
import argparse
import bz2
import datetime
import itertools
import json
import math
import os
import pathlib
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time

PROJECT = pathlib.Path(__file__).resolve().parent.parent

TAUS = [0.1, 0.01, 0.001, 0.0001]

CLBA_SOLVERS = [
    "clba:auto:mixed",
    "clba:auto:double",
    "clba:pcg_schur:schur_jacobi:mixed",
]
CERES_SOLVERS = [
    "ceres:dense_schur",
    "ceres:sparse_schur",
    "ceres:iterative_schur:jacobi",
    "ceres:iterative_schur:schur_jacobi",
    "ceres:iterative_schur:cluster_jacobi",
]
PYCOLMAP_SOLVERS = [
    "pycolmap:dense_schur",
    "pycolmap:sparse_schur",
    "pycolmap:iterative_schur:schur_jacobi",
]
PRECISIONS = ["mixed", "double"]

# Real measurements, below the data folder.
REAL = [
    "bal/problem-16-22106-pre", "bal/problem-21-11315-pre", "bal/problem-49-7776-pre",
    "real/olsson-Cherub", "real/olsson-Cherub-perturbed", "real/olsson-De_Guerre-perturbed",
    "real/dbat-roma-60", "real/colmap-gtsfm_set1_lund_door", "real/colmap-softmurata",
    "real/fakepile-47", "real/libmv-problem_02",
    "real/kitti-2011_09_30_drive_0027-stereo-deadreckoned", "real/malaga-170-gtpose-clean",
    "real/strecha-Herz-Jesus-P25", "real/strecha-fountain-P11",
]
# Scene, images, observations per image; five observations a point.
GENERATED = [
    ("hall", 100, 1000), ("hall", 356, 2800), ("hall", 1000, 5000),
    ("street", 500, 200), ("street", 2000, 400), ("street", 10000, 500),
    ("landmark", 200, 500), ("landmark", 1000, 1000), ("landmark", 2500, 2001),
]
OBSERVATIONS_PER_POINT = 5
# Finds the best cost of a generated scene from its truth, so that it does not depend on whether any
# solver had the time to get there from the start.
TRUTH_SOLVER = "clba:pcg_schur:schur_jacobi:double"

SETTINGS = """\
Common to all: at most {iterations} iterations and {seconds:g} s a run, function tolerance 1e-9, gradient
tolerance 1e-10, parameter tolerance 1e-10, Levenberg-Marquardt with an initial trust-region radius of
1e4, no loss, all nine parameters of every image and all points free, points behind their camera kept as
the formula gives them, {threads} threads.

Ceres: Debian's package, analytic derivatives by its automatic differentiation, points eliminated first,
`trust_region_strategy_type` levenberg_marquardt, `jacobi_scaling` on, `eta` 0.1,
`max_linear_solver_iterations` 500, `use_explicit_schur_complement` off, `dense_schur` through LAPACK
(OpenBLAS, which is several times faster here than the default, Eigen), `sparse_schur` through
SuiteSparse, all else at its defaults. fp64 throughout. Debian compiles Ceres for any x86-64 (OpenBLAS
picks its kernels by the CPU at hand); OpenCL drivers compile clba's kernels for the CPU at hand.

pycolmap, where it is listed: the problem that `create_default_ceres_bundle_adjuster` makes (camera model
RADIAL, no gauge fixed), solved through pyceres, whose wheel brings its own Ceres, with the settings of
Ceres above. COLMAP itself takes dense_schur up to 50 images, sparse_schur up to 1000 and iterative_schur
with schur_jacobi beyond. It drops the residuals of points behind their camera, so it takes no part in
what is the best cost, and on a problem that starts with such points its runs are shown but not compared.

clba: through its C ABI, all else at its defaults."""


# ---- Solvers -------------------------------------------------------------------------------------

def command_of(solver, programs, path, arguments):
    program, linear_solver, *words = solver.split(":")
    command = [*programs[program], str(path), "--linear-solver", linear_solver,
               "--max-iterations", str(arguments.max_iterations),
               "--max-seconds", str(arguments.seconds)]
    if program != "clba":
        command += ["--threads", str(arguments.threads)]
    if program == "ceres" and linear_solver == "dense_schur":
        command += ["--dense-library", "lapack"]
    for word in words:
        if "=" in word:
            option, value = word.split("=", 1)
            command += [f"--{option}", value]
        else:
            command += ["--precision" if word in PRECISIONS else "--preconditioner", word]
    return command


def is_clba(solver):
    return solver.startswith("clba:")


def sets_best(solver):
    """Whether it computes in fp64 throughout, and minimises the cost that all others do."""
    return solver.startswith("ceres:") or (is_clba(solver) and "double" in solver.split(":"))


def environment_of(arguments, cache):
    threads = str(arguments.threads)
    environment = dict(os.environ, OPENBLAS_NUM_THREADS=threads, OMP_NUM_THREADS=threads,
                       POCL_MAX_PTHREAD_COUNT=threads, CLBA_CACHE_DIR=str(cache / "clba"),
                       POCL_CACHE_DIR=str(cache / "pocl"))
    plugin = next(pathlib.Path(arguments.build).rglob("libclba_cholmod.so"), None)
    if plugin:
        environment.setdefault("CLBA_CHOLMOD", str(plugin.resolve()))
    return environment


def peak_bytes(pid):
    """Peak resident memory of a running process since its last reset; 0 where there is no /proc."""
    try:
        for line in pathlib.Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    return 0


class Watchdog:
    """Kills a process that is still going when the time that was last set has passed."""

    def __init__(self, process, seconds):
        self.process = process
        self.has_killed = False
        self.peak_bytes = 0
        self.timer = None
        self.set(seconds)

    def set(self, seconds):
        self.cancel()
        self.timer = threading.Timer(seconds, self.kill)
        self.timer.daemon = True
        self.timer.start()

    def kill(self):
        self.peak_bytes = peak_bytes(self.process.pid)
        self.has_killed = True
        self.process.kill()

    def cancel(self):
        if self.timer:
            self.timer.cancel()


def run(command, environment, arguments, memory=None):
    """One run: its rows, and the events `warmed`, `loaded` and `summary` as far as it came. memory:
    a limit in bytes."""
    def limit_memory():
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))

    outcome = {"rows": [], "warmed": None, "loaded": None, "summary": None}
    with tempfile.TemporaryFile("w+") as errors, subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True,
            preexec_fn=limit_memory if memory else None) as process:
        watchdog = Watchdog(process, arguments.load_seconds)
        for line in process.stdout:
            try:
                event = json.loads(line)
            except ValueError:  # cut off in the middle of a line
                continue
            kind = event.pop("event")
            if kind == "row":
                outcome["rows"].append(event)
            else:
                outcome[kind] = event
            if kind == "loaded":
                watchdog.set(arguments.seconds + 5)
        code = process.wait()
        watchdog.cancel()
        errors.seek(0)
        message = errors.read().strip().splitlines()
    if outcome["summary"]:
        outcome["peak_bytes"] = outcome["summary"]["peak_bytes"]
        outcome["state"] = outcome["summary"]["termination"].lower()
    elif watchdog.has_killed:
        outcome["peak_bytes"] = watchdog.peak_bytes
        outcome["state"] = "cut off" if outcome["loaded"] else "cut off before the start"
    else:
        outcome["peak_bytes"] = 0
        reason = next((line for line in message if line.startswith("peers_")),
                      message[-1] if message else f"exit code {code}")
        outcome["state"] = "failed: " + ("out of memory" if "bad_alloc" in " ".join(message)
                                         else reason)
    return outcome


def final_cost(outcome):
    """The lowest cost of a run, as the serial fp64 reference gives it where the run ended by itself;
    None if it has none."""
    if outcome["summary"] and outcome["rows"]:
        cost = outcome["summary"]["final_cost"]
    elif outcome["rows"]:
        cost = min(row["cost"] for row in outcome["rows"])
    else:
        return None
    return cost if math.isfinite(cost) else None


def total_seconds(outcome):
    if outcome["summary"]:
        return outcome["summary"]["total_seconds"]
    return outcome["rows"][-1]["seconds"] if outcome["rows"] else None


def is_comparable(problem, solver):
    """Whether a run starts from the cost that the solvers that set the best cost start from."""
    def start(name):
        return next((outcome["rows"][0]["cost"] for outcome in problem["runs"].get(name, [])
                     if outcome["rows"]), None)
    costs = [start(name) for name in problem["runs"] if sets_best(name)]
    common = next((cost for cost in costs if cost is not None), None)
    mine = start(solver)
    return mine is None or common is None or abs(mine - common) <= 1e-6 * common


def seconds_to(outcome, bound):
    return next((row["seconds"] for row in outcome["rows"] if row["cost"] <= bound), None)


def median(values):
    """Median of what may hold None for "not reached"; None if that is the median."""
    ordered = sorted(values, key=lambda value: math.inf if value is None else value)
    middle = ordered[(len(ordered) - 1) // 2:len(ordered) // 2 + 1]
    return None if not middle or None in middle else statistics.fmean(middle)


# ---- Problems ------------------------------------------------------------------------------------

def problems_of(arguments, data):
    """(name, path or None, command that makes it or None), smallest first within each kind."""
    problems = []
    if arguments.problems in ("real", "all"):
        for name in REAL:
            problems.append((os.path.basename(name), data / (name + ".txt.bz2"), None))
    if arguments.problems in ("generated", "all"):
        for scene, images, per_image in GENERATED:
            observations = images * per_image
            if arguments.largest and observations > arguments.largest:
                continue
            command = ["generate", scene, "--images", str(images), "--points",
                       str(observations // OBSERVATIONS_PER_POINT), "--observations-per-image",
                       str(per_image), "--seed", "1"]
            problems.append((f"{scene}-{images}-{observations // 1000}k", None, command))
    only = arguments.only
    return [p for p in problems if not only or any(word in p[0] for word in only)]


def observations_in(path):
    """From the first line of a BAL file."""
    opener = bz2.open if str(path).endswith(".bz2") else open
    with opener(path, "rt") as file:
        return int(file.readline().split()[2])


# ---- Reports -------------------------------------------------------------------------------------

def best_cost(problem):
    """The lowest that any solver found in fp64, from the common start or, unless that is another
    valley than all of them went into, from the truth."""
    costs = [final_cost(outcome) for solver, outcomes in problem["runs"].items()
             if sets_best(solver) for outcome in outcomes]
    lowest = min((cost for cost in costs if cost is not None), default=None)
    truth = final_cost(problem["from_truth"]) if problem["from_truth"] else None
    if truth is None or lowest is None:
        return lowest if truth is None else truth
    return min(truth, lowest) if lowest <= (1 + TAUS[0]) * truth else lowest


def times_of(problem, solver):
    """Median seconds to each tau."""
    best = best_cost(problem)
    outcomes = problem["runs"].get(solver, [])
    if best is None or not outcomes or not is_comparable(problem, solver):
        return [None] * len(TAUS)
    return [median([seconds_to(outcome, (1 + tau) * best) for outcome in outcomes])
            for tau in TAUS]


def cell(value, form="{:.3g}", missing="--"):
    return missing if value is None else form.format(value)


def spread(problem, solver, tau):
    """(max - min) / median of the repeats, if there are several and all reached tau."""
    best = best_cost(problem)
    seconds = [seconds_to(outcome, (1 + tau) * best) for outcome in problem["runs"][solver]]
    if len(seconds) < 2 or None in seconds:
        return None
    return (max(seconds) - min(seconds)) / statistics.median(seconds)


def ratios(problem, solver, solvers):
    """A solver's time to each tau divided by the fastest peer's. "only": no peer reached it; "not":
    the solver did not; "none": neither; "unrun": the solver was not run."""
    if not problem["runs"].get(solver):
        return ["unrun"] * len(TAUS)
    mine = times_of(problem, solver)
    peers = [times_of(problem, other) for other in solvers if not is_clba(other)]
    result = []
    for i, seconds in enumerate(mine):
        fastest = min((times[i] for times in peers if times[i] is not None), default=None)
        if seconds is not None and fastest is not None:
            result.append(seconds / fastest)
        else:
            result.append("only" if seconds is not None else "not" if fastest is not None
                          else "none")
    return result


def ratio_cell(value):
    words = {"only": "no peer reached it", "not": "**not reached**", "none": "none reached it",
             "unrun": "not run"}
    return words[value] if value in words else f"{value:.2f}"


def problem_table(name, problem, solvers):
    best = best_cost(problem)
    info = problem["info"]
    lines = [f"### {name}", ""]
    if info:
        lines += [f"{info['images']} images, {info['points']} points, {info['observations']} "
                  f"observations; lowest cost found in fp64: {cell(best, '{:.10g}', 'none')}; "
                  f"runs: {max(map(len, problem['runs'].values()), default=0)}.", ""]
    lines += ["| solver | " + " | ".join(f"{tau:g}" for tau in TAUS)
              + " | spread | final cost / best - 1 | total s | iterations | inner iterations "
                "| memory MB | ended by |",
              "|---|" + "---|" * (len(TAUS) + 7)]
    for solver in solvers:
        outcomes = problem["runs"].get(solver)
        if not outcomes:
            lines.append(f"| {solver} |" + " |" * (len(TAUS) + 6) + " not run |")
            continue
        cost = median([final_cost(outcome) for outcome in outcomes])
        spreads = [spread(problem, solver, tau) for tau in TAUS] if best is not None else []
        spreads = [value for value in spreads if value is not None]
        iterations = median([len(outcome["rows"]) - 1 if outcome["rows"] else None
                             for outcome in outcomes])
        inner = median([sum(row["linear_solver_iterations"] for row in outcome["rows"])
                        if outcome["rows"] else None for outcome in outcomes])
        memory = max(outcome["peak_bytes"] for outcome in outcomes) / 1e6
        states = sorted({outcome["state"] for outcome in outcomes})
        if not is_comparable(problem, solver):
            states.append("not compared: another cost at the start")
        lines.append(
            f"| {solver} | " + " | ".join(cell(value) for value in times_of(problem, solver))
            + f" | {cell(max(spreads, default=None), '{:.0%}')}"
            + f" | {cell(cost / best - 1 if cost is not None and best else None, '{:+.1e}')}"
            + f" | {cell(median([total_seconds(outcome) for outcome in outcomes]))}"
            + f" | {cell(iterations, '{:.0f}')} | {cell(inner, '{:.0f}')}"
            + f" | {memory:.0f} | {', '.join(states)} |")
    return lines + [""]


def ratio_table(problems, solver, solvers):
    lines = [f"### {solver} against the fastest peer", "",
             "| problem | " + " | ".join(f"{tau:g}" for tau in TAUS) + " |",
             "|---|" + "---|" * len(TAUS)]
    columns = [[] for _ in TAUS]
    for name, problem in problems.items():
        row = ratios(problem, solver, solvers)
        lines.append(f"| {name} | " + " | ".join(ratio_cell(value) for value in row) + " |")
        for column, value in zip(columns, row):
            column.append(value)
    means = []
    for column in columns:
        numbers = [value for value in column if not isinstance(value, str)]
        text = f"{math.exp(statistics.fmean(map(math.log, numbers))):.2f}" if numbers else "--"
        means.append(f"**{text}** ({len(numbers)} problems; not reached {column.count('not')}, "
                     f"only clba {column.count('only')})")
    lines.append("| geometric mean | " + " | ".join(means) + " |")
    return lines + [""]


def cold_table(cold):
    if not cold:
        return []
    lines = ["## Cold start", "",
             "Seconds of a first solve of one iteration with empty kernel caches, with filled ones, and "
             "so what compiling costs once on a machine. Peers compile nothing when they run.", "",
             "| solver | empty caches | filled caches | compiling |", "|---|---|---|---|"]
    for solver, (empty, filled) in cold.items():
        difference = None if empty is None or filled is None else empty - filled
        lines.append(f"| {solver} | {cell(empty)} | {cell(filled)} | {cell(difference)} |")
    return lines + [""]


def report(raw, solvers, arguments):
    problems = raw["problems"]
    machine = raw["machine"]
    lines = ["# clba and its peers", "",
             "Made by `bench/peers.py`. Seconds until cost <= (1 + tau) best, where best is the lowest cost "
             "that any of the solvers found on that problem in fp64 (on a generated scene also from its "
             f"truth, by `{TRUTH_SOLVER}`, unless all ended more than 10 % above that). The clock starts when the problem's "
             "arrays are in host memory: it includes making the solver's problem, ordering and upload, but "
             "not reading the file, nor compiling kernels, whose cost is listed under Cold start. Medians of the "
             "runs of each problem, solvers interleaved; spread is "
             "(max - min) / median, the largest of the four taus. `--`: not reached. Memory is the largest "
             "resident set from the start of the clock (on a CPU device this holds the device's buffers).",
             "", SETTINGS.format(iterations=arguments.max_iterations, seconds=arguments.seconds,
                                 threads=arguments.threads), "",
             f"{machine['cpu']}, {machine['cores']} cores; {machine['system']}; clba's device: "
             f"{machine.get('device', 'none')}; " + ", ".join(
                 f"{name} {version}" for name, version in sorted(machine["versions"].items()))
             + f"; {machine['date']}.", ""]
    if raw["skipped"]:
        lines += ["Skipped: " + "; ".join(f"{name}: {why}" for name, why in raw["skipped"].items())
                  + ".", ""]
    clba_solvers = [solver for solver in solvers if is_clba(solver)]
    lines += ["## Ratios", "", "Below 1: clba is faster. Means are over the problems where both got "
              "there; the others are counted.", ""]
    for solver in clba_solvers:
        lines += ratio_table(problems, solver, solvers)
    lines += ["![Performance profiles](peers-profile.svg)", "",
              "Share of the problems that a solver brought below (1 + tau) best within a factor x of the "
              "fastest solver's time.", ""]
    lines += cold_table(raw["cold"])
    lines += ["## Problems", ""]
    for name, problem in problems.items():
        lines += problem_table(name, problem, solvers)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def plot(raw, solvers, path):
    try:
        import matplotlib
        matplotlib.use("svg")
        from matplotlib import pyplot
    except ImportError:
        print("peers: no plot, as there is no matplotlib; scripts/install-bench-packages installs it")
        return
    matplotlib.rcParams["svg.hashsalt"] = "clba"
    problems = raw["problems"].values()
    colors = dict(zip(solvers, itertools.cycle(pyplot.get_cmap("tab20").colors)))
    figure, axes = pyplot.subplots(1, len(TAUS), figsize=(4 * len(TAUS), 5), sharey=True)
    for i, (tau, axis) in enumerate(zip(TAUS, axes)):
        times = {solver: [times_of(problem, solver)[i] for problem in problems]
                 for solver in solvers}
        fastest = [min((value for value in column if value is not None), default=None)
                   for column in zip(*times.values())]
        for solver in solvers:
            factors = sorted(value / least for value, least in zip(times[solver], fastest)
                             if value is not None)
            shares = [(k + 1) / len(fastest) for k in range(len(factors))]
            axis.step([1, *factors, 1000], [0, *shares, shares[-1] if shares else 0],
                      where="post", label=solver, color=colors[solver],
                      linestyle="-" if is_clba(solver) else "--")
        axis.set_xscale("log")
        axis.set_xlim(1, 1000)
        axis.set_ylim(0, 1.02)
        axis.set_title(f"tau = {tau:g}")
        axis.set_xlabel("factor of the fastest")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of problems")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncol=4)
    figure.tight_layout(rect=(0, 0.07 * math.ceil(len(solvers) / 4), 1, 1))
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


# ---- Main ----------------------------------------------------------------------------------------

def describe_machine():
    cpu = platform.processor()
    try:
        for line in pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                cpu = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    return {"cpu": cpu, "cores": os.cpu_count(), "system": platform.system(), "versions": {},
            "date": datetime.date.today().isoformat()}


def available_bytes():
    """Of memory; None where there is no /proc."""
    try:
        for line in pathlib.Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    return None


def measure_cold(solver, programs, path, folder, arguments):
    """Seconds of one iteration with empty and with filled kernel caches."""
    command = command_of(solver, programs, path, arguments)
    command[command.index("--max-iterations") + 1] = "0"
    with tempfile.TemporaryDirectory(dir=folder) as cache:
        environment = environment_of(arguments, pathlib.Path(cache))
        outcomes = [run(command, environment, arguments) for _ in range(2)]
    return [outcome["warmed"]["seconds"] if outcome["warmed"] else None for outcome in outcomes]


def save(raw, solvers, arguments):
    """Writes the raw runs and the reports, which show every solver that was ever run on these."""
    solvers = list(dict.fromkeys(
        [*solvers, *(solver for problem in raw["problems"].values() for solver in problem["runs"])]))
    partial = arguments.raw.with_suffix(".partial")
    partial.write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")
    partial.replace(arguments.raw)
    report(raw, solvers, arguments)
    plot(raw, solvers, arguments.output.with_name("peers-profile.svg"))


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=
                                     argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--problems", choices=["real", "generated", "all"], default="all")
    parser.add_argument("--only", nargs="*", help="problems whose name has one of these in it")
    parser.add_argument("--largest", type=int, help="leave out problems of more observations")
    parser.add_argument("--smallest", type=int, help="leave out problems of fewer observations")
    parser.add_argument("--solvers", nargs="*",
                        default=CLBA_SOLVERS + CERES_SOLVERS + PYCOLMAP_SOLVERS)
    parser.add_argument("--pycolmap-python", help="a Python that has pycolmap and pyceres")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60, help="limit of a run")
    parser.add_argument("--load-seconds", type=float, default=300,
                        help="limit for reading, and for compiling kernels, before the clock starts")
    parser.add_argument("--max-iterations", type=int, default=100)
    parser.add_argument("--memory-share", type=float, default=0.8,
                        help="limit of a peer's run, as a share of the memory available at first")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--resume", action="store_true", help="reuse the raw runs there are")
    parser.add_argument("--again", nargs="*", default=[],
                        help="with --resume: drop the runs of solvers whose name begins so")
    parser.add_argument("--raw", type=pathlib.Path, default=pathlib.Path("peers.json"))
    parser.add_argument("-o", "--output", type=pathlib.Path, default=PROJECT / "docs" / "peers.md")
    return parser.parse_args()


def start_raw(arguments):
    """The saved runs, or an empty record of this machine and these settings."""
    settings = {name: getattr(arguments, name) for name in ("seconds", "max_iterations", "threads")}
    fresh = {"machine": describe_machine(), "settings": settings, "cold": {}, "skipped": {},
             "problems": {}}
    if not arguments.resume or not arguments.raw.exists():
        return fresh
    raw = json.loads(arguments.raw.read_text(encoding="utf-8"))
    if raw["settings"] != settings:
        sys.exit(f"peers: {arguments.raw} was made with {raw['settings']}, but now {settings}; give "
                 "the same, or another --raw")
    raw["skipped"] = {}
    def is_again(problem):
        return not arguments.only or any(word in problem for word in arguments.only)

    for runs in [raw["cold"], *(problem["runs"] for name, problem in raw["problems"].items()
                                if is_again(name))]:
        for solver in [name for name in runs if name.startswith(tuple(arguments.again))]:
            del runs[solver]
    return raw


def find_programs(arguments):
    """The commands that run each program, and why there is none for the others."""
    programs, missing = {}, {}
    for name in ("clba", "ceres"):
        path = (arguments.build / "bench" / f"peers_{name}").resolve()
        if path.exists():
            programs[name] = [str(path)]
        else:
            missing[name] = f"{path.name} is not built"
    if arguments.pycolmap_python:
        programs["pycolmap"] = [arguments.pycolmap_python,
                                str(PROJECT / "bench" / "peers_pycolmap.py")]
    else:
        missing["pycolmap"] = "--pycolmap-python is not given"
    return programs, missing


def measure_problem(name, path, problem, solvers, programs, raw, folder, arguments):
    memory = available_bytes()
    environment = environment_of(arguments, folder)
    for repeat in range(arguments.repeat):
        for solver in solvers:
            outcomes = problem["runs"].setdefault(solver, [])
            if len(outcomes) > repeat:
                continue
            if is_clba(solver) and solver not in raw["cold"]:
                raw["cold"][solver] = measure_cold(solver, programs, path, folder, arguments)
            limit = int(memory * arguments.memory_share) if memory and not is_clba(solver) else None
            start = time.monotonic()
            outcome = run(command_of(solver, programs, path, arguments), environment, arguments,
                          limit)
            outcomes.append(outcome)
            if outcome["loaded"]:
                problem["info"] = outcome["loaded"]
                raw["machine"]["versions"][solver.split(":")[0]] = outcome["loaded"]["version"]
            if outcome["warmed"]:
                raw["machine"]["device"] = outcome["warmed"]["device"]
            print(f"{name} {solver}: cost {cell(final_cost(outcome), '{:.9g}')} in "
                  f"{cell(total_seconds(outcome))} s, {outcome['state']} "
                  f"({time.monotonic() - start:.1f} s with reading)", flush=True)


def main():
    arguments = parse()
    programs, missing = find_programs(arguments)
    raw = start_raw(arguments)
    solvers = []
    for solver in arguments.solvers:
        program = solver.split(":")[0]
        if program in programs:
            solvers.append(solver)
        elif program in missing:
            raw["skipped"][solver] = missing[program]
            print(f"peers: {solver} skipped: {missing[program]}")
        else:
            sys.exit(f"peers: there is no program for the solver {solver}")

    data = pathlib.Path(os.environ.get("CLBA_TEST_DATA", PROJECT.parent / "shared" / "data"))
    with tempfile.TemporaryDirectory(prefix="clba-peers-") as folder:
        folder = pathlib.Path(folder)
        for name, path, generate in problems_of(arguments, data):
            problem = raw["problems"].get(name, {"info": None, "runs": {}, "from_truth": None})
            if all(len(problem["runs"].get(solver, [])) >= arguments.repeat for solver in solvers):
                continue
            if generate:
                path, truth = folder / f"{name}.txt", folder / f"{name}-truth.txt"
                subprocess.run([str(arguments.build / "src" / "cli" / "clba"), *generate, "-o",
                                str(path), "--truth", str(truth)], check=True,
                               stdout=subprocess.DEVNULL)
            elif not path.exists():
                raw["skipped"][name] = "its file is not there; set CLBA_TEST_DATA"
                print(f"peers: {name} skipped: there is no {path}")
                continue
            size = observations_in(path)
            if (size <= (arguments.largest or size)) and size >= (arguments.smallest or 0):
                raw["problems"][name] = problem
                if generate and not problem["from_truth"] and "clba" in programs:
                    problem["from_truth"] = run(
                        command_of(TRUTH_SOLVER, programs, truth, arguments),
                        environment_of(arguments, folder), arguments)
                    print(f"{name} from its truth: cost "
                          f"{cell(final_cost(problem['from_truth']), '{:.9g}')}", flush=True)
                measure_problem(name, path, problem, solvers, programs, raw, folder, arguments)
                save(raw, solvers, arguments)
            if generate:
                path.unlink()
                truth.unlink()
        save(raw, solvers, arguments)
    print(f"wrote {arguments.output} and {arguments.raw}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
