#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How time and memory grow with the number of observations: tables, fitted exponents and a plot.

  bench/scale.py SCALE [-o docs/scale.svg] [--json FILE] [--scenes hall,street,landmark]
                 [--sizes 1e5,...,2.9e7] [--repetitions 1] [--clock processor|wall]
                 [--memory-limit 12]
  bench/scale.py --from-json FILE [-o docs/scale.svg]

SCALE is the built program bench/scale; each measurement is a process of its own, so that none sees
what another left in memory. Everything is in mixed with the recomputed Jacobian. Points have 5
observations; the largest landmark has the size of Final-13682: 13682 images, 4.46 million points
and 29 million observations (6.5 a point), and is solved to its end.

Seconds are those of the processor over the device's compute units, which other programs on the
machine change less, or the wall's (medians). Of several repetitions the fastest counts. A solve
that is expected to take more memory than --memory-limit (GiB) is left out.
"""
import argparse
import json
import math
import os
import subprocess
import sys
import tempfile

SIZES = [1e5, 3e5, 1e6, 3e6, 1e7, 2.9e7]
OBSERVATIONS_PER_IMAGE = {"hall": 2800, "street": 200, "landmark": 2120}
FINAL = {"scene": "landmark", "size": 2.9e7, "images": 13682, "points": 4_460_000}
SOLVERS = ["pcg_schur", "auto"]
SOLVER_NAMES = {1: "pcg_schur", 4: "explicit_schur"}
WORKS = ["tiles", "setup", "product", "linearize", "cost"]
DEVICE_LIMIT = 64  # bytes an observation
HOST_LIMIT = 200
EXPONENT_LIMIT = 1.05
GIB = 2.0**30


def run(scale, *arguments):
    command = [scale, *map(str, arguments)]
    result = subprocess.run(command, stdout=subprocess.PIPE, check=False, text=True)
    if result.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed with {result.returncode}")
    return json.loads(result.stdout)


def fastest(runs):
    """The least of each time; all else is the same in every run, or taken from the last."""
    merged = dict(runs[-1])
    for key in merged:
        if key.endswith("_seconds"):
            merged[key] = min(each[key] for each in runs)
    return merged


def measure(scale, scene, size, repetitions, largest_process, folder):
    """One row: largest_process(solver) is a limit on the observations that it may be given."""
    is_final = scene == FINAL["scene"] and size == FINAL["size"]
    images = FINAL["images"] if is_final else max(8, round(size / OBSERVATIONS_PER_IMAGE[scene]))
    points = FINAL["points"] if is_final else 0
    path = os.path.join(folder, "problem")
    row = {"scene": scene, "is_final": is_final}
    row.update(run(scale, "generate", scene, images, int(size), points, path))
    row.update(fastest([run(scale, "time", path) for _ in range(repetitions)]))
    iterations, linear_solver_iterations = (50, 500) if is_final else (3, 60)
    for solver in SOLVERS:
        if row["observations"] > largest_process(solver):
            continue
        # Automatic choice changes its mind only after many iterations of conjugate gradients.
        most = linear_solver_iterations if solver == "pcg_schur" else 500
        row[solver] = run(scale, "solve", path, solver, iterations, most)
    os.remove(path)
    return row


def measure_all(options):
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in options.scenes:
            process_bytes = {solver: 0.0 for solver in SOLVERS}  # an observation, at the last size

            def largest_process(solver):
                return options.memory_limit * GIB / max(process_bytes[solver], 1e-9)

            for size in options.sizes:
                row = measure(options.scale, scene, size, options.repetitions, largest_process,
                              folder)
                rows.append(row)
                for solver in SOLVERS:
                    if solver in row:
                        process_bytes[solver] = (
                            row[solver]["device_bytes"] + row[solver]["host_bytes"]
                        ) / row["observations"]
                print(f"{scene} {row['observations']}: "
                      f"{1e9 * row['product_seconds'] / row['observations']:.2f} ns an observation "
                      "for a product", file=sys.stderr, flush=True)
    return rows


def seconds(row, work, clock):
    if clock == "wall":
        return row[f"{work}_seconds"]
    return row[f"{work}_processor_seconds"] / row["compute_units"]


def fit(rows, clock):
    """Exponent and factor of seconds ~ factor observations^exponent, by least squares on
    logarithms, and the exponent's standard error."""
    x = [math.log(row["observations"]) for row in rows]
    y = [math.log(seconds(row, "product", clock)) for row in rows]
    n = len(x)
    mean_x, mean_y = sum(x) / n, sum(y) / n
    sum_xx = sum((a - mean_x)**2 for a in x)
    exponent = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y)) / sum_xx
    factor = math.exp(mean_y - exponent * mean_x)
    rest = sum((b - mean_y - exponent * (a - mean_x))**2 for a, b in zip(x, y))
    error = math.sqrt(rest / (n - 2) / sum_xx) if n > 2 else float("nan")
    return exponent, factor, error


def of_scene(rows, scene):
    return [row for row in rows if row["scene"] == scene]


def scenes_of(rows):
    return list(dict.fromkeys(row["scene"] for row in rows))


def bytes_of(row, solver, what):
    if solver not in row:
        return "-"
    value = row[solver][f"{what}_bytes"] / row["observations"]
    used = row[solver]["linear_solver"]
    mark = "" if used == 1 else f" ({SOLVER_NAMES.get(used, used)})"
    return f"{value:.1f}{mark if what == 'device' else ''}"


