# SPDX-License-Identifier: Apache-2.0
"""Runs the paper's experiments and writes paper.md and its figures: see bench/paper."""
import argparse
import json
import os
import pathlib
import sys
import tempfile
import time

import accuracy
import document
import figures
import programs
import scenes
import timing

FULL = {
    "sizes": list(scenes.SIZES),
    "growth_sizes": [12, 16, 24, 34, 48, 68, 96, 135, 190, 256, 302, 356],
    "observations_per_image": 800,
    "repetitions": 3,
    "accuracy_observations": 200,
    "seeds": [1, 2, 3, 4, 5],
    "far_start": {"images": 60, "disturbance": 6.0, "seeds": list(range(1, 11))},
    "by_iteration_images": 135,
    "by_iteration_most": 6,
    "model_images": scenes.SIZES[0],
    "real": True,
}
# All that can go wrong, in a minute or two; its figures mean little.
REDUCED = {
    **FULL,
    "sizes": [24, 16],
    "growth_sizes": [16, 48, 64],
    "observations_per_image": 100,
    "repetitions": 1,
    "accuracy_observations": 60,
    "seeds": [1, 2],
    "far_start": {"images": 16, "disturbance": 6.0, "seeds": [1, 2]},
    "by_iteration_images": 16,
    "by_iteration_most": 2,
    "model_images": 24,
    "real": False,
}
BY_ITERATION = ("paper_marquardt", "paper_levenberg_weighted", "paper_uncertainty_weighted",
                "paper_uncertainty_true")


def measure(settings, build):
    start = time.monotonic()
    runner = programs.Programs(build)
    far = settings["far_start"]
    results = {"settings": settings}
    results["premise"] = accuracy.premise(runner, settings["sizes"],
                                          settings["accuracy_observations"], settings["seeds"])
    results["far_start"] = accuracy.far_start(far["images"], settings["accuracy_observations"],
                                              far["seeds"], far["disturbance"])
    results["by_iteration"] = accuracy.by_iteration(
        settings["by_iteration_images"], settings["accuracy_observations"], settings["seeds"],
        BY_ITERATION, settings["by_iteration_most"])
    if settings["real"]:
        if scenes.data_folder():
            results["real"] = accuracy.real(runner)
        else:
            print("paper: real problems are skipped, there is no folder of them; "
                  "set CLBA_TEST_DATA")
    results["growth"] = timing.growth(runner, settings["growth_sizes"],
                                      settings["observations_per_image"], settings["repetitions"],
                                      settings["threads"])
    results["steps"] = timing.steps(runner, settings["sizes"], settings["observations_per_image"])
    results["device"] = results["steps"][0]["device"]
    results["seconds"] = time.monotonic() - start
    return results


def write(results, folder, command):
    """All files at once: on an error, those that were there stay."""
    folder.mkdir(parents=True, exist_ok=True)
    settings = results["settings"]
    with tempfile.TemporaryDirectory(dir=folder) as made:
        made = pathlib.Path(made)
        (made / "paper.md").write_text(document.document(results, command), encoding="utf-8")
        figures.model(settings["model_images"], settings["observations_per_image"],
                      settings["far_start"]["disturbance"], made / "paper-model.svg")
        figures.growth(results["growth"], document.GROWTH,
                       document.growth_fits(results["growth"]), made / "paper-growth.svg")
        figures.by_iteration(results["by_iteration"], made / "paper-weights.svg")
        for path in made.iterdir():
            path.replace(folder / path.name)
    print(f"wrote {folder / 'paper.md'}")


def main():
    parser = argparse.ArgumentParser(prog="bench/paper", description=__doc__)
    parser.add_argument("--build", required=True, help="build folder with the benches")
    parser.add_argument("--output", type=pathlib.Path, required=True,
                        help="folder of paper.md and its figures")
    parser.add_argument("--json", type=pathlib.Path, help="the measurements are written here, too")
    parser.add_argument("--from-json", type=pathlib.Path, help="measured before: nothing is run")
    parser.add_argument("--reduced", action="store_true",
                        help="small scenes and few seeds: shows that everything runs")
    arguments = parser.parse_args()
    command = "bench/paper" + (" --reduced" if arguments.reduced else "")
    if arguments.from_json:
        results = json.loads(arguments.from_json.read_text(encoding="utf-8"))
    else:
        settings = {**(REDUCED if arguments.reduced else FULL),
                    "threads": min(2, len(os.sched_getaffinity(0)))}
        results = measure(settings, arguments.build)
        if arguments.json:
            arguments.json.write_text(json.dumps(results), encoding="utf-8")
    write(results, arguments.output, command)
    return 0


if __name__ == "__main__":
    sys.exit(main())
