# SPDX-License-Identifier: Apache-2.0
"""Problems that the tests share."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pytest

import clba

# camera_models, camera_params: one of each model that looks along +z.
MODELS = ["simple_pinhole", "pinhole", "simple_radial", "radial", "opencv"]
PARAMS = [
    [800.0, 320, 240],
    [800.0, 820, 320, 240],
    [800.0, 320, 240, -0.1],
    [800.0, 320, 240, -0.1, 0.02],
    [800.0, 820, 320, 240, -0.1, 0.02, 0.001, -0.002],
]


def rotate(quaternions: Any, vectors: Any) -> Any:
    """R(q) x of rows w, x, y, z, as in clba.h."""
    w, axis = quaternions[:, :1], quaternions[:, 1:]
    cross = np.cross(axis, vectors)
    return vectors + 2 * (w * cross + np.cross(axis, cross))


def project(model: str, params: Any, camera_points: Any) -> Any:
    """The pixel of points in camera coordinates, by the formulas of clba.h."""
    u, v = (camera_points[:, :2] / camera_points[:, 2:]).T
    r2 = u * u + v * v
    values = dict(zip(clba.PARAM_NAMES[model], params, strict=False))
    fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
    k1, k2 = values.get("k1", values.get("k", 0)), values.get("k2", 0)
    p1, p2 = values.get("p1", 0), values.get("p2", 0)
    radial = 1 + k1 * r2 + k2 * r2 * r2
    du = 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    dv = 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return np.column_stack(
        [fx * (radial * u + du) + values["cx"], fy * (radial * v + dv) + values["cy"]]
    )


def scene(num_images: int = 10, num_points: int = 40, noise: float = 0.5) -> dict[str, Any]:
    """Arguments of from_arrays: 5 models, each camera shared by the images whose turn it is."""
    random = np.random.default_rng(7)
    axes = random.normal(size=(num_images, 3))
    angles = 0.2 * random.random((num_images, 1))
    axes *= np.sin(angles / 2) / np.linalg.norm(axes, axis=1, keepdims=True)
    quaternions = np.hstack([np.cos(angles / 2), axes])
    translations = random.normal(size=(num_images, 3)) * 0.5 + [0, 0, 6]
    points = random.uniform(-1, 1, (num_points, 3))
    image_indices = np.repeat(np.arange(num_images), num_points).astype(np.int32)
    point_indices = np.tile(np.arange(num_points), num_images).astype(np.int32)
    camera_indices = (np.arange(num_images) % len(MODELS)).astype(np.int32)
    pixels = np.vstack(
        [
            project(
                MODELS[camera],
                PARAMS[camera],
                rotate(np.tile(quaternion, (num_points, 1)), points) + translation,
            )
            for camera, quaternion, translation in zip(
                camera_indices, quaternions, translations, strict=True
            )
        ]
    )
    return {
        "camera_models": MODELS,
        "camera_params": PARAMS,
        "camera_indices": camera_indices,
        "poses": np.hstack([quaternions, translations]),
        "points": points,
        "image_indices": image_indices,
        "point_indices": point_indices,
        "pixels": pixels + noise * random.normal(size=pixels.shape),
    }


@pytest.fixture
def arrays() -> dict[str, Any]:
    return scene()


@pytest.fixture
def problem(arrays: dict[str, Any]) -> clba.Problem:
    return clba.Problem.from_arrays(**arrays)


@pytest.fixture
def hall() -> clba.Problem:
    start, _ = clba.Problem.generate("hall", num_images=6, observations_per_image=60)
    return start


@pytest.fixture(scope="session")
def package() -> pathlib.Path:
    """The folder of the Python package's sources."""
    return pathlib.Path(__file__).resolve().parent.parent
