# SPDX-License-Identifier: Apache-2.0
"""What the plots show, computed without a plotting library."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clba._arrays import Doubles, Int32s
from clba._devices import Context, context_of
from clba._problem import Problem
from clba._summary import Summary

# More would make a page slow to load and no easier to read.
MAX_POINTS = 50_000
MAX_CAMERAS = 5_000
MAX_FRUSTA = 500
MAX_IMAGES = 5_000
NUM_BINS = 60


@dataclass(frozen=True, eq=False)
class State:
    """What the plots need of a problem, copied from it, since a solve changes a problem in place.

    Attributes:
        centers: (num_images, 3), camera centres in world coordinates.
        axes: (num_images, 3, 3), rows are each image's right, up and viewing direction in the
            world.
        points: (num_points, 3).
        image_indices: (num_observations,).
        residual_norms: (num_observations,), without the loss, in pixels or in the sigmas that are
            set.
    """

    centers: Doubles
    axes: Doubles
    points: Doubles
    image_indices: Int32s
    residual_norms: Doubles

    @classmethod
    def of(cls, problem: Problem, *, device: int | str | Context | None = None) -> State:
        """The problem's present state; its residuals are computed on the device.

        Raises:
            ValueError: the problem has no observations.
        """
        if problem.num_observations == 0:
            raise ValueError("the problem has no observations, so there is nothing to draw")
        context = context_of(device)
        residuals = problem.evaluate(
            gradient=False,
            jacobian=False,
            apply_loss=False,
            precision="double" if context.device.has_double else "single",
            device=context,
        ).residuals
        assert residuals is not None
        return cls(
            centers=problem.centers,
            axes=_axes(problem),
            points=problem.points,
            image_indices=problem.image_indices,
            residual_norms=np.hypot(residuals[:, 0], residuals[:, 1]),
        )

    @property
    def rms(self) -> float:
        """Root mean square of the residual norms."""
        return float(np.sqrt(np.mean(self.residual_norms**2)))


def state_of(problem: Problem | State) -> State:
    """The state itself, or the present one of a problem."""
    if isinstance(problem, State):
        return problem
    if isinstance(problem, Problem):
        return State.of(problem)
    raise TypeError(
        f"a {type(problem).__name__} was given, but it must be a clba.Problem or a clba.plot.State"
    )


def states_of(after: Problem | State, before: Problem | State | None) -> list[tuple[str, State]]:
    """The states to draw, named, the earlier first.

    Raises:
        ValueError: they are not of the same images and points.
    """
    last = state_of(after)
    if before is None:
        return [("after", last)]
    first = state_of(before)
    for name, count, other in (
        ("images", len(last.centers), len(first.centers)),
        ("points", len(last.points), len(first.points)),
    ):
        if count != other:
            raise ValueError(
                f"before has {other} {name} and after has {count}, but they must be two states of "
                "one problem"
            )
    return [("before", first), ("after", last)]


def _axes(problem: Problem) -> Doubles:
    from scipy.spatial.transform import Rotation

    quaternions = problem.poses[:, [1, 2, 3, 0]]
    camera_from_world: Doubles = Rotation.from_quat(quaternions).as_matrix()
    # Pixels' y goes down and cameras look along +z, but snavely's go up and look along -z.
    is_snavely = np.array([model == "snavely" for model in problem.camera_models])
    signs = np.where(is_snavely[problem.camera_indices, None], [1, 1, -1], [1, -1, 1])
    return camera_from_world * signs[:, :, None]


def spans_decades(values: npt.ArrayLike) -> bool:
    """A logarithmic axis shows these values better than a linear one."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    return bool(finite.size > 0 and finite.min() > 0 and finite.max() >= 10 * finite.min())


@dataclass(frozen=True, eq=False)
class Histogram:
    """Shares of the residual norms by bins of equal width in the logarithm.

    Attributes:
        edges: (NUM_BINS + 1,).
        percents: (NUM_BINS,) of each state. Norms below the first edge count in the first bin.
    """

    edges: Doubles
    percents: list[Doubles]


