"""How the figures of a study look: sizes that fit a column of the page, colours of options, ticks.

An output over its top factors: a dot per run, and the median in bins.

How an output spreads over the runs, and a signal over time.

The tornado: what moves an output, the largest on top, each bar with its 95 % interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from orchestrator.results.figures import PALETTE, frame
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    TOTAL,
    Array,
    Effect,
    Estimate,
    Finding,
    Sensitivity,
    done,
    short,
)
from orchestrator.studies.report.quantities import Unit, display, factor, number, seen
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output

WIDTH = 6.2  # in; a column of the page, text stays readable where it is 500 pixels wide
DARK = tuple(dark for _, dark in PALETTE.pairs)
LIGHT = tuple(light for light, _ in PALETTE.pairs)


def figure(height: float) -> Figure:
    """A figure as wide as a column; what is drawn as pixels is fine enough for two of them per point."""
    made = Figure(figsize=(WIDTH, height), dpi=144, layout=ConstrainedLayoutEngine(h_pad=0.05, w_pad=0.05))
    FigureCanvasAgg(made)
    return made


def axis_label(name: str, unit: Unit) -> str:
    """A quantity with its unit."""
    return f"{name} [{display(unit)}]" if display(unit) else name


def ticks(axis: Axis, count: int = 5) -> None:
    """Few ticks; very large and small numbers with their power of ten at the last tick only."""
    axis.set_major_locator(MaxNLocator(count))
    low, high = sorted(axis.get_view_interval())
    largest = max(abs(low), abs(high))
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    if -3 <= power <= 4:
        axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value, high - low)))
        return

    def told(value: float, _: object) -> str:
        return _plain(value / 10.0**power, (high - low) / 10.0**power)

    axis.set_major_formatter(FuncFormatter(told))
    ending = number(10.0**power).split("·")[-1]
    label = axis.get_label_text()
    cut = label.rfind("[")
    axis.set_label_text(
        f"{label[: cut + 1]}{ending} {label[cut + 1 :]}" if cut >= 0 else f"{label} [{ending}]"
    )


def _plain(value: float, span: float) -> str:
    """As many digits as the span needs."""
    digits = max(0, 1 - math.floor(math.log10(span))) if span > 0 else 2
    text = f"{value:.{min(digits, 4)}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text.replace("-", "\N{MINUS SIGN}")


def legend(made: Figure | Axes, columns: int = 3, **more: object) -> None:
    """Above what it is of: inside it would lie on the curves."""
    options = {"fontsize": 8, "frameon": False, "labelcolor": PALETTE.ink, "ncols": columns, **more}
    if isinstance(made, Figure):
        made.legend(**{"loc": "outside upper left", **options})
    else:
        made.legend(**{"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, **options})


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


MOST = 12  # bars; what is below them is in the table
DOTTED = 12  # combinations whose dots can be told from each other
LABELS = {
    MU_STAR: "change over the factor's range, μ*",
    TOTAL: "share of the variance",
    FIRST: "share of the variance, first order",
}


def tornado(finding: Finding, sensitivity: Sensitivity) -> Figure:
    """Bars from the measure that orders them; the first order within a total; dots for each combination."""
    effects, measure = sensitivity.effects[:MOST], sensitivity.measure
    scale = factor(finding.seen) if measure == MU_STAR else 100.0
    made = figure(1.25 + 0.27 * len(effects))
    axes = made.subplots()
    frame(axes)
    axes.grid(False, axis="y")
    for place, effect in enumerate(effects):
        _bar(axes, place, effect, measure, scale)
    dotted = 0 < len(sensitivity.apart) <= DOTTED
    if dotted:
        _dots(axes, effects, sensitivity.apart, measure, scale, sensitivity.variance)
    axes.set_yticks(
        range(len(effects)), [effect.label.replace(" (", "\n(") for effect in effects], color=PALETTE.ink
    )
    axes.set_ylim(len(effects) - 0.4, -0.6)
    right = axes.get_xlim()[1]
    axes.set_xlim(0, right if measure == MU_STAR else min(right, 103.0))  # no share is more than 100 %
    unit = finding.seen if measure == MU_STAR else "%"
    axes.set_xlabel(
        axis_label(LABELS.get(measure, "share of the variance"), unit), color=PALETTE.ink, fontsize=9
    )
    ticks(axes.xaxis)
    _legend(made, effects, measure, dotted)
    return made


def _bar(axes: Axes, place: int, effect: Effect, measure: str, scale: float) -> None:
    """Light: all that it does; dark: what it does by itself; a line for the interval."""
    pair = 1 if effect.kind == "choice" else 0
    whole = effect.estimates[measure]
    axes.barh(place, _drawn(whole.value, measure, scale), height=0.72, color=LIGHT[pair], linewidth=0)
    if measure == TOTAL:
        alone = effect.estimates[FIRST]
        axes.barh(place, _drawn(alone.value, measure, scale), height=0.34, color=DARK[pair], linewidth=0)
    if "sigma" in effect.more:
        axes.plot(effect.more["sigma"] * scale, place, marker="|", markersize=11, color=PALETTE.bad)
    _interval(axes, place, whole, measure, scale)


def _interval(axes: Axes, place: int, estimate: Estimate, measure: str, scale: float) -> None:
    if estimate.low is not None:
        ends = [_drawn(end, measure, scale) for end in (estimate.floor, estimate.ceiling)]
        axes.plot(ends, [place, place], color=PALETTE.ink, linewidth=1.2, marker="|", markersize=7)


def _drawn(value: float, measure: str, scale: float) -> float:
    """Where a number lies on the axis: a share lies between 0 and 100 %, an estimate of it need not."""
    return max(0.0, value if measure == MU_STAR else min(1.0, value)) * scale


def _dots(
    axes: Axes,
    effects: tuple[Effect, ...],
    apart: Mapping[str, tuple[Effect, ...]],
    measure: str,
    scale: float,
    variance: float,
) -> None:
    """The same in each combination of choices; shares there are of the variance of that combination."""
    places = {effect.name: place for place, effect in enumerate(effects)}
    for found in apart.values():
        for effect in found:
            if effect.name in places and variance > 0:
                value = _drawn(effect.estimates[measure].value, measure, scale)
                spot = (value, places[effect.name] + 0.24)
                axes.plot(*spot, "o", markersize=3, markerfacecolor="none", color=PALETTE.faint, alpha=0.9)


def _legend(made: Figure, effects: tuple[Effect, ...], measure: str, dotted: bool) -> None:
    """What the marks mean."""
    handles: list[Patch | Line2D] = []
    if measure == TOTAL:
        handles += [Patch(color=LIGHT[0], label="total"), Patch(color=DARK[0], label="by itself")]
    if any(effect.kind == "choice" for effect in effects):
        handles.append(Patch(color=LIGHT[1], label="choice"))
    if any(effect.estimates[measure].low is not None for effect in effects):
        handles.append(Line2D([], [], color=PALETTE.ink, linewidth=1.4, label="95 %"))
    if any("sigma" in effect.more for effect in effects):
        label = "\N{GREEK SMALL LETTER SIGMA} of the effects"
        handles.append(Line2D([], [], color=PALETTE.bad, marker="|", markersize=10, linewidth=0, label=label))
    if dotted:
        dot = Line2D([], [], color=PALETTE.faint, marker="o", markersize=3, linewidth=0)
        dot.set(markerfacecolor="none", label="each combination")
        handles.append(dot)
    if handles:
        legend(made, len(handles), handles=handles, handlelength=1.2, columnspacing=1.2)
