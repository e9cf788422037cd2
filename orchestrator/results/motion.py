"""Motion of a machine as points in space: frames of the animation in a report, and a strobe figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.pages.figures import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FRAMES_PER_SECOND = 25


@dataclass(frozen=True)
class MachineMotion:
    """Points of a machine over time, z up.

    time     shape (n,) [s], strictly increasing
    points   label -> shape (n, 3) [m]
    lines    polylines, each a sequence of labels; default: all points in their order
    tip      label of the point with a trail; default: the last one
    turning  the side view is the plane of the z axis and the tip; otherwise it is the x-z plane
    ground   height of the ground [m], drawn in the side view
    """

    time: Array
    points: Mapping[str, Array]
    lines: tuple[tuple[str, ...], ...] = ()
    tip: str = ""
    turning: bool = True
    ground: float = 0.0

    def __post_init__(self) -> None:
        """Refuse arrays of wrong shape and positions that are not finite."""
        for label, values in self.points.items():
            if values.shape != (len(self.time), 3):
                raise Problem(f"motion: {label!r}: expected shape ({len(self.time)}, 3), got {values.shape}")
            if not np.isfinite(values).all():
                raise Problem(f"motion: {label!r}: expected finite positions, got infinity or NaN")
        unknown = {name for line in self.polylines for name in line} | {self.tip_label} - {""}
        if unknown - set(self.points):
            missing = ", ".join(sorted(unknown - set(self.points)))
            raise Problem(f"motion: expected points {missing}, got {', '.join(self.points)}")

    @property
    def polylines(self) -> tuple[tuple[str, ...], ...]:
        """The polylines to draw."""
        return self.lines or (tuple(self.points),)

    @property
    def views(self) -> tuple[str, ...]:
        """The views to draw: a planar machine has no view from above."""
        return ("side", "top") if self.turning else ("side",)

    @property
    def tip_label(self) -> str:
        """The label of the point with a trail."""
        return self.tip or list(self.points)[-1]

    def side(self, label: str) -> Array:
        """Side view of a point, shape (n, 2) [m]: distance along the arm, height."""
        x, y, z = self.points[label].T
        if not self.turning:
            return np.column_stack((x, z))
        tip = self.points[self.tip_label]
        heading = np.arctan2(tip[:, 1], tip[:, 0])
        return np.column_stack((x * np.cos(heading) + y * np.sin(heading), z))

    def top(self, label: str) -> Array:
        """View from above, shape (n, 2) [m]."""
        return self.points[label][:, :2]

    def at(self, time: Array) -> MachineMotion:
        """The motion at other instants, shape (m,) [s], by linear interpolation."""
        points = {
            label: np.column_stack([np.interp(time, self.time, axis) for axis in values.T])
            for label, values in self.points.items()
        }
        return replace(self, time=time, points=points)


def frames(motion: MachineMotion, ghost: MachineMotion | None = None) -> dict[str, Any]:
    """Data of the animation [m, s], positions rounded to millimetres, 25 frames per second.

    ghost   motion of the same points in the reference, drawn pale behind the machine
    """
    start, stop = motion.time[0], motion.time[-1]
    count = max(2, round((stop - start) * FRAMES_PER_SECOND) + 1)
    time = np.linspace(start, stop, count)
    machines = [m.at(time) for m in (motion, ghost) if m is not None]
    views = {name: [_view(m, name) for m in machines] for name in motion.views}
    bounds = {name: _bounds(machines, name) for name in views}
    return {
        "step": float(time[1] - time[0]),
        "start": float(time[0]),
        "labels": list(motion.points),
        "lines": [[list(motion.points).index(label) for label in line] for line in motion.polylines],
        "tip": list(motion.points).index(motion.tip_label),
        "ground": motion.ground,
        "bounds": bounds,
        "views": views,
        "deviation": _deviation(machines) if len(machines) == 2 else None,
    }


def strobe(motion: MachineMotion, poses: int = 9, title: str = "") -> Figure:
    """The machine at `poses` instants, with equal distances on the path of its tip, coloured by time."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    from orchestrator.pages.plotting import WIDTH, heading, new_figure

    figure = new_figure(WIDTH, 4.6)
    still = motion.at(_instants(motion, poses))
    panels = figure.subplots(1, len(motion.views), squeeze=False)[0]
    start, stop = float(motion.time[0]), float(motion.time[-1])
    colours = LinearSegmentedColormap.from_list("time", colormaps["viridis"](np.linspace(0.0, 0.88, 64)))
    scale = ScalarMappable(Normalize(start, stop), colours)
    for axes, view in zip(panels, motion.views, strict=True):
        _draw_view(axes, motion, view)
        for k, colour in enumerate(scale.to_rgba(still.time)):
            for line in still.polylines:
                xy = np.array([getattr(still, view)(label)[k] for label in line])
                style = {"linewidth": 2.6, "marker": "o", "markersize": 3.2, "solid_joinstyle": "round"}
                axes.plot(*xy.T, color=tuple(colour), **style)
    bar = figure.colorbar(scale, ax=figure.axes, shrink=0.8, pad=0.01)
    bar.set_label("time [s]", color=PALETTE.ink)
    heading(figure, title)
    return figure


