"""Figures of the report of a study, each as wide as a column of the page.

scatter     an output over the factors with the largest effects: a dot per run, and the median in bins
histogram   distribution of an output over the runs
bands       quantiles of a signal over time
tornado     sensitivities of an output, the largest on top, each bar with its 95 % interval
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from orchestrator.base.text import DisplayUnit, display_unit, name_with_unit
from orchestrator.data.table import Array
from orchestrator.pages.figures import PALETTE, TraceArea, TraceFigure, TraceLine, TracePanel
from orchestrator.pages.plotting import legend, limit_ticks, new_figure, style_axes
from orchestrator.studies.analysis.output_samples import done
from orchestrator.studies.analysis.results import FIRST, MU_STAR, TOTAL, Effect, OutputAnalysis, Sensitivity
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output, short

WIDTH = 6.2  # [in], a column of the page; text is readable down to 500 pixels
LIGHT, DARK = zip(*PALETTE.pairs[:3], strict=True)


def column_figure(height: float) -> Figure:
    """A figure as wide as a column; parts that are drawn as pixels have two pixels per point."""
    figure = new_figure(WIDTH, height, h_pad=0.05, w_pad=0.05)
    figure.set_dpi(144)
    return figure


PANELS = 4  # of a scatter figure; two more if the tornado next to it is long
MOST_DOTS = 1500  # per panel; more would overlap
LARGE_DOTS = 300  # number of runs up to which dots are larger
BINS = 12
# Between light and dark colours of the palette, as pixels do not follow the theme of the page.
COLOURS = ("#3f7fb0", "#bb7319", "#2f8f6f")


def scatter(
    results: Results, output: Output, analysed: OutputAnalysis, sensitivity: Sensitivity
) -> Figure | None:
    """Small multiples in the order of the tornado; None if no factor was varied."""
    by_name = {f.name: f for f in results.study.factors}
    top = [by_name[e.name] for e in sensitivity.effects if e.name in by_name]
    top = top[: PANELS if len(sensitivity.effects) <= 8 else PANELS + 2]
    if not top:
        return None
    runs = done(results).dropna(subset=[output.column])
    rows = (len(top) + 1) // 2
    figure = column_figure(0.4 + 2.15 * rows)
    panels = figure.subplots(rows, min(2, len(top)), sharey=True, squeeze=False)
    choice = colouring(results, sensitivity)
    for axes, factor in zip(panels.ravel(), top, strict=False):
        unit = factor_unit(factor)
        varied = factor.name + (", times its value" if factor.relative else "")
        style_axes(axes, name_with_unit(varied, unit.display), size=8)
        x = unit.factor * runs[factor.column].to_numpy(float)
        y = analysed.display.factor * runs[output.column].to_numpy(float)
        _dots(axes, x, y, choice, runs)
        if shows_medians(results):
            axes.plot(*medians(x, y), color=PALETTE.ink, linewidth=1.8)
        limit_ticks(axes.xaxis, 4)
    for axes in panels.ravel()[len(top) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel(name_with_unit(output.name, analysed.display.display), color=PALETTE.ink, fontsize=8)
        limit_ticks(axes.yaxis, 4)
    if choice:
        handles, labels = panels[0, 0].get_legend_handles_labels()
        legend(figure, handles=handles, labels=labels, markerscale=3)
    return figure


def _dots(axes: Axes, x: Array, y: Array, choice: Choice | None, runs: pd.DataFrame) -> None:
    """Draw up to MOST_DOTS runs, in the colours of the options."""
    shown = slice(None, None, max(1, -(-len(runs) // MOST_DOTS)))
    size, alpha = (5, 0.45) if len(runs) > LARGE_DOTS else (12, 0.7)
    for (name, rows), colour in zip(_groups(runs, choice), COLOURS, strict=False):
        style: dict[str, Any] = {"s": size, "alpha": alpha, "linewidths": 0, "rasterized": True}
        axes.scatter(x[shown][rows[shown]], y[shown][rows[shown]], color=colour, label=name, **style)


def _groups(runs: pd.DataFrame, choice: Choice | None) -> list[tuple[str, Array]]:
    """Each option with a mask of its rows; all rows if there is no choice."""
    if choice is None:
        return [("", np.ones(len(runs), dtype=bool))]
    column = runs[choice.column].astype(str).to_numpy()
    return [(short(option), column == option) for option in choice.options]


def colouring(results: Results, sensitivity: Sensitivity | None) -> Choice | None:
    """The choice with the largest effect, of those with at most as many options as there are colours."""
    by_name = {c.name: c for c in results.study.compared if len(c.options) <= len(COLOURS)}
    names = [e.name for e in sensitivity.effects] if sensitivity else list(by_name)
    return next((by_name[name] for name in names if name in by_name), None)


def shows_medians(results: Results) -> bool:
    """Whether medians are drawn: not for Morris, where the other factors differ between the four levels."""
    return results.study.method != "morris"


def factor_unit(factor: Factor) -> DisplayUnit:
    """Display unit of the samples of a factor; none if they are relative."""
    if factor.relative:
        return DisplayUnit("", "")
    return display_unit(factor.unit, float(np.max([np.max(np.abs(n)) for n in factor.numbers.values()])))


def medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Median of y in bins of x with equal counts, or at each value of x if there are few."""
    values = np.unique(x)
    if len(values) <= BINS:
        return values, np.array([np.median(y[x == value]) for value in values])
    parts = np.array_split(np.argsort(x, kind="stable"), BINS)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def histogram(results: Results, output: Output, analysed: OutputAnalysis, choice: Choice | None) -> Figure:
    """Histogram of an output, options stacked, with lines at the 5, 50 and 95 % quantiles."""
    figure = column_figure(2.5)
    axes = figure.subplots()
    style_axes(axes, name_with_unit(output.name, analysed.display.display), "runs")
    scale = analysed.display.factor
    runs = done(results).dropna(subset=[output.column])
    values = scale * runs[output.column].to_numpy(float)
    edges = np.histogram_bin_edges(values, bins=min(50, max(8, round(len(values) ** 0.5))))
    groups = _groups(runs, choice)
    parts, names = [values[rows] for _, rows in groups], [name for name, _ in groups]
    colours = list(LIGHT[: len(parts)])
    axes.hist(parts, bins=edges.tolist(), stacked=True, color=colours, label=names, linewidth=0)
    if analysed.spread:
        for value in (analysed.spread.low, analysed.spread.median, analysed.spread.high):
            axes.axvline(value * scale, color=PALETTE.ink, linewidth=1.0, linestyle=(0, (4, 2)))
    limit_ticks(axes.xaxis, 6)
    if choice:
        legend(figure)
    return figure


QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
EXTREMES = "smallest and largest"


def bands(results: Results, signal: str, unit: DisplayUnit, choice: Choice | None) -> TraceFigure:
    """Median, 5 to 95 % and extremes over the runs at each time; a colour per option."""
    runs = done(results)
    assert results.bands is not None  # called only if signals are stored
    lines, areas = list[TraceLine](), list[TraceArea]()
    key: dict[str, Mapping[str, Any]] = {}
    for i, (name, rows) in enumerate(_groups(runs, choice)[: len(DARK)]):
        samples = results.bands[results.bands["run"].isin(runs["run"][rows])]
        if samples.empty:
            continue
        time, values = quantiles(samples, signal)
        low, five, median, ninety_five, high = unit.factor * values
        solid = {"color": DARK[i], "linewidth": 1.6}
        dashed = {"color": DARK[i], "linewidth": 0.9, "linestyle": (0, (2, 2))}
        label = name or "median, 5 to 95 %"
        areas.append(TraceArea(time, five, ninety_five, LIGHT[i], label))
        lines.append(TraceLine(time, median, solid, key=label))
        key[label] = solid
        if choice is None:
            lines += [TraceLine(time, values, dashed, key=EXTREMES) for values in (low, high)]
            key[EXTREMES] = dashed
    panel = TracePanel(unit.display, lines, signal, areas=areas, heights=(4.2, 0.0))
    return TraceFigure([panel], key=tuple(key.items()))


