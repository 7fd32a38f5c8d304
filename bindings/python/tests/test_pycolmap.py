# SPDX-License-Identifier: Apache-2.0
"""COLMAP's reconstructions, there and back, and its own bundle adjustment."""

from __future__ import annotations

import copy
import pathlib
from typing import Any

import numpy as np
import pycolmap
import pytest

import clba
from clba import _pycolmap

# Parameters of a camera of 1000 x 800 pixels.
PARAMS = {
    "SIMPLE_PINHOLE": [900.0, 500, 400],
    "PINHOLE": [900.0, 920, 500, 400],
    "SIMPLE_RADIAL": [900.0, 500, 400, 0.05],
    "RADIAL": [900.0, 500, 400, 0.05, -0.02],
    "OPENCV": [900.0, 920, 500, 400, 0.05, -0.02, 0.002, -0.001],
    "OPENCV_FISHEYE": [900.0, 920, 500, 400, 0.05, -0.02, 0.01, 0.003],
    "FULL_OPENCV": [
        *(900.0, 920, 500, 400, 0.05, -0.02, 0.002, -0.001),
        *(0.004, 0.03, 0.01, 0.002),
    ],
    "FOV": [900.0, 920, 500, 400, 0.9],
    "SIMPLE_RADIAL_FISHEYE": [900.0, 500, 400, 0.05],
    "RADIAL_FISHEYE": [900.0, 500, 400, 0.05, -0.02],
    "THIN_PRISM_FISHEYE": [
        *(900.0, 920, 500, 400, 0.05, -0.02, 0.002, -0.001),
        *(0.01, 0.003, 0.002, -0.003),
    ],
}


def reconstruction_of(
    models: list[str], *, noise: float = 0.0, images_per_camera: int = 4, num_points: int = 100
) -> pycolmap.Reconstruction:
    """A synthetic one, each camera shared by some images, its start disturbed."""
    pycolmap.set_random_seed(3)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = len(models)
    options.num_frames_per_rig = images_per_camera
    options.num_points3D = num_points
    options.camera_width, options.camera_height = 1000, 800
    options.camera_model_id = pycolmap.CameraModelId.PINHOLE
    options.camera_params = PARAMS["PINHOLE"]
    made = pycolmap.synthesize_dataset(options)
    # Other models, with the pixels that belong to them.
    for camera_id, model in zip(sorted(made.cameras), models, strict=True):
        camera = made.camera(camera_id)
        camera.model = getattr(pycolmap.CameraModelId, model)
        camera.params = PARAMS[model]
    for image in made.images.values():
        for point2d in image.points2D:
            if point2d.has_point3D():
                point2d.xy = image.project_point(made.point3D(point2d.point3D_id).xyz)
    disturbance = pycolmap.SyntheticNoiseOptions()
    disturbance.point2D_stddev = noise
    disturbance.point3D_stddev = 0.05 * (noise > 0)
    disturbance.rig_from_world_translation_stddev = 0.02 * (noise > 0)
    disturbance.rig_from_world_rotation_stddev = 0.5 * (noise > 0)
    pycolmap.synthesize_noise(disturbance, made)
    return made


def state_of(reconstruction: pycolmap.Reconstruction) -> dict[str, Any]:
    return {
        "params": [c.params.tolist() for _, c in sorted(reconstruction.cameras.items())],
        "poses": [i.cam_from_world().matrix() for _, i in sorted(reconstruction.images.items())],
        "points": np.array([p.xyz for _, p in sorted(reconstruction.points3D.items())]),
    }


def test_every_model_of_colmap_is_one_of_clba() -> None:
    assert set(_pycolmap.MODELS) == set(PARAMS)
    assert set(clba.PARAM_NAMES) == {name.lower() for name in PARAMS} | {"snavely", "brown"}


