# SPDX-License-Identifier: Apache-2.0
"""The plots as figures for print."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from clba import _plot_data as data
from clba._arrays import Doubles
from clba._plot_data import State
from clba._plot_style import DARK, GRID, INK, LINE, MUTED, TINT
from clba._summary import Summary

_DPI = 150


def convergence(summary: Summary, unit: str) -> Figure:
    """Cost against iteration and against time."""
    rows = summary.iterations
    is_accepted = rows["step_is_accepted"] | (rows["iteration"] == 0)
    figure = _figure(9, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, title) in zip(
        panels, [("iteration", "Iteration"), ("seconds", "Time (s)")], strict=True
    ):
        axes.plot(rows[name], rows["cost"], color=TINT["after"], linewidth=1.2, zorder=1)
        for is_kind, color, face, label in (
            (is_accepted, LINE["after"], LINE["after"], "step accepted"),
            (~is_accepted, LINE["before"], "white", "step rejected"),
        ):
            axes.plot(
                rows[name][is_kind],
                rows["cost"][is_kind],
                "o",
                markersize=4.5,
                color=color,
                markerfacecolor=face,
                label=label,
            )
        axes.set_xlabel(title)
        axes.xaxis.set_major_locator(MaxNLocator(7, integer=name == "iteration"))
        if data.spans_decades(rows["cost"]):
            axes.set_yscale("log")
    panels[1].set_xlim(left=0)
    panels[0].set_ylabel(f"Cost ({unit}²)")
    if not is_accepted.all():
        panels[1].legend(frameon=False)
    return _styled(figure, panels)


def residuals(states: list[tuple[str, State]], unit: str) -> Figure:
    """Histogram of the residual norms."""
    bins = data.histogram(states)
    figure = _figure(6, 3.6)
    axes = figure.subplots()
    for (name, state), percents in zip(states, bins.percents, strict=True):
        axes.stairs(percents, bins.edges, fill=True, color=LINE[name], alpha=0.15)
        label = f"{name}, RMS {state.rms:.4g} {unit}"
        axes.stairs(percents, bins.edges, color=LINE[name], linewidth=1.2, label=label)
    axes.set_xscale("log")
    axes.set_xlabel(f"Residual norm ({unit})")
    axes.set_ylabel("Observations (%)")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    return _styled(figure, [axes])


def image_residuals(states: list[tuple[str, State]], unit: str) -> Figure:
    """Root mean square residual norm of each image."""
    rows = data.image_residuals(states)
    figure = _figure(7.5, 3.6)
    axes = figure.subplots()
    for (name, _), rms in zip(states, rows.rms, strict=True):
        axes.plot(
            rows.images,
            rms,
            "o",
            markersize=3 if len(rows.images) > 200 else 4.5,
            color=LINE[name],
            markerfacecolor=LINE[name] if name == "after" else "none",
            label=name,
        )
    if data.spans_decades(np.concatenate(rows.rms)):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)
    axes.set_xlabel("Image")
    axes.set_ylabel(f"RMS residual norm ({unit})")
    if len(states) > 1:
        axes.legend(frameon=False)
    return _noted(_styled(figure, [axes]), rows.note)


def timing(summary: Summary) -> Figure:
    """Wall time by step, and device time by kernel where it is known."""
    panels = [("Wall time (s)", data.seconds_by_step(summary), LINE["after"])]
    kernels = data.device_seconds_by_kernel(summary)
    if any(seconds > 0 for _, seconds in kernels):
        panels.append(("Time in kernels on the device (s)", kernels, MUTED))
    figure = _figure(5.5 * len(panels), 2.8)
    all_axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (title, parts, color) in zip(all_axes, panels, strict=True):
        names, seconds = zip(*parts, strict=True)
        total = sum(seconds) or 1
        bars = axes.barh(names, seconds, color=color, height=0.65)
        labels = [f"{100 * part / total:.1f} %" for part in seconds]
        axes.bar_label(bars, labels, padding=4, color=INK, fontsize=9)
        axes.set_xlim(0, 1.2 * (max(seconds) or 1))
        axes.set_xlabel(title)
        axes.invert_yaxis()
        axes.xaxis.set_major_locator(MaxNLocator(5))
    _styled(figure, all_axes)
    for axes in all_axes:
        axes.grid(False, axis="y")
    return figure


def scene(states: list[tuple[str, State]]) -> Figure:
    """Points and cameras, seen from above and from the side."""
    drawn = data.scene(states)
    across = np.cross(drawn.up, drawn.along)
    views = [
        ("above", np.stack([drawn.along, across], axis=1), "across"),
        ("the side", np.stack([drawn.along, drawn.up], axis=1), "up"),
    ]
    limits = [_limits(drawn, plane) for _, plane, _ in views]
    width = 5.0
    heights = [width * np.ptp(vertical) / np.ptp(along) for along, vertical in limits]
    figure = _figure((width + 0.9) * len(states), sum(heights) + 1.8)
    panels = figure.subplots(2, len(states), squeeze=False, height_ratios=heights)
    for column, (name, state) in enumerate(drawn.states):
        for row, (view, plane, label) in enumerate(views):
            axes = panels[row, column]
            _draw(axes, name, state, drawn.center, plane)
            axes.set_aspect("equal")
            axes.set_title(f"{name.capitalize()}, from {view}", fontsize=10, loc="left")
            axes.set_ylabel(f"{label} (world units)")
            axes.set_xlim(limits[row][0])
            axes.set_ylim(limits[row][1])
        panels[1, column].set_xlabel("along (world units)")
    return _noted(_styled(figure, panels.flat), drawn.note)


def _limits(drawn: data.Scene, plane: Doubles) -> list[tuple[float, float]]:
    """What both axes of a view cover: all that is drawn of all states."""
    rows = [row for _, state in drawn.states for row in (state.points, state.centers)]
    flat = (np.concatenate([*rows, drawn.center[None]]) - drawn.center) @ plane
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = 0.04 * np.max(high - low) or 1.0
    return [(float(a - margin), float(b + margin)) for a, b in zip(low, high, strict=True)]


def _draw(axes: Axes, name: str, state: data.SceneState, center: Doubles, plane: Doubles) -> None:
    points, centers = (state.points - center) @ plane, (state.centers - center) @ plane
    size = float(np.clip(4000 / max(len(points), 1), 0.15, 2))
    axes.scatter(
        points[:, 0], points[:, 1], s=size, color=TINT[name], linewidths=0, rasterized=True
    )
    if len(state.frusta) == 0:
        axes.scatter(
            centers[:, 0], centers[:, 1], s=1.5, color=DARK[name], linewidths=0, rasterized=True
        )
        return
    strokes = (state.frusta - center) @ plane
    ends = np.flatnonzero(np.isnan(strokes[:, 0]))
    lines = [part[~np.isnan(part[:, 0])] for part in np.split(strokes, ends + 1)]
    axes.add_collection(LineCollection(lines, colors=DARK[name], linewidths=0.5))


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=_DPI, layout="constrained")


def _styled(figure: Figure, panels: Iterable[Axes]) -> Figure:
    for axes in panels:
        axes.grid(True, color=GRID, linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.spines[["left", "bottom"]].set_color(MUTED)
        axes.tick_params(color=MUTED, labelcolor=INK, labelsize=9)
    return figure


def _noted(figure: Figure, note: str) -> Figure:
    """The figure with what it leaves out said below it."""
    if note:
        figure.supxlabel(note, x=0.01, ha="left", fontsize=8, color=MUTED)
    return figure
