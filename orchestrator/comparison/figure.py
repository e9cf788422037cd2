"""Signals of several runs over each other, and below each the difference from the reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from orchestrator.comparison.compare import Comparison
from orchestrator.comparison.runs import Run
from orchestrator.symbols import convert, linear, shown
from orchestrator.validation.compare import Row
from orchestrator.validation.figures import PALETTE, decimate, frame
from orchestrator.validation.wording import finer

PANELS = 6  # more rows than these do not fit on a page
EACH = 3  # of one quantity
ALIKE = 0.01  # of its range: two curves that are nearer cannot be told apart in the picture
# Colours that differ in hue and lightness (Okabe and Ito, darkened), each with its own dashes for print.
COLOURS = ("#0b5fa5", "#b34700", "#00735a", "#8f3f8f", "#7a6400", "#333333")
DASHES = ("-", (0, (4, 2)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)))


def chosen(comparison: Comparison) -> list[str]:
    """The signals that fit into one picture: of each quantity those that differ most, in their order."""
    groups: dict[str, list[Row]] = {}
    for validation in comparison.against.values():
        for row in validation.rows:
            if row.signal in comparison.signals:
                groups.setdefault(row.group, []).append(row)
    most = EACH if len(groups) > 1 else PANELS
    kept = {row.signal for rows in groups.values() for row in _distinct(rows, most)}
    return [signal for signal in comparison.signals if signal in kept][:PANELS]


def _distinct(rows: Sequence[Row], most: int) -> list[Row]:
    """The rows with the largest differences, without those that look like one before."""
    found: list[Row] = []
    for row in sorted(rows, key=lambda r: -r.metrics.maximum_error):
        if len(found) < most and not any(_alike(row, other) for other in found):
            found.append(row)
    return found


def _alike(row: Row, other: Row) -> bool:
    """The same signal, or another one that lies on it."""
    if row.signal == other.signal or len(row.time) != len(other.time):
        return row.signal == other.signal
    apart = [
        np.abs(a - b).max() for a, b in ((row.reference, other.reference), (row.simulation, other.simulation))
    ]
    return bool(max(apart) < ALIKE * np.ptp(row.reference))


def draw(comparison: Comparison, signals: Sequence[str] | None = None) -> Figure:
    """The picture; `signals` default to those of the comparison that differ most."""
    names = list(signals) if signals is not None else chosen(comparison)
    heights = [2.5, 1.2] * len(names)
    figure = Figure(figsize=(9.6, 0.46 * sum(heights) + 0.9), layout=ConstrainedLayoutEngine(h_pad=0.02))
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for place, name in enumerate(names):
        _curves(axes[2 * place], comparison, name)
        _differences(axes[2 * place + 1], comparison, name)
    axes[-1].set_xlabel("time [s]", color=PALETTE.ink)
    axes[-1].set_xlim(*comparison.window)
    _legend(figure, comparison)
    figure.align_ylabels()
    return figure


def _curves(axes: Axes, comparison: Comparison, name: str) -> None:
    frame(axes)
    unit = comparison.reference.trace.units.get(name, "")
    for run in [comparison.reference, *_others(comparison)]:
        own = run.trace.units.get(name, unit)
        seen = (run.trace.time >= comparison.window[0]) & (run.trace.time <= comparison.window[1])
        values = convert(run.trace[name][seen], own, shown(unit), name)
        axes.plot(*decimate(run.trace.time[seen], values), **_style(comparison, run))
    axes.set_ylabel(f"[{shown(unit) or '1'}]", color=PALETTE.ink, fontsize=9)
    axes.set_title(name, loc="left", fontsize=9, color=PALETTE.ink, pad=3)


def _differences(axes: Axes, comparison: Comparison, name: str) -> None:
    """Run - reference, on a scale of its own."""
    frame(axes)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    largest, unit = 0.0, ""
    for run in _others(comparison):
        row = comparison.against[run.label][name]
        unit = finer(row.unit)
        difference = (row.simulation - row.reference) * linear(row.unit, unit, name)[0]
        largest = max(largest, float(np.abs(difference).max()))
        axes.plot(*decimate(row.time, difference), **_style(comparison, run) | {"linewidth": 0.9})
    axes.set_ylim(-1.2 * largest or -1, 1.2 * largest or 1)
    axes.set_ylabel(f"difference\n[{unit or '1'}]", color=PALETTE.ink, fontsize=7)
    axes.locator_params(axis="y", nbins=3)


def _others(comparison: Comparison) -> list[Run]:
    return [run for run in comparison.runs if run.label in comparison.against]


def _style(comparison: Comparison, run: Run) -> dict[str, Any]:
    """The reference broad and pale, the others thin, each in its colour."""
    if run is comparison.reference:
        return {"color": PALETTE.faint, "linewidth": 2.8, "alpha": 0.6}
    place = _others(comparison).index(run)
    dashes = DASHES[place % len(DASHES)]
    return {"color": COLOURS[place % len(COLOURS)], "linewidth": 1.2, "linestyle": dashes}


def _legend(figure: Figure, comparison: Comparison) -> None:
    """Title on the left, the runs on the right."""
    runs = [comparison.reference, *_others(comparison)]
    labels = [f"{run.label} (reference)" if run is comparison.reference else run.label for run in runs]
    handles = [
        Line2D([], [], label=label, **_style(comparison, run))
        for run, label in zip(runs, labels, strict=True)
    ]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=min(len(runs), 4),
        fontsize=9,
        frameon=False,
        labelcolor=PALETTE.ink,
    )