def test_every_model_projects_as_in_colmap() -> None:
    """To 1e-9, up to 85 degrees from the axis, in its middle and next to it.

    COLMAP replaces FOV's formula by truncated series, which are less exact: where omega < 0.01 and,
    the more so the larger omega is, where r < 0.01.
    """
    random = np.random.default_rng(1)
    angles = np.radians([0, 1e-7, 1e-4, 0.1, *random.uniform(0, 85, 500)])
    around = random.uniform(0, 2 * np.pi, len(angles))
    directions = np.column_stack(
        [np.sin(angles) * np.cos(around), np.sin(angles) * np.sin(around), np.cos(angles)]
    )
    points = directions * random.uniform(0.5, 50, (len(angles), 1))
    cameras = [*PARAMS.items(), ("FOV", [900.0, 920, 500, 400, 0.02])]
    problem = clba.Problem.from_arrays(
        camera_models=[model.lower() for model, _ in cameras],
        camera_params=[params for _, params in cameras],
        camera_indices=np.arange(len(cameras)),
        poses=np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(cameras), 1)),
        points=points,
        image_indices=np.repeat(np.arange(len(cameras)), len(points)),
        point_indices=np.tile(np.arange(len(points)), len(cameras)),
        pixels=np.zeros((len(cameras) * len(points), 2)),
    )
    at = problem.evaluate(gradient=False, jacobian=False)
    assert at.residuals is not None
    for (model, params), pixels in zip(
        cameras, np.reshape(at.residuals, (len(cameras), -1, 2)), strict=True
    ):
        camera = pycolmap.Camera(model=model, width=1000, height=800, params=params)
        np.testing.assert_allclose(pixels, camera.img_from_cam(points), rtol=1e-9, err_msg=model)


@pytest.mark.parametrize("model", PARAMS)
def test_round_trip(model: str) -> None:
    """Both project alike, and what comes out is what a solve found."""
    reconstruction = reconstruction_of([model, model])
    before = state_of(reconstruction)
    problem = clba.Problem.from_pycolmap(reconstruction)
    assert problem.camera_models == [model.lower()] * 2
    assert (problem.num_images, problem.num_points) == (8, 100)
    assert problem.num_observations == reconstruction.compute_num_observations()
    at = problem.evaluate(gradient=False, jacobian=False)
    assert at.residuals is not None and abs(at.residuals).max() < 1e-9

    problem.update_pycolmap(reconstruction)
    after = state_of(reconstruction)
    assert after["params"] == before["params"]
    np.testing.assert_allclose(after["poses"], before["poses"], atol=1e-14)
    np.testing.assert_array_equal(after["points"], before["points"])

    problem.points = problem.points + [1, 2, 3]
    problem.poses = problem.poses + [0, 0, 0, 0, 0.1, 0.2, 0.3]
    params = problem.camera_params
    params += np.arange(1, params.shape[1] + 1) / 64
    problem.camera_params = params
    problem.update_pycolmap(reconstruction)
    after = state_of(reconstruction)
    np.testing.assert_array_equal(after["params"], params)
    np.testing.assert_allclose(
        np.array(after["poses"])[:, :, 3], np.array(before["poses"])[:, :, 3] + [0.1, 0.2, 0.3]
    )
    np.testing.assert_allclose(after["points"], np.array(before["points"]) + [1, 2, 3])
    assert reconstruction.is_valid()


def test_three_models_end_where_colmap_ends(tmp_path: pathlib.Path) -> None:
    """The same cost to 1e-6, and a reconstruction that is valid."""
    reconstruction = reconstruction_of(["SIMPLE_RADIAL", "PINHOLE", "OPENCV"], noise=0.6)
    theirs = copy.deepcopy(reconstruction)
    problem = clba.Problem.from_pycolmap(reconstruction)
    start = problem.evaluate(jacobian=False).cost
    summary = clba.solve(problem, function_tolerance=1e-12, precision="double")
    problem.update_pycolmap(reconstruction)

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.bundle_adjustment(theirs, options)
    their_cost = clba.Problem.from_pycolmap(theirs).evaluate(jacobian=False).cost
    our_cost = clba.Problem.from_pycolmap(reconstruction).evaluate(jacobian=False).cost

    assert summary.converged and our_cost < 0.01 * start
    assert our_cost == pytest.approx(summary.final_cost, rel=1e-9)
    assert our_cost == pytest.approx(their_cost, rel=1e-6)
    assert reconstruction.is_valid()
    error = theirs.compute_mean_reprojection_error()
    assert reconstruction.compute_mean_reprojection_error() == pytest.approx(error, rel=1e-4)
    reconstruction.write(tmp_path)
    read = pycolmap.Reconstruction(tmp_path)
    assert read.compute_num_observations() == problem.num_observations


