#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Solves one BAL problem by pycolmap's bundle adjustment and prints lines of JSON as peers_ceres does.

  bench/peers_pycolmap.py FILE --linear-solver dense_schur|sparse_schur|iterative_schur ...

COLMAP's RADIAL camera looks along +z, so camera frames are turned by diag(1, -1, -1) and the y of
observations changes sign: the residuals are those of BAL but for that sign, and but for points behind
their camera, whose residuals COLMAP takes to be 0. Needs pycolmap and pyceres from PyPI.
"""
import argparse
import bz2
import json
import math
import pathlib
import sys
import tempfile
import time

import pyceres
import pycolmap


def quaternion(rotation_vector):
    angle = math.sqrt(sum(x * x for x in rotation_vector))
    if angle == 0:
        return 1.0, 0.0, 0.0, 0.0
    s = math.sin(angle / 2) / angle
    return (math.cos(angle / 2), *(s * x for x in rotation_vector))


def write_model(path, folder):
    """The problem as COLMAP's text files; returns its numbers of images, points and observations."""
    opener = bz2.open if path.endswith(".bz2") else open
    with opener(path, "rt") as file:
        num_images, num_points, num_observations = map(int, file.readline().split())
        keypoints = [[] for _ in range(num_images)]
        tracks = [[] for _ in range(num_points)]
        for _ in range(num_observations):
            image, point, x, y = file.readline().split()
            image, point = int(image), int(point)
            tracks[point].append(f"{image + 1} {len(keypoints[image])}")
            keypoints[image].append(f"{x} {-float(y)!r} {point + 1}")
        numbers = file.read().split()
    with (open(folder / "cameras.txt", "w") as cameras, open(folder / "images.txt", "w") as images):
        for i in range(num_images):
            row = [float(x) for x in numbers[9 * i:9 * i + 9]]
            w, x, y, z = quaternion(row[:3])
            pose = (-x, w, -z, y, row[3], -row[4], -row[5])  # diag(1, -1, -1) is (0, 1, 0, 0)
            cameras.write(f"{i + 1} RADIAL 1 1 {row[6]!r} 0 0 {row[7]!r} {row[8]!r}\n")
            images.write(f"{i + 1} {' '.join(map(repr, pose))} {i + 1} {i + 1}.jpg\n"
                         f"{' '.join(keypoints[i])}\n")
    with open(folder / "points3D.txt", "w") as points:
        for i in range(num_points):
            start = 9 * num_images + 3 * i
            points.write(f"{i + 1} {' '.join(numbers[start:start + 3])} 0 0 0 0 "
                         f"{' '.join(tracks[i])}\n")
    return num_images, num_points, num_observations


def peak_bytes():
    for line in pathlib.Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    return 0


def say(event, **fields):
    print(json.dumps({"event": event, **fields}), flush=True)


class PrintRow(pyceres.IterationCallback):
    def __init__(self, start):
        pyceres.IterationCallback.__init__(self)
        self.start = start
        self.cost = None

    def __call__(self, row):
        if row.step_is_successful or row.iteration == 0:
            self.cost = row.cost
        say("row", iteration=row.iteration, seconds=time.monotonic() - self.start, cost=self.cost,
            accepted=int(row.step_is_successful),
            linear_solver_iterations=row.linear_solver_iterations,
            linear_solver_seconds=row.step_solver_time_in_seconds,
            trust_region_radius=row.trust_region_radius)
        return pyceres.CallbackReturnType.SOLVER_CONTINUE


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--linear-solver", default="sparse_schur")
    parser.add_argument("--preconditioner")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--max-iterations", type=int, default=100)
    parser.add_argument("--max-seconds", type=float, default=1e9)
    arguments = parser.parse_args()

    read_start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        num_images, num_points, num_observations = write_model(arguments.file, folder)
        reconstruction = pycolmap.Reconstruction()
        reconstruction.read_text(folder)
    pathlib.Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    say("loaded", read_seconds=time.monotonic() - read_start, images=num_images, points=num_points,
        observations=num_observations, start_bytes=peak_bytes(),
        version=f"{pycolmap.__version__} with Ceres {pyceres.__ceres_version__}")

    start = time.monotonic()
    config = pycolmap.BundleAdjustmentConfig()
    for image in reconstruction.images:
        config.add_image(image)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(
        pycolmap.BundleAdjustmentOptions(), config, reconstruction)
    # Not adjuster.solve(), which takes no callback.
    options = pyceres.SolverOptions()
    options.linear_solver_type = getattr(pyceres.LinearSolverType,
                                         arguments.linear_solver.upper())
    if arguments.preconditioner:
        options.preconditioner_type = getattr(pyceres.PreconditionerType,
                                              arguments.preconditioner.upper())
    options.dense_linear_algebra_library_type = pyceres.DenseLinearAlgebraLibraryType.LAPACK
    options.num_threads = arguments.threads
    options.max_num_iterations = arguments.max_iterations
    options.max_linear_solver_iterations = 500
    options.function_tolerance = 1e-9
    options.gradient_tolerance = 1e-10
    options.parameter_tolerance = 1e-10
    options.logging_type = pyceres.LoggingType.SILENT
    create_seconds = time.monotonic() - start
    options.max_solver_time_in_seconds = max(0.0, arguments.max_seconds - create_seconds)
    print_row = PrintRow(start)
    options.callbacks = [print_row]
    summary = pyceres.SolverSummary()
    pyceres.solve(options, adjuster.problem, summary)
    say("summary", initial_cost=summary.initial_cost, final_cost=summary.final_cost,
        total_seconds=time.monotonic() - start, create_seconds=create_seconds,
        termination=summary.termination_type.name,
        preconditioner_used=summary.preconditioner_type_used.name, peak_bytes=peak_bytes())
    return 0


if __name__ == "__main__":
    sys.exit(main())
