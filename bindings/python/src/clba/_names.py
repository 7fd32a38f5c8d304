# SPDX-License-Identifier: Apache-2.0
"""The library's enumerations by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from clba._ffi import lib

CameraModel = Literal[
    "snavely",
    "simple_pinhole",
    "pinhole",
    "simple_radial",
    "radial",
    "opencv",
    "opencv_fisheye",
    "full_opencv",
    "fov",
    "simple_radial_fisheye",
    "radial_fisheye",
    "thin_prism_fisheye",
    "brown",
]
Loss = Literal["none", "huber", "soft_l1", "cauchy", "tukey"]
LinearSolver = Literal["auto", "pcg_schur", "pcg_hessian", "explicit_schur", "direct_schur"]
Preconditioner = Literal["default", "block_jacobi", "schur_jacobi"]
Damping = Literal["marquardt", "levenberg", "uncertainty"]
Precision = Literal["auto", "double", "mixed", "single"]
JacobianForm = Literal["default", "recomputed", "stored"]
GaugeChoice = Literal["default", "problem", "first_image_and_baseline", "three_points", "inner"]
CovarianceMethod = Literal["auto", "exact", "sampled"]
ErrorUnit = Literal["pixels", "sigmas"]
Scene = Literal["hall", "street", "landmark"]
Format = Literal[
    "auto",
    "bal",
    "colmap_binary",
    "colmap_text",
    "bundler",
    "nvm",
    "openmvg",
    "opensfm",
    "ply",
]

# An enumeration's values are small; the functions that name them answer NULL to the others.
_END_OF_VALUES = 32


def _named(name_of: Callable[[int], bytes | None]) -> dict[str, int]:
    names = ((value, name_of(value)) for value in range(_END_OF_VALUES))
    return {name.decode(): value for value, name in names if name is not None}


CAMERA_MODELS = _named(lib.clba_camera_model_name)
LOSSES = _named(lib.clba_loss_name)
LINEAR_SOLVERS = _named(lib.clba_linear_solver_name)
PRECONDITIONERS = _named(lib.clba_preconditioner_name)
DAMPINGS = _named(lib.clba_damping_name)
PRECISIONS = _named(lib.clba_precision_name)
JACOBIANS = _named(lib.clba_jacobian_name)
GAUGE_CHOICES = _named(lib.clba_covariance_gauge_name)
COVARIANCE_METHODS = _named(lib.clba_covariance_method_name)
ERROR_UNITS = _named(lib.clba_unit_name)
GAUGES = _named(lib.clba_gauge_state_name)
SCENES = _named(lib.clba_scene_name)
FORMATS = _named(lib.clba_format_name)

DEVICE_TYPES = {"cpu": 1, "gpu": 2, "accelerator": 3, "other": 4}
TERMINATIONS = {"convergence": 0, "no_convergence": 1, "failure": 2, "user_stop": 3}
REASONS = {
    "function_tolerance": 1,
    "gradient_tolerance": 2,
    "parameter_tolerance": 3,
    "target_cost": 4,
    "max_iterations": 5,
    "max_seconds": 6,
    "min_radius": 7,
    "invalid_steps": 8,
    "invalid_start": 9,
    "callback": 10,
    "nothing_to_do": 11,
    "cancelled": 12,
}

PARAM_NAMES: dict[str, tuple[str, ...]] = {
    name: tuple(lib.clba_camera_model_param_names(value).decode().split(","))
    for name, value in CAMERA_MODELS.items()
}


def value_of(names: dict[str, int], name: str, option: str) -> int:
    """The value of a name.

    Raises:
        ValueError: there is no such name; the message lists those there are.
        TypeError: it is no string.
    """
    if not isinstance(name, str):
        raise TypeError(f"{option} = {name!r}, but it must be a name: {', '.join(names)}")
    if name not in names:
        raise ValueError(f"{option} = {name!r}, but it must be one of {', '.join(names)}")
    return names[name]


def name_of(names: dict[str, int], value: int) -> str:
    """The name of a value."""
    return next((name for name, known in names.items() if known == value), "unknown")