def quantiles(samples: pd.DataFrame, signal: str) -> tuple[Array, Array]:
    """Time (n,) and QUANTILES over runs, shape (5, n), in the unit of the signal."""
    table = samples.pivot(index="time", columns="run", values=signal)
    return table.index.to_numpy(float), np.nanquantile(table.to_numpy(float), QUANTILES, axis=1)


MOST_BARS = 12  # the table contains all effects
LABELS = {
    MU_STAR: "change over the factor's range, μ*",
    TOTAL: "fraction of the variance",
    FIRST: "fraction of the variance, first order",
}


def tornado(analysed: OutputAnalysis, sensitivity: Sensitivity) -> Figure:
    """Bars of the sensitivity measure, first-order bars within total ones."""
    effects, measure = sensitivity.effects[:MOST_BARS], sensitivity.measure
    unit = analysed.display if measure == MU_STAR else DisplayUnit("1", "%")
    figure = column_figure(1.25 + 0.27 * len(effects))
    axes = figure.subplots()
    style_axes(axes, name_with_unit(LABELS.get(measure, "fraction of the variance"), unit.display))
    axes.grid(False, axis="y")
    for row, effect in enumerate(effects):
        _bar(axes, row, effect, measure, unit.factor)
    names = [effect.label.replace(" (", "\n(") for effect in effects]
    axes.set_yticks(range(len(effects)), names, color=PALETTE.ink)
    axes.set_ylim(len(effects) - 0.4, -0.6)
    right = axes.get_xlim()[1]
    axes.set_xlim(0, right if measure == MU_STAR else min(right, 103.0))  # a fraction is at most 100 %
    limit_ticks(axes.xaxis)
    if marks := _marks(effects, measure):
        legend(figure, handles=marks, ncols=len(marks), handlelength=1.2, columnspacing=1.2)
    return figure


def _bar(axes: Axes, row: int, effect: Effect, measure: str, scale: float) -> None:
    """Draw an effect. Light: total; dark: first order; line: interval."""
    light, dark = PALETTE.pair(1 if effect.kind == "choice" else 0)
    estimate = effect.estimates[measure]
    axes.barh(row, _drawn(estimate.value, measure, scale), height=0.72, color=light, linewidth=0)
    if measure == TOTAL:
        first = _drawn(effect.estimates[FIRST].value, measure, scale)
        axes.barh(row, first, height=0.34, color=dark, linewidth=0)
    if "sigma" in effect.more:
        axes.plot(effect.more["sigma"] * scale, row, marker="|", markersize=11, color=PALETTE.bad)
    if estimate.low is not None:
        ends = [_drawn(end, measure, scale) for end in (estimate.floor, estimate.ceiling)]
        axes.plot(ends, [row, row], color=PALETTE.ink, linewidth=1.2, marker="|", markersize=7)


def _drawn(value: float, measure: str, scale: float) -> float:
    """Position of an estimate on the axis; a fraction is limited to 0..1, as its estimate can be outside."""
    return max(0.0, value if measure == MU_STAR else min(1.0, value)) * scale


def _marks(effects: tuple[Effect, ...], measure: str) -> list[Patch | Line2D]:
    """Legend entries of a tornado."""
    marks: list[Patch | Line2D] = []
    if measure == TOTAL:
        marks += [Patch(color=LIGHT[0], label="total"), Patch(color=DARK[0], label="first order")]
    if any(effect.kind == "choice" for effect in effects):
        marks.append(Patch(color=LIGHT[1], label="choice"))
    if any(effect.estimates[measure].low is not None for effect in effects):
        marks.append(Line2D([], [], label="95 %", color=PALETTE.ink, linewidth=1.4))
    if any("sigma" in effect.more for effect in effects):
        name = "\N{GREEK SMALL LETTER SIGMA} of the effects"
        marks.append(Line2D([], [], label=name, color=PALETTE.bad, marker="|", markersize=10, linewidth=0))
    return marks
