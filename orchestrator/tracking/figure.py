"""The paths as the tip drew them, and the error over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from orchestrator.tracking.follow import Array, Ride
from orchestrator.validation.figures import PALETTE, frame

COLOURS = ("#0b5fa5", "#b34700", "#00735a", "#8f3f8f")  # of the machines
WITH, WITHOUT = "-", (0, (3, 1.5))
LEAST = 0.1  # mm: nobody looks at less
UPRIGHT = 0.05  # height over length of a path that is seen from the side


def draw(rides: Sequence[Ride]) -> Figure:
    """One row per path: seen across its plane, and the error over time."""
    paths = list(dict.fromkeys(r.path for r in rides))
    machines = list(dict.fromkeys(r.machine for r in rides))
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    figure = Figure(figsize=(11, 3.7 * len(paths) + 0.5), layout=layout)
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(paths), 2, squeeze=False, width_ratios=(1, 1.4))
    for (left, right), path in zip(axes, paths, strict=True):
        mine = [r for r in rides if r.path == path]
        _seen(left, mine, machines)
        _errors(right, mine, machines)
    axes[-1][1].set_xlabel("time [s]", color=PALETTE.ink)
    _legend(figure, rides, machines)
    return figure


def plane(points: Array) -> tuple[Array, tuple[str, str]]:
    """Two directions, shape (2, 3), in which a path (n, 3) is seen best, and their names.

    Paths that rise are seen from the side, level ones from above, the machine below.
    """
    span = np.ptp(points, axis=0)
    if span[2] > UPRIGHT * np.hypot(*span[:2]):
        level = points[:, :2] - points[0, :2]
        along = level[np.argmax(np.hypot(*level.T))]
        along = along / max(float(np.hypot(*along)), 1e-9)
        return np.array([[*along, 0.0], [0.0, 0.0, 1.0]]), ("along its level sides [m]", "height [m]")
    return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]), ("to the right [m]", "forward [m]")


def _seen(axes: Axes, rides: Sequence[Ride], machines: Sequence[str]) -> None:
    frame(axes)
    directions, names = plane(rides[0].wanted)
    axes.plot(*directions @ rides[0].wanted.T, color=PALETTE.faint, linewidth=4, alpha=0.5)
    for ride in rides:
        axes.plot(*directions @ ride.tip.T, **_style(ride, machines))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(names[0], color=PALETTE.ink)
    axes.set_ylabel(names[1], color=PALETTE.ink)
    title = f"{rides[0].path}, up to {rides[0].speed:.2g} m/s"
    axes.set_title(title, loc="left", fontsize=10, color=PALETTE.ink)


def _errors(axes: Axes, rides: Sequence[Ride], machines: Sequence[str]) -> None:
    """On a logarithmic scale: with and without feedback are far apart."""
    frame(axes)
    for ride in rides:
        axes.semilogy(ride.time, np.maximum(1e3 * ride.error, LEAST / 10), **_style(ride, machines))
    axes.set_ylim(LEAST, None)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:.1g}" if f"{value:.0e}"[0] in "25" else "")
    axes.tick_params(axis="y", which="minor", colors=PALETTE.ink, labelsize=8)
    axes.set_ylabel("distance from the path [mm]", color=PALETTE.ink)


def _style(ride: Ride, machines: Sequence[str]) -> dict[str, Any]:
    colour = COLOURS[machines.index(ride.machine) % len(COLOURS)]
    return {"color": colour, "linewidth": 1.3, "linestyle": WITH if ride.feedback else WITHOUT}


def _legend(figure: Figure, rides: Sequence[Ride], machines: Sequence[str]) -> None:
    handles = [Line2D([], [], color=PALETTE.faint, linewidth=4, alpha=0.5, label="path")]
    for colour, machine in zip(COLOURS, machines, strict=False):
        handles.append(Line2D([], [], color=colour, linewidth=1.3, label=machine))
    if any(not r.feedback for r in rides):
        handles.append(Line2D([], [], color=PALETTE.ink, linestyle=WITHOUT, label="without feedback"))
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False, labelcolor=PALETTE.ink)