def time_table(rows, clock):
    lines = [
        "| scene | images | observations | observations a run | slots an observation | tiles | "
        "set-up | S p | linearisation | cost | generation |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        n = row["observations"]
        cells = [row["scene"], row["images"], n]
        cells += [f"{n / row['runs']:.1f}", f"{row['slots'] / n:.2f}"]
        cells += [f"{1e9 * seconds(row, work, clock) / n:.2f}" for work in WORKS]
        cells.append(f"{1e9 * row['generate_processor_seconds'] / n:.0f}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def memory_table(rows):
    lines = [
        "| scene | observations | device, pcg_schur | device, auto | host, pcg_schur | "
        "host, auto | generation |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row["scene"], row["observations"]]
        cells += [bytes_of(row, solver, "device") for solver in SOLVERS]
        cells += [bytes_of(row, solver, "host") for solver in SOLVERS]
        cells.append(f"{row['generate_peak_bytes'] / row['observations']:.0f}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def solve_lines(rows):
    for row in rows:
        if not row["is_final"]:
            continue
        for solver in SOLVERS:
            if solver not in row:
                continue
            of = row[solver]
            yield (f"- the size of Final-13682, {solver}: cost {of['initial_cost']:.6g} to "
                   f"{of['reference_final_cost']:.6g} in {of['iterations']} iterations "
                   f"({of['linear_solver_iterations']} of the linear solver), "
                   f"{of['solve_seconds']:.0f} s; {of['device_bytes'] / GIB:.2f} GiB on the "
                   f"device, {of['host_bytes'] / GIB:.2f} GiB beside; {of['termination']}")


def exponent_lines(rows, clock):
    for scene in scenes_of(rows):
        of = of_scene(rows, scene)
        if len(of) < 2:
            continue
        exponent, _, error = fit(of, clock)
        verdict = "at most" if exponent <= EXPONENT_LIMIT else "above"
        yield (f"- {scene}: seconds a product grow with observations^{exponent:.3f} "
               f"(standard error {error:.3f}), {verdict} {EXPONENT_LIMIT}")


def draw(rows, clock, path):
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "clba"  # equal figures are equal files
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    markers = {"hall": "o", "street": "s", "landmark": "^"}
    for index, scene in enumerate(scenes_of(rows)):
        of = of_scene(rows, scene)
        n = [row["observations"] for row in of]
        color = f"C{index}"
        label = scene
        if len(of) > 1:
            exponent, factor, error = fit(of, clock)
            label = f"{scene}: exponent {exponent:.3f} ± {error:.3f}"
            left.plot(n, [factor * each**exponent for each in n], color=color, linewidth=1)
        left.plot(n, [seconds(row, "product", clock) for row in of], markers[scene], color=color,
                  label=label)
        for solver, fill, style in (("pcg_schur", "full", "-"), ("auto", "none", ":")):
            solved = [row for row in of if solver in row]
            right.plot([row["observations"] for row in solved],
                       [row[solver]["device_bytes"] / row["observations"] for row in solved],
                       markers[scene] + style, color=color, fillstyle=fill, linewidth=1,
                       label=f"{scene}, {solver}")
    right.axhline(DEVICE_LIMIT, color="0.5", linewidth=1, linestyle="--")
    of_clock = "processor seconds over compute units" if clock == "processor" else "seconds"
    left.set(xscale="log", yscale="log", xlabel="observations", ylabel=of_clock,
             title="One product S p (mixed, recomputed Jacobian)")
    right.set(xscale="log", yscale="log", xlabel="observations",
              ylabel="peak device bytes an observation", title="Device memory of a solve")
    ticks = [32, 48, 64, 96, 128, 192, 256, 384]
    right.set_yticks(ticks, [str(tick) for tick in ticks])
    right.minorticks_off()
    left.legend(fontsize="small")
    right.legend(fontsize="small")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


def numbers(text):
    return [float(each) for each in text.split(",")]


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scale", nargs="?", metavar="SCALE")
    parser.add_argument("-o", "--output", metavar="SVG")
    parser.add_argument("--json", metavar="FILE", help="the rows are written here, too")
    parser.add_argument("--from-json", metavar="FILE", help="measured before: nothing is run")
    parser.add_argument("--scenes", type=lambda text: text.split(","),
                        default=list(OBSERVATIONS_PER_IMAGE))
    parser.add_argument("--sizes", type=numbers, default=SIZES)
    parser.add_argument("--repetitions", type=int, default=1)
    parser.add_argument("--clock", choices=["processor", "wall"], default="processor")
    parser.add_argument("--memory-limit", type=float, default=12)
    options = parser.parse_args()
    if bool(options.scale) == bool(options.from_json):
        parser.error("give SCALE or --from-json FILE")
    if options.from_json:
        with open(options.from_json, encoding="utf-8") as file:
            rows = json.load(file)
    else:
        rows = measure_all(options)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)
            file.write("\n")
    print(f"Device: {rows[0]['device']}, {rows[0]['compute_units']} compute units.\n")
    print(f"Nanoseconds an observation ({options.clock} time; generation on one core):\n")
    print("\n".join(time_table(rows, options.clock)) + "\n")
    print("\n".join(exponent_lines(rows, options.clock)) + "\n")
    print(f"Peak bytes an observation (limits: {DEVICE_LIMIT} on the device, {HOST_LIMIT} on the "
          "host beside it):\n")
    print("\n".join(memory_table(rows)))
    print("\n".join(["", *solve_lines(rows)]))
    if options.output:
        draw(rows, options.clock, options.output)


if __name__ == "__main__":
    main()
