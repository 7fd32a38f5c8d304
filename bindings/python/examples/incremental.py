# SPDX-License-Identifier: Apache-2.0
"""A map that grows image by image, each new one followed by a local bundle adjustment.

    python incremental.py [NUM_IMAGES]

A generated drive along a street stands for a tracker: it gives the first images their true poses,
and each later image and each new point a rough one.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import clba

WINDOW = 8  # latest images, which are refined after each new one
KNOWN = 4  # images of the first map


def main() -> tuple[float, float, float]:
    """Largest error of a camera centre: as tracked, in the map, and after a solve of all of it."""
    num_images = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    rough, truth = clba.Problem.generate(
        "street", num_images=num_images, observations_per_image=150, seed=2
    )
    poses, points = rough.poses, rough.points
    poses[:KNOWN] = truth.poses[:KNOWN]
    image_indices, point_indices, pixels = truth.image_indices, truth.point_indices, truth.pixels

    grown = clba.Problem()
    grown.set_loss("huber", 2.0)
    row_of_point = np.full(len(points), -1)
    seconds = []
    for image in range(num_images):
        grown.add_cameras("snavely", truth.camera_params[image : image + 1])
        grown.add_images(poses[image : image + 1], [image])
        rows = image_indices == image
        seen = point_indices[rows]
        new = np.unique(seen[row_of_point[seen] < 0])
        row_of_point[new] = grown.add_points(points[new])
        grown.add_observations(np.full(len(seen), image), row_of_point[seen], pixels[rows])
        if image < KNOWN:
            continue
        latest = np.arange(max(KNOWN, image + 1 - WINDOW), image + 1)
        begin = time.perf_counter()
        clba.solve(grown, window=clba.Window(images=latest), max_num_iterations=10)
        seconds.append(time.perf_counter() - begin)

    def largest_error(centers: np.ndarray) -> float:
        return float(np.linalg.norm(centers - truth.centers, axis=1).max())

    tracked, local = largest_error(rough.centers), largest_error(grown.centers)
    known = np.arange(num_images) < KNOWN
    grown.set_constant_images(rotation=known, position=known)
    clba.solve(grown)
    everything = largest_error(grown.centers)
    print(grown)
    print(f"a local bundle adjustment takes {np.median(seconds):.3f} s, the last {seconds[-1]:.3f}")
    print(f"largest error of a centre: {tracked:.3g} as tracked, {local:.3g} in the map,")
    print(f"and {everything:.3g} after a bundle adjustment of all")
    return tracked, local, everything


if __name__ == "__main__":
    main()
