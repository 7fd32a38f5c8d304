# SPDX-License-Identifier: Apache-2.0
"""Table 2: errors of camera positions, over seeds."""
import pathlib
import tempfile

import clba

import methods
import scenes
from errors import position_errors


def solved(scene, name, method, max_num_iterations=methods.MAX_ITERATIONS, **options):
    problem, summary = methods.solve(method, scene, max_num_iterations=max_num_iterations,
                                     **options)
    return {"method": name, "num_iterations": summary.num_iterations,
            "num_rejected_steps": summary.num_rejected_steps,
            "final_cost": summary.reference_final_cost,
            **position_errors(problem.centers, scene.centers)}


def start_and_baseline(programs, scene):
    yield {"method": "start", **position_errors(scene.start.centers, scene.centers)}
    with tempfile.TemporaryDirectory() as folder:
        path, output = pathlib.Path(folder, "start.txt"), pathlib.Path(folder, "solved.txt")
        scene.start.to_bal(path)
        answer = programs.baseline(path, output, "schur", methods.MAX_ITERATIONS)
        centers = clba.Problem.from_bal(output).centers
    yield {"method": "baseline", "num_iterations": answer["num_iterations"],
           "num_rejected_steps": answer["num_rejected_steps"], "final_cost": answer["final_cost"],
           **position_errors(centers, scene.centers)}


def premise(programs, sizes, observations_per_image, seeds):
    """Every method on halls as the paper assumes them."""
    rows = []
    for num_images in sizes:
        for seed in seeds:
            print(f"accuracy: {num_images} images, seed {seed}", flush=True)
            scene = scenes.hall(num_images, observations_per_image, seed)
            of = list(start_and_baseline(programs, scene))
            of += [solved(scene, name, method) for name, method in methods.ALL.items()]
            rows += [{"images": num_images, "seed": seed, **row} for row in of]
    return rows


def far_start(num_images, observations_per_image, seeds, disturbance):
    """The paper's algorithm from a start so bad that steps are rejected: ended there, as the paper has
    it, and carried on."""
    rows = []
    for seed in seeds:
        print(f"far start: seed {seed}", flush=True)
        scene = scenes.hall(num_images, observations_per_image, seed, disturbance)
        of = [{"method": "start", **position_errors(scene.start.centers, scene.centers)}]
        for name, method in methods.PAPERS.items():
            of.append(solved(scene, name, method))
            # The path up to the first rejection is the same.
            if of[-1]["num_rejected_steps"] > 0:
                of[-1]["rmse_as_printed"] = solved(scene, name, method,
                                                   stops_at_rejection=True)["rmse"]
            else:
                of[-1]["rmse_as_printed"] = of[-1]["rmse"]
        of.append(solved(scene, "default", methods.ALL["default"]))
        rows += [{"seed": seed, **row} for row in of]
    return rows


def by_iteration(num_images, observations_per_image, seeds, names, most):
    """Errors of the paper's algorithm ended after 0 to `most` iterations."""
    rows = []
    for seed in seeds:
        print(f"by iteration: seed {seed}", flush=True)
        scene = scenes.hall(num_images, observations_per_image, seed)
        for name in names:
            for iterations in range(most + 1):
                row = solved(scene, name, methods.ALL[name], iterations)
                rows.append({"seed": seed, "iterations": iterations, **row})
    return rows


def real(programs):
    """The same on real problems with independent camera positions."""
    rows = []
    for name in scenes.REAL:
        print(f"accuracy: {name}", flush=True)
        scene = scenes.real(name)
        of = list(start_and_baseline(programs, scene))
        of += [solved(scene, method_name, method) for method_name, method in methods.ALL.items()
               if not method.needs_truth]
        rows += [{"problem": name, "images": scene.start.num_images, **row} for row in of]
    return rows
