"""The tornado: what moves an output, the largest on top, each bar with its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from orchestrator.sweep.analysis.outcome import FIRST, MU_STAR, TOTAL, Effect, Estimate, Finding, Sensitivity
from orchestrator.sweep.report.style import DARK, LIGHT, axis_label, figure, legend, ticks
from orchestrator.sweep.units import factor
from orchestrator.validation.figures import PALETTE, frame

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
