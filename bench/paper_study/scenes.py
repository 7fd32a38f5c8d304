# SPDX-License-Identifier: Apache-2.0
"""The scenes of the study, each with the true camera centres."""
import dataclasses
import os
import pathlib

import clba
import numpy as np

PROJECT = pathlib.Path(__file__).resolve().parents[2]
SIZES = (356, 302, 256, 135)  # images of the paper's four scenes
PIXEL_NOISE = 0.5  # standard deviation at a feature's finest octave, pixels
OCTAVES = ((1, 0.6), (2, 0.3), (4, 0.1))  # of features: factor of their noise, and their share
OUTLIER_SHARE = 0.01
OUTLIER_RADIUS = 20  # of what geometric verification of matches leaves, pixels
INTRINSICS_NOISE = 1e-5  # relative; the extrinsics are disturbed by 1e-2, 1000 times as much
WEIGHT = 1000  # the paper's: extrinsics are so much more uncertain than intrinsics
REAL = {
    "kitti-0027": "kitti-2011_09_30_drive_0027-stereo-deadreckoned",
    "malaga-170": "malaga-170-gtpose-clean",
    "Herz-Jesus-P25": "strecha-Herz-Jesus-P25",
    "fountain-P11": "strecha-fountain-P11",
}


@dataclasses.dataclass
class Scene:
    start: clba.Problem
    centers: np.ndarray  # true ones, an image a row
    truth: "clba.Problem | None" = None
    sigmas: "np.ndarray | None" = None  # of the observations, pixels
    # Standard deviations of the start's rotations (rad), centres and points, where they are known.
    uncertainties: "tuple[float, float, float] | None" = None


def hall(num_images, observations_per_image, seed, disturbance=1.0):
    """A hall photographed all round, disturbed as the paper assumes: intrinsics are calibrated, while
    poses and points have drifted; observations as feature matching leaves them. Rotations are off by
    0.5 degrees, centres and points by 1 % of the distance to the walls, times disturbance."""
    disturbed, truth = clba.Problem.generate(
        "hall", num_images=num_images, observations_per_image=observations_per_image, seed=seed,
        pixel_noise=0, rotation_noise=0.5 * disturbance, position_noise=0.01 * disturbance,
        point_noise=0.01 * disturbance)
    random = np.random.default_rng([seed, num_images])
    count = truth.num_observations
    factors, shares = zip(*OCTAVES)
    sigmas = PIXEL_NOISE * random.choice(factors, count, p=shares)
    pixels = truth.pixels + sigmas[:, None] * random.standard_normal((count, 2))
    radius = OUTLIER_RADIUS * np.sqrt(random.random(count))
    angle = random.uniform(0, 2 * np.pi, count)
    moved = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pixels += (random.random(count) < OUTLIER_SHARE)[:, None] * moved
    params = truth.camera_params
    params = params + INTRINSICS_NOISE * np.abs([params[0, 0], 1, 1]) * random.standard_normal(
        params.shape)

    def of(poses, points, params):
        return clba.Problem.from_arrays(
            camera_models="snavely", camera_params=params, poses=poses, points=points,
            image_indices=truth.image_indices, point_indices=truth.point_indices, pixels=pixels)

    def spread(a, b):
        return float(np.sqrt(np.mean((a - b) ** 2)))

    return Scene(
        start=of(disturbed.poses, disturbed.points, params),
        centers=truth.centers,
        truth=of(truth.poses, truth.points, truth.camera_params),
        sigmas=sigmas,
        uncertainties=(np.radians(0.5 * disturbance), spread(disturbed.centers, truth.centers),
                       spread(disturbed.points, truth.points)))


def data_folder():
    """Of the real problems, or None."""
    folder = pathlib.Path(os.environ.get("CLBA_TEST_DATA", PROJECT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


def real(name):
    folder = data_folder()
    return Scene(start=clba.Problem.from_bal(folder / "real" / f"{REAL[name]}.txt.bz2"),
                 centers=np.loadtxt(folder / "truth" / f"{REAL[name]}.centres"))


def make(spec):
    """(num_images, observations_per_image, seed), or the name of a real problem."""
    return real(spec) if isinstance(spec, str) else hall(*spec)
