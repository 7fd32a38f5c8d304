# SPDX-License-Identifier: Apache-2.0
"""clba.plot: what the figures hold, of either library."""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import clba
from clba import _plot_data, plot


@pytest.fixture
def before(hall: clba.Problem) -> plot.State:
    return plot.State.of(hall)


@pytest.fixture
def summary(hall: clba.Problem, before: plot.State) -> clba.Summary:
    return clba.solve(hall, linear_solver="pcg_schur", precision="double")


def norms(problem: clba.Problem) -> Any:
    residuals = problem.evaluate(jacobian=False, apply_loss=False).residuals
    return np.linalg.norm(residuals, axis=1)


def directions(problem: clba.Problem, state: plot.State) -> Any:
    """Right, up and forward coordinates of each observation's point, seen from its image."""
    rays = problem.points[problem.point_indices] - problem.centers[problem.image_indices]
    return np.einsum("nij,nj->ni", state.axes[problem.image_indices], rays)


def test_axes_of_images_that_look_along_minus_z() -> None:
    _, truth = clba.Problem.generate("hall", num_images=6, pixel_noise=0.0)
    right, up, forward = directions(truth, plot.State.of(truth)).T
    assert (forward > 0).all()
    x, y = truth.pixels.T
    assert (np.sign(right) == np.sign(x)).mean() > 0.999
    assert (np.sign(up) == np.sign(y)).mean() > 0.999


def test_axes_of_images_that_look_along_z(problem: clba.Problem) -> None:
    right, up, forward = directions(problem, plot.State.of(problem)).T
    assert (forward > 0).all()
    x, y = (problem.pixels - [320, 240]).T
    assert np.corrcoef(right / forward, x)[0, 1] > 0.99
    assert np.corrcoef(up / forward, -y)[0, 1] > 0.99


def test_state_is_a_copy_without_the_loss(hall: clba.Problem) -> None:
    expected = norms(hall)
    hall.set_loss("cauchy", 0.1)
    before = plot.State.of(hall)
    points = hall.points
    clba.solve(hall)
    np.testing.assert_allclose(before.residual_norms, expected, rtol=1e-12)
    np.testing.assert_array_equal(before.points, points)
    assert before.rms == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-12)


def test_convergence(summary: clba.Summary) -> None:
    rows = summary.iterations
    assert rows["step_is_accepted"][1:].all()
    figure = plot.convergence(summary)
    markers = [trace for trace in figure.data if trace.mode == "markers"]
    for trace, name in zip(markers, ("iteration", "seconds"), strict=True):
        np.testing.assert_array_equal(trace.x, rows[name])
        np.testing.assert_array_equal(trace.y, rows["cost"])
    assert figure.layout.yaxis.type == "log"  # from 1e5 to 1e2
    left, right = plot.convergence(summary, backend="matplotlib").axes
    np.testing.assert_array_equal(left.lines[0].get_ydata(), rows["cost"])
    np.testing.assert_array_equal(right.lines[0].get_xdata(), rows["seconds"])
    assert (left.get_xlabel(), right.get_xlabel()) == ("Iteration", "Time (s)")
    assert (left.get_ylabel(), left.get_yscale()) == ("Cost (px²)", "log")


def test_rejected_steps_are_marked(hall: clba.Problem) -> None:
    # No step is as good as this asks for.
    summary = clba.solve(hall, min_relative_decrease=0.9999999, max_num_iterations=4)
    assert summary.num_rejected_steps > 0
    names = [trace.name for trace in plot.convergence(summary).data]
    assert names.count("step rejected") == 2
    panels = plot.convergence(summary, backend="matplotlib").axes
    marked = panels[0].lines[2].get_xdata()
    assert len(marked) == summary.num_rejected_steps + summary.num_invalid_steps


