# SPDX-License-Identifier: Apache-2.0
"""Rigs of several cameras."""

from __future__ import annotations

import numpy as np
import pytest

import clba
from clba._arrays import Doubles

IDENTITY = [1.0, 0, 0, 0, 0, 0, 0]


@pytest.fixture
def stereo() -> clba.Problem:
    """Six frames of a rig, its second camera 0.2 to the side, close to what they saw."""
    _, truth = clba.Problem.generate(num_images=6, observations_per_image=60)
    poses = np.repeat(truth.poses, 2, 0)
    poses[1::2, 4:] += [0.2, 0, 0]
    random = np.random.default_rng(1)

    def made(points: Doubles, pixels: Doubles) -> clba.Problem:
        return clba.Problem.from_arrays(
            camera_models="snavely",
            camera_params=truth.camera_params[:2],
            camera_indices=np.arange(12) % 2,
            poses=poses,
            points=points,
            image_indices=np.concatenate([2 * truth.image_indices, 2 * truth.image_indices + 1]),
            point_indices=np.tile(truth.point_indices, 2),
            pixels=pixels,
        )

    pixels = np.zeros((2 * truth.num_observations, 2))
    at = made(truth.points, pixels).evaluate(gradient=False, jacobian=False)
    assert at.residuals is not None
    pixels = at.residuals.reshape(-1, 2) + random.normal(0, 0.5, pixels.shape)
    problem = made(truth.points + random.normal(0, 0.02, truth.points.shape), pixels)
    problem.set_rigs(
        np.arange(12) // 2,
        np.arange(12) % 2,
        [IDENTITY, [1.0, 0, 0, 0, 0.2, 0, 0]],
        constant_sensors=[0],
    )
    return problem