def histogram(states: list[tuple[str, State]]) -> Histogram:
    """Of the residual norms of all states, by the same bins."""
    norms = [state.residual_norms[np.isfinite(state.residual_norms)] for _, state in states]
    largest = max((float(row.max()) for row in norms if row.size > 0), default=0.0)
    if largest == 0:
        largest = 1.0
    smallest = min((float(np.quantile(row, 1e-3)) for row in norms if row.size > 0), default=0.0)
    edges = np.geomspace(max(smallest, 1e-7 * largest) * 0.99, largest * 1.01, NUM_BINS + 1)
    counts = [np.histogram(np.maximum(row, edges[0]), edges)[0] for row in norms]
    return Histogram(edges, [100.0 * row / max(row.sum(), 1) for row in counts])


@dataclass(frozen=True, eq=False)
class ImageResiduals:
    """Root mean square residual norms by image.

    Attributes:
        images: indices of those shown.
        num_observations: of each of them.
        rms: of each state, one a shown image.
        note: what is left out, or "".
    """

    images: npt.NDArray[np.int64]
    num_observations: npt.NDArray[np.int64]
    rms: list[Doubles]
    note: str


def image_residuals(states: list[tuple[str, State]]) -> ImageResiduals:
    """Of the images that have observations; of many, those with the largest residuals at last."""
    num_images = len(states[-1][1].centers)
    counts = np.bincount(states[-1][1].image_indices, minlength=num_images)
    rms = []
    for _, state in states:
        sums = np.bincount(
            state.image_indices, weights=state.residual_norms**2, minlength=num_images
        )
        rms.append(np.sqrt(sums / np.maximum(counts, 1)))
    images = np.flatnonzero(counts)
    note = ""
    if len(images) > MAX_IMAGES:
        note = f"The {MAX_IMAGES:,} of {len(images):,} images with the largest residuals."
        largest = np.argsort(-rms[-1][images], kind="stable")[:MAX_IMAGES]
        images = np.sort(images[largest])
    return ImageResiduals(images, counts[images], [row[images] for row in rms], note)


def seconds_by_step(summary: Summary) -> list[tuple[str, float]]:
    """Parts of the wall time; they add up to it."""
    return [
        ("kernel build or load", summary.build_seconds),
        ("setup and upload", summary.setup_seconds),
        ("linearization", summary.linearize_seconds),
        ("linear solver", summary.linear_solver_seconds),
        ("trial states", summary.evaluate_seconds),
        ("reference cost", summary.reference_seconds),
        ("other", summary.other_seconds),
    ]


def device_seconds_by_kernel(summary: Summary) -> list[tuple[str, float]]:
    """Parts of the time in kernels; all 0 where the device cannot tell."""
    return [
        ("f, residuals", summary.residual_device_seconds),
        ("J, Jacobian and gradient", summary.jacobian_device_seconds),
        ("M⁻¹, blocks and inverses", summary.preconditioner_device_seconds),
        ("Jx, product", summary.jx_device_seconds),
        ("Jᵀy, product", summary.jty_device_seconds),
        ("Sx, fused product", summary.schur_device_seconds),
        ("vectors, dots, updates", summary.vector_device_seconds),
    ]


@dataclass(frozen=True, eq=False)
class SceneState:
    """What is drawn of a state: points and cameras that lie in the scene's box.

    Attributes:
        points: (n, 3).
        centers: (n, 3).
        images: (n,) the image of each centre.
        frusta: polylines with rows of NaN between them; empty if there are too many cameras.
    """

    points: Doubles
    centers: Doubles
    images: npt.NDArray[np.int64]
    frusta: Doubles


@dataclass(frozen=True, eq=False)
class Scene:
    """What the views of a scene show.

    Attributes:
        low, high: (3,) corners of the box, which leaves out points far from the others.
        up: (3,) unit vector.
        along: (3,) unit vector, horizontal: in which the scene is longest.
        note: what is left out, or "".
    """

    states: list[tuple[str, SceneState]]
    low: Doubles
    high: Doubles
    up: Doubles
    along: Doubles
    note: str

    @property
    def center(self) -> Doubles:
        """Of the box."""
        middle: Doubles = (self.low + self.high) / 2
        return middle