def still(motion: MachineMotion, poses: int = 7) -> Markup:
    """The machine at `poses` instants as SVG, the last one strongest, for a page on paper."""
    shown, drawings = motion.at(_instants(motion, poses)), []
    for name in motion.views:
        left, right, low, high = _bounds([motion], name)
        scale = min(520 / (right - left), 320 / (high - low))

        def path(points: Array, left: float = left, high: float = high, scale: float = scale) -> str:
            corners = np.round((points - (left, high)) * (scale, -scale), 1)
            return " ".join(f"{x:g},{y:g}" for x, y in corners)

        tip = getattr(motion.at(_instants(motion, 200)), name)(motion.tip_label)
        lines = [f'<polyline points="{path(tip)}" stroke="{PALETTE.soft}" stroke-dasharray="4 3"/>']
        for k in range(poses):
            for line in shown.polylines:
                points = np.array([getattr(shown, name)(label)[k] for label in line])
                strength = 0.25 + 0.75 * k / max(poses - 1, 1)
                lines.append(
                    f'<polyline points="{path(points)}" stroke="{PALETTE.pair(0)[1]}" stroke-width="4"'
                    f' opacity="{strength:.2f}"/>'
                )
        size = f"{(right - left) * scale:.0f} {(high - low) * scale:.0f}"
        label = {"side": "Side view", "top": "From above"}[name]
        drawings.append(
            f'<svg viewBox="0 0 {size}" role="img" aria-label="{label}" fill="none">{"".join(lines)}</svg>'
        )
    return Markup("".join(drawings))


def _draw_view(axes: Axes, motion: MachineMotion, view: str) -> None:
    """Draw the path of the tip, ground or axis of rotation, and labels; both axes have the same scale."""
    from orchestrator.pages.plotting import style_axes

    if view == "side":
        style_axes(axes, "along the arm [m]" if motion.turning else "x [m]", "height [m]", size=10)
        axes.axhline(motion.ground, color=PALETTE.faint, linewidth=1.2)
    else:
        style_axes(axes, "x [m]", "y [m]", size=10)
        axes.plot(0, 0, marker="+", color=PALETTE.faint, markersize=10)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title({"side": "Side view", "top": "From above"}[view], loc="left", fontsize=10)
    path = getattr(motion, view)(motion.tip_label)
    axes.plot(*path.T, color=PALETTE.faint, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1)


def _instants(motion: MachineMotion, poses: int) -> Array:
    """Times [s] at equal distances on the path of the tip; equal intervals of time if it does not move."""
    steps = np.linalg.norm(np.diff(motion.points[motion.tip_label], axis=0), axis=1)
    distance = np.concatenate(([0.0], np.cumsum(steps + 1e-9 * max(1.0, float(steps.sum())))))
    return np.interp(np.linspace(0.0, distance[-1], poses), distance, motion.time)


def _view(motion: MachineMotion, name: str) -> list[list[float]]:
    """Frames of one view: for each instant x0, y0, x1, y1, ... of the points [m]."""
    flat = np.hstack([getattr(motion, name)(label) for label in motion.points])
    return [[round(value, 3) for value in row] for row in flat.tolist()]


def _bounds(machines: Sequence[MachineMotion], name: str) -> list[float]:
    """Left, right, lower and upper edge of a view [m] with all points, the ground and the axis."""
    origin = np.array([[0.0, machines[0].ground if name == "side" else 0.0]])
    points = np.vstack([getattr(m, name)(label) for m in machines for label in m.points] + [origin])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * max(high - low)
    low, high = low - margin, high + margin
    return [round(float(v), 3) for v in (low[0], high[0], low[1], high[1])]


def _deviation(machines: Sequence[MachineMotion]) -> list[float]:
    """Distance between the tips of machine and ghost [mm]."""
    tip, ghost_tip = (m.points[m.tip_label] for m in machines)
    return [round(value, 2) for value in (1e3 * np.linalg.norm(tip - ghost_tip, axis=1)).tolist()]