def test_residuals(hall: clba.Problem, before: plot.State, summary: clba.Summary) -> None:
    figure = plot.residuals(hall, before)
    bars = plot.residuals(hall, before, backend="matplotlib").axes[0].patches
    assert [trace.name.split(",")[0] for trace in figure.data] == ["before", "after"]
    for trace, drawn, values in zip(
        figure.data, bars[::2], (before.residual_norms, norms(hall)), strict=True
    ):
        assert trace.y.sum() == pytest.approx(100)
        inside = (values >= trace.x[10]) & (values < trace.x[20])
        assert trace.y[10:20].sum() == pytest.approx(100 * inside.mean())
        np.testing.assert_array_equal(drawn.get_data().values, trace.y[:-1])
    assert figure.layout.xaxis.title.text == "Residual norm (px)"


def test_residuals_of_zero_have_a_histogram(before: plot.State) -> None:
    zero = np.zeros_like(before.residual_norms)
    state = plot.State(before.centers, before.axes, before.points, before.image_indices, zero)
    (trace,) = plot.residuals(state).data
    assert trace.y[0] == 100 and np.isfinite(trace.x).all()


def test_residuals_by_image(hall: clba.Problem, before: plot.State) -> None:
    squares = before.residual_norms**2
    expected = [np.sqrt(squares[hall.image_indices == i].mean()) for i in range(hall.num_images)]
    (trace,) = plot.image_residuals(hall).data
    np.testing.assert_allclose(trace.y, expected, rtol=1e-12)
    (line,) = plot.image_residuals(hall, backend="matplotlib").axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), expected, rtol=1e-12)


def test_of_many_images_the_worst_are_shown(
    before: plot.State, monkeypatch: pytest.MonkeyPatch
) -> None:
    (everything,) = plot.image_residuals(before).data
    monkeypatch.setattr(_plot_data, "MAX_IMAGES", 2)
    figure = plot.image_residuals(before)
    assert set(figure.data[0].x) == set(np.argsort(everything.y)[-2:])
    note = "The 2 of 6 images with the largest residuals."
    assert figure.layout.annotations[0].text == note
    assert plot.image_residuals(before, backend="matplotlib").get_supxlabel() == note


def test_scene(hall: clba.Problem, before: plot.State, summary: clba.Summary) -> None:
    figure = plot.scene(hall, before)
    assert [trace.legendgroup for trace in figure.data] == ["before"] * 3 + ["after"] * 3
    assert [trace.visible for trace in figure.data] == [False] * 3 + [True] * 3
    points, frusta, centers = figure.data[3:]
    box = [(axis.range[0], axis.range[1]) for axis in map(figure.layout.scene.__getitem__, AXES)]
    low, high = np.transpose(box)
    inside = ((hall.points >= low) & (hall.points <= high)).all(axis=1)
    assert inside.mean() > 0.9
    np.testing.assert_array_equal(
        np.stack([points.x, points.y, points.z], axis=1), hall.points[inside].astype(np.float32)
    )
    np.testing.assert_allclose(centers.x, hall.centers[:, 0], rtol=1e-6)
    assert np.isfinite(frusta.x).sum() == 11 * hall.num_images
    assert figure.layout.scene.aspectmode == "data"
    assert len(figure.layout.updatemenus[0].buttons) == 3


AXES = ("xaxis", "yaxis", "zaxis")


def test_scene_for_print(hall: clba.Problem, before: plot.State) -> None:
    panels = plot.scene(hall, before, backend="matplotlib").axes
    titles = [axes.get_title(loc="left") for axes in panels]
    assert titles == [
        "Before, from above",
        "After, from above",
        "Before, from the side",
        "After, from the side",
    ]
    assert all(axes.get_aspect() == 1 for axes in panels)
    (drawn,) = {len(axes.collections[0].get_offsets()) for axes in panels}
    assert 0.9 * hall.num_points < drawn <= hall.num_points


def test_of_many_points_and_cameras_a_sample_is_drawn(
    hall: clba.Problem, before: plot.State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_plot_data, "MAX_POINTS", 20)
    monkeypatch.setattr(_plot_data, "MAX_FRUSTA", 5)
    monkeypatch.setattr(_plot_data, "MAX_CAMERAS", 4)
    figure = plot.scene(hall)
    points, frusta, centers = figure.data
    assert len(points.x) <= 20 and len(centers.x) == 4
    note = f"4 of 6 cameras, chosen at random. 20 of {hall.num_points} points, chosen at random."
    assert figure.layout.annotations[0].text.startswith(note)
    monkeypatch.setattr(_plot_data, "MAX_FRUSTA", 3)
    assert len(plot.scene(hall).data) == 2
    panels = plot.scene(hall, backend="matplotlib").axes
    assert len(panels[0].collections[1].get_offsets()) == 4


