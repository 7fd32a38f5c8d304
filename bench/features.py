#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What everything in use costs a PCG iteration: four camera models, cameras that images share, a Huber loss
and GPS priors, beside the plain BAL problem of the same images, points and observations.

  bench/features.py [--images 356] [--observations 200000] [--repetitions 7]

Prints nanoseconds an observation and PCG iteration of the linear solver (pcg_schur, 3 steps of 50 iterations
each), medians and spreads of alternating runs, and their ratio to the plain problem, feature by
feature; exits with 1 where all together take more than 1.5 times as long.
"""
import argparse
import statistics
import sys

import clba
import numpy as np

LIMIT = 1.5
STEPS, ITERATIONS = 3, 50
MODELS = {
    "simple_radial": [800.0, 0, 0, -0.05],
    "radial": [800.0, 0, 0, -0.05, 0.01],
    "opencv": [800.0, 810, 0, 0, -0.05, 0.01, 1e-3, -1e-3],
    "opencv_fisheye": [800.0, 810, 0, 0, -0.01, 0.002, 0, 0],
}


def flipped(quaternions):
    w, x, y, z = quaternions.T
    return np.stack([-x, w, -z, y], axis=1)  # half a turn about x, then the pose: snavely looks along -z


def colmap_like(start, truth, models, is_shared):
    """The scene with cameras that look along +z: camera k of the models for every len(models)-th image,
    shared or one an image."""
    count = start.num_images
    kinds = np.arange(count) % len(models)
    names = list(models)
    camera_models = names if is_shared else [names[kind] for kind in kinds]
    params = list(models.values()) if is_shared else [models[names[kind]] for kind in kinds]
    cameras = kinds if is_shared else np.arange(count)

    def of(problem, pixels):
        poses = problem.poses
        poses[:, :4] = flipped(poses[:, :4])
        poses[:, 5:] *= -1
        return clba.Problem.from_arrays(
            camera_models=camera_models, camera_params=params, poses=poses, points=problem.points,
            camera_indices=cameras.astype(np.int32), image_indices=problem.image_indices,
            point_indices=problem.point_indices, pixels=pixels)

    with of(truth, np.zeros((truth.num_observations, 2))) as at_truth:
        pixels = at_truth.evaluate(gradient=False, jacobian=False).residuals.reshape(-1, 2)
    noise = np.random.default_rng(0).standard_normal(pixels.shape)
    return of(start, pixels + 0.5 * noise)


def with_priors(problem, truth):
    problem.set_position_priors(np.arange(truth.num_images), truth.centers, sigmas=0.05)
    return problem


def with_loss(problem):
    problem.set_loss("huber", 2.0)
    return problem


def nanoseconds(problem):
    """Of the linear solver, an observation and PCG iteration. The state is put back."""
    poses, points, params = problem.poses, problem.points, problem.camera_params
    summary = clba.solve(
        problem, linear_solver="pcg_schur", max_num_iterations=STEPS, function_tolerance=0.0,
        min_linear_solver_iterations=ITERATIONS, max_linear_solver_iterations=ITERATIONS)
    problem.poses, problem.points, problem.camera_params = poses, points, params
    if summary.num_linear_solver_iterations != STEPS * ITERATIONS:
        raise SystemExit(f"features: {summary.num_linear_solver_iterations} PCG iterations")
    return 1e9 * summary.linear_solver_seconds / summary.num_linear_solver_iterations / (
        problem.num_observations)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=356)
    parser.add_argument("--observations", type=int, default=200000)
    parser.add_argument("--repetitions", type=int, default=7)
    arguments = parser.parse_args()
    start, truth = clba.Problem.generate(
        "hall", num_images=arguments.images, seed=1,
        observations_per_image=arguments.observations // arguments.images)
    one = {"radial": MODELS["radial"]}
    problems = {
        "plain BAL": start,
        "Huber loss": with_loss(clba.Problem.generate(
            "hall", num_images=arguments.images, seed=1,
            observations_per_image=arguments.observations // arguments.images)[0]),
        "GPS priors": with_priors(clba.Problem.generate(
            "hall", num_images=arguments.images, seed=1,
            observations_per_image=arguments.observations // arguments.images)[0], truth),
        "one radial camera, shared": colmap_like(start, truth, one, True),
        "four models, one an image": colmap_like(start, truth, MODELS, False),
        "four cameras of four models, shared": colmap_like(start, truth, MODELS, True),
        "all of these": with_priors(with_loss(colmap_like(start, truth, MODELS, True)), truth),
    }
    runs = {name: [] for name in problems}
    for repetition in range(arguments.repetitions + 1):
        for name, problem in problems.items():
            taken = nanoseconds(problem)
            if repetition > 0:  # the first compiles kernels
                runs[name].append(taken)
    plain = statistics.median(runs["plain BAL"])
    print(f"{start.num_images} images, {start.num_observations} observations\n")
    print("| problem | ns an observation and iteration | spread | ratio |\n|---|---|---|---|")
    for name, taken in runs.items():
        print(f"| {name} | {statistics.median(taken):.2f} | {min(taken):.2f} to {max(taken):.2f} "
              f"| {statistics.median(taken) / plain:.2f} |")
    return 0 if statistics.median(runs["all of these"]) <= LIMIT * plain else 1


if __name__ == "__main__":
    sys.exit(main())
