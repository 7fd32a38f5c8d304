# SPDX-License-Identifier: Apache-2.0
"""Plots of solves, as interactive figures (plotly) or for print (matplotlib).

before = clba.plot.State.of(problem)
summary = clba.solve(problem)
clba.plot.scene(problem, before).show()
clba.plot.save(clba.plot.convergence(summary, backend="matplotlib"), "convergence.png")
clba.plot.report("report.html", summary, problem, before)

A solve changes its problem in place, so a `State` keeps what was before it. Needs the libraries of
``pip install clba[plot]``.
"""

from __future__ import annotations

import importlib
import io
import os
import pathlib
from types import ModuleType
from typing import Any, Literal

from clba import _files
from clba._plot_data import State, states_of
from clba._problem import Problem
from clba._summary import Summary

Backend = Literal["plotly", "matplotlib"]

__all__ = [
    "State",
    "convergence",
    "image_residuals",
    "report",
    "residuals",
    "save",
    "scene",
    "timing",
]


def convergence(summary: Summary, *, unit: str = "px", backend: Backend = "plotly") -> Any:
    """Cost against iteration and against time.

    Args:
        unit: of residuals: "px", or what the sigmas that are set make of them.
        backend: "plotly" or "matplotlib".

    Returns:
        A ``plotly.graph_objects.Figure`` or a ``matplotlib.figure.Figure``, as all plots.
    """
    return _drawn_by(backend).convergence(summary, unit)


def residuals(
    after: Problem | State,
    before: Problem | State | None = None,
    *,
    unit: str = "px",
    backend: Backend = "plotly",
) -> Any:
    """Histogram of the residual norms, without the loss."""
    module = _drawn_by(backend)
    return module.residuals(states_of(after, before), unit)


def image_residuals(
    after: Problem | State,
    before: Problem | State | None = None,
    *,
    unit: str = "px",
    backend: Backend = "plotly",
) -> Any:
    """Root mean square residual norm of each image, without the loss."""
    module = _drawn_by(backend)
    return module.image_residuals(states_of(after, before), unit)


def scene(
    after: Problem | State,
    before: Problem | State | None = None,
    *,
    backend: Backend = "plotly",
) -> Any:
    """Points and cameras: by plotly in three dimensions, by matplotlib from above and the side.

    Of many points a sample is drawn, and points far from the others are left out; the figure says
    how many.
    """
    module = _drawn_by(backend)
    return module.scene(states_of(after, before))


def timing(summary: Summary, *, backend: Backend = "plotly") -> Any:
    """Wall time by step, and time in kernels where the device tells it."""
    return _drawn_by(backend).timing(summary)


def save(figure: Any, path: str | os.PathLike[str]) -> None:
    """Writes a figure: one of plotly as an .html page, one of matplotlib as .png, .pdf or .svg.

    The page holds all it needs, so it works offline. A file that was there is replaced at once or,
    on failure, unchanged.

    Raises:
        ValueError: the figure's library does not write files of this name.
        TypeError: it is no figure of either library.
    """
    suffix = pathlib.Path(path).suffix.lower()
    library = type(figure).__module__.partition(".")[0]
    if library not in ("plotly", "matplotlib"):
        raise TypeError(
            f"figure is a {type(figure).__name__}, but it must be a figure of plotly or matplotlib"
        )
    suffixes = {"plotly": (".html",), "matplotlib": (".png", ".pdf", ".svg")}
    if suffix not in suffixes[library]:
        other = "plotly" if library == "matplotlib" else "matplotlib"
        hint = f"; draw it with backend={other!r}" if suffix in suffixes[other] else ""
        raise ValueError(
            f"{os.fspath(path)}: a figure of {library} is written as "
            f"{', '.join(suffixes[library])}{hint}"
        )
    if library == "plotly":
        page = figure.to_html(config=_drawn_by("plotly").CONFIG, include_mathjax=False)
        _files.write(path, page.encode())
        return
    content = io.BytesIO()
    figure.savefig(content, format=suffix[1:])
    _files.write(path, content.getvalue())


def report(
    path: str | os.PathLike[str],
    summary: Summary,
    after: Problem | State,
    before: Problem | State | None = None,
    *,
    title: str = "Bundle adjustment",
    unit: str = "px",
) -> None:
    """Writes a page with the summary, the convergence, the residuals, the scene and the timing.

    The page holds all it needs, so it works offline. A file that was there is replaced at once or,
    on failure, unchanged.
    """
    _drawn_by("plotly")
    from clba import _report

    page = _report.page(summary, states_of(after, before), title=title, unit=unit)
    _files.write(path, page.encode())


def _drawn_by(backend: str) -> ModuleType:
    """The module that draws with a library.

    Raises:
        ImportError: the library is not installed.
        ValueError: there is no such backend.
    """
    if backend not in ("plotly", "matplotlib"):
        raise ValueError(f"backend = {backend!r}, but it must be one of plotly, matplotlib")
    try:
        importlib.import_module(backend)
    except ModuleNotFoundError as error:
        if error.name != backend:
            raise
        raise ImportError(
            f"clba.plot needs {backend}, which is not installed: pip install clba[plot]",
            name=backend,
        ) from None
    return importlib.import_module(f"clba._plot_{backend}")