def test_a_reconstruction_is_not_lost_in_a_file(tmp_path: pathlib.Path) -> None:
    """Its names, sizes and colours are in the reconstruction, not in the problem."""
    problem = clba.Problem.from_pycolmap(reconstruction_of(["RADIAL"]))
    for write in (problem.check_write, problem.write):
        with pytest.raises(clba.InvalidArgumentError, match="update_pycolmap.*accept_loss"):
            write(tmp_path / "model", format="colmap_binary")
    problem.add_points([[0, 0, 1]])
    with pytest.raises(clba.InvalidArgumentError, match="names, sizes, colours"):
        problem.write(tmp_path / "model", format="colmap_binary")
    assert list(tmp_path.iterdir()) == []
    problem.write(tmp_path / "scene.ply")
    problem.write(tmp_path / "model", format="colmap_binary", accept_loss=True)
    assert (tmp_path / "model" / "images.bin").is_file()


def test_what_is_refined_is_as_in_colmap() -> None:
    reconstruction = reconstruction_of(["OPENCV"], noise=0.5)
    for refined, changed in (
        ({}, [True, True, False, False, True, True, True, True]),
        ({"refine_focal_length": False}, [False] * 4 + [True] * 4),
        ({"refine_extra_params": False, "refine_principal_point": True}, [True] * 4 + [False] * 4),
    ):
        problem = clba.Problem.from_pycolmap(reconstruction, **refined)
        clba.solve(problem, max_num_iterations=2)
        assert (problem.camera_params[0] != PARAMS["OPENCV"]).tolist() == changed


def test_images_without_a_pose_are_left_out() -> None:
    reconstruction = reconstruction_of(["PINHOLE", "RADIAL"])
    image = reconstruction.image(reconstruction.reg_image_ids()[0])
    reconstruction.deregister_frame(image.frame_id)
    problem = clba.Problem.from_pycolmap(reconstruction)
    assert problem.num_images == 7
    problem.update_pycolmap(reconstruction)
    assert not image.has_pose


