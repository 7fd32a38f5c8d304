# SPDX-License-Identifier: Apache-2.0
"""A bundle-adjustment problem: cameras, images, points and observations."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from ctypes import byref, c_double, c_int32, c_int64
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clba import (
    _arrays,
    _covariance,
    _evaluation,
    _ffi,
    _filter,
    _names,
    _priors,
    _problem_files,
    _rigs,
    _rows,
)
from clba._arrays import Doubles, Int32s, UInt64s, pointer, stride
from clba._covariance import Covariance
from clba._devices import Context, context_of
from clba._errors import InvalidArgumentError
from clba._evaluation import Evaluation
from clba._ffi import check, lib
from clba._filter import FilterReport
from clba._rows import NO_DOUBLES, problem_info
from clba._summary import Summary

if TYPE_CHECKING:
    import pycolmap


@dataclass(frozen=True)
class Comparison:
    """What is left between two problems after a similarity alignment of their camera centres.

    Attributes:
        scale: of the similarity that takes the other problem to this one.
        max_center_distance, median_center_distance: of camera centres, in units of this problem.
        max_point_distance, median_point_distance: of points, in the same units.
        extent: root mean square distance of this problem's centres from their mean.
    """

    scale: float
    max_center_distance: float
    median_center_distance: float
    max_point_distance: float
    median_point_distance: float
    extent: float


class Problem:
    """A bundle-adjustment problem, made by one of the ``from_`` functions or ``generate``.

    Terms are COLMAP's: a camera is a set of intrinsics with a model, an image is a pose that refers
    to a camera, and a pose takes world to camera coordinates. Arrays that come out are copies.

    One thread uses a problem at a time: other threads wait, or, while it is solved, get a
    RuntimeError. A closed problem raises ValueError.
    """

    def __init__(self) -> None:
        handle = ctypes.POINTER(_ffi.ProblemHandle)()
        check(lib.clba_problem_create(byref(handle)))
        self._adopt(handle)

    def _adopt(self, handle: Any) -> None:
        self._handle = handle
        self._release = weakref.finalize(self, lib.clba_problem_release, handle)
        self._lock = threading.RLock()
        self._is_being_solved = False
        self._summary: Summary | None = None
        self._is_of_reconstruction = False  # of pycolmap, which has what a file of it would lose
        # Which rows are which of its parts; None once rows were added.
        self._colmap_ids: tuple[list[int], list[int], list[int]] | None = None
        # Of each frame its id, of each sensor the ids of its rig and its camera.
        self._colmap_rigs: tuple[list[int], list[tuple[int, int]]] | None = None

    @classmethod
    def _of(cls, handle: Any) -> Problem:
        problem = cls.__new__(cls)
        problem._adopt(handle)
        return problem

    # ---- Making one ----------------------------------------------------------------------------

    @classmethod
    def from_arrays(
        cls,
        *,
        camera_models: str | Sequence[str],
        camera_params: npt.ArrayLike | Sequence[Sequence[float]],
        poses: npt.ArrayLike,
        points: npt.ArrayLike,
        image_indices: npt.ArrayLike,
        point_indices: npt.ArrayLike,
        pixels: npt.ArrayLike,
        camera_indices: npt.ArrayLike | None = None,
        sigmas: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
    ) -> Problem:
        """A problem from numpy arrays.

        Arrays of float64 and int32 are read where they lie, whatever the distance between their
        rows; others are converted.

        Args:
            camera_models: a name of ``clba.PARAM_NAMES``; one for all cameras or one a camera.
            camera_params: (num_cameras, k), in COLMAP's order of the model's parameters (see
                ``clba.PARAM_NAMES``). If models differ, rows may differ in length, or are padded.
            poses: (num_images, 7), camera from world: qw, qx, qy, qz, tx, ty, tz. Quaternions are
                normalised.
            points: (num_points, 3), world coordinates.
            image_indices, point_indices: (num_observations,), which image saw which point.
            pixels: (num_observations, 2), where: x to the right, y down, in the frame of the
                principal point (COLMAP's: the centre of the first pixel is (0.5, 0.5)). For snavely
                cameras, which look along -z, y goes up and (0, 0) is the centre of the image.
            camera_indices: (num_images,), the camera of each image. By default the one camera
                there is, or, with as many cameras as images, the camera of the same index.
            sigmas: (num_observations,), standard deviations of the observations in pixels.
            covariances: (num_observations, 3), rows xx, xy, yy in squared pixels, instead.

        Raises:
            TypeError: an array is not of numbers, or indices are not integers.
            ValueError: an array has the wrong shape, or a number breaks a rule.
            IndexError: an index is out of range.
        """
        if sigmas is not None and covariances is not None:
            raise ValueError("sigmas and covariances say the same thing; give one of them")
        poses = _arrays.doubles(poses, (None, 7), "poses")
        points = _arrays.doubles(points, (None, 3), "points")
        models, params = _rows.camera_rows(camera_models, camera_params)
        if camera_indices is None:
            camera_indices = _rows.default_camera_indices(len(models), len(poses))
        cameras = _arrays.indices(
            camera_indices, len(poses), len(models), "camera_indices", "cameras"
        )
        images = _arrays.indices(image_indices, None, len(poses), "image_indices", "images")
        tracks = _arrays.indices(point_indices, len(images), len(points), "point_indices", "points")
        pixels = _arrays.doubles(pixels, (len(images), 2), "pixels")
        problem = cls()
        with problem._use() as handle:
            _rows.set_cameras(handle, models, params)
            _rows.set_images(handle, cameras, poses)
            _rows.set_points(handle, points)
            check(
                lib.clba_problem_set_observations(
                    handle,
                    len(images),
                    pointer(images, c_int32),
                    stride(images),
                    pointer(tracks, c_int32),
                    stride(tracks),
                    pointer(pixels, c_double),
                    stride(pixels),
                ),
                xy="pixels",
            )
        if sigmas is not None:
            problem.set_sigmas(sigmas)
        if covariances is not None:
            problem.set_covariances(covariances)
        return problem

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        format: _names.Format = "auto",
        progress: Callable[[float], bool | None] | None = None,
    ) -> Problem:
        """Reads a file, or a folder of files, of any format the library knows.

        What a problem has no place for (names, ids, colours, features without a point, rigs) is
        kept beside it and written back.

        Args:
            format: by default it is told by content.
            progress: called with the fraction read, from 0 to 1; one that returns True stops the
                reading, and one that raises stops it and has its exception raised.

        Warns:
            UserWarning: what cannot be solved as it is in the file; also in ``notices``.

        Raises:
            FileError (an OSError): a file cannot be read.
            FormatError (a ValueError): no format fits, or the content breaks a rule of it.
            CancelledError: progress returned True.
        """
        problem = cls._of(_problem_files.read(path, format, progress))
        for notice in problem.notices:
            warnings.warn(f"{os.fspath(path)}: {notice}", stacklevel=2)
        return problem

    @classmethod
    def from_bal(cls, path: str | os.PathLike[str]) -> Problem:
        """Reads a file of Bundle Adjustment in the Large: plain, gzip or bzip2.

        Each camera of the file becomes an image with a snavely camera of its own.

        Raises:
            FileError (an OSError): the file cannot be read.
            FormatError (a ValueError): its content breaks a rule of the format.
        """
        handle = ctypes.POINTER(_ffi.ProblemHandle)()
        check(lib.clba_problem_read_bal(os.fsencode(path), byref(handle)))
        return cls._of(handle)

    @classmethod
    def from_pycolmap(
        cls,
        reconstruction: pycolmap.Reconstruction,
        *,
        refine_focal_length: bool = True,
        refine_principal_point: bool = False,
        refine_extra_params: bool = True,
        refine_sensor_from_rig: bool = True,
    ) -> Problem:
        """A problem from the registered images of a reconstruction, its points and their tracks.

        As in COLMAP's bundle adjustment, principal points are constant unless asked for, and the
        sensors of rigs are free, but for reference sensors.

        Raises:
            ValueError: a camera has a model that clba does not have; the message names it.
        """
        from clba import _pycolmap

        return _pycolmap.problem(
            reconstruction,
            refine_focal_length,
            refine_principal_point,
            refine_extra_params,
            refine_sensor_from_rig,
        )

    def update_pycolmap(self, reconstruction: pycolmap.Reconstruction) -> None:
        """Writes poses, sensors of rigs, intrinsics and points back, and updates points' errors.

        Args:
            reconstruction: the one given to ``from_pycolmap``, or a copy of it.

        Raises:
            ValueError: the problem was not made by ``from_pycolmap``, or the reconstruction lacks
                a camera, image or point of it, or has other rigs; then nothing is changed.
        """
        from clba import _pycolmap

        _pycolmap.update(self, reconstruction)

    @classmethod
    def generate(
        cls,
        scene: _names.Scene = "hall",
        *,
        num_images: int | None = None,
        num_points: int | None = None,
        observations_per_image: int | None = None,
        seed: int | None = None,
        pixel_noise: float | None = None,
        outlier_share: float | None = None,
        rotation_noise: float | None = None,
        position_noise: float | None = None,
        point_noise: float | None = None,
    ) -> tuple[Problem, Problem]:
        """Makes a scene with known truth, of images with a snavely camera each.

        Args:
            scene: "hall", "street" or "landmark".
            num_images: at least 2; 356 by default.
            num_points: by default it follows from the number of observations.
            observations_per_image: about so many, at least 8; 400 by default.
            seed: equal seeds give equal scenes.
            pixel_noise: standard deviation in pixels; 0.5 by default.
            outlier_share: of the observations, moved anywhere in the image; 0 by default.
            rotation_noise: of the start, in degrees; 0.5 by default.
            position_noise, point_noise: of the start's camera centres and points, as a share of
                the distance to the scene; 0.01 by default.

        Returns:
            The disturbed start, as a solver gets it, and the truth: the same observations with the
            true state.
        """
        options = _ffi.SceneOptions()
        check(lib.clba_scene_options_init(byref(options), ctypes.sizeof(options)))
        options.scene = _names.value_of(_names.SCENES, scene, "scene")
        given = {
            "num_images": num_images,
            "num_points": num_points,
            "observations_per_image": observations_per_image,
            "seed": seed,
            "pixel_noise": pixel_noise,
            "outlier_share": outlier_share,
            "rotation_noise": rotation_noise,
            "position_noise": position_noise,
            "point_noise": point_noise,
        }
        for name, value in given.items():
            _ffi.set_number(options, name, value)
        start = ctypes.POINTER(_ffi.ProblemHandle)()
        truth = ctypes.POINTER(_ffi.ProblemHandle)()
        check(lib.clba_problem_generate(byref(options), byref(start), byref(truth)))
        return cls._of(start), cls._of(truth)

    # ---- Growing -------------------------------------------------------------------------------

    def add_cameras(
        self,
        camera_models: str | Sequence[str],
        camera_params: npt.ArrayLike | Sequence[Sequence[float]],
    ) -> range:
        """Appends cameras, as in ``from_arrays``, and returns their indices."""
        models, params = _rows.camera_rows(camera_models, camera_params)
        with self._use() as handle:
            first = problem_info(handle).num_cameras
            _rows.set_cameras(handle, models, params, lib.clba_problem_add_cameras)
            self._colmap_ids = None
            return range(first, first + len(models))

    def add_images(self, poses: npt.ArrayLike, camera_indices: npt.ArrayLike) -> range:
        """Appends images, whose poses are free, and returns their indices.

        Args:
            poses: (n, 7), camera from world: qw, qx, qy, qz, tx, ty, tz.
            camera_indices: (n,), the camera of each.
        """
        rows = _arrays.doubles(poses, (None, 7), "poses")
        with self._use() as handle:
            info = problem_info(handle)
            cameras = _arrays.indices(
                camera_indices, len(rows), info.num_cameras, "camera_indices", "cameras"
            )
            _rows.set_images(handle, cameras, rows, lib.clba_problem_add_images)
            self._colmap_ids = None
            return range(info.num_images, info.num_images + len(rows))

    def add_points(self, points: npt.ArrayLike) -> range:
        """Appends points, (n, 3), which are free, and returns their indices."""
        rows = _arrays.doubles(points, (None, 3), "points")
        with self._use() as handle:
            first = problem_info(handle).num_points
            _rows.set_points(handle, rows, lib.clba_problem_add_points)
            self._colmap_ids = None
            return range(first, first + len(rows))

    def add_observations(
        self,
        image_indices: npt.ArrayLike,
        point_indices: npt.ArrayLike,
        pixels: npt.ArrayLike,
        covariances: npt.ArrayLike | None = None,
    ) -> range:
        """Appends observations and returns their indices.

        Args:
            image_indices, point_indices: (n,), which image saw which point.
            pixels: (n, 2), where.
            covariances: (n, 3), rows xx, xy, yy in squared pixels; None: the identity.
        """
        with self._use() as handle:
            info = problem_info(handle)
            images = _arrays.indices(
                image_indices, None, info.num_images, "image_indices", "images"
            )
            points = _arrays.indices(
                point_indices, len(images), info.num_points, "point_indices", "points"
            )
            xy = _arrays.doubles(pixels, (len(images), 2), "pixels")
            rows = None
            if covariances is not None:
                rows = _arrays.doubles(covariances, (len(images), 3), "covariances")
            check(
                lib.clba_problem_add_observations(
                    handle,
                    len(images),
                    pointer(images, c_int32),
                    stride(images),
                    pointer(points, c_int32),
                    stride(points),
                    pointer(xy, c_double),
                    stride(xy),
                    NO_DOUBLES if rows is None else pointer(rows, c_double),
                    0 if rows is None else stride(rows),
                ),
                xy="pixels",
            )
            return range(info.num_observations, info.num_observations + len(images))

    # ---- Files ---------------------------------------------------------------------------------

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        format: _names.Format = "auto",
        accept_loss: bool = False,
    ) -> None:
        """Writes a file, or a folder of files; an error leaves what was there.

        Args:
            format: by default a folder's if path is a folder or ends in "/", else that of the
                name's ending if it has one, else the one the problem was read in.
            accept_loss: leave out what the format cannot hold.

        Raises:
            InvalidArgumentError (a ValueError): the format cannot hold the problem or, unless
                accept_loss, what was read with it; the message lists that.
            FileError (an OSError): the file cannot be written.
        """
        self._check_no_reconstruction_is_lost(path, format, accept_loss)
        with self._use() as handle:
            _problem_files.write(handle, path, format, accept_loss)

    def check_write(
        self,
        path: str | os.PathLike[str],
        *,
        format: _names.Format = "auto",
        accept_loss: bool = False,
    ) -> None:
        """Raises what ``write`` would say against the format and a loss: before a long solve."""
        self._check_no_reconstruction_is_lost(path, format, accept_loss)
        with self._use() as handle:
            _problem_files.check_write(handle, path, format, accept_loss)

    def _check_no_reconstruction_is_lost(
        self, path: str | os.PathLike[str], format: str, accept_loss: bool
    ) -> None:
        is_ply = format == "ply" or (format == "auto" and os.fspath(path).endswith(".ply"))
        if self._is_of_reconstruction and not accept_loss and not is_ply:
            raise InvalidArgumentError(
                f"{os.fspath(path)}: the problem was made from a pycolmap.Reconstruction and does "
                "not hold its names, sizes, colours and features without a point. Write the result "
                "to the reconstruction (update_pycolmap) and that to a file, or accept the loss "
                "(accept_loss)"
            )

    @property
    def format(self) -> str | None:
        """Name of the format that the problem was read in, if it was."""
        with self._use() as handle:
            value = int(lib.clba_problem_get_format(handle))
        return _names.name_of(_names.FORMATS, value) if value else None

    @property
    def notices(self) -> list[str]:
        """What was read and cannot be solved as it is in the file."""
        with self._use() as handle:
            return _ffi.text(lib.clba_problem_notices(handle)).splitlines()

    @property
    def image_names(self) -> list[str]:
        """Of each image, "" where the file has none."""
        with self._use() as handle:
            count = problem_info(handle).num_images
            return [os.fsdecode(lib.clba_problem_get_image_name(handle, i)) for i in range(count)]

    @property
    def image_ids(self) -> UInt64s:
        """(num_images,); the index + 1 where the file has none."""
        with self._use() as handle:
            return _problem_files.image_ids(handle, problem_info(handle).num_images)

    @property
    def camera_ids(self) -> UInt64s:
        """(num_cameras,); the index + 1 where the file has none."""
        with self._use() as handle:
            return _problem_files.camera_info(handle, problem_info(handle).num_cameras)[0]

    @property
    def camera_sizes(self) -> UInt64s:
        """(num_cameras, 2), width and height in pixels; 0 where they are not known."""
        with self._use() as handle:
            return _problem_files.camera_info(handle, problem_info(handle).num_cameras)[1]

    @property
    def point_ids(self) -> UInt64s:
        """(num_points,); the index + 1 where the file has none."""
        with self._use() as handle:
            return _problem_files.point_info(handle, problem_info(handle).num_points)[0]

    @property
    def point_colors(self) -> npt.NDArray[np.uint8]:
        """(num_points, 3), red, green and blue; white where the file has none."""
        with self._use() as handle:
            return _problem_files.point_info(handle, problem_info(handle).num_points)[1]

    def to_bal(self, path: str | os.PathLike[str]) -> None:
        """Writes a BAL file, compressed if the name ends in .gz or .bz2.

        Raises:
            InvalidArgumentError (a ValueError): a camera is not a snavely one.
            FileError (an OSError): the file cannot be written; one that was there is unchanged.
        """
        with self._use() as handle:
            check(lib.clba_problem_write_bal(handle, os.fsencode(path)))

    def to_ply(self, path: str | os.PathLike[str]) -> None:
        """Writes points in white and camera centres in green as a binary PLY file."""
        with self._use() as handle:
            check(lib.clba_problem_write_ply(handle, os.fsencode(path)))

    # ---- What it holds -------------------------------------------------------------------------

    @property
    def num_cameras(self) -> int:
        """Number of cameras."""
        return int(self._info().num_cameras)

    @property
    def num_images(self) -> int:
        """Number of images."""
        return int(self._info().num_images)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return int(self._info().num_points)

    @property
    def num_observations(self) -> int:
        """Number of observations."""
        return int(self._info().num_observations)

    @property
    def num_parameters(self) -> int:
        """Length of a step: the dimension of the tangent space, constants included."""
        return int(self._info().num_parameters)

    @property
    def camera_models(self) -> list[str]:
        """The name of each camera's model."""
        with self._use() as handle:
            return [
                _names.name_of(_names.CAMERA_MODELS, value) for value in _rows.models_of(handle)
            ]

    @property
    def camera_params(self) -> Doubles:
        """(num_cameras, k) parameters; shorter rows of a mixture of models end in NaN.

        It may be set to as many rows.
        """
        with self._use() as handle:
            return _rows.params_of(handle)

    @camera_params.setter
    def camera_params(self, values: npt.ArrayLike) -> None:
        with self._use() as handle:
            models = _rows.models_of(handle)
            params = _arrays.doubles(values, (len(models), None), "camera_params")
            _rows.check_num_params(models, params)
            _rows.set_cameras(handle, models, params)

    @property
    def camera_indices(self) -> Int32s:
        """(num_images,) the camera of each image."""
        with self._use() as handle:
            return _rows.images_of(handle)[0]

    @property
    def poses(self) -> Doubles:
        """(num_images, 7) camera from world: qw, qx, qy, qz, tx, ty, tz.

        It may be set to as many rows; quaternions are normalised.
        """
        with self._use() as handle:
            return _rows.images_of(handle)[1]

    @poses.setter
    def poses(self, values: npt.ArrayLike) -> None:
        with self._use() as handle:
            cameras, _ = _rows.images_of(handle)
            _rows.set_images(handle, cameras, _arrays.doubles(values, (len(cameras), 7), "poses"))

    @property
    def centers(self) -> Doubles:
        """(num_images, 3) camera centres in world coordinates."""
        with self._use() as handle:
            count = problem_info(handle).num_images
            centers = np.empty((count, 3))
            check(lib.clba_problem_get_centers(handle, 0, count, pointer(centers, c_double), 0))
            return centers

    @property
    def points(self) -> Doubles:
        """(num_points, 3) world coordinates. It may be set to as many rows."""
        with self._use() as handle:
            count = problem_info(handle).num_points
            points = np.empty((count, 3))
            check(lib.clba_problem_get_points(handle, 0, count, pointer(points, c_double), 0))
            return points

    @points.setter
    def points(self, values: npt.ArrayLike) -> None:
        with self._use() as handle:
            count = problem_info(handle).num_points
            _rows.set_points(handle, _arrays.doubles(values, (count, 3), "points"))

    @property
    def image_indices(self) -> Int32s:
        """(num_observations,) the image of each observation."""
        with self._use() as handle:
            images = np.empty(problem_info(handle).num_observations, np.int32)
            _rows.get_observations(handle, len(images), images=images)
            return images

    @property
    def point_indices(self) -> Int32s:
        """(num_observations,) the point of each observation."""
        with self._use() as handle:
            points = np.empty(problem_info(handle).num_observations, np.int32)
            _rows.get_observations(handle, len(points), points=points)
            return points

    @property
    def pixels(self) -> Doubles:
        """(num_observations, 2) where the points were seen."""
        with self._use() as handle:
            pixels = np.empty((problem_info(handle).num_observations, 2))
            _rows.get_observations(handle, len(pixels), pixels=pixels)
            return pixels

    @property
    def summary(self) -> Summary | None:
        """Of the last solve, also of one that a callback's exception or Ctrl-C ended."""
        return self._summary

    # ---- Weights, constants, losses ------------------------------------------------------------

    def set_sigmas(self, sigmas: npt.ArrayLike | None) -> None:
        """Standard deviations of the observations.

        Args:
            sigmas: (num_observations,) in pixels, > 0; one number for all; None: all 1.
        """
        with self._use() as handle:
            count = 0 if sigmas is None else problem_info(handle).num_observations
            values = np.ones(0) if sigmas is None else sigmas
            if np.ndim(values) == 0:
                values = np.full(count, values)
            rows = _arrays.doubles(values, (count,), "sigmas")
            check(lib.clba_problem_set_sigmas(handle, count, pointer(rows, c_double), stride(rows)))

    def set_covariances(self, covariances: npt.ArrayLike | None) -> None:
        """Covariances of the observations.

        Args:
            covariances: (num_observations, 3), rows xx, xy, yy in squared pixels, each positive
                definite; None: all identity.
        """
        with self._use() as handle:
            if covariances is None:
                check(lib.clba_problem_set_covariances(handle, 0, NO_DOUBLES, 0))
                return
            count = problem_info(handle).num_observations
            rows = _arrays.doubles(covariances, (count, 3), "covariances")
            check(
                lib.clba_problem_set_covariances(
                    handle, count, pointer(rows, c_double), stride(rows)
                )
            )

    def set_loss(self, loss: _names.Loss, scale: float = 1.0) -> None:
        """The robust loss rho(|r|^2).

        Args:
            loss: "none", "huber", "soft_l1", "cauchy" or "tukey", as in Ceres.
            scale: where it sets in, in pixels, or in sigmas where these are set; > 0.
        """
        value = _names.value_of(_names.LOSSES, loss, "loss")
        with self._use() as handle:
            check(lib.clba_problem_set_loss(handle, value, _ffi.number("scale", scale, float)))

    def set_constant_images(
        self,
        rotation: npt.ArrayLike | None = None,
        position: npt.ArrayLike | None = None,
    ) -> None:
        """Holds poses constant; what is not named is free.

        Args:
            rotation: images whose rotation stays: True for all, a boolean array (num_images,), or
                indices.
            position: images whose camera centre stays, likewise.
        """
        with self._use() as handle:
            count = problem_info(handle).num_images
            flags = _arrays.mask(rotation, count, "rotation").astype(np.int32)
            flags += 2 * _arrays.mask(position, count, "position").astype(np.int32)
            check(lib.clba_problem_set_constant_images(handle, count, pointer(flags, c_int32), 0))

    @property
    def constant_images(self) -> npt.NDArray[np.bool_]:
        """(num_images, 2): whether rotation and position of each are constant."""
        with self._use() as handle:
            count = problem_info(handle).num_images
            flags = _rows.constants_of(handle, lib.clba_problem_get_constant_images, count)
            return _rows.bits_of(flags, 2)

    def set_constant_cameras(
        self, cameras: npt.ArrayLike | None = True, params: Sequence[str] | None = None
    ) -> None:
        """Holds intrinsics constant; what is not named is free.

        Args:
            cameras: True for all, None for none of them, a boolean array (num_cameras,), indices,
                or a boolean array (num_cameras, k) that says it of each parameter.
            params: names of the parameters that stay, as ("cx", "cy"); by default all. A camera
                whose model lacks one of them is not held by that name.
        """
        with self._use() as handle:
            models = _rows.models_of(handle)
            names = [_names.PARAM_NAMES[_names.name_of(_names.CAMERA_MODELS, m)] for m in models]
            known = {name for row in names for name in row}
            if isinstance(params, str):
                raise TypeError(f"params = {params!r}, but it must be a sequence of names")
            for name in params or ():
                if name not in known:
                    raise ValueError(
                        f"params has {name!r}, but these cameras have {', '.join(sorted(known))}"
                    )
            if np.ndim(cameras) == 2:  # type: ignore[arg-type]
                chosen = np.asarray(cameras)
                most = max((len(row) for row in names), default=0)
                if chosen.dtype.kind != "b" or chosen.shape != (len(models), most):
                    raise ValueError(
                        f"cameras has shape {chosen.shape} and dtype {chosen.dtype}, but it must "
                        f"be boolean and ({len(models)}, {most})"
                    )
            else:
                rows = _arrays.mask(cameras, len(models), "cameras")
                chosen = np.repeat(rows[:, None], max((len(row) for row in names), default=0), 1)
            flags = np.zeros(len(models), np.int32)
            for camera, row in enumerate(names):
                for k, name in enumerate(row):
                    if chosen[camera, k] and (params is None or name in params):
                        flags[camera] |= 1 << k
            check(
                lib.clba_problem_set_constant_cameras(
                    handle, len(flags), pointer(flags, c_int32), 0
                )
            )

    @property
    def constant_cameras(self) -> npt.NDArray[np.bool_]:
        """(num_cameras, k): which parameters are constant, as ``set_constant_cameras`` takes them.

        Of a problem that was read from OpenMVG or OpenSfM also those that its cameras do not have.
        """
        with self._use() as handle:
            count, most = _rows.params_of(handle).shape
            flags = _rows.constants_of(handle, lib.clba_problem_get_constant_cameras, count)
            return _rows.bits_of(flags, most)

    @property
    def constant_points(self) -> npt.NDArray[np.bool_]:
        """(num_points,)"""
        with self._use() as handle:
            count = problem_info(handle).num_points
            flags = _rows.constants_of(handle, lib.clba_problem_get_constant_points, count)
            return flags.astype(np.bool_)

    def set_constant_points(self, points: npt.ArrayLike | None = True) -> None:
        """Holds points constant; what is not named is free.

        Args:
            points: True for all, None for none, a boolean array (num_points,), or indices.
        """
        with self._use() as handle:
            count = problem_info(handle).num_points
            flags = _arrays.mask(points, count, "points").astype(np.int32)
            check(lib.clba_problem_set_constant_points(handle, count, pointer(flags, c_int32), 0))

    def set_uncertainties(
        self,
        *,
        images: npt.ArrayLike | None = None,
        cameras: npt.ArrayLike | None = None,
        points: npt.ArrayLike | None = None,
    ) -> None:
        """How uncertain each parameter of the start is, which shapes the damping, not the cost.

        They count with ``damping="levenberg"`` and ``"uncertainty"``: a parameter of small
        uncertainty moves less in a step. They are no priors: nothing pulls towards the start.

        Args:
            images: (num_images, 6), rotation in rad and position in world units; > 0.
            cameras: (num_cameras, k), as long as the longest model's parameters; > 0.
            points: (num_points, 3), world units; > 0.

        What is None is set to 1. An array that numpy can broadcast to its shape will do.
        """
        with self._use() as handle:
            info = problem_info(handle)
            most = _rows.params_of(handle).shape[1] if cameras is not None else 0
            for values, shape, name, function in (
                (images, (info.num_images, 6), "images", lib.clba_problem_set_image_uncertainties),
                (
                    cameras,
                    (info.num_cameras, most),
                    "cameras",
                    lib.clba_problem_set_camera_uncertainties,
                ),
                (points, (info.num_points, 3), "points", lib.clba_problem_set_point_uncertainties),
            ):
                if values is None:
                    check(function(handle, 0, NO_DOUBLES, 0))
                    continue
                rows = _arrays.broadcast(values, shape, name)
                check(
                    function(handle, len(rows), pointer(rows, c_double), stride(rows)),
                    values=name,
                )

    # ---- Rigs ----------------------------------------------------------------------------------

    def set_rigs(
        self,
        frames: npt.ArrayLike | None,
        sensors: npt.ArrayLike | None = None,
        sensor_poses: npt.ArrayLike | None = None,
        *,
        frame_poses: npt.ArrayLike | None = None,
        constant_sensors: npt.ArrayLike | None = None,
        constant_frames: npt.ArrayLike | None = None,
    ) -> None:
        """Cameras that are fixed to one body; replaces what was set before.

        An image's pose becomes ``sensor_from_rig * rig_from_world`` of its sensor and its frame,
        exactly, and these are what a solve moves. Hold one sensor of each rig, usually one whose
        pose is the identity.

        Args:
            frames: (num_images,) the frame of each image, from 0 without gaps; -1 where it is in no
                rig; None: no rigs.
            sensors: (num_images,) its sensor, likewise. Sensors of all rigs are numbered together.
            sensor_poses: (num_sensors, 7), sensor from rig, qw, qx, qy, qz, tx, ty, tz.
            frame_poses: (num_frames, 7), rig from world; by default those that the images have,
                which must agree with their sensors.
            constant_sensors: sensors whose pose stays: True for all, a boolean array
                (num_sensors,), indices, or a boolean array (num_sensors, 2) for rotations and
                positions.
            constant_frames: frames whose pose stays, likewise.
        """
        with self._use() as handle:
            self._colmap_rigs = None
            if frames is None:
                _rigs.remove_rigs(handle)
                return
            _rigs.set_rigs(
                handle,
                problem_info(handle).num_images,
                frames,
                _arrays.required(sensors, "sensors"),
                _arrays.required(sensor_poses, "sensor_poses"),
                frame_poses,
                constant_sensors,
                constant_frames,
            )

    @property
    def frame_poses(self) -> Doubles:
        """(num_frames, 7) rig from world; no rows without rigs."""
        with self._use() as handle:
            count = problem_info(handle).num_frames
            return _rigs.poses(handle, lib.clba_problem_get_frames, count)

    @property
    def sensor_poses(self) -> Doubles:
        """(num_sensors, 7) sensor from rig; no rows without rigs."""
        with self._use() as handle:
            count = problem_info(handle).num_sensors
            return _rigs.poses(handle, lib.clba_problem_get_sensors, count)

    @property
    def image_frames(self) -> Int32s:
        """(num_images,) the frame of each image, -1 where it is in no rig."""
        with self._use() as handle:
            return _rigs.of_images(handle, problem_info(handle).num_images)[0]

    @property
    def image_sensors(self) -> Int32s:
        """(num_images,) the sensor of each image, -1 where it is in no rig."""
        with self._use() as handle:
            return _rigs.of_images(handle, problem_info(handle).num_images)[1]

    # ---- Removing outliers ---------------------------------------------------------------------

    def reprojection_errors(self, unit: _names.ErrorUnit = "pixels") -> Doubles:
        """(num_observations,) lengths of the residuals at the current state, without the loss.

        Args:
            unit: "pixels", or "sigmas": whitened by the covariances.
        """
        value = _names.value_of(_names.ERROR_UNITS, unit, "unit")
        with self._use() as handle:
            errors = np.empty(problem_info(handle).num_observations)
            check(
                lib.clba_problem_get_reprojection_errors(
                    handle, value, 0, len(errors), pointer(errors, c_double), 0
                )
            )
            return errors

    def filter(
        self,
        *,
        max_reprojection_error: float = 4.0,
        min_triangulation_angle: float = 1.5,
        min_num_views: int = 2,
        remove_behind: bool = True,
        remove_points: bool = False,
        unit: _names.ErrorUnit = "pixels",
    ) -> FilterReport:
        """Removes outliers at the current state, with their covariances.

        A rule looks at what those before it left, in the order of the arguments' description.

        Args:
            remove_behind: observations of points behind their camera, or in its own plane.
            max_reprojection_error: observations with a larger error; may be infinite.
            unit: of that error, "pixels" or "sigmas".
            min_num_views: all observations of points that fewer images see.
            min_triangulation_angle: all observations of points whose largest angle between two
                rays is smaller, in degrees.
            remove_points: remove the points that are left without observations, too.
        """
        options = _filter.options(
            error_unit=_names.value_of(_names.ERROR_UNITS, unit, "unit"),
            max_reprojection_error=max_reprojection_error,
            min_triangulation_angle=min_triangulation_angle,
            min_num_views=min_num_views,
            remove_behind=remove_behind,
            remove_points=remove_points,
        )
        with self._use() as handle:
            report = _filter.run(
                problem_info(handle),
                lambda to: lib.clba_problem_filter(handle, byref(options), to),
            )
            self._forget_points(report)
            return report

    def remove_observations(
        self, observations: npt.ArrayLike, *, remove_points: bool = False
    ) -> FilterReport:
        """Removes observations of the caller's choice, with their covariances.

        Args:
            observations: a boolean array (num_observations,), or indices.
            remove_points: remove the points that are left without observations, too.
        """
        with self._use() as handle:
            info = problem_info(handle)
            mask = _arrays.mask(observations, info.num_observations, "observations")
            flags = mask.astype(np.int32)
            report = _filter.run(
                info,
                lambda to: lib.clba_problem_remove_observations(
                    handle, len(flags), pointer(flags, c_int32), 0, bool(remove_points), to
                ),
            )
            self._forget_points(report)
            return report

    def _forget_points(self, report: FilterReport) -> None:
        """Keeps the rows of a reconstruction's points in step with a removal."""
        if self._colmap_ids is not None:
            cameras, images, points = self._colmap_ids
            kept = [point for point, row in zip(points, report.point_rows, strict=True) if row >= 0]
            self._colmap_ids = (cameras, images, kept)

    # ---- Priors --------------------------------------------------------------------------------

    def set_position_priors(
        self,
        images: npt.ArrayLike | None,
        positions: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
        *,
        sigmas: npt.ArrayLike | None = None,
    ) -> None:
        """What is known of camera centres, as by GPS, in world units; replaces what was set before.

        Priors add 1/2 |L^-1 (h(x) - target)|^2 to the cost, with L L^T the covariance.

        Args:
            images: (n,) indices of images, each at most once; None: no priors.
            positions: (n, 3).
            covariances: (n, 3, 3), or one for all.
            sigmas: instead of covariances, standard deviations: (n, 3), or what numpy can broadcast
                to it.
        """
        with self._use() as handle:
            _priors.set_priors(
                handle,
                lib.clba_problem_set_position_priors,
                ("images", images, 1),
                ("positions", positions, 3),
                (covariances, sigmas, 3),
            )

    def set_pose_priors(
        self,
        images: npt.ArrayLike | None,
        poses: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
        *,
        sigmas: npt.ArrayLike | None = None,
    ) -> None:
        """What is known of whole poses; replaces what was set before.

        The residual is log(R R0^T), a rotation vector in rad, then the camera's centre less that of
        the target in world units; covariances are in this order.

        Args:
            images: (n,) indices of images, each at most once; None: no priors.
            poses: (n, 7), as in ``poses``.
            covariances: (n, 6, 6), or one for all.
            sigmas: instead of covariances, standard deviations: (n, 6), or what numpy can broadcast
                to it.
        """
        with self._use() as handle:
            _priors.set_priors(
                handle,
                lib.clba_problem_set_pose_priors,
                ("images", images, 1),
                ("poses", poses, 7),
                (covariances, sigmas, 6),
            )

    def set_point_priors(
        self,
        points: npt.ArrayLike | None,
        positions: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
        *,
        sigmas: npt.ArrayLike | None = None,
    ) -> None:
        """What is known of points, as of ground control, in world units; replaces what was set.

        Args:
            points: (n,) indices of points, each at most once; None: no priors.
            positions: (n, 3).
            covariances: (n, 3, 3), or one for all.
            sigmas: instead of covariances, standard deviations: (n, 3), or what numpy can broadcast
                to it.
        """
        with self._use() as handle:
            _priors.set_priors(
                handle,
                lib.clba_problem_set_point_priors,
                ("points", points, 1),
                ("positions", positions, 3),
                (covariances, sigmas, 3),
            )

    def set_relative_pose_priors(
        self,
        pairs: npt.ArrayLike | None,
        poses: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
        *,
        sigmas: npt.ArrayLike | None = None,
    ) -> None:
        """What is known of one camera's pose from another, as by odometry; replaces what was set.

        With (R, t) the pose of the second camera from the first and (M, m) the target, the residual
        is log(M^T R), a rotation vector in rad, then M^T (t - m) in world units; covariances are in
        this order.

        Args:
            pairs: (n, 2) indices of first and second image; a pair may have several; None: none.
            poses: (n, 7), second camera from first camera, qw qx qy qz tx ty tz.
            covariances: (n, 6, 6), or one for all.
            sigmas: instead of covariances, standard deviations: (n, 6), or what numpy can broadcast
                to it.
        """
        if pairs is not None and np.shape(pairs)[1:] != (2,):
            raise ValueError(f"pairs has shape {np.shape(pairs)}, but it must be (any, 2)")
        with self._use() as handle:
            _priors.set_priors(
                handle,
                lib.clba_problem_set_relative_pose_priors,
                ("pairs.flat", None if pairs is None else np.ravel(pairs), 2),
                ("poses", poses, 7),
                (covariances, sigmas, 6),
            )

    def set_intrinsics_priors(
        self,
        cameras: npt.ArrayLike | None,
        params: npt.ArrayLike | None = None,
        covariances: npt.ArrayLike | None = None,
        *,
        sigmas: npt.ArrayLike | None = None,
    ) -> None:
        """What is known of intrinsics, as by a calibration; replaces what was set before.

        Args:
            cameras: (n,) indices of cameras, each at most once; None: no priors.
            params: (n, k), as in ``camera_params``.
            covariances: (n, k, k), or one for all. An infinite variance, with 0 in the rest of its
                row and column, leaves a parameter without a prior.
            sigmas: instead of covariances, standard deviations: (n, k), or what numpy can broadcast
                to it; infinite for parameters without a prior.
        """
        with self._use() as handle:
            _priors.set_intrinsics_priors(handle, cameras, params, covariances, sigmas)

    # ---- Evaluating ----------------------------------------------------------------------------

    def evaluate(
        self,
        *,
        residuals: bool = True,
        gradient: bool = True,
        jacobian: bool = True,
        apply_loss: bool = True,
        precision: _names.Precision = "double",
        device: int | str | Context | None = None,
    ) -> Evaluation:
        """Cost, residuals, gradient and Jacobian at the current state, computed on the device.

        Residuals and Jacobian are whitened by the covariances and multiplied by sqrt(rho'), so that
        gradient = J^T r, to which priors add: cost and gradient include them, residuals and
        Jacobian are those of observations alone.

        Args:
            residuals, gradient, jacobian: what to compute besides the cost.
            apply_loss: False leaves the loss out.
            precision: "double", "mixed" or "single".
            device: as in ``solve``.
        """
        value = _names.value_of(_names.PRECISIONS, precision, "precision")
        context = context_of(device)
        with self._use() as handle, context._use() as context_handle:
            return _evaluation.evaluate(
                handle,
                context_handle,
                problem_info(handle),
                precision=value,
                apply_loss=apply_loss,
                residuals=residuals,
                gradient=gradient,
                structure=self._jacobian_structure(handle) if jacobian else None,
            )

    def covariance(
        self,
        *,
        points: npt.ArrayLike | bool = True,
        gauge: _names.GaugeChoice = "default",
        gauge_images: Sequence[int] | None = None,
        gauge_points: Sequence[int] | None = None,
        method: _names.CovarianceMethod = "auto",
        apply_variance_factor: bool = False,
        num_samples: int | None = None,
        relative_error: float | None = None,
        seed: int | None = None,
        max_bytes: int | None = None,
        max_linear_solver_iterations: int | None = None,
        device: int | str | Context | None = None,
    ) -> Covariance:
        """Covariances of poses, intrinsics and points at the current state.

        They are blocks of the inverse of J^T J, whose J has the observations' covariances and the
        loss in it; docs/covariance.md has definitions and formulas.

        Args:
            points: indices of points, True for all, or False for none.
            gauge: what takes the freedoms of a similarity away that the problem does not hold.
                "default": "problem" where it holds all, otherwise "first_image_and_baseline".
            gauge_images: the image whose pose is held, and the one whose distance from it is;
                -1 chooses.
            gauge_points: of "three_points".
            method: "sampled" estimates where "exact" would take too much memory; "auto" chooses.
            apply_variance_factor: multiply by the a posteriori variance factor.
            num_samples, relative_error, seed, max_linear_solver_iterations: of "sampled".
            max_bytes: memory that "auto" lets "exact" take; by default half of all there is.
            device: as in ``solve``; it must have fp64.
        """
        context = context_of(device)
        options, indices = _covariance.make_options(
            self.num_points,
            points=points,
            gauge=gauge,
            gauge_images=gauge_images,
            gauge_points=gauge_points,
            method=method,
            apply_variance_factor=apply_variance_factor,
            num_samples=num_samples,
            relative_error=relative_error,
            seed=seed,
            max_bytes=max_bytes,
            max_linear_solver_iterations=max_linear_solver_iterations,
        )
        with self._use() as handle, context._use() as context_handle:
            num_params = [lib.clba_camera_model_num_params(int(m)) for m in _rows.models_of(handle)]
            return _covariance.compute(
                handle,
                context_handle,
                options,
                indices,
                num_params,
                _rows.images_of(handle)[0],
            )

    def fix_gauge(
        self,
        *,
        gauge: _names.GaugeChoice = "default",
        images: Sequence[int] | None = None,
        pose: npt.ArrayLike | None = None,
        baseline: float | None = None,
        points: Sequence[int] | None = None,
        xyz: npt.ArrayLike | None = None,
        centers: npt.ArrayLike | None = None,
    ) -> None:
        """Moves the state by a similarity, which changes no residual.

        Args:
            gauge: "default", which is "first_image_and_baseline", "three_points" or "inner".
            images: as gauge_images of ``covariance``.
            pose: where the first image goes, as a row of ``poses``.
            baseline: distance of the two images' centres.
            points, xyz: indices of three points, and (3, 3) where they go: the first one, the line
                to the second with its length, and the plane to the third.
            centers: (num_images, 3) of "inner", NaN where not known, to which the camera centres
                are brought as close as a similarity brings them.

        Raises:
            InvalidArgumentError: among others, if poses or points are constant.
        """
        with self._use() as handle:
            _covariance.set_gauge(
                handle,
                problem_info(handle).num_images,
                gauge=gauge,
                images=images,
                points=points,
                pose=pose,
                baseline=baseline,
                xyz=xyz,
                centers=centers,
            )

    def _jacobian_structure(self, handle: Any) -> _evaluation.Structure:
        info = problem_info(handle)
        pose_offsets = np.empty(info.num_images, np.int64)
        intrinsics_offsets = np.empty(info.num_cameras, np.int64)
        check(
            lib.clba_problem_get_offsets(
                handle, pointer(pose_offsets, c_int64), pointer(intrinsics_offsets, c_int64)
            )
        )
        images = np.empty(info.num_observations, np.int32)
        points = np.empty(info.num_observations, np.int32)
        _rows.get_observations(handle, len(images), images=images, points=points)
        num_params = np.array(
            [lib.clba_camera_model_num_params(model) for model in _rows.models_of(handle)],
            np.int64,
        )
        return _evaluation.Structure(
            pose_offsets=pose_offsets,
            intrinsics_offsets=intrinsics_offsets,
            num_params=num_params,
            camera_indices=_rows.images_of(handle)[0],
            image_indices=images,
            point_indices=points,
        )

    def offsets(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int]:
        """Where parameters are in a step, a gradient and the columns of the Jacobian.

        Returns:
            The first of the 6 parameters of each image's pose (rotation, position), the first of
            each camera's intrinsics, and the first of the points, which follow 3 by 3.
        """
        with self._use() as handle:
            structure = self._jacobian_structure(handle)
            return (
                structure.pose_offsets,
                structure.intrinsics_offsets,
                int(problem_info(handle).num_image_camera_parameters),
            )

    def apply_step(self, step: npt.ArrayLike) -> None:
        """Moves the state: R <- exp([w]_x) R, t <- exp([w]_x) t + v, all else is added.

        Args:
            step: (num_parameters,); constant parameters stay.
        """
        with self._use() as handle:
            values = _arrays.doubles(step, (problem_info(handle).num_parameters,), "step")
            values = np.ascontiguousarray(values)
            check(lib.clba_problem_apply_step(handle, pointer(values, c_double)))

    def compare(self, other: Problem) -> Comparison:
        """Aligns another problem to this one by a similarity and measures what is left.

        Both need as many images and points as each other.
        """
        if not isinstance(other, Problem):
            raise TypeError(f"other is a {type(other).__name__}, but it must be a clba.Problem")
        comparison = _ffi.sized(_ffi.Comparison)
        with contextlib.ExitStack() as stack:
            handles = {
                problem: stack.enter_context(problem._use())
                for problem in sorted({self, other}, key=id)  # in one order in every thread
            }
            check(lib.clba_problem_compare(handles[self], handles[other], byref(comparison)))
        return Comparison(**_ffi.fields(comparison))

    # ---- Lifetime ------------------------------------------------------------------------------

    def close(self) -> None:
        """Frees its memory, on the device too; it can be used no more.

        Raises:
            RuntimeError: it is being solved.
        """
        with self._lock:
            self._check_not_being_solved()
            self._release()

    def __enter__(self) -> Problem:
        with self._use():
            return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        if not self._release.alive:
            return "<clba.Problem, closed>"
        if self._is_being_solved:
            return "<clba.Problem, being solved>"
        info = self._info()
        return (
            f"<clba.Problem: {info.num_images} images, {info.num_cameras} cameras, "
            f"{info.num_points} points, {info.num_observations} observations>"
        )

    @contextlib.contextmanager
    def _use(self) -> Iterator[Any]:
        """The handle, for one thread, and not freed before the end of the block."""
        with self._lock:
            self._check_not_being_solved()
            if not self._release.alive:
                raise ValueError("the problem is closed; make another")
            lib.clba_problem_retain(self._handle)
            try:
                yield self._handle
            finally:
                lib.clba_problem_release(self._handle)

    @contextlib.contextmanager
    def _solving(self) -> Iterator[Any]:
        """The handle, for a solve: others are turned away instead of waiting."""
        with self._use() as handle:
            self._is_being_solved = True
            lib.clba_problem_retain(handle)
        try:
            yield handle
        finally:
            with self._lock:
                self._is_being_solved = False
            lib.clba_problem_release(handle)

    def _check_not_being_solved(self) -> None:
        if self._is_being_solved:
            raise RuntimeError(
                "the problem is being solved; wait for the end of the solve, or give each thread a "
                "problem of its own"
            )

    def _info(self) -> _ffi.ProblemInfo:
        with self._use() as handle:
            return problem_info(handle)
