"""The machine's motion as points in space: data for the animation in a report, and a strobe picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.plotting import PALETTE, WIDTH, heading, new_figure, style_axes

Array = NDArray[np.float64]

FRAMES_PER_SECOND = 25


@dataclass(frozen=True)
class Motion:
    """Points of the machine over time, z up.

    time     shape (n,) [s], strictly increasing
    points   label -> shape (n, 3) [m]
    lines    polylines, each a sequence of labels; none given: all points in their order
    tip      label of the point that leaves a trail; none given: the last one
    turning  the side view looks at the plane of the machine's axis (z) and its tip; else at the x-z plane
    ground   height of the ground [m], drawn in the side view
    """

    time: Array
    points: Mapping[str, Array]
    lines: tuple[tuple[str, ...], ...] = ()
    tip: str = ""
    turning: bool = True
    ground: float = 0.0

    def __post_init__(self) -> None:
        """Refuse shapes that do not fit and numbers that are not finite."""
        for label, values in self.points.items():
            if values.shape != (len(self.time), 3):
                raise Problem(f"motion: {label!r} has shape {values.shape}, expected ({len(self.time)}, 3)")
            if not np.isfinite(values).all():
                raise Problem(f"motion: {label!r} expected finite positions, got one that is not")
        unknown = {name for line in self.drawn for name in line} | {self.leader} - {""}
        if unknown - set(self.points):
            missing = ", ".join(sorted(unknown - set(self.points)))
            raise Problem(f"motion: {missing} expected among the points, got {', '.join(self.points)}")

    @property
    def drawn(self) -> tuple[tuple[str, ...], ...]:
        """The polylines to draw."""
        return self.lines or (tuple(self.points),)

    @property
    def views(self) -> tuple[str, ...]:
        """The views worth showing: a planar machine needs no view from above."""
        return ("side", "top") if self.turning else ("side",)

    @property
    def leader(self) -> str:
        """The label of the point that leaves a trail."""
        return self.tip or list(self.points)[-1]

    def side(self, label: str) -> Array:
        """Side view of a point, shape (n, 2) [m]: distance along the arm, height."""
        x, y, z = self.points[label].T
        if not self.turning:
            return np.column_stack((x, z))
        tip = self.points[self.leader]
        heading = np.arctan2(tip[:, 1], tip[:, 0])
        return np.column_stack((x * np.cos(heading) + y * np.sin(heading), z))

    def top(self, label: str) -> Array:
        """View from above, shape (n, 2) [m]."""
        return self.points[label][:, :2]

    def at(self, time: Array) -> Motion:
        """The motion at other instants, shape (m,) [s], by linear interpolation."""
        points = {
            label: np.column_stack([np.interp(time, self.time, axis) for axis in values.T])
            for label, values in self.points.items()
        }
        return replace(self, time=time, points=points)


def frames(motion: Motion, ghost: Motion | None = None) -> dict[str, Any]:
    """What the animation needs, as plain numbers [m, s] to the millimetre, 25 frames per second.

    ghost   the reference's motion of the same points, drawn pale behind the machine
    """
    ends = (motion.time[0], motion.time[-1])
    count = max(2, round((ends[1] - ends[0]) * FRAMES_PER_SECOND) + 1)
    time = np.linspace(*ends, count)
    machines = [m.at(time) for m in (motion, ghost) if m is not None]
    views = {name: [_view(m, name) for m in machines] for name in motion.views}
    bounds = {name: _bounds(machines, name) for name in views}
    return {
        "step": float(time[1] - time[0]),
        "start": float(time[0]),
        "labels": list(motion.points),
        "lines": [[list(motion.points).index(label) for label in line] for line in motion.drawn],
        "tip": list(motion.points).index(motion.leader),
        "ground": motion.ground,
        "bounds": bounds,
        "views": views,
        "deviation": _deviation(machines) if len(machines) == 2 else None,
    }


def strobe(motion: Motion, poses: int = 9, title: str = "") -> Figure:
    """A still picture: the machine at `poses` instants, evenly spread over the path of its tip, by time."""
    figure = new_figure(WIDTH, 4.6)
    still = motion.at(_instants(motion, poses))
    panels = figure.subplots(1, len(motion.views), squeeze=False)[0]
    start, stop = float(motion.time[0]), float(motion.time[-1])
    early = LinearSegmentedColormap.from_list("early", colormaps["viridis"](np.linspace(0.0, 0.88, 64)))
    scale = ScalarMappable(Normalize(start, stop), early)
    for axes, view in zip(panels, motion.views, strict=True):
        _draw_view(axes, motion, view)
        for k, colour in enumerate(scale.to_rgba(still.time)):
            for line in still.drawn:
                xy = np.array([getattr(still, view)(label)[k] for label in line])
                style = {"linewidth": 2.6, "marker": "o", "markersize": 3.2, "solid_joinstyle": "round"}
                axes.plot(*xy.T, color=tuple(colour), **style)
    bar = figure.colorbar(scale, ax=figure.axes, shrink=0.8, pad=0.01)
    bar.set_label("time [s]", color=PALETTE.ink)
    heading(figure, title)
    return figure


def _draw_view(axes: Axes, motion: Motion, view: str) -> None:
    """The path of the tip, ground or axis of rotation, labels; both axes to one scale."""
    if view == "side":
        style_axes(axes, "along the arm [m]" if motion.turning else "x [m]", "height [m]", size=10)
        axes.axhline(motion.ground, color=PALETTE.faint, linewidth=1.2)
    else:
        style_axes(axes, "x [m]", "y [m]", size=10)
        axes.plot(0, 0, marker="+", color=PALETTE.faint, markersize=10)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title({"side": "Side view", "top": "From above"}[view], loc="left", fontsize=10)
    path = getattr(motion, view)(motion.leader)
    axes.plot(*path.T, color=PALETTE.faint, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1)


def _instants(motion: Motion, poses: int) -> Array:
    """Times [s] at which the tip has gone equal parts of its way; a machine at rest gives equal times."""
    steps = np.linalg.norm(np.diff(motion.points[motion.leader], axis=0), axis=1)
    way = np.concatenate(([0.0], np.cumsum(steps + 1e-9 * max(1.0, float(steps.sum())))))
    return np.interp(np.linspace(0.0, way[-1], poses), way, motion.time)


def _view(motion: Motion, name: str) -> list[list[float]]:
    """Frames of one view: for each instant x0, y0, x1, y1, ... of the points [m]."""
    flat = np.hstack([getattr(motion, name)(label) for label in motion.points])
    return [[round(value, 3) for value in row] for row in flat.tolist()]


def _bounds(machines: Sequence[Motion], name: str) -> list[float]:
    """Left, right, lower and upper edge of a view [m]; the ground and the axis are in it."""
    origin = np.array([[0.0, machines[0].ground if name == "side" else 0.0]])
    every = np.vstack([getattr(m, name)(label) for m in machines for label in m.points] + [origin])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.06 * max(high - low)
    low, high = low - margin, high + margin
    return [round(float(v), 3) for v in (low[0], high[0], low[1], high[1])]


def _deviation(machines: Sequence[Motion]) -> list[float]:
    """Distance between the tips of machine and ghost [mm]."""
    one, other = (m.points[m.leader] for m in machines)
    return [round(value, 2) for value in (1e3 * np.linalg.norm(one - other, axis=1)).tolist()]
