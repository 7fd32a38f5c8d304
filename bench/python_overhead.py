#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What Python costs on top of a solve: arrays in, the call with a callback and a bar, arrays out.

  bench/python_overhead.py [--images N] [--repeats N]

2500 images have about a million observations. Everything but clba_problem_solve's own time without the
building of kernels counts as Python's, also the copies that the library makes of its input. Needs the
Python package.
"""
import argparse
import statistics
import time

import clba

NAMES = ("camera_params", "camera_indices", "poses", "points", "image_indices", "point_indices",
         "pixels")


def measure(arrays):
    """Seconds of the library's solve, and of each part of Python's."""
    start = time.perf_counter()
    problem = clba.Problem.from_arrays(camera_models="snavely", **arrays)
    made = time.perf_counter()
    summary = clba.solve(problem, callback=lambda iteration: None)
    solved = time.perf_counter()
    for name in ("poses", "points", "camera_params"):
        getattr(problem, name)
    end = time.perf_counter()
    library = summary.total_seconds
    parts = {"from_arrays": made - start, "solve": solved - made - library, "getters": end - solved}
    return library - summary.build_seconds, parts, summary


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=2500)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    start, _ = clba.Problem.generate("hall", num_images=arguments.images)
    print(start)
    arrays = {name: getattr(start, name) for name in NAMES}
    start.close()
    measure(arrays)  # builds the kernels
    shares = []
    for _ in range(arguments.repeats):
        library, parts, summary = measure(arrays)
        shares.append(sum(parts.values()) / library)
        listed = ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in parts.items())
        print(f"library {library:.3f} s in {summary.num_iterations} iterations; {listed}; "
              f"{100 * shares[-1]:.2f} %")
    print(f"overhead of Python: {100 * statistics.median(shares):.2f} % of the solve (median)")


if __name__ == "__main__":
    main()
