"""An output over its top factors: a dot per run, and the median in bins."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orchestrator.sweep.analysis.outcome import Finding, Sensitivity, short
from orchestrator.sweep.analysis.results import Array, done
from orchestrator.sweep.report.style import axis_label, figure, legend, ticks
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import Choice, Factor, Output
from orchestrator.sweep.units import Unit, factor, seen
from orchestrator.validation.figures import PALETTE, frame

PANELS = 4  # six where the tornado beside them is long
DOTS = 1500  # per panel; more only cover each other
FEW = 300  # runs up to which dots are drawn larger
BINS = 12
# Between the light and the dark of the palette: pixels do not follow the page's theme.
COLOURS = ("#3f7fb0", "#c47a1f", "#2f8f6f")


def scatter(results: Results, output: Output, finding: Finding, sensitivity: Sensitivity) -> Figure | None:
    """Small multiples in the order of the tornado; none where no factor was varied."""
    by_name = {f.name: f for f in results.study.factors}
    top = [by_name[e.name] for e in sensitivity.effects if e.name in by_name]
    top = top[: PANELS if len(sensitivity.effects) <= 8 else PANELS + 2]
    if not top:
        return None
    runs = done(results).dropna(subset=[output.column])
    runs = runs.assign(**{output.column: runs[output.column] * factor(finding.seen)})
    rows = (len(top) + 1) // 2
    made = figure(0.4 + 2.15 * rows)
    panels = made.subplots(rows, min(2, len(top)), sharey=True, squeeze=False)
    colour = colouring(results, sensitivity)
    for axes, own in zip(panels.ravel(), top, strict=False):
        _panel(axes, runs, own, output, colour)
        if has_line(results):
            x, y = _values(runs, own, shown_factor(own), output)
            axes.plot(*medians(x, y), color=PALETTE.ink, linewidth=1.8)
    for axes in panels.ravel()[len(top) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel(axis_label(output.name, finding.seen), color=PALETTE.ink, fontsize=8)
        ticks(axes.yaxis, 4)
    if colour:
        handles, labels = panels[0, 0].get_legend_handles_labels()
        legend(made, 3, handles=handles, labels=labels, markerscale=3)
    return made


def colouring(results: Results, sensitivity: Sensitivity | None) -> Choice | None:
    """The choice that moves the output most, if its options can have colours of their own."""
    by_name = {c.what: c for c in results.study.compared if len(c.options) <= len(COLOURS)}
    names = [e.name for e in sensitivity.effects] if sensitivity else list(by_name)
    return next((by_name[name] for name in names if name in by_name), None)


def has_line(results: Results) -> bool:
    """Whether medians say something: not at the four levels of Morris, at each of which the others differ."""
    return results.study.method != "morris"


def shown_factor(own: Factor) -> Unit:
    """The unit of what is drawn: samples of a relative factor are shares."""
    if own.relative:
        return ""
    return seen(own.unit, float(np.max([np.max(np.abs(n)) for n in own.numbers.values()])))


def _panel(axes: Axes, runs: pd.DataFrame, own: Factor, output: Output, colour: Choice | None) -> None:
    frame(axes)
    unit = shown_factor(own)
    drawn = runs.iloc[:: max(1, -(-len(runs) // DOTS))]
    for place, (label, part) in enumerate(_groups(drawn, colour)):
        x, y = _values(part, own, unit, output)
        axes.scatter(
            x,
            y,
            color=COLOURS[place],
            label=label,
            s=5 if len(runs) > FEW else 12,
            linewidths=0,
            alpha=0.45 if len(runs) > FEW else 0.7,
            rasterized=True,
        )
    name = own.name + (", times its value" if own.relative else "")
    axes.set_xlabel(axis_label(name, unit), color=PALETTE.ink, fontsize=8)
    ticks(axes.xaxis, 4)


def _groups(runs: pd.DataFrame, colour: Choice | None) -> list[tuple[str, pd.DataFrame]]:
    if colour is None:
        return [("", runs)]
    column = runs[colour.column].astype(str)
    return [(short(option), runs[column == option]) for option in colour.options]


def _values(runs: pd.DataFrame, own: Factor, unit: Unit, output: Output) -> tuple[Array, Array]:
    """The factor in its display unit, and the output."""
    x = runs[own.column].to_numpy(float) * factor(unit)
    return x, runs[output.column].to_numpy(float)


def medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Median of y in bins of equal count of x, or at each value where there are few."""
    values = np.unique(x)
    if len(values) <= BINS:
        return values, np.array([np.median(y[x == value]) for value in values])
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, BINS)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])
