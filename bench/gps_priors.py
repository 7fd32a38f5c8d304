#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What priors of camera positions (GPS) do for real problems with independently known camera centres.

  bench/gps_priors.py [--seeds 10]

The priors are the true centres with Gaussian noise. Each problem is moved to their frame by the similarity
that fits its start's centres to the noisy ones, and solved with and without priors; observations count
with the standard deviation that the solution without priors leaves. Errors are root mean square distances
from the true centres: with priors as they are, without priors after the similarity that fits the solution
to the priors, and to the truth. The problems are looked for in the folder CLBA_TEST_DATA (default:
../shared/data beside the project). Prints a table; exits with 1 where the mean error with priors is not
below both the priors' noise and the error without, fitted to the priors.
"""
import argparse
import os
import pathlib
import statistics
import sys

import clba
import numpy as np

PROJECT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT / "bench" / "paper_study"))
from errors import similarity_parameters  # noqa: E402

# Standard deviation of a coordinate of the priors, metres.
PROBLEMS = [
    ("kitti-2011_09_30_drive_0027-stereo-deadreckoned", 1.0),
    ("malaga-170-gtpose-clean", 0.5),
    ("strecha-Herz-Jesus-P25", 0.02),
    ("strecha-Herz-Jesus-P25", 0.005),
    ("strecha-fountain-P11", 0.02),
    ("strecha-fountain-P11", 0.005),
]


def rms(difference):
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def fitted(centers, to):
    scale, rotation, shift = similarity_parameters(centers, to)
    return scale * centers @ rotation.T + shift


def measure(path, truth, sigma, seed, unaided, pixel_sigma):
    priors = truth + sigma * np.random.default_rng(seed).standard_normal(truth.shape)
    with clba.Problem.from_bal(path) as problem:
        problem.fix_gauge(gauge="inner", centers=priors)
        problem.set_sigmas(np.full(problem.num_observations, pixel_sigma))
        problem.set_position_priors(np.arange(len(truth)), priors, sigmas=sigma)
        clba.solve(problem, max_num_iterations=100)
        aided = problem.centers
    return {"priors": rms(priors - truth), "aided": rms(aided - truth),
            "unaided, fitted to priors": rms(fitted(unaided, priors) - truth),
            "unaided, fitted to truth": rms(fitted(unaided, truth) - truth)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    arguments = parser.parse_args()
    data = pathlib.Path(os.environ.get("CLBA_TEST_DATA", PROJECT.parent / "shared" / "data"))
    if not (data / "truth").is_dir():
        print(f"gps_priors: skipped, there is no folder {data / 'truth'}; set CLBA_TEST_DATA")
        return 77
    print(f"RMS errors of camera centres in metres, mean and standard deviation of "
          f"{arguments.seeds} seeds:\n")
    print("| problem | priors | with priors | without, fitted to the priors | without, fitted to the "
          "truth |\n|---|---|---|---|---|")
    is_met = True
    for name, sigma in PROBLEMS:
        path = data / "real" / f"{name}.txt.bz2"
        truth = np.loadtxt(data / "truth" / f"{name}.centres")
        with clba.Problem.from_bal(path) as problem:
            summary = clba.solve(problem, max_num_iterations=100)
            unaided = problem.centers
            pixel_sigma = (summary.final_cost / problem.num_observations) ** 0.5
        rows = [measure(path, truth, sigma, seed, unaided, pixel_sigma)
                for seed in range(arguments.seeds)]
        means = {key: statistics.mean(row[key] for row in rows) for key in rows[0]}
        spread = {key: statistics.stdev(row[key] for row in rows) if len(rows) > 1 else 0
                  for key in rows[0]}
        is_met = is_met and means["aided"] < min(means["priors"],
                                                 means["unaided, fitted to priors"])
        print(f"| {name} | " + " | ".join(
            f"{means[key]:.4g} ± {spread[key]:.2g}" for key in means) + " |", flush=True)
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main())
