"""Figures of a convergence study: error over communication step, and the work-precision diagram.

Settings with equal results are drawn as one curve. Each curve is labelled at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from scipy.optimize import isotonic_regression

from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import new_figure, style_axes
from orchestrator.ssp.masters import MASTERS
from orchestrator.studies.convergence.runs import ConvergenceStudy, SettingRun

SIZE = (8.4, 5.2)  # [in]
# One colour for each family, different in hue and in lightness (Okabe and Ito, darkened).
DARK = ("#c2341d", "#c98500", "#00735a", "#0b5fa5", "#333333", "#8f3f8f")
COLOURS = dict(zip(("plain", *MASTERS, "adaptive"), DARK, strict=True))
# Line style and marker tell the curves of a family apart.
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
MARKERS = ("o", "s", "^", "D")
SAME_ERROR = 0.01  # relative: settings whose errors differ by less are drawn as one curve
SLOPE_TRIANGLES = (1, 2, 4)  # orders of convergence
TEXT: dict[str, Any] = {"color": PALETTE.ink, "fontsize": 8, "va": "center"}
LEADER: dict[str, Any] = {"arrowstyle": "-", "linewidth": 0.6, "alpha": 0.6, "shrinkA": 1.0, "shrinkB": 3.0}
LABEL_GAP = 0.034  # smallest distance of two labels, fraction of the height of the axes
LETTER_WIDTH = 0.0062  # fraction of the width of the axes
LABEL_RANGE = (0.02, 0.98)  # heights of the lowest and the highest label, fractions of the height of the axes


@dataclass(eq=False)
class SettingCurve:
    """Runs of one setting, or of several settings with equal results."""

    settings: list[str]
    runs: list[SettingRun]
    family: str
    index_in_family: int

    def __post_init__(self) -> None:
        self.colour = COLOURS[self.family]
        self.stable = [r for r in self.runs if r.stable]
        self.unstable = [r for r in self.runs if not r.stable and not r.refusal]

    @property
    def label(self) -> str:
        """The labels of the settings; a shared first word is written once."""
        first = self.settings[0].split()[0]
        return ", ".join([self.settings[0], *(s.removeprefix(f"{first} ") for s in self.settings[1:])])


def curves(study: ConvergenceStudy, group: str) -> list[SettingCurve]:
    """One curve for each setting; a setting with the results of an earlier one joins its curve."""
    distinct: list[SettingCurve] = []
    for setting in study.settings:
        runs = study.of(setting)
        same = next((curve for curve in distinct if _equal_results(curve.runs, runs, group)), None)
        if same is not None:
            same.settings.append(setting.label)
            continue
        index = sum(curve.family == setting.family for curve in distinct)
        distinct.append(SettingCurve([setting.label], runs, setting.family, index))
    return distinct


def _equal_results(first: Sequence[SettingRun], second: Sequence[SettingRun], group: str) -> bool:
    """Both have the same steps, are stable at the same ones, and have equal errors there."""
    if [(r.mean_step, r.stable) for r in first] != [(r.mean_step, r.stable) for r in second]:
        return False
    pairs = [(a.error(group), b.error(group)) for a, b in zip(first, second, strict=True) if a.stable]
    return bool(pairs) and all(abs(a - b) <= SAME_ERROR * max(a, b) for a, b in pairs)


def draw_error(study: ConvergenceStudy, group: str | None = None) -> Figure:
    """Error over communication step, of the worst signal of a group; default: of the first group."""
    group = group or next(iter(study.reference.groups))
    figure, axes, ends = _draw(study, group, "communication step [ms]", lambda run: 1e3 * run.mean_step)
    steps = [1e3 * step for step in study.steps]
    axes.set_xticks(steps, [f"{step:g}" for step in steps])
    steps = sorted([*steps, *(1e3 * r.mean_step for curve in ends for r in curve.stable)])
    axes.set_xlim(steps[0] / (1.5 * steps[-1] / steps[0]) ** _label_margin(ends), steps[-1] * 1.35)
    _mark_unstable(axes, curves(study, group), group)
    _draw_slope_triangles(axes, steps)
    _label_curves(axes, ends, left=True)
    return figure


def draw_work_precision(study: ConvergenceStudy, group: str | None = None) -> Figure:
    """Work-precision diagram: error over wall time per simulated second; lower left is better."""
    group = group or next(iter(study.reference.groups))
    label = "wall time per simulated second [ms]"
    figure, axes, ends = _draw(study, group, label, lambda run: 1e3 * run.cost)
    costs = [1e3 * r.cost for curve in ends for r in curve.stable]
    if costs:
        axes.set_xlim(min(costs) / 1.3, max(costs) * (1.5 * max(costs) / min(costs)) ** _label_margin(ends))
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
    _label_curves(axes, ends, left=False)
    return figure


def _draw(
    study: ConvergenceStudy, group: str, label: str, x: Callable[[SettingRun], float]
) -> tuple[Figure, Axes, dict[SettingCurve, tuple[float, float]]]:
    """Draw the stable runs; returns the first point of each drawn curve, too."""
    figure, ends = new_figure(*SIZE), dict[SettingCurve, tuple[float, float]]()
    axes = figure.subplots()
    style_axes(axes, label, f"worst {group}, root mean square error over range", size=10)
    axes.set(xscale="log", yscale="log")
    axes.minorticks_off()
    axes.set_title(f"against: {study.reference.title}", loc="left", fontsize=9, color=PALETTE.faint)
    for curve in (curve for curve in curves(study, group) if curve.stable):
        points = [(x(run), run.error(group)) for run in curve.stable]
        ends[curve] = points[0]
        dashes, marker = (own[curve.index_in_family % len(own)] for own in (DASHES, MARKERS))
        style: dict[str, Any] = {"color": curve.colour, "linestyle": dashes, "marker": marker}
        axes.plot(*zip(*points, strict=True), linewidth=1.4, markersize=4, **style)
    return figure, axes, ends


def _mark_unstable(axes: Axes, every: Sequence[SettingCurve], group: str) -> None:
    """A cross above the curves for each unstable run, side by side if there are several at one step."""
    low, high = axes.get_ylim()
    level = high * (high / low) ** 0.05
    axes.set_ylim(low, level * (high / low) ** 0.05)
    unstable = [curve for curve in every if curve.unstable]
    if unstable:
        axes.axhline(high, color=PALETTE.faint, linewidth=0.8, linestyle=(0, (1, 3)))
        axes.text(0.01, level, "unstable", transform=axes.get_yaxis_transform(), **TEXT)
    for i, curve in enumerate(unstable):
        shift = 1.045 ** (i - (len(unstable) - 1) / 2)
        x = [1e3 * r.mean_step * shift for r in curve.unstable]
        axes.plot(x, [level] * len(x), color=curve.colour, linestyle="", marker="x", markersize=5.5)
        smaller = [r for r in curve.stable if r.mean_step < curve.unstable[0].mean_step]
        if smaller:
            x_pair, y_pair = [1e3 * smaller[-1].mean_step, x[0]], [smaller[-1].error(group), level]
            axes.plot(x_pair, y_pair, color=curve.colour, linewidth=0.7, linestyle=(0, (1, 2)))


def _draw_slope_triangles(axes: Axes, steps: Sequence[float]) -> None:
    """Slope triangles of the orders of convergence, lower right."""
    low, high = axes.get_ylim()
    decades = np.log10(high / low)
    right = steps[-1] * 1.2
    for order in reversed(SLOPE_TRIANGLES):
        ratio = min(10 ** (0.2 * decades / order), 1.45)
        left, bottom = right / ratio, low * 10 ** (0.03 * decades)
        top = bottom * ratio**order
        corners = [left, right, right, left], [bottom, bottom, top, bottom]
        axes.plot(*corners, color=PALETTE.faint, linewidth=0.9)
        axes.text(right / ratio**0.33, bottom * (top / bottom) ** 0.25, f"{order}", ha="center", **TEXT)
        right = left / 1.08


def _label_margin(drawn: Iterable[SettingCurve]) -> float:
    """Margin for the labels, as a fraction of the width of the data."""
    width = 0.05 + LETTER_WIDTH * max((len(curve.label) for curve in drawn), default=0)
    return width / (1 - width)


def _label_curves(axes: Axes, ends: Mapping[SettingCurve, tuple[float, float]], left: bool) -> None:
    """The label of each curve next to its end, moved up or down if labels would overlap."""
    to_axes = (axes.transData + axes.transAxes.inverted()).transform
    positions = {curve: to_axes(end) for curve, end in ends.items()}
    by_height = sorted(positions, key=lambda curve: float(positions[curve][1]))
    heights = _spread([float(positions[curve][1]) for curve in by_height])
    edges = [float(x) for x, _ in positions.values()] or [0.0]
    x = min(edges) - 0.03 if left else max(edges) + 0.03
    style = TEXT | {"ha": "right" if left else "left", "xycoords": "axes fraction"}
    for curve, height in zip(by_height, heights, strict=True):
        arrow = LEADER | {"color": curve.colour, "relpos": (1.0 if left else 0.0, 0.5)}
        drawn = style | {"color": curve.colour, "textcoords": "axes fraction", "arrowprops": arrow}
        axes.annotate(curve.label, tuple(positions[curve]), (x, height), **drawn)


def _spread(heights: Sequence[float]) -> list[float]:
    """Increasing heights, moved as little as needed to be LABEL_GAP apart and inside LABEL_RANGE."""
    gaps = LABEL_GAP * np.arange(len(heights))
    lowest, highest = LABEL_RANGE
    moved = isotonic_regression(heights - gaps).x if len(heights) else gaps
    return [float(height) for height in gaps + np.clip(moved, lowest, highest - gaps[-1:])]
