# SPDX-License-Identifier: Apache-2.0
"""Problems in files: COLMAP reads what clba writes and the other way, and nothing is lost."""

from __future__ import annotations

import filecmp
import os
import pathlib
import shutil
from typing import Any

import numpy as np
import pycolmap
import pytest

import clba

# The project's folder for real problems is beside its root, unless CLBA_TEST_DATA names another.
DATA = pathlib.Path(
    os.environ.get(
        "CLBA_TEST_DATA", pathlib.Path(__file__).resolve().parents[3].parent / "shared/data"
    )
)
FORMATS = ["colmap_binary", "colmap_text"]


def synthetic(num_cameras_per_rig: int = 1, noise: float = 0.0) -> pycolmap.Reconstruction:
    pycolmap.set_random_seed(5)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = 2
    options.num_cameras_per_rig = num_cameras_per_rig
    options.num_frames_per_rig = 4
    options.num_points3D = 50
    made = pycolmap.synthesize_dataset(options)
    if noise > 0:
        disturbance = pycolmap.SyntheticNoiseOptions()
        disturbance.point2D_stddev = noise
        disturbance.point3D_stddev = 0.02
        pycolmap.synthesize_noise(disturbance, made)
        made.update_point_3d_errors()
    return made


def write(made: pycolmap.Reconstruction, folder: pathlib.Path, format: str) -> pathlib.Path:
    folder.mkdir()
    (made.write_binary if format == "colmap_binary" else made.write_text)(folder)
    return folder


def cost_of(made: pycolmap.Reconstruction) -> float:
    """1/2 the sum of squared reprojection errors, as pycolmap projects."""
    errors = [
        image.project_point(made.point3D(feature.point3D_id).xyz) - feature.xy
        for image in made.images.values()
        for feature in image.points2D
        if feature.has_point3D()
    ]
    return 0.5 * float(np.sum(np.square(errors)))


def counts(made: pycolmap.Reconstruction | clba.Problem) -> tuple[int, ...]:
    if isinstance(made, clba.Problem):
        return made.num_cameras, made.num_images, made.num_points, made.num_observations
    return (
        made.num_cameras(),
        made.num_reg_images(),
        made.num_points3D(),
        made.compute_num_observations(),
    )


def assert_same_files(a: pathlib.Path, b: pathlib.Path) -> None:
    names = sorted(path.name for path in a.iterdir())
    assert names == sorted(path.name for path in b.iterdir())
    assert filecmp.cmpfiles(a, b, names, shallow=False) == (names, [], [])


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("num_cameras_per_rig", [1, 3])
@pytest.mark.filterwarnings("ignore:.*frames of several sensors")
def test_round_trip_to_the_bit(
    format: str, num_cameras_per_rig: int, tmp_path: pathlib.Path
) -> None:
    made = synthetic(num_cameras_per_rig, noise=0.5)
    theirs = write(made, tmp_path / "theirs", format)
    problem = clba.Problem.read(theirs)
    assert problem.format == format
    assert counts(problem) == counts(made)
    problem.write(tmp_path / "ours")
    assert_same_files(theirs, tmp_path / "ours")
    other = FORMATS[1 - FORMATS.index(format)]
    problem.write(tmp_path / "other", format=other)  # type: ignore[arg-type]
    assert_same_files(write(made, tmp_path / "their other", other), tmp_path / "other")


@pytest.mark.parametrize("format", FORMATS)
def test_a_solved_model_is_read_by_colmap(format: str, tmp_path: pathlib.Path) -> None:
    made = synthetic(noise=0.5)
    problem = clba.Problem.read(write(made, tmp_path / "theirs", format))
    summary = clba.solve(problem, precision="double")
    problem.write(tmp_path / "ours")
    read = pycolmap.Reconstruction(tmp_path / "ours")
    assert counts(read) == counts(made)
    assert read.is_valid()
    assert cost_of(read) == pytest.approx(summary.final_cost, rel=1e-9)
    assert summary.final_cost < 0.9 * cost_of(made)
    written = read.compute_mean_reprojection_error()
    read.update_point_3d_errors()
    assert written == pytest.approx(read.compute_mean_reprojection_error(), rel=1e-9)
    # Frames have the poses of their images.
    for image in read.images.values():
        row = problem.image_ids.tolist().index(image.image_id)
        np.testing.assert_allclose(
            image.cam_from_world().translation, problem.poses[row, 4:], rtol=1e-12
        )


