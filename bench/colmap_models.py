#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment of COLMAP models by pycolmap and by clba, with the same options: costs and seconds.

  bench/colmap_models.py [MODEL ...] [--repetitions 3] [--threads N]

MODEL is a folder of a sparse model, binary or text; by default those below colmap/ in the folder
CLBA_TEST_DATA (default: ../shared/data beside the project). Needs pycolmap from PyPI and the package of
bindings/python. All start from the same state and end by a change of the cost below 1e-9 of it, or after
100 iterations; costs are evaluated by clba. Seconds are medians, from the reconstruction in memory to the
solved one, without compiling kernels. pycolmap's steps are exact for models of these sizes, and in fp64, as
those of explicit_schur in precision double are; auto in mixed is clba's default. Prints a table; exits with 1 where the cost of explicit_schur is
higher than pycolmap's by more than 1e-6.
"""
import argparse
import copy
import os
import pathlib
import statistics
import sys
import time

import clba
import pycolmap

PROJECT = pathlib.Path(__file__).resolve().parent.parent
TOLERANCE = 1e-6  # relative, of costs
FUNCTION_TOLERANCE = 1e-9
MAX_ITERATIONS = 100
CAUCHY_SCALE = 1.0  # pixels
SOLVERS = ("pycolmap", "explicit_schur", "auto")
PRECISIONS = {"explicit_schur": "double", "auto": "auto"}
# What is held constant, and the loss.
CASES = {
    "as it is": {},
    "intrinsics constant": {"constant_intrinsics": True},
    "principal point, too": {"refine_principal_point": True},
    "every other pose constant": {"constant_poses": True},
    "Cauchy loss": {"loss": True},
}


def constant_images(reconstruction):
    return sorted(reconstruction.reg_image_ids())[::2]


def solve_by_pycolmap(reconstruction, case, threads):
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = "refine_principal_point" in case
    if "constant_intrinsics" in case:
        options.refine_focal_length = options.refine_extra_params = False
    if "loss" in case:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = CAUCHY_SCALE
    solver = options.ceres.solver_options
    solver.function_tolerance = FUNCTION_TOLERANCE
    solver.max_num_iterations = MAX_ITERATIONS
    solver.num_threads = threads
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    if "constant_poses" in case:
        for image_id in constant_images(reconstruction):
            config.set_constant_rig_from_world_pose(reconstruction.image(image_id).frame_id)
    start = time.perf_counter()
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    return time.perf_counter() - start


def problem_of(reconstruction, case):
    refine = "constant_intrinsics" not in case
    problem = clba.Problem.from_pycolmap(
        reconstruction, refine_focal_length=refine, refine_extra_params=refine,
        refine_principal_point="refine_principal_point" in case)
    if "loss" in case:
        problem.set_loss("cauchy", CAUCHY_SCALE)
    if "constant_poses" in case:
        rows = sorted(reconstruction.reg_image_ids())
        constant = set(constant_images(reconstruction))
        problem.set_constant_images([image_id in constant for image_id in rows])
    return problem


def solve_by_clba(reconstruction, case, linear_solver):
    start = time.perf_counter()
    problem = problem_of(reconstruction, case)
    summary = clba.solve(problem, linear_solver=linear_solver, precision=PRECISIONS[linear_solver],
                         max_num_iterations=MAX_ITERATIONS, function_tolerance=FUNCTION_TOLERANCE)
    problem.update_pycolmap(reconstruction)
    return time.perf_counter() - start - summary.build_seconds


def cost_of(reconstruction, case):
    with problem_of(reconstruction, case) as problem:
        return problem.evaluate(gradient=False, jacobian=False).cost


def compare(reconstruction, case, repetitions, threads):
    seconds = {name: [] for name in SOLVERS}
    costs = {}
    for _ in range(repetitions):
        for name in seconds:
            solved = copy.deepcopy(reconstruction)
            seconds[name].append(solve_by_pycolmap(solved, case, threads) if name == "pycolmap"
                                 else solve_by_clba(solved, case, name))
            costs[name] = cost_of(solved, case)
    return costs, {name: statistics.median(values) for name, values in seconds.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", type=pathlib.Path)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    models = arguments.models
    if not models:
        data = pathlib.Path(os.environ.get("CLBA_TEST_DATA", PROJECT.parent / "shared" / "data"))
        if not (data / "colmap").is_dir():
            print(f"colmap_models: skipped, there is no folder {data / 'colmap'}; set CLBA_TEST_DATA")
            return 77
        models = sorted((data / "colmap").iterdir())
    print("| model | images / points / observations | case | cost at the start | pycolmap | "
          "explicit_schur over it | auto over it | pycolmap s | explicit_schur s | auto s |\n|"
          + "---|" * 10)
    is_met = True
    for path in models:
        reconstruction = pycolmap.Reconstruction(path)
        sizes = (f"{reconstruction.num_reg_images()} / {reconstruction.num_points3D()} / "
                 f"{reconstruction.compute_num_observations()}")
        for name, case in CASES.items():
            start = cost_of(reconstruction, case)
            costs, seconds = compare(reconstruction, case, arguments.repetitions,
                                     arguments.threads)
            excess = {solver: costs[solver] / costs["pycolmap"] - 1 for solver in SOLVERS[1:]}
            is_met = is_met and excess["explicit_schur"] <= TOLERANCE
            print(f"| {path.name} | {sizes} | {name} | {start:.8g} | {costs['pycolmap']:.9g} | "
                  + " | ".join(f"{excess[solver]:+.1e}" for solver in excess) + " | "
                  + " | ".join(f"{seconds[solver]:.3f}" for solver in SOLVERS) + " |", flush=True)
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main())
