"""How an output spreads over the runs, and a signal over time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orchestrator.sweep.analysis.outcome import Finding, short
from orchestrator.sweep.analysis.results import Array, done
from orchestrator.sweep.report.style import DARK, LIGHT, axis_label, figure, legend, ticks
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import Choice, Output
from orchestrator.sweep.units import Unit, factor
from orchestrator.validation.figures import PALETTE, frame

QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


def histogram(results: Results, output: Output, finding: Finding, colour: Choice | None) -> Figure:
    """Runs over the output, options on each other's shoulders; lines at 5, 50 and 95 %."""
    made = figure(2.5)
    axes = made.subplots()
    frame(axes)
    scale = factor(finding.seen)
    ended = done(results).dropna(subset=[output.column])
    values = ended[output.column].to_numpy(float) * scale
    edges = np.histogram_bin_edges(values, bins=min(50, max(8, round(len(values) ** 0.5))))
    parts, labels = _parts(ended, values, colour)
    axes.hist(
        parts, bins=edges.tolist(), stacked=True, color=list(LIGHT[: len(parts)]), label=labels, linewidth=0
    )
    if finding.spread:
        for value in (finding.spread.low, finding.spread.median, finding.spread.high):
            axes.axvline(value * scale, color=PALETTE.ink, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.set_xlabel(axis_label(output.name, finding.seen), color=PALETTE.ink, fontsize=9)
    axes.set_ylabel("runs", color=PALETTE.ink, fontsize=9)
    ticks(axes.xaxis, 6)
    if colour:
        legend(made)
    return made


def _parts(ended: pd.DataFrame, values: Array, colour: Choice | None) -> tuple[list[Array], list[str]]:
    if colour is None:
        return [values], [""]
    column = ended[colour.column].astype(str).to_numpy()
    return [values[column == option] for option in colour.options], [short(o) for o in colour.options]


def bands(results: Results, signal: str, unit: Unit, choice: Choice | None) -> Figure:
    """Median, 5 to 95 % and extremes over the runs at each time; a colour per option."""
    made = figure(2.7)
    axes = made.subplots()
    frame(axes)
    ended = done(results)
    assert results.bands is not None  # asked for only where signals are kept
    kept = results.bands[results.bands["run"].isin(ended["run"])]
    if choice is None:
        _band(axes, kept, signal, unit, 0, "median, 5 to 95 %")
    else:
        column = ended[choice.column].astype(str)
        for place, option in enumerate(choice.options[: len(DARK)]):
            runs = ended.loc[column == option, "run"]
            _band(axes, kept[kept["run"].isin(runs)], signal, unit, place, short(option), extremes=False)
    axes.set_xlabel("time [s]", color=PALETTE.ink, fontsize=9)
    axes.set_ylabel(axis_label(signal, unit), color=PALETTE.ink, fontsize=8)
    ticks(axes.yaxis)
    axes.margins(x=0)
    legend(axes)
    return made


def _band(
    axes: Axes, kept: pd.DataFrame, signal: str, unit: Unit, place: int, label: str, extremes: bool = True
) -> None:
    """One group of runs; nothing where it is empty."""
    if kept.empty:
        return
    time, found = quantiles(kept, signal)
    low, five, median, ninety_five, high = found * factor(unit)
    axes.fill_between(time, five, ninety_five, color=LIGHT[place], alpha=0.55, linewidth=0)
    axes.plot(time, median, color=DARK[place], linewidth=1.6, label=label)
    if extremes:
        axes.plot(
            time, low, color=DARK[place], linewidth=0.9, linestyle=(0, (2, 2)), label="least and largest"
        )
        axes.plot(time, high, color=DARK[place], linewidth=0.9, linestyle=(0, (2, 2)))


def quantiles(kept: pd.DataFrame, signal: str) -> tuple[Array, Array]:
    """Time (n,) and QUANTILES over runs, shape (5, n), in the unit of the signal."""
    table = kept.pivot(index="time", columns="run", values=signal)
    found = np.nanquantile(table.to_numpy(float), QUANTILES, axis=1)
    return table.index.to_numpy(float), found