def test_cameras_of_both_states_are_in_the_box(before: plot.State) -> None:
    moved = plot.State(
        before.centers + [200.0, 0, 0],
        before.axes,
        before.points,
        before.image_indices,
        before.residual_norms,
    )
    figure = plot.scene(before, moved)
    assert [len(figure.data[k].x) for k in (2, 5)] == [len(before.centers)] * 2


def test_far_points_are_left_out(before: plot.State) -> None:
    points = before.points.copy()
    points[3] = 1e6
    state = plot.State(
        before.centers, before.axes, points, before.image_indices, before.residual_norms
    )
    figure = plot.scene(state)
    assert np.max(figure.data[0].x) < 1e3
    assert "far from the others and left out" in figure.layout.annotations[0].text


def test_timing(summary: clba.Summary) -> None:
    wall, device = plot.timing(summary).data
    assert sum(wall.x) == pytest.approx(summary.total_seconds, rel=1e-6)
    assert dict(zip(wall.y, wall.x, strict=True))["linear solver"] == summary.linear_solver_seconds
    assert sum(device.x) > 0
    panels = plot.timing(summary, backend="matplotlib").axes
    assert [bar.get_width() for bar in panels[0].patches] == list(wall.x)


def test_save(before: plot.State, tmp_path: pathlib.Path) -> None:
    page, image = tmp_path / "scene.html", tmp_path / "scene.png"
    image.write_bytes(b"old")
    plot.save(plot.scene(before), page)
    plot.save(plot.scene(before, backend="matplotlib"), image)
    assert page.stat().st_size > 3e6  # with the library
    assert "cdn.plot.ly/plotly" not in page.read_text(encoding="utf-8")
    assert image.read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.html", "scene.png"]


def test_save_refuses(before: plot.State, tmp_path: pathlib.Path) -> None:
    page, print_ = plot.residuals(before), plot.residuals(before, backend="matplotlib")
    with pytest.raises(ValueError, match=r"a\.png: .* written as \.html; draw it with backend="):
        plot.save(page, tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"written as \.png, \.pdf, \.svg; draw it with"):
        plot.save(print_, tmp_path / "a.html")
    with pytest.raises(TypeError, match="figure is a str"):
        plot.save("figure", tmp_path / "a.png")
    with pytest.raises(clba.FileError, match="none/a.png: cannot be written: No such file"):
        plot.save(print_, tmp_path / "none/a.png")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_file(
    before: plot.State, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.svg"
    target.write_text("old", encoding="utf-8")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(clba.FileError, match=r"a\.svg: cannot be written: No space left"):
        plot.save(plot.residuals(before, backend="matplotlib"), target)
    assert [path.read_text(encoding="utf-8") for path in tmp_path.iterdir()] == ["old"]


def test_misuse(hall: clba.Problem, before: plot.State, problem: clba.Problem) -> None:
    with pytest.raises(ValueError, match="before has 6 images and after has 10"):
        plot.scene(problem, before)
    with pytest.raises(TypeError, match="a str was given, but it must be a clba.Problem"):
        plot.residuals("problem")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="backend = 'bokeh', but it must be one of plotly, mat"):
        plot.residuals(before, backend="bokeh")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no observations"):
        plot.State.of(clba.Problem())


@pytest.mark.parametrize("library", ["plotly", "matplotlib"])
def test_without_the_library(
    library: plot.Backend, before: plot.State, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"needs {library}.*: pip install clba\[plot\]") as info:
        plot.residuals(before, backend=library)
    assert info.value.name == library


def test_libraries_are_loaded_when_needed() -> None:
    code = "import sys, clba.plot; print({'plotly', 'matplotlib', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
