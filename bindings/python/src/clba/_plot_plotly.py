# SPDX-License-Identifier: Apache-2.0
"""The plots as interactive figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go  # type: ignore[import-untyped]
from plotly.subplots import make_subplots  # type: ignore[import-untyped]

from clba import _plot_data as data
from clba._arrays import Doubles
from clba._plot_data import State
from clba._plot_style import DARK, GRID, INK, LINE, MUTED, TINT
from clba._summary import Summary

# The page's own buttons alone: one of the library's would upload the data.
CONFIG = {
    "displaylogo": False,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "tableRotation"],
    "plotlyServerURL": "",
    "responsive": True,
    "showSendToCloud": False,
}
_FONT = {"family": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"}
_LOG_AXIS = {"type": "log", "dtick": 1, "minor": {"ticks": "outside", "ticklen": 3, "dtick": "D1"}}


def convergence(summary: Summary, unit: str) -> Any:
    """Cost against iteration and against time."""
    rows = summary.iterations
    figure = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.05)
    kinds = [("accepted", rows["step_is_accepted"] | (rows["iteration"] == 0), LINE["after"])]
    kinds += [("rejected", ~kinds[0][1], LINE["before"])]
    for column, (name, title) in enumerate(
        [("iteration", "Iteration"), ("seconds", "Time (s)")], start=1
    ):
        figure.add_scatter(
            x=rows[name],
            y=rows["cost"],
            mode="lines",
            line={"color": TINT["after"], "width": 1.5},
            hoverinfo="skip",
            showlegend=False,
            name="cost",
            row=1,
            col=column,
        )
        for kind, is_kind, color in kinds:
            if not is_kind.any():
                continue
            figure.add_scatter(
                x=rows[name][is_kind],
                y=rows["cost"][is_kind],
                customdata=np.stack([rows["iteration"], rows["seconds"]], axis=1)[is_kind],
                mode="markers",
                marker={
                    "color": color,
                    "size": 7,
                    "symbol": "circle" if kind == "accepted" else "circle-open",
                },
                hovertemplate="iteration %{customdata[0]}, %{customdata[1]:.4g} s<br>"
                f"cost %{{y:.9g}} {unit}²<extra>step {kind}</extra>",
                name=f"step {kind}",
                legendgroup=kind,
                showlegend=column == 1 and not rows["step_is_accepted"][1:].all(),
                row=1,
                col=column,
            )
        figure.update_xaxes(title=title, row=1, col=column)
    latest = float(rows["seconds"].max()) or 1.0
    figure.update_xaxes(range=[0, 1.05 * latest], row=1, col=2)
    if data.spans_decades(rows["cost"]):
        figure.update_yaxes(**_LOG_AXIS)
    figure.update_yaxes(title=f"Cost ({unit}²)", row=1, col=1)
    return _styled(figure, 360)


def residuals(states: list[tuple[str, State]], unit: str) -> Any:
    """Histogram of the residual norms."""
    bins = data.histogram(states)
    figure = go.Figure()
    for (name, state), percents in zip(states, bins.percents, strict=True):
        figure.add_scatter(
            x=bins.edges,
            y=np.append(percents, 0),
            mode="lines",
            line={"color": LINE[name], "width": 1.5, "shape": "hv"},
            fill="tozeroy",
            fillcolor=_translucent(LINE[name]),
            name=f"{name}, RMS {state.rms:.4g} {unit}",
            hovertemplate=f"from %{{x:.3g}} {unit}: %{{y:.2f}} %<extra>{name}</extra>",
        )
    figure.update_xaxes(title=f"Residual norm ({unit})", **_LOG_AXIS)
    figure.update_yaxes(title="Observations (%)", rangemode="tozero")
    return _styled(figure, 360)


def image_residuals(states: list[tuple[str, State]], unit: str) -> Any:
    """Root mean square residual norm of each image."""
    rows = data.image_residuals(states)
    figure = go.Figure()
    for (name, _), rms in zip(states, rows.rms, strict=True):
        figure.add_scatter(
            x=rows.images,
            y=rms,
            customdata=rows.num_observations,
            mode="markers",
            marker={
                "color": LINE[name],
                "size": 5 if len(rows.images) > 200 else 7,
                "symbol": "circle" if name == "after" else "circle-open",
            },
            name=name,
            hovertemplate="image %{x}, %{customdata} observations<br>"
            f"RMS %{{y:.4g}} {unit}<extra>{name}</extra>",
        )
    figure.update_xaxes(title="Image")
    figure.update_yaxes(title=f"RMS residual norm ({unit})", rangemode="tozero")
    if data.spans_decades(np.concatenate(rows.rms)):
        figure.update_yaxes(**_LOG_AXIS)
    return _noted(_styled(figure, 360), rows.note)


def timing(summary: Summary) -> Any:
    """Wall time by step, and device time by kernel where it is known."""
    panels = [("Wall time (s)", data.seconds_by_step(summary), LINE["after"])]
    kernels = data.device_seconds_by_kernel(summary)
    if any(seconds > 0 for _, seconds in kernels):
        panels.append(("Time in kernels on the device (s)", kernels, MUTED))
    figure = make_subplots(1, len(panels), horizontal_spacing=0.22)
    for column, (title, parts, color) in enumerate(panels, start=1):
        names, seconds = zip(*parts, strict=True)
        total = sum(seconds)
        figure.add_bar(
            x=seconds,
            y=names,
            orientation="h",
            marker={"color": color},
            text=[f"{_seconds(part)}  {100 * part / (total or 1):.1f} %" for part in seconds],
            textposition="outside",
            cliponaxis=False,
            hoverinfo="skip",
            showlegend=False,
            name=title,
            row=1,
            col=column,
        )
        largest = max(seconds) or 1.0
        figure.update_xaxes(title=title, range=[0, 1.45 * largest], nticks=6, row=1, col=column)
        figure.update_yaxes(autorange="reversed", showgrid=False, row=1, col=column)
    return _styled(figure, 320)


def scene(states: list[tuple[str, State]]) -> Any:
    """Points and cameras in three dimensions, with buttons for before and after."""
    drawn = data.scene(states)
    figure = go.Figure()
    names = [name for name, _ in drawn.states]
    for name, state in drawn.states:
        common = {"name": name, "legendgroup": name, "visible": name == names[-1]}
        figure.add_scatter3d(
            **_xyz(state.points),
            mode="markers",
            marker={"size": 1.5, "color": TINT[name]},
            hoverinfo="skip",
            showlegend=False,
            **common,
        )
        if len(state.frusta) > 0:
            figure.add_scatter3d(
                **_xyz(state.frusta),
                mode="lines",
                line={"color": DARK[name], "width": 2},
                connectgaps=False,
                hoverinfo="skip",
                showlegend=False,
                **common,
            )
        figure.add_scatter3d(
            **_xyz(state.centers),
            mode="markers",
            marker={"size": 2.5, "color": DARK[name]},
            customdata=state.images,
            hovertemplate=f"image %{{customdata}}<extra>{name}</extra>",
            showlegend=False,
            **common,
        )
    if len(names) > 1:
        _add_buttons(figure, names)
    axes = {
        f"{axis}axis": {
            "title": {"text": f"{axis} (world units)"},
            "range": [float(drawn.low[k]), float(drawn.high[k])],
            "showbackground": False,
            "gridcolor": GRID,
            "zeroline": False,
            "nticks": 6,
        }
        for k, axis in enumerate("xyz")
    }
    figure.update_scenes(
        aspectmode="data",
        camera={"eye": _vector(_eye(drawn)), "up": _vector(drawn.up)},
        **axes,
    )
    return _noted(_styled(figure, 640), drawn.note)


def _eye(drawn: data.Scene) -> Doubles:
    """From where the whole box is seen, in plotly's units: the box's volume is 1, its centre 0."""
    across = np.cross(drawn.up, drawn.along)
    toward = -0.8 * across + 0.35 * drawn.along + 0.6 * drawn.up
    toward /= np.linalg.norm(toward)
    right = np.cross(drawn.up, toward)
    right /= np.linalg.norm(right)
    extents = drawn.high - drawn.low
    signs = np.stack(np.meshgrid(*3 * [[-0.5, 0.5]]), axis=-1).reshape(-1, 3)
    corners = signs * extents / np.prod(extents) ** (1 / 3)
    # The view's angle is 45 degrees in height; the figure is wider than it is high.
    x, y = np.abs(corners @ right) / 1.5, np.abs(corners @ np.cross(toward, right))
    distance = np.max(np.maximum(x, y) / np.tan(np.pi / 8) + corners @ toward)
    eye: Doubles = distance * toward
    return eye


def _add_buttons(figure: Any, names: list[str]) -> None:
    groups = [trace.legendgroup for trace in figure.data]
    choices = [(name.capitalize(), {name}) for name in reversed(names)] + [("Both", set(names))]
    figure.update_layout(
        updatemenus=[
            {
                "type": "buttons",
                "direction": "right",
                "x": 0,
                "y": 1,
                "xanchor": "left",
                "yanchor": "bottom",
                "pad": {"b": 6},
                "bgcolor": "white",
                "bordercolor": GRID,
                "showactive": True,
                "buttons": [
                    {
                        "label": label,
                        "method": "restyle",
                        "args": [{"visible": [group in shown for group in groups]}],
                    }
                    for label, shown in choices
                ],
            }
        ]
    )


def _xyz(rows: Doubles) -> dict[str, Any]:
    return {axis: rows[:, k].astype(np.float32) for k, axis in enumerate("xyz")}


def _vector(values: Doubles) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _seconds(value: float) -> str:
    return f"{value:.3g} s" if value >= 1 else f"{1000 * value:.3g} ms"


def _translucent(color: str) -> str:
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.15)"


def _styled(figure: Any, height: int) -> Any:
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 70, "r": 20, "t": 40, "b": 55},
        font={**_FONT, "color": INK, "size": 13},
        legend={"orientation": "h", "x": 0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"},
        hoverlabel={"font": _FONT},
        bargap=0.35,
    )
    figure.update_xaxes(showline=True, linecolor=MUTED, ticks="outside", gridcolor=GRID)
    figure.update_yaxes(showline=True, linecolor=MUTED, ticks="outside", gridcolor=GRID)
    figure.update_xaxes(zeroline=False)
    figure.update_yaxes(zeroline=False, exponentformat="power")
    return figure


def _noted(figure: Any, note: str) -> Any:
    """The figure with what it leaves out said below it."""
    if note:
        figure.add_annotation(
            text=note,
            xref="paper",
            yref="paper",
            x=0,
            y=0,
            yshift=-38,
            xanchor="left",
            yanchor="top",
            showarrow=False,
            font={"size": 12, "color": MUTED},
        )
        figure.update_layout(margin_b=75)
    return figure