def test_a_rig_is_kept_while_its_images_agree_with_it(tmp_path: pathlib.Path) -> None:
    made = synthetic(3)
    problem = clba.Problem.read(write(made, tmp_path / "theirs", "colmap_binary"))
    assert not problem.notices
    assert (len(problem.frame_poses), len(problem.sensor_poses)) == (8, 6)
    # The world moves: P = R X + t = R (X - d) + (t + R d).
    shift = np.array([1.0, -2.0, 0.5])
    poses = problem.poses
    poses[:, 4:] += np.array(
        [pycolmap.Rotation3d(pose[[1, 2, 3, 0]]) * shift for pose in problem.poses]
    )
    problem.poses, problem.points = poses, problem.points - shift
    problem.write(tmp_path / "moved")
    moved = pycolmap.Reconstruction(tmp_path / "moved")
    assert (moved.num_rigs(), moved.num_frames()) == (2, 8)
    assert cost_of(moved) == pytest.approx(0, abs=1e-15)
    # One image leaves its rig.
    poses[5, 4] += 0.1
    with pytest.raises(ValueError, match="image 5 is turned by"):
        problem.poses = poses
    problem.set_rigs(None)
    problem.poses = poses
    problem.write(tmp_path / "split")
    split = pycolmap.Reconstruction(tmp_path / "split")
    assert (split.num_rigs(), split.num_frames(), split.num_images()) == (6, 24, 24)
    assert cost_of(split) > 1
    np.testing.assert_allclose(
        split.image(int(problem.image_ids[5])).cam_from_world().translation, poses[5, 4:]
    )


def test_names_ids_sizes_and_colours(tmp_path: pathlib.Path) -> None:
    made = synthetic()
    for point_id, point in made.points3D.items():
        point.color = np.array([point_id % 256, 7, 255], np.uint8)
    problem = clba.Problem.read(write(made, tmp_path / "model", "colmap_binary"))
    assert problem.image_names == [made.image(int(i)).name for i in problem.image_ids]
    assert sorted(problem.camera_ids) == sorted(made.cameras)
    assert problem.camera_sizes.tolist() == [[1024, 768]] * 2
    assert sorted(problem.point_ids) == sorted(made.point3D_ids())
    assert problem.point_colors.tolist() == [[i % 256, 7, 255] for i in problem.point_ids]
    new = clba.Problem()
    assert (new.format, new.notices, new.image_names) == (None, [], [])


@pytest.mark.parametrize("name", ["lund_door", "softmurata", "maupertuis"])
def test_real_models(name: str, tmp_path: pathlib.Path) -> None:
    """Read, solved a little, written: COLMAP reads it and computes the same cost."""
    folder = DATA / "colmap" / name
    if not folder.is_dir():
        pytest.skip(f"no real models: {folder} is not there; set CLBA_TEST_DATA")
    made = pycolmap.Reconstruction(folder)
    problem = clba.Problem.read(folder)
    assert counts(problem) == counts(made)
    summary = clba.solve(problem, max_num_iterations=3)
    assert summary.final_cost < summary.initial_cost
    for format in FORMATS:
        problem.write(tmp_path / format, format=format)  # type: ignore[arg-type]
        read = pycolmap.Reconstruction(tmp_path / format)
        assert counts(read) == counts(made)
        assert cost_of(read) == pytest.approx(summary.reference_final_cost, rel=1e-9)
        written = read.compute_mean_reprojection_error()
        read.update_point_3d_errors()
        assert written == pytest.approx(read.compute_mean_reprojection_error(), rel=1e-9)
    again = clba.Problem.read(folder)
    again.write(tmp_path / "same")
    if name == "softmurata":  # the others are texts with other numbers of digits
        assert_same_files(folder, tmp_path / "same")
    else:
        read_again = clba.Problem.read(tmp_path / "same")
        for array in ("poses", "points", "pixels", "image_indices", "point_ids", "point_colors"):
            np.testing.assert_array_equal(getattr(read_again, array), getattr(again, array))


