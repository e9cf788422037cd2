"""Two pictures of a study: error over step, and error over wall time. Each line is named where it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from orchestrator.convergence.lines import Line, lines_of
from orchestrator.convergence.names import name, room
from orchestrator.convergence.study import Row, Study
from orchestrator.validation.figures import PALETTE, frame

DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))  # within a family
MARKERS = ("o", "s", "^", "D")
SIZE = (8.4, 5.2)  # [in]
TRIANGLES = (1, 2, 4)  # orders


def draw_error(study: Study, group: str | None = None) -> Figure:
    """Error over step, of the worst signal of a group; the first group unless one is named."""
    chosen = group or next(iter(study.truth.groups))
    figure, axes = _figure(study, chosen)
    lines = lines_of(study, chosen)
    drawn = [line for line in lines if line.stable]
    for line in drawn:
        _plot(axes, line, lambda row: 1e3 * row.mean_step, chosen)
    axes.set_xlabel("communication step [ms]", color=PALETTE.ink)
    steps = [1e3 * step for step in study.steps]
    axes.set_xticks(steps, [f"{step:g}" for step in steps])
    steps = sorted([*steps, *(1e3 * row.mean_step for line in drawn for row in line.stable)])
    axes.set_xlim(steps[0] / (1.5 * steps[-1] / steps[0]) ** room(drawn), steps[-1] * 1.35)
    _losses(axes, lines, chosen)
    _triangles(axes, steps)
    ends = {line: (1e3 * line.stable[0].mean_step, line.stable[0].error(chosen)) for line in drawn}
    name(axes, ends, left=True)
    return figure


def draw_work(study: Study, group: str | None = None) -> Figure:
    """Error over wall time for each second simulated: lower left is better."""
    chosen = group or next(iter(study.truth.groups))
    figure, axes = _figure(study, chosen)
    drawn = [line for line in lines_of(study, chosen) if line.stable]
    for line in drawn:
        _plot(axes, line, lambda row: 1e3 * row.cost, chosen)
    axes.set_xlabel("wall time [ms] for each second simulated", color=PALETTE.ink)
    costs = [1e3 * row.cost for line in drawn for row in line.stable]
    if costs:
        axes.set_xlim(min(costs) / 1.3, max(costs) * (1.5 * max(costs) / min(costs)) ** room(drawn))
        axes.set_xticks(_round(*axes.get_xlim()), [f"{tick:g}" for tick in _round(*axes.get_xlim())])
    ends = {line: (1e3 * line.stable[0].cost, line.stable[0].error(chosen)) for line in drawn}
    name(axes, ends, left=False)
    return figure


def _figure(study: Study, group: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=SIZE, layout=ConstrainedLayoutEngine())
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    frame(axes)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.set_ylabel(f"worst {group}, root mean square error over range", color=PALETTE.ink)
    axes.set_title(f"against: {study.truth.title}", loc="left", fontsize=9, color=PALETTE.faint)
    return figure, axes


def _plot(axes: Axes, line: Line, x: Callable[[Row], float], group: str) -> None:
    axes.plot(
        [x(row) for row in line.stable],
        [row.error(group) for row in line.stable],
        color=line.colour,
        linestyle=DASHES[line.place % len(DASHES)],
        linewidth=1.4,
        marker=MARKERS[line.place % len(MARKERS)],
        markersize=4,
    )


def _losses(axes: Axes, lines: Sequence[Line], group: str) -> None:
    """A cross above the picture for each unstable run, side by side where there are several."""
    low, high = axes.get_ylim()
    level = high * (high / low) ** 0.05
    axes.set_ylim(low, level * (high / low) ** 0.05)
    lost = [line for line in lines if line.lost]
    if not lost:
        return
    axes.axhline(high, color=PALETTE.faint, linewidth=0.8, linestyle=(0, (1, 3)))
    axes.text(
        0.01,
        level,
        "unstable",
        transform=axes.get_yaxis_transform(),
        color=PALETTE.ink,
        fontsize=8,
        va="center",
    )
    for place, line in enumerate(lost):
        aside = 1.045 ** (place - (len(lost) - 1) / 2)
        at = [1e3 * row.step * aside for row in line.lost]
        axes.plot(at, [level] * len(at), color=line.colour, linestyle="", marker="x", markersize=5.5)
        before = [row for row in line.stable if row.step < line.lost[0].step]
        if before:
            ends = [1e3 * before[-1].mean_step, at[0]], [before[-1].error(group), level]
            axes.plot(*ends, color=line.colour, linewidth=0.7, linestyle=(0, (1, 2)))


def _triangles(axes: Axes, steps: Sequence[float]) -> None:
    """What orders 1, 2 and 4 look like, in the corner of long steps and small errors."""
    low, high = axes.get_ylim()
    decades = np.log10(high / low)
    right = steps[-1] * 1.2
    for order in reversed(TRIANGLES):
        run = min(10 ** (0.2 * decades / order), 1.45)
        left, bottom = right / run, low * 10 ** (0.03 * decades)
        top = bottom * run**order
        axes.plot(
            [left, right, right, left], [bottom, bottom, top, bottom], color=PALETTE.faint, linewidth=0.9
        )
        axes.text(
            right / run**0.33,
            bottom * (top / bottom) ** 0.25,
            f"{order}",
            color=PALETTE.ink,
            fontsize=8,
            ha="center",
            va="center",
        )
        right = left / 1.08


def _round(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten between two numbers."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [tick for p in powers for k in (1, 2, 5) if low <= (tick := k * 10.0**p) <= high]