def test_other_models_are_refused_by_name() -> None:
    reconstruction = reconstruction_of(["PINHOLE"])
    camera = next(iter(reconstruction.cameras.values()))
    for model in ("RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "EUCM"):
        camera.model = getattr(pycolmap.CameraModelId, model)
        camera.params = pycolmap.Camera.create_from_model_name(0, model, 900, 1000, 800).params
        with pytest.raises(
            ValueError, match=f"camera 1 has the model {model}, but clba has SIMPLE"
        ):
            clba.Problem.from_pycolmap(reconstruction)


def rig_reconstruction() -> pycolmap.Reconstruction:
    """Two rigs of three cameras, whose frames, sensors and points are disturbed."""
    pycolmap.set_random_seed(5)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 3, 4
    options.num_points3D = 150
    options.sensor_from_rig_translation_stddev = 0.3
    made = pycolmap.synthesize_dataset(options)
    disturbance = pycolmap.SyntheticNoiseOptions()
    disturbance.point2D_stddev = 0.7
    disturbance.point3D_stddev = 0.02
    disturbance.rig_from_world_translation_stddev = 0.02
    disturbance.rig_from_world_rotation_stddev = 0.3
    pycolmap.synthesize_noise(disturbance, made)
    random = np.random.default_rng(2)
    for rig in made.rigs.values():
        for sensor, pose in rig.non_ref_sensors.items():
            assert pose is not None
            turn = pycolmap.Rotation3d(random.normal(0, 0.003, 3))
            moved = pose.translation + random.normal(0, 0.01, 3)
            rig.set_sensor_from_rig(sensor, pycolmap.Rigid3d(turn * pose.rotation, moved))
    return made


@pytest.mark.parametrize(
    ("refines", "linear_solver"),
    [(True, "pcg_schur"), (True, "explicit_schur"), (False, "pcg_schur")],
)
def test_rigs_end_where_colmap_ends(
    refines: bool, linear_solver: Any, tmp_path: pathlib.Path
) -> None:
    """The same cost to 1e-6, with sensors that are refined and that are not."""
    reconstruction = rig_reconstruction()
    theirs = copy.deepcopy(reconstruction)
    reconstruction.write(tmp_path)
    problem = clba.Problem.from_pycolmap(reconstruction, refine_sensor_from_rig=refines)
    assert (problem.frame_poses.shape, problem.sensor_poses.shape) == ((8, 7), (6, 7))
    start = problem.evaluate(jacobian=False).cost
    sensors = problem.sensor_poses
    summary = clba.solve(
        problem, function_tolerance=1e-12, precision="double", linear_solver=linear_solver
    )
    assert (problem.sensor_poses == sensors).all(axis=1).tolist() == (
        [True, False, False] * 2 if refines else [True] * 6
    )
    problem.update_pycolmap(reconstruction)

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_sensor_from_rig = refines
    # It stops by the gradient alone, where its default is loose.
    options.ceres.solver_options.gradient_tolerance = 1e-8
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in theirs.reg_image_ids():
        config.add_image(image_id)
    # Not two cameras, as by default: the length of a rig that is constant fixes the scale.
    config.set_constant_rig_from_world_pose(min(theirs.reg_frame_ids()))
    pycolmap.create_default_bundle_adjuster(options, config, theirs).solve()
    their_cost = clba.Problem.from_pycolmap(theirs).evaluate(jacobian=False).cost
    our_cost = clba.Problem.from_pycolmap(reconstruction).evaluate(jacobian=False).cost
    assert summary.converged and our_cost < 0.1 * start
    assert our_cost == pytest.approx(summary.final_cost, rel=1e-9)
    assert our_cost == pytest.approx(their_cost, rel=1e-6)
    assert reconstruction.is_valid()

    # A file of it has the same rigs.
    read = clba.Problem.read(tmp_path)
    assert not read.notices
    assert sorted(read.image_sensors) == sorted(problem.image_sensors)
    assert read.evaluate(jacobian=False).cost == pytest.approx(start, rel=1e-9)
    if refines:
        read.set_constant_cameras(True, ["cx", "cy"])
        clba.solve(read, function_tolerance=1e-12, precision="double")
        read.write(tmp_path / "solved/")
        solved = pycolmap.Reconstruction(tmp_path / "solved")
        assert solved.num_frames() == 8
        assert clba.Problem.from_pycolmap(solved).evaluate(jacobian=False).cost == pytest.approx(
            our_cost, rel=1e-6
        )


def test_rigs_that_changed_are_named() -> None:
    reconstruction = rig_reconstruction()
    problem = clba.Problem.from_pycolmap(reconstruction)
    problem.set_rigs(None)
    with pytest.raises(ValueError, match="has rigs of several sensors, but the problem has them"):
        problem.update_pycolmap(reconstruction)


def test_updating_another_reconstruction_changes_nothing(problem: clba.Problem) -> None:
    reconstruction = reconstruction_of(["PINHOLE", "RADIAL"], noise=0.5)
    with pytest.raises(ValueError, match="was not made by from_pycolmap"):
        problem.update_pycolmap(reconstruction)
    made = clba.Problem.from_pycolmap(reconstruction)
    clba.solve(made, max_num_iterations=1)
    point_id = max(reconstruction.point3D_ids())
    reconstruction.delete_point3D(point_id)
    before = state_of(reconstruction)
    with pytest.raises(ValueError, match=f"the reconstruction has no point {point_id}"):
        made.update_pycolmap(reconstruction)
    after = state_of(reconstruction)
    assert after["params"] == before["params"]
    np.testing.assert_array_equal(after["points"], before["points"])
    np.testing.assert_array_equal(after["poses"], before["poses"])


def test_a_model_that_changed_is_named() -> None:
    reconstruction = reconstruction_of(["PINHOLE", "RADIAL"])
    made = clba.Problem.from_pycolmap(reconstruction)
    camera = reconstruction.camera(2)
    camera.model, camera.params = pycolmap.CameraModelId.PINHOLE, PARAMS["PINHOLE"]
    with pytest.raises(ValueError, match="camera 2 has the model PINHOLE, but had RADIAL"):
        made.update_pycolmap(reconstruction)


def test_an_empty_reconstruction() -> None:
    problem = clba.Problem.from_pycolmap(pycolmap.Reconstruction())
    assert problem.num_images == 0
    problem.update_pycolmap(pycolmap.Reconstruction())