def test_bal_to_colmap_and_back(hall: clba.Problem, tmp_path: pathlib.Path) -> None:
    """The flip of the camera's frame: the same cost on both sides, and the same problem again."""
    cost = hall.evaluate(jacobian=False, gradient=False).cost
    hall.write(tmp_path / "model", format="colmap_text")
    assert cost_of(pycolmap.Reconstruction(tmp_path / "model")) == pytest.approx(cost, rel=1e-9)
    model = clba.Problem.read(tmp_path / "model")
    assert set(model.camera_models) == {"radial"}
    assert (model.pixels >= 0).all()
    assert (model.pixels <= model.camera_sizes[model.camera_indices[model.image_indices]]).all()
    with pytest.raises(ValueError, match=r"do not hold.*principal points.*names and ids of images"):
        model.write(tmp_path / "back.txt")
    assert not (tmp_path / "back.txt").exists()
    model.write(tmp_path / "back.txt", accept_loss=True)
    back = clba.Problem.read(tmp_path / "back.txt")
    assert back.format == "bal"
    assert back.evaluate(jacobian=False, gradient=False).cost == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(back.centers, hall.centers, atol=1e-12)
    # A rotation is two quaternions, q and -q.
    same = np.abs(np.sum(back.poses[:, :4] * hall.poses[:, :4], axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-14)
    np.testing.assert_array_equal(back.points, hall.points)
    assert back.camera_models == ["snavely"] * hall.num_images


def test_progress_and_its_end(tmp_path: pathlib.Path) -> None:
    folder = write(synthetic(), tmp_path / "model", "colmap_text")
    seen: list[float] = []
    clba.Problem.read(folder, progress=seen.append)  # type: ignore[arg-type]
    assert seen == sorted(seen)
    assert 0 < seen[-1] <= 1
    with pytest.raises(clba.CancelledError, match="progress callback"):
        clba.Problem.read(folder, progress=lambda fraction: True)

    def fails(fraction: float) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        clba.Problem.read(folder, progress=fails)


def test_errors_leave_what_was_there(hall: clba.Problem, tmp_path: pathlib.Path) -> None:
    folder = write(synthetic(), tmp_path / "model", "colmap_binary")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(OSError, match="holds a binary one"):
        hall.write(folder, format="colmap_text")
    with pytest.raises(ValueError, match=r"format = 'stl', but it must be one of"):
        hall.write(folder, format="stl")  # type: ignore[arg-type]
    with pytest.raises(OSError, match="it is a folder"):
        hall.write(folder, format="bal")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    # A model without frames takes the place of one with frames, all of it.
    hall.write(folder, format="colmap_binary")
    assert sorted(path.name for path in folder.iterdir()) == [
        "cameras.bin",
        "images.bin",
        "points3D.bin",
    ]
    assert counts(pycolmap.Reconstruction(folder)) == counts(hall)


def test_other_models_are_refused_by_name(tmp_path: pathlib.Path) -> None:
    made = synthetic()
    camera = next(iter(made.cameras.values()))
    unknown = pycolmap.Camera.create_from_model_name(
        0, "RAD_TAN_THIN_PRISM_FISHEYE", 900, 1000, 800
    )
    camera.model, camera.params = unknown.model, unknown.params
    for format in FORMATS:
        folder = write(made, tmp_path / format, format)
        with pytest.raises(ValueError, match=r"camera \d has the model RAD_TAN_THIN_PRISM_FISHEYE"):
            clba.Problem.read(folder)


def test_what_is_no_problem(tmp_path: pathlib.Path) -> None:
    def refuse(path: pathlib.Path, match: str) -> Any:
        with pytest.raises((clba.FormatError, clba.FileError), match=match):
            clba.Problem.read(path)

    refuse(tmp_path, "none of the formats that are read")
    (tmp_path / "empty").write_bytes(b"")
    refuse(tmp_path / "empty", "is empty")
    (tmp_path / "picture").write_bytes(b"\x89PNG\r\n")
    refuse(tmp_path / "picture", "none of the formats")
    refuse(tmp_path / "absent", "absent")
    folder = write(synthetic(), tmp_path / "model", "colmap_binary")
    (folder / "points3D.bin").unlink()
    refuse(folder, "points3D.bin")
    shutil.copy(tmp_path / "picture", folder / "points3D.bin")
    refuse(folder, "points3D.bin")
