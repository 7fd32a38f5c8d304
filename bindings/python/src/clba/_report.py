# SPDX-License-Identifier: Apache-2.0
"""The report of a solve: one HTML page that holds all it needs."""

from __future__ import annotations

import datetime
import html
import importlib.resources
import string
from typing import Any

from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

from clba import _plot_plotly as figures
from clba._plot_data import State
from clba._summary import Summary
from clba._version import __version__

_OUTCOMES = {
    "convergence": "Converged",
    "no_convergence": "Stopped before convergence",
    "failure": "Failed",
    "user_stop": "Stopped by the user",
}


def page(summary: Summary, states: list[tuple[str, State]], *, title: str, unit: str) -> str:
    """The page; states are those before, if known, and after the solve."""
    template = importlib.resources.files("clba").joinpath("_report.html").read_text("utf-8")
    outcome = f"{_OUTCOMES.get(summary.termination, summary.termination)}. {summary.message}"
    sections = [
        _section("convergence", "Convergence", "", figures.convergence(summary, unit)),
        _section(
            "residuals",
            "Residuals",
            "Distances between observed and projected points, without the robust loss.",
            figures.residuals(states, unit),
        ),
        _section(
            "image-residuals", "Residuals by image", "", figures.image_residuals(states, unit)
        ),
        _section("scene", "Scene", "Drag to turn, scroll to zoom.", figures.scene(states)),
        _section("timing", "Time by step", "", figures.timing(summary)),
    ]
    return string.Template(template).substitute(
        title=html.escape(title),
        version=__version__,
        plotly=get_plotlyjs(),
        outcome=html.escape(outcome),
        facts="\n".join(_table(rows) for rows in _facts(summary, states, unit)),
        sections="\n".join(sections),
        report=html.escape(summary.report()),
        written=datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
    )


def _section(name: str, title: str, text: str, figure: Any) -> str:
    plot = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        include_mathjax=False,
        config=figures.CONFIG,
        div_id=name,
    )
    paragraph = f"<p>{html.escape(text)}</p>\n" if text else ""
    return f"<h2>{html.escape(title)}</h2>\n{paragraph}<figure>{plot}</figure>"


def _facts(
    summary: Summary, states: list[tuple[str, State]], unit: str
) -> list[list[tuple[str, str]]]:
    _, after = states[-1]
    rms = " → ".join(f"{state.rms:.4g}" for _, state in states)
    steps = f"{summary.num_accepted_steps} steps accepted, {summary.num_rejected_steps} rejected"
    if summary.num_invalid_steps > 0:
        steps += f", {summary.num_invalid_steps} invalid"
    behind = f"{summary.num_behind_initial:,} → {summary.num_behind_final:,} observations"
    return [
        [
            ("Cost", f"{summary.initial_cost:.6e} → {summary.final_cost:.6e} {unit}²"),
            ("RMS residual", f"{rms} {unit}"),
            ("Iterations", f"{summary.num_iterations}: {steps}"),
            ("Behind their camera", behind),
            ("Wall time", f"{summary.total_seconds:.3f} s"),
        ],
        [
            ("Images", f"{len(after.centers):,}"),
            ("Points", f"{len(after.points):,}"),
            ("Observations", f"{len(after.residual_norms):,}"),
            ("Solver", f"{summary.linear_solver}, {summary.precision} precision"),
            ("Device", summary.device),
        ],
    ]


def _table(rows: list[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
        for name, value in rows
    )
    return f"<table>{cells}</table>"
