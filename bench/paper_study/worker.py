# SPDX-License-Identifier: Apache-2.0
"""One timed measurement in a process of its own, so that it has the threads that its environment says.

  worker.py SPEC METHOD [--repetitions 1] [--endless]

SPEC is a hall's [images, observations an image, seed] as JSON, METHOD a name in methods.py. Prints the
last run's summary as JSON, with the seconds of each repetition; kernels are compiled before.
"""
import argparse
import json

import methods
import scenes

# Kernels take their sizes as arguments: a small scene compiles those that a large one needs.
WARM_UP = (24, 100, 0)
NEVER = {"function_tolerance": 0.0, "gradient_tolerance": 0.0, "parameter_tolerance": 0.0,
         "min_trust_region_radius": 1e-300, "max_num_consecutive_invalid_steps": 1000}
STEPS = ("residual", "jacobian", "preconditioner", "jx", "jty", "schur", "vector")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("spec", type=json.loads)
    parser.add_argument("method", choices=methods.ALL)
    parser.add_argument("--repetitions", type=int, default=1)
    parser.add_argument("--endless", action="store_true",
                        help="no tolerance ends the solve: it takes all its iterations unless a step moves nothing")
    arguments = parser.parse_args()
    method = methods.ALL[arguments.method]
    options = NEVER if arguments.endless else {}
    methods.solve(method, scenes.make(WARM_UP))
    scene = scenes.make(arguments.spec)
    runs = []
    for _ in range(arguments.repetitions):
        _, summary = methods.solve(method, scene, **options)
        rows = summary.iterations
        runs.append({
            "seconds": summary.total_seconds - summary.build_seconds,
            "rows": [[float(row["seconds"]) - summary.build_seconds, float(row["cost"])]
                     for row in rows]})
    print(json.dumps({
        "runs": runs,
        "observations": scene.start.num_observations,
        "final_cost": summary.reference_final_cost,
        "num_iterations": summary.num_iterations,
        "num_rejected_steps": summary.num_rejected_steps,
        "num_linear_solver_iterations": summary.num_linear_solver_iterations,
        "linear_solver": summary.linear_solver,
        "steps": {step: getattr(summary, f"{step}_device_seconds") for step in STEPS},
        "factorization_seconds": summary.factorization_seconds,
        "device": summary.device,
    }))


if __name__ == "__main__":
    main()