def scene(states: list[tuple[str, State]]) -> Scene:
    """Points, camera centres and directions, in one box for all states."""
    last = states[-1][1]
    low, high = _box([state for _, state in states])
    up = _up(last)
    random = np.random.default_rng(0)
    points, point_note = _subset(len(last.points), MAX_POINTS, "points", random)
    cameras, camera_note = _subset(len(last.centers), MAX_CAMERAS, "cameras", random)
    has_frusta = len(cameras) <= MAX_FRUSTA
    size = _frustum_size(last.centers[cameras], float(np.linalg.norm(high - low)))
    drawn = []
    num_far = [0, 0]
    for name, state in states:
        is_near = [
            np.all((rows >= low) & (rows <= high), axis=1)
            for rows in (state.centers[cameras], state.points[points])
        ]
        num_far = [
            max(k, int(np.count_nonzero(~near))) for k, near in zip(num_far, is_near, strict=True)
        ]
        seen, shown = cameras[is_near[0]], points[is_near[1]]
        frusta = np.empty((0, 3))
        if has_frusta:
            frusta = _frusta(state.centers[seen], state.axes[seen], size)
        drawn.append((name, SceneState(state.points[shown], state.centers[seen], seen, frusta)))
    notes = [note for note in (camera_note, point_note) if note]
    notes += [
        f"{count:,} of the {what} are far from the others and left out."
        for count, what in zip(num_far, ("cameras", "points"), strict=True)
        if count > 0
    ]
    return Scene(drawn, low, high, up, _along(last, up, low, high), " ".join(notes))


def _subset(
    count: int, limit: int, what: str, random: np.random.Generator
) -> tuple[npt.NDArray[np.int64], str]:
    if count <= limit:
        return np.arange(count), ""
    chosen = np.sort(random.choice(count, limit, replace=False))
    return chosen, f"{limit:,} of {count:,} {what}, chosen at random."


def _box(states: list[State]) -> tuple[Doubles, Doubles]:
    """Around most points of the last state and nearly all cameras of all."""
    lows, highs = [], []
    for rows, share in [(states[-1].points, 0.02), *((state.centers, 0.005) for state in states)]:
        rows = rows[np.all(np.isfinite(rows), axis=1)]
        if len(rows) > 0:
            low, high = np.quantile(rows, [share, 1 - share], axis=0)
            lows.append(low - 0.15 * (high - low))
            highs.append(high + 0.15 * (high - low))
    if not lows:
        return -np.ones(3), np.ones(3)
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    largest = float(np.max(high - low)) or 1.0
    # No side is so short that the axes would have no room for their labels.
    margin = np.maximum(0.2 * largest - (high - low), 0) / 2
    return low - margin, high + margin


def _up(state: State) -> Doubles:
    """The mean of the images' up; where they disagree, the normal of the cameras' plane."""
    mean = state.axes[:, 1].mean(axis=0) if len(state.axes) > 0 else np.zeros(3)
    length = float(np.linalg.norm(mean))
    if length > 0.5:
        up: Doubles = mean / length
        return up
    centered = state.centers - state.centers.mean(axis=0)
    normal: Doubles = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    away = (state.centers.mean(axis=0) - np.median(state.points, axis=0)) @ normal
    return -normal if away < 0 else normal


def _along(state: State, up: Doubles, low: Doubles, high: Doubles) -> Doubles:
    rows = np.concatenate([state.points, state.centers])
    rows = rows[np.all((rows >= low) & (rows <= high), axis=1)]
    if len(rows) < 2:
        rows = np.array([low, high])
    centered = rows - rows.mean(axis=0)
    level = centered - np.outer(centered @ up, up)
    along: Doubles = np.linalg.eigh(level.T @ level)[1][:, 2]
    along = along - (along @ up) * up
    return along / np.linalg.norm(along)


def _frustum_size(centers: Doubles, diagonal: float) -> float:
    """In proportion to the distances of neighbours, so that the frusta of a sequence stay apart."""
    from scipy.spatial import cKDTree

    if len(centers) < 2:
        return 0.04 * diagonal
    distances = np.asarray(cKDTree(centers).query(centers, k=2)[0])[:, 1]
    return float(np.clip(1.5 * np.median(distances), 0.008 * diagonal, 0.04 * diagonal))


def _frusta(centers: Doubles, axes: Doubles, size: float) -> Doubles:
    """A pyramid a camera, of 4 : 3, drawn in three strokes."""
    corners = np.array([[-1, 0.75, 1.6], [1, 0.75, 1.6], [1, -0.75, 1.6], [-1, -0.75, 1.6]])
    tips = centers[:, None] + 0.5 * size * corners @ axes
    apex, gap = centers[:, None], np.full((len(centers), 1, 3), np.nan)
    one, two, three, four = (tips[:, k : k + 1] for k in range(4))
    strokes = [apex, one, two, apex, three, four, apex, gap, two, three, gap, four, one, gap]
    return np.concatenate(strokes, axis=1).reshape(-1, 3)
