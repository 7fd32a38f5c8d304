# SPDX-License-Identifier: Apache-2.0
"""Problems from COLMAP's reconstructions and back.

Both name an image's pose camera from world and measure pixels in the frame of the principal point,
and a model's parameters have COLMAP's order; only quaternions differ: COLMAP's end in w.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clba import _names
from clba._arrays import Doubles
from clba._problem import Problem

if TYPE_CHECKING:
    import pycolmap

# COLMAP has none that looks along -z, and none of OpenMVG's with one focal length.
NOT_OF_COLMAP = ("snavely", "brown")
MODELS = {name.upper(): name for name in _names.CAMERA_MODELS if name not in NOT_OF_COLMAP}

_TO_XYZW = [1, 2, 3, 0]
_TO_WXYZ = [3, 0, 1, 2]


def problem(
    reconstruction: pycolmap.Reconstruction,
    refine_focal_length: bool,
    refine_principal_point: bool,
    refine_extra_params: bool,
    refine_sensor_from_rig: bool,
) -> Problem:
    """See Problem.from_pycolmap."""
    image_ids = sorted(reconstruction.reg_image_ids())
    images = [reconstruction.image(image_id) for image_id in image_ids]
    camera_ids = sorted({image.camera_id for image in images})
    cameras = [reconstruction.camera(camera_id) for camera_id in camera_ids]
    for camera in cameras:
        if camera.model.name not in MODELS:
            raise ValueError(
                f"camera {camera.camera_id} has the model {camera.model.name}, but clba has "
                f"{', '.join(MODELS)}; undistort its images, or fit one of these models"
            )
    point_ids = sorted(reconstruction.point3D_ids())
    points = [reconstruction.point3D(point_id) for point_id in point_ids]

    camera_rows = {camera_id: row for row, camera_id in enumerate(camera_ids)}
    point_rows = {point_id: row for row, point_id in enumerate(point_ids)}
    image_indices, point_indices, pixels = [], [], []
    for row, image in enumerate(images):
        observations = image.get_observation_points2D()
        image_indices.append(np.full(len(observations), row, np.int32))
        point_indices += [point_rows[observation.point3D_id] for observation in observations]
        pixels += [observation.xy for observation in observations]
    poses = [image.cam_from_world() for image in images]
    made = Problem.from_arrays(
        camera_models=[MODELS[camera.model.name] for camera in cameras],
        camera_params=[camera.params for camera in cameras],
        camera_indices=np.array([camera_rows[image.camera_id] for image in images], np.int32),
        poses=np.array([_row(pose) for pose in poses]).reshape(-1, 7),
        points=np.array([point.xyz for point in points]).reshape(-1, 3),
        image_indices=np.concatenate([np.zeros(0, np.int32), *image_indices]),
        point_indices=np.array(point_indices, np.int32),
        pixels=np.array(pixels).reshape(-1, 2),
    )
    made._is_of_reconstruction = True
    made._colmap_ids = (camera_ids, image_ids, point_ids)

    most_params = max((len(camera.params) for camera in cameras), default=0)
    constant = np.zeros((len(cameras), most_params), dtype=bool)
    for row, camera in enumerate(cameras):
        for is_refined, indices in (
            (refine_focal_length, camera.focal_length_idxs()),
            (refine_principal_point, camera.principal_point_idxs()),
            (refine_extra_params, camera.extra_params_idxs()),
        ):
            constant[row, list(indices)] = not is_refined
    made.set_constant_cameras(constant)
    if not all(_is_rig_of_its_own(image) for image in images):
        _set_rigs(made, images, refine_sensor_from_rig)
    return made


def update(problem: Problem, reconstruction: pycolmap.Reconstruction) -> None:
    """See Problem.update_pycolmap."""
    if problem._colmap_ids is None:
        raise ValueError(
            "the problem was not made by from_pycolmap, or cameras, images or points were added to "
            "it since, so it has no reconstruction"
        )
    camera_ids, image_ids, point_ids = problem._colmap_ids
    models = problem.camera_models
    for kind, ids, known in (
        ("camera", camera_ids, reconstruction.cameras),
        ("image", image_ids, set(reconstruction.reg_image_ids())),
        ("point", point_ids, reconstruction.point3D_ids()),
    ):
        missing = set(ids).difference(known)
        if missing:
            raise ValueError(
                f"the reconstruction has no {kind} {min(missing)}; give update_pycolmap the one "
                "that from_pycolmap was given"
            )
    for camera_id, model in zip(camera_ids, models, strict=True):
        found = reconstruction.camera(camera_id).model.name
        if found != model.upper():
            raise ValueError(
                f"camera {camera_id} has the model {found}, but had {model.upper()} when the "
                "problem was made"
            )
    _check_rigs(problem, reconstruction)
    for camera_id, model, params in zip(camera_ids, models, problem.camera_params, strict=True):
        reconstruction.camera(camera_id).params = params[: len(_names.PARAM_NAMES[model])]
    if problem._colmap_rigs is not None:
        _update_rigs(problem, reconstruction)
    else:
        for image_id, pose in zip(image_ids, problem.poses, strict=True):
            image = reconstruction.image(image_id)
            assert image.frame is not None  # it is registered
            image.frame.set_cam_from_world(image.camera_id, _rigid(pose))
    for point_id, xyz in zip(point_ids, problem.points, strict=True):
        reconstruction.point3D(point_id).xyz = xyz
    reconstruction.update_point_3d_errors()


def _row(pose: pycolmap.Rigid3d) -> list[float]:
    return [*pose.rotation.quat[_TO_WXYZ], *pose.translation]


def _rigid(row: Doubles) -> pycolmap.Rigid3d:
    import pycolmap

    return pycolmap.Rigid3d(pycolmap.Rotation3d(row[_TO_XYZW]), row[4:])


def _frame_of(image: pycolmap.Image) -> pycolmap.Frame:
    assert image.frame is not None  # it is registered
    return image.frame


def _rig_of(image: pycolmap.Image) -> pycolmap.Rig:
    rig = _frame_of(image).rig
    assert rig is not None  # it is registered
    return rig


def _sensor_of(image: pycolmap.Image) -> pycolmap.sensor_t:
    assert image.camera is not None  # the reconstruction has it
    return image.camera.sensor_id


def _set_rigs(made: Problem, images: list[pycolmap.Image], refines: bool) -> None:
    frame_ids = sorted({image.frame_id for image in images})
    frames = {_frame_of(image).frame_id: _frame_of(image) for image in images}
    rigs = {_rig_of(image).rig_id: _rig_of(image) for image in images}
    sensors = {(_rig_of(image).rig_id, image.camera_id): _sensor_of(image) for image in images}
    keys = sorted(sensors)
    is_reference = [rigs[rig_id].is_ref_sensor(sensors[rig_id, camera]) for rig_id, camera in keys]
    poses = [
        [1.0, 0, 0, 0, 0, 0, 0]
        if reference
        else _row(_known(rigs[key[0]].sensor_from_rig(sensors[key])))
        for key, reference in zip(keys, is_reference, strict=True)
    ]
    frame_rows = {frame_id: row for row, frame_id in enumerate(frame_ids)}
    sensor_rows = {key: row for row, key in enumerate(keys)}
    made.set_rigs(
        [frame_rows[image.frame_id] for image in images],
        [sensor_rows[_rig_of(image).rig_id, image.camera_id] for image in images],
        poses,
        frame_poses=[_row(_known(frames[frame_id].rig_from_world)) for frame_id in frame_ids],
        constant_sensors=np.array(is_reference) if refines else True,
    )
    made._colmap_rigs = (frame_ids, keys)


def _known(pose: pycolmap.Rigid3d | None) -> pycolmap.Rigid3d:
    assert pose is not None  # its images are registered
    return pose


def _check_rigs(problem: Problem, reconstruction: pycolmap.Reconstruction) -> None:
    """That the reconstruction has the rigs that the problem was made of, and the problem still."""
    assert problem._colmap_ids is not None
    image_ids = problem._colmap_ids[1]
    images = [reconstruction.image(image_id) for image_id in image_ids]
    if problem._colmap_rigs is None:
        if not all(_is_rig_of_its_own(image) for image in images):
            raise ValueError(
                "the reconstruction has rigs of several sensors, but the problem has them no "
                "longer; give each of its cameras a rig of its own"
            )
        return
    frame_ids, keys = problem._colmap_rigs
    for image, frame, sensor in zip(
        images, problem.image_frames, problem.image_sensors, strict=True
    ):
        if image.frame_id != frame_ids[frame] or keys[sensor] != (
            _rig_of(image).rig_id,
            image.camera_id,
        ):
            raise ValueError(
                f"image {image.image_id} is in frame {image.frame_id} of rig "
                f"{_rig_of(image).rig_id} with camera {image.camera_id}, but was in frame "
                f"{frame_ids[frame]} of rig {keys[sensor][0]} with camera {keys[sensor][1]} when "
                "the problem was made"
            )


def _update_rigs(problem: Problem, reconstruction: pycolmap.Reconstruction) -> None:
    assert problem._colmap_rigs is not None
    frame_ids, keys = problem._colmap_rigs
    for (rig_id, camera_id), pose in zip(keys, problem.sensor_poses, strict=True):
        rig, sensor = reconstruction.rig(rig_id), reconstruction.camera(camera_id).sensor_id
        if not rig.is_ref_sensor(sensor):
            rig.set_sensor_from_rig(sensor, _rigid(pose))
    for frame_id, pose in zip(frame_ids, problem.frame_poses, strict=True):
        reconstruction.frame(frame_id).rig_from_world = _rigid(pose)


def _is_rig_of_its_own(image: pycolmap.Image) -> bool:
    frame = image.frame
    return frame is not None and frame.rig is not None and frame.rig.num_sensors() == 1