def test_images_are_placed_by_frames_and_sensors(stereo: clba.Problem) -> None:
    np.testing.assert_array_equal(stereo.frame_poses, stereo.poses[::2])
    np.testing.assert_array_equal(stereo.image_frames, np.arange(12) // 2)
    np.testing.assert_array_equal(stereo.image_sensors, np.arange(12) % 2)
    np.testing.assert_allclose(stereo.poses[1::2, 4:], stereo.poses[::2, 4:] + [0.2, 0, 0])
    stereo.set_rigs(None)
    assert stereo.frame_poses.shape == (0, 7)
    assert (stereo.image_frames == -1).all()


def test_a_solve_keeps_them_rigid(stereo: clba.Problem) -> None:
    before = stereo.evaluate(jacobian=False).cost
    summary = clba.solve(stereo, precision="double", max_num_iterations=10)
    assert summary.final_cost < before
    baselines = np.linalg.norm(stereo.centers[1::2] - stereo.centers[::2], axis=1)
    np.testing.assert_allclose(baselines, np.linalg.norm(stereo.sensor_poses[1, 4:]), rtol=1e-12)
    assert stereo.sensor_poses[0].tolist() == IDENTITY
    assert stereo.sensor_poses[1, 4] != 0.2


def test_constants(stereo: clba.Problem) -> None:
    frames = stereo.frame_poses
    both = np.zeros((6, 2), bool)
    both[1] = [True, True]
    both[2] = [True, False]
    stereo.set_rigs(
        stereo.image_frames,
        stereo.image_sensors,
        stereo.sensor_poses,
        constant_sensors=True,
        constant_frames=both,
    )
    sensors = stereo.sensor_poses
    clba.solve(stereo, max_num_iterations=3)
    np.testing.assert_array_equal(stereo.sensor_poses, sensors)
    np.testing.assert_array_equal(stereo.frame_poses[1], frames[1])
    np.testing.assert_array_equal(stereo.frame_poses[2, :4], frames[2, :4])
    assert (stereo.frame_poses[2, 4:] != frames[2, 4:]).any()


def test_what_is_wrong_is_named(stereo: clba.Problem) -> None:
    args = (stereo.image_frames, stereo.image_sensors, stereo.sensor_poses)
    poses = stereo.poses
    with pytest.raises(ValueError, match="image 3 is in a rig; hold its frame"):
        stereo.set_constant_images([3])
    with pytest.raises(ValueError, match=r"frames has shape \(11,\), but it must be \(12,\)"):
        stereo.set_rigs(args[0][1:], *args[1:])
    with pytest.raises(ValueError, match="frame 1 has no image"):
        stereo.set_rigs(np.where(args[0] == 1, 2, args[0]), *args[1:])
    with pytest.raises(ValueError, match=r"rigs.sensors\[1\] = 1 .* num_sensors = 1"):
        stereo.set_rigs(args[0], args[1], args[2][:1])
    moved = poses.copy()
    moved[3, 4] += 1
    with pytest.raises(ValueError, match=r"image 3 is turned by .* away from where its sensor 1"):
        stereo.poses = moved
    with pytest.raises(TypeError, match="sensor_poses is None"):
        stereo.set_rigs(args[0], args[1])
    np.testing.assert_array_equal(stereo.poses, poses)
    together = moved.copy()
    together[:, 4] = poses[:, 4] + 1
    stereo.poses = together
    np.testing.assert_allclose(stereo.frame_poses, together[::2], rtol=1e-15)


def test_a_similarity_scales_rigs(stereo: clba.Problem) -> None:
    cost = stereo.evaluate(jacobian=False).cost
    baseline = float(np.linalg.norm(stereo.centers[4] - stereo.centers[0]))
    stereo.fix_gauge(images=[0, 4], pose=IDENTITY, baseline=3 * baseline)
    np.testing.assert_allclose(stereo.sensor_poses[1], [1, 0, 0, 0, 0.6, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(stereo.poses[0], IDENTITY, atol=1e-12)
    assert stereo.evaluate(jacobian=False).cost == pytest.approx(cost, rel=1e-9)
    args = (stereo.image_frames, stereo.image_sensors, stereo.sensor_poses)
    stereo.set_rigs(*args, constant_sensors=True)
    with pytest.raises(ValueError, match="scale of this problem is held by sensor 1 of a rig"):
        stereo.fix_gauge(images=[0, 4], pose=IDENTITY, baseline=1.0)


def test_rows_that_come_and_go(stereo: clba.Problem) -> None:
    stereo.add_images(stereo.poses[:1], [0])
    assert stereo.image_frames.tolist() == [*np.arange(12) // 2, -1]
    stereo.remove_observations(np.arange(0, stereo.num_observations, 5), remove_points=True)
    assert clba.solve(stereo, max_num_iterations=2).final_cost > 0
    baselines = np.linalg.norm(stereo.centers[1:12:2] - stereo.centers[:12:2], axis=1)
    np.testing.assert_allclose(baselines, np.linalg.norm(stereo.sensor_poses[1, 4:]), rtol=1e-12)


def test_rigs_grow_with_their_problem(stereo: clba.Problem) -> None:
    clba.solve(stereo, window=clba.Window(images=[0]), max_num_iterations=1)
    seen = stereo.image_indices >= 10
    stereo.add_images(stereo.poses[10:], [0, 1])
    stereo.add_observations(
        stereo.image_indices[seen] + 2, stereo.point_indices[seen], stereo.pixels[seen]
    )
    stereo.set_rigs(
        np.arange(14) // 2,
        np.arange(14) % 2,
        stereo.sensor_poses,
        frame_poses=stereo.frame_poses[[*range(6), 5]] + [0, 0, 0, 0, 0.01, 0, 0],
        constant_sensors=True,
    )
    before = stereo.poses
    clba.solve(stereo, window=clba.Window(images=[13]), max_num_iterations=3)
    moved = (stereo.poses != before).any(axis=1)
    assert moved.tolist() == [False] * 12 + [True] * 2


def test_covariances_of_a_frame_belong_together(stereo: clba.Problem) -> None:
    args = (stereo.image_frames, stereo.image_sensors, stereo.sensor_poses)
    stereo.set_rigs(*args, constant_sensors=True)
    clba.solve(stereo, max_num_iterations=10)
    covariance = stereo.covariance(gauge_images=[0, 8])
    assert covariance.num_freedoms == 6  # the rig has a length
    # The sensors are turned alike, so that both images of a frame are as uncertain in rotation.
    of_rotations = covariance.poses[:, :3, :3]
    np.testing.assert_allclose(of_rotations[3::2], of_rotations[2::2], rtol=1e-9, atol=1e-20)
    assert not covariance.poses[:2].any()


def test_windows_take_whole_frames(stereo: clba.Problem) -> None:
    before = stereo.poses
    clba.solve(stereo, window=clba.Window(images=[3]), max_num_iterations=2)
    moved = (stereo.poses != before).any(axis=1)
    assert moved.tolist() == [i in (2, 3) for i in range(12)]
