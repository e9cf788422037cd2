"""Figures of the report of a study, each as wide as a column of the page.

scatter     an output over each of the factors with the largest effects: a dot per run, and the median in bins
histogram   distribution of an output over the runs
bands       quantiles of a signal over time
tornado     sensitivities of an output, the largest on top, each bar with its 95 % interval
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from orchestrator.base.text import DisplayUnit, display_unit, name_with_unit
from orchestrator.data.table import Array
from orchestrator.pages.figures import PALETTE, TraceArea, TraceFigure, TraceLine, TracePanel, bars
from orchestrator.studies.analysis.output_samples import done
from orchestrator.studies.analysis.results import FIRST, MU_STAR, TOTAL, OutputAnalysis, Sensitivity
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output, short

LIGHT, DARK = zip(*PALETTE.pairs, strict=True)  # of the options of a choice
HEIGHT = 4.2  # of a panel
QUANTILE = {"color": PALETTE.ink, "linewidth": 1.0, "linestyle": (0, (4, 2))}
PANELS = 4  # of the factors with the largest effects
BINS = 12


def scatter(
    results: Results, output: Output, analysed: OutputAnalysis, sensitivity: Sensitivity
) -> dict[str, TraceFigure]:
    """Factor -> all runs over it, in the order of the tornado; empty if no factor was varied."""
    by_name = {f.name: f for f in results.study.factors}
    top = [by_name[e.name] for e in sensitivity.effects if e.name in by_name][:PANELS]
    runs, choice = done(results).dropna(subset=[output.column]), colouring(results, sensitivity)
    y, figures = analysed.display.factor * runs[output.column].to_numpy(float), dict[str, TraceFigure]()
    for factor in top:
        unit = factor_unit(factor)
        x = unit.factor * runs[factor.column].to_numpy(float)
        dots = [
            TraceLine(x[rows], y[rows], {"color": colour, "marker": "o", "alpha": 0.5}, name)
            for (name, rows), colour in zip(_groups(runs, choice), DARK, strict=False)
        ]
        if shows_medians(results):
            dots.append(TraceLine(*medians(x, y), {"color": PALETTE.ink, "linewidth": 1.8}, "median"))
        varied = factor.name + (", times its value" if factor.relative else "")
        panel = TracePanel(analysed.display.display, dots, output.name, heights=(HEIGHT, 0.0))
        figures[factor.name] = TraceFigure([panel], axis=name_with_unit(varied, unit.display))
    return figures


def _groups(runs: pd.DataFrame, choice: Choice | None) -> list[tuple[str, Array]]:
    """Each option with a mask of its rows; all rows if there is no choice."""
    if choice is None:
        return [("", np.ones(len(runs), dtype=bool))]
    column = runs[choice.column].astype(str).to_numpy()
    return [(short(option), column == option) for option in choice.options]


def colouring(results: Results, sensitivity: Sensitivity | None) -> Choice | None:
    """The choice with the largest effect, of those with at most as many options as there are colours."""
    by_name = {c.name: c for c in results.study.compared if len(c.options) <= len(DARK)}
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


def histogram(
    results: Results, output: Output, analysed: OutputAnalysis, choice: Choice | None
) -> TraceFigure:
    """Histogram of an output, options stacked, with lines at the 5, 50 and 95 % quantiles."""
    runs = done(results).dropna(subset=[output.column])
    values = analysed.display.factor * runs[output.column].to_numpy(float)
    edges = np.histogram_bin_edges(values, bins=min(50, max(8, round(len(values) ** 0.5))))
    lines, below = list[TraceLine](), np.zeros(len(edges) - 1)
    for (name, rows), colour in zip(_groups(runs, choice), LIGHT, strict=False):
        below = below + np.histogram(values[rows], edges)[0]
        outline = np.concatenate([[0], np.repeat(below, 2), [0]])
        lines.insert(0, TraceLine(np.repeat(edges, 2), outline, {"color": colour, "fill": True}, name))
    if spread := analysed.spread:
        places = np.repeat(np.multiply((spread.low, spread.median, spread.high), analysed.display.factor), 3)
        lines.append(TraceLine(places, np.tile([0.0, below.max(), np.nan], 3), QUANTILE, "5, 50, 95 %"))
    panel = TracePanel("", lines, "runs", heights=(HEIGHT, 0.0))
    return TraceFigure([panel], axis=name_with_unit(output.name, analysed.display.display))


QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
EXTREMES = "smallest and largest"


def bands(results: Results, signal: str, unit: DisplayUnit, choice: Choice | None) -> TraceFigure:
    """Median, 5 to 95 % and extremes over the runs at each time; a colour per option, of four at most."""
    runs = done(results)
    assert results.bands is not None  # called only if signals are stored
    lines, areas = list[TraceLine](), list[TraceArea]()
    key: dict[str, Mapping[str, Any]] = {}
    groups = _groups(runs, choice)
    missing = ", ".join(name for name, _ in groups[len(DARK) :])
    for i, (name, rows) in enumerate(groups[: len(DARK)]):
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
    below = f"not drawn: {missing}; there are colours for {len(DARK)} options" if missing else ""
    return TraceFigure([panel], key=tuple(key.items()), below=below)


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


def tornado(analysed: OutputAnalysis, sensitivity: Sensitivity) -> TraceFigure:
    """Bars of the sensitivity measure, those of first order within total ones.

    A fraction of the variance is drawn from 0 to 1, as its estimate can be outside.
    """
    effects, measure = sensitivity.effects[:MOST_BARS], sensitivity.measure
    unit, most = (analysed.display, np.inf) if measure == MU_STAR else (DisplayUnit("1", "%"), 1.0)

    def drawn(values: Iterable[float]) -> Array:
        return unit.factor * np.clip([*values], 0.0, most)

    rows = [-float(k) for k in range(len(effects))]
    ends = [drawn([effect.estimates[measure].value])[0] for effect in effects]
    lines = []
    names = ("total", "total, choice") if measure == TOTAL else ("factor", "choice")
    for kind, name, colour in zip(("factor", "choice"), names, LIGHT, strict=False):
        of_kind = [(row, 0.0, end) for row, end, e in zip(rows, ends, effects, strict=True) if e.kind == kind]
        lines += [bars(of_kind, 0.36, colour, name)] if of_kind else []
    if measure == TOTAL:
        firsts = drawn(effect.estimates[FIRST].value for effect in effects)
        within = [(row, 0.0, first) for row, first in zip(rows, firsts, strict=True)]
        lines.append(bars(within, 0.17, DARK[0], "first order"))
    estimates = [(row, e.estimates[measure]) for row, e in zip(rows, effects, strict=True)]
    if limits := [(row, e.floor, e.ceiling) for row, e in estimates if e.low is not None]:
        x = np.concatenate([[*drawn([low, high]), np.nan] for _, low, high in limits])
        y = np.concatenate([[row, row, np.nan] for row, *_ in limits])
        lines.append(TraceLine(x, y, {"color": PALETTE.ink, "linewidth": 1.4}, "95 %"))
    if spread := [(row, e.more["sigma"]) for row, e in zip(rows, effects, strict=True) if "sigma" in e.more]:
        style = {"color": PALETTE.bad, "marker": "D"}
        y, sigma = np.array(spread).T
        lines.append(TraceLine(unit.factor * sigma, y, style, "\N{GREEK SMALL LETTER SIGMA} of the effects"))
    right = max(float(np.nanmax(line.time)) for line in lines)
    words = {row: effect.label.replace(" (", "\n(") for row, effect in zip(rows, effects, strict=True)}
    axis = name_with_unit(LABELS.get(measure, "fraction of the variance"), unit.display)
    row_height = 0.9 if any("\n" in word for word in words.values()) else 0.6
    panel = TracePanel("", lines, heights=(row_height * len(effects) + 0.8, 0.0), words=words)
    return TraceFigure([panel], (0.0, right or 1.0), axis=axis)
