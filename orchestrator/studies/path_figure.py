"""Figure of `harvester track`: paths of the tip from above and from the side, and the error over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import legend, new_figure, style_axes

if TYPE_CHECKING:
    from orchestrator.studies.path_following import Array, PathRun

WITH, WITHOUT = "-", (0, (3, 1.5))
RISING = 0.05  # height over length above which a path rises
STRAIGHT = 1e-3  # width over length, seen from above, below which a path is in one upright plane
LEAST_ERROR = 0.1  # [mm], lower end of the error axis


def draw(runs: Sequence[PathRun]) -> Figure:
    """One row per path: from above, from the side, and the error over time."""
    paths = list(dict.fromkeys(r.path for r in runs))
    machines = list(dict.fromkeys(r.machine for r in runs))
    figure = new_figure(14, 3.7 * len(paths) + 0.5, w_pad=0.08, h_pad=0.08)
    axes = figure.subplots(len(paths), 3, squeeze=False, width_ratios=(1, 1, 1.4))
    for (left, middle, right), path in zip(axes, paths, strict=True):
        on_path = [r for r in runs if r.path == path]
        title = f"{path}, up to {on_path[0].speed:.2g} m/s"
        left.set_title(title, loc="left", fontsize=10, color=PALETTE.ink)
        _draw_view(left, on_path, machines, top_view, ("to the right [m]", "forward [m]"))
        side, axis_label = side_view(on_path[0].commanded)
        _draw_view(middle, on_path, machines, side, (axis_label, "height [m]"))
        _draw_errors(right, on_path, machines)
    axes[-1][2].set_xlabel("time [s]", color=PALETTE.ink)
    _legend(figure, runs, machines)
    return figure


def top_view(points: Array) -> Array:
    """Points (n, 3) from above, the machine at the bottom: to the right and forward [m], shape (2, n)."""
    return np.stack([-points[:, 1], points[:, 0]])


def side_view(commanded: Array) -> tuple[Callable[[Array], Array], str]:
    """The side view of a path (n, 3), a function from points (n, 3) to shape (2, n) [m], and its axis label.

    A path that rises in one upright plane is projected on that plane, so its lengths are true. Any other
    path is drawn in the plane of the arm, which swings.
    """
    horizontal = commanded[:, :2] - commanded[0, :2]
    along = horizontal[np.argmax(np.hypot(*horizontal.T))]
    length = float(np.hypot(*along))
    across = np.abs(horizontal @ [along[1], -along[0]]).max()
    if np.ptp(commanded[:, 2]) > RISING * length > 0 and across < STRAIGHT * length**2:
        direction = along / length
        return lambda p: np.stack(
            [(p[:, :2] - commanded[0, :2]) @ direction, p[:, 2]]
        ), "along the ground [m]"
    return lambda p: np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]]), "radius from the swing axis [m]"


def _draw_view(
    axes: Axes,
    runs: Sequence[PathRun],
    machines: Sequence[str],
    view: Callable[[Array], Array],
    axis_labels: tuple[str, str],
) -> None:
    """Draw path and tips in one view; both axes have the same scale."""
    style_axes(axes, *axis_labels, size=10)
    axes.plot(*view(runs[0].commanded), color=PALETTE.faint, linewidth=4, alpha=0.5)
    for run in runs:
        axes.plot(*view(run.tip), **_style(run, machines))
    axes.set_aspect("equal", adjustable="datalim")


def _draw_errors(axes: Axes, runs: Sequence[PathRun], machines: Sequence[str]) -> None:
    """Draw the errors over time on a logarithmic scale, as feedback reduces them tenfold and more."""
    style_axes(axes, y="distance to the commanded point [mm]", size=10)
    for run in runs:
        axes.semilogy(run.time, np.maximum(1e3 * run.error, LEAST_ERROR / 10), **_style(run, machines))
    axes.set_ylim(LEAST_ERROR, None)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")


def _style(run: PathRun, machines: Sequence[str]) -> dict[str, Any]:
    colour = PALETTE.colour(machines.index(run.machine))
    return {"color": colour, "linewidth": 1.3, "linestyle": WITH if run.feedback else WITHOUT}


def _legend(figure: Figure, runs: Sequence[PathRun], machines: Sequence[str]) -> None:
    handles = [Line2D([], [], label="path", color=PALETTE.faint, linewidth=4, alpha=0.5)]
    handles += [
        Line2D([], [], label=name, color=PALETTE.colour(k), linewidth=1.3) for k, name in enumerate(machines)
    ]
    if any(not r.feedback for r in runs):
        handles.append(Line2D([], [], label="without feedback", color=PALETTE.ink, linestyle=WITHOUT))
    legend(figure, handles=handles, loc="outside upper center", ncols=5, fontsize=10)
