# SPDX-License-Identifier: Apache-2.0
"""Tables 1 and 3: where the time goes, and how it grows with the number of images."""
import pathlib
import statistics
import tempfile

import numpy as np

import scenes

SEED = 1


def steps(programs, sizes, observations_per_image):
    """Table 1: time of each step over 60 iterations, in one thread."""
    rows = []
    for num_images in sizes:
        spec = (num_images, observations_per_image, SEED)
        for method in ("paper_marquardt", "default"):
            print(f"steps: {num_images} images, {method}", flush=True)
            rows.append({"images": num_images, "method": method,
                         **programs.clba(spec, method, 1, endless=True)})
    return rows


def growth(programs, sizes, observations_per_image, repetitions, threads):
    """Table 3 and Fig. 4. Slow programs run once at each size, the others several times."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path, output = pathlib.Path(folder, "start.txt"), pathlib.Path(folder, "solved.txt")
        for num_images in sizes:
            spec = (num_images, observations_per_image, SEED)
            scene = scenes.make(spec)
            scene.start.to_bal(path)
            runs = {
                "normal": lambda: programs.baseline(path, output, "normal"),
                "schur": lambda: programs.baseline(path, output, "schur"),
                "paper, one thread": lambda: programs.clba(spec, "paper_marquardt", 1),
                "paper, all threads":
                    lambda: programs.clba(spec, "paper_marquardt", threads),
                "clba": lambda: programs.clba(spec, "default", threads, 5),
            }
            if programs.has_ceres():
                for solver in ("sparse_schur", "iterative_schur"):
                    runs[f"Ceres {solver}"] = (
                        lambda solver=solver: programs.solve_by_ceres(path, solver, threads))
            for name, run in runs.items():
                print(f"growth: {num_images} images, {name}", flush=True)
                answers = [run() for _ in range(1 if name.startswith("paper") else repetitions)]
                rows.append({"images": num_images, "name": name,
                             "observations": scene.start.num_observations,
                             "runs": [each for answer in answers for each in answer["runs"]],
                             "num_iterations": answers[-1]["num_iterations"],
                             "final_cost": answers[-1]["final_cost"]})
    return rows


def median_seconds(row):
    return statistics.median(run["seconds"] for run in row["runs"])


def spread_seconds(row):
    seconds = [run["seconds"] for run in row["runs"]]
    return min(seconds), max(seconds)


def seconds_to(row, cost):
    """Median seconds until the cost was at most this, or None."""
    seconds = [next((at for at, reached in run["rows"] if reached <= cost), None)
               for run in row["runs"]]
    return None if None in seconds else statistics.median(seconds)


def exponent(rows, smallest):
    """Of seconds = factor * images^exponent, fitted to the sizes from smallest on, and its standard
    error."""
    rows = [row for row in rows if row["images"] >= smallest]
    x = np.log([row["images"] for row in rows])
    y = np.log([median_seconds(row) for row in rows])
    (slope, intercept), residual, *_ = np.polyfit(x, y, 1, full=True)
    error = 0.0
    if len(rows) > 2:
        total = float(residual[0]) if len(residual) else 0.0
        error = float(np.sqrt(total / (len(rows) - 2) / ((x - x.mean()) ** 2).sum()))
    return float(slope), float(np.exp(intercept)), error
