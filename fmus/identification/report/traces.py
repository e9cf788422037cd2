"""Which signals of a joint are shown together, measured and predicted, as in the paper's Figs. 10 and 11.

Measured against predicted signals over time, as in the paper's Figs. 10 and 11, each with its residual.

As there the measurement is a solid line and the prediction a dotted one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from fmus.identification.known import Array
from fmus.identification.report.figures import heading
from fmus.identification.report.panels import DOTS, PALETTE, WIDTH, decimate, frame
from fmus.identification.report.wording import footer
from orchestrator.base.units import display

# Below this share of the largest value the range of a signal that stands still is not shown.
REST = 1e-9


@dataclass(frozen=True)
class Line:
    """One signal in its SI unit; `predicted` is None for what is given, such as a command."""

    signal: str
    unit: str
    measured: Array
    predicted: Array | None = None
    name: str = ""

    @property
    def shown(self) -> tuple[str, float]:
        """Display unit and its factor."""
        return display(self.unit) or (self.unit, 1.0)

    @property
    def nrmse(self) -> float | None:
        """Root mean square residual over the range of the measurement, where both are numbers."""
        if self.predicted is None:
            return None
        known = np.isfinite(self.measured) & np.isfinite(self.predicted)
        if not known.any():
            return None
        measured, predicted = self.measured[known], self.predicted[known]
        span = float(np.ptp(measured))
        error = float(np.sqrt(np.mean((predicted - measured) ** 2)))
        return error / span if span > REST * (1 + float(np.abs(measured).max())) else None


@dataclass(frozen=True)
class Row:
    """Signals of one quantity in one panel."""

    label: str
    lines: tuple[Line, ...]


# what the paper's Figs. 10 and 11 show, and the same for the boom: label -> signals with their names
SIGNALS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "swing": {
        "command": {"swing.swing_command": ""},
        "angle": {"manipulator.swing_angle": ""},
        "speed": {"manipulator.swing_speed": ""},
        "flow into A": {"swing.swing_flow_a": ""},
        "pressure": {"swing.swing_pressure_a": "line A", "swing.swing_pressure_b": "line B"},
    },
    **{
        joint: {
            "command": {f"boom_stick.{joint}_command": ""},
            "angle": {f"manipulator.{joint}_angle": ""},
            "speed": {f"manipulator.{joint}_speed": ""},
            "flow into head": {f"boom_stick.{joint}_head_flow": ""},
            "pressure": {
                f"boom_stick.{joint}_head_pressure": "head",
                f"boom_stick.{joint}_rod_pressure": "rod",
            },
        }
        for joint in ("boom", "stick")
    },
}
FIGURES = {"swing": 10, "boom": 0, "stick": 11}


def rows(
    joint: str, measured: Mapping[str, Array], predicted: Mapping[str, Array], units: Mapping[str, str]
) -> list[Row]:
    """The panels of a joint, of the signals that were measured.

    measured, predicted   signals by name, shape (n,), SI; speeds among them
    """
    found = []
    for label, signals in SIGNALS[joint].items():
        lines = tuple(
            Line(signal, units[signal], measured[signal], predicted.get(signal), name)
            for signal, name in signals.items()
            if signal in measured
        )
        if lines:
            found.append(Row(label, lines))
    return found


def draw(
    title: str,
    time: Array,
    panels: Sequence[Row],
    *,
    number: int = 0,
    kinds: Iterable[str] = (),
    window: tuple[float, float] | None = None,
) -> Figure:
    """The figure: every row with its residual below; `number` is that of the paper's figure."""
    heights: list[float] = []
    for row in panels:
        heights += [1.35, 0.6] if _predicted(row) else [0.8]
    layout = ConstrainedLayoutEngine(h_pad=0.02, hspace=0.0)
    figure = Figure(figsize=(WIDTH, 0.92 * sum(heights) + 1.1), layout=layout)
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    places = iter(axes)
    for row in panels:
        _curves(next(places), time, row)
        if _predicted(row):
            _residuals(next(places), time, row)
    axes[-1].set_xlabel("time [s]", color=PALETTE.ink, fontsize=9)
    axes[-1].set_xlim(*(window or (time[0], time[-1])))
    heading(figure, title, footer(number, kinds))
    _key(figure)
    figure.align_ylabels()
    return figure


def _predicted(row: Row) -> bool:
    return any(line.predicted is not None for line in row.lines)


def _curves(axes: Axes, time: Array, row: Row) -> None:
    """Measurement solid and broad, prediction dotted and dark; the error as a number at the right."""
    frame(axes)
    unit = row.lines[0].shown[0]
    axes.set_ylabel(f"{row.label}\n[{unit}]", color=PALETTE.ink, fontsize=9)
    for place, line in enumerate(row.lines):
        light, dark = PALETTE.pair(place)
        factor = line.shown[1]
        colour, width = (dark, 1.2) if line.predicted is None else (light, 2.6)
        axes.plot(*decimate(time, factor * line.measured), color=colour, linewidth=width)
        if line.predicted is not None:
            values = decimate(time, factor * line.predicted)
            axes.plot(*values, color=dark, linewidth=1.3, linestyle=DOTS)
        if (error := line.nrmse) is not None:
            text = f"{line.name}\nNRMSE {100 * error:.2g} %".strip()
            at = (1.01, 0.95 - 0.42 * place)
            axes.annotate(text, at, xycoords="axes fraction", color=dark, fontsize=8, va="top")
    axes.margins(y=0.12)


def _residuals(axes: Axes, time: Array, row: Row) -> None:
    """Measured - predicted, on a scale of its own."""
    frame(axes)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    largest = 0.0
    for place, line in enumerate(row.lines):
        if line.predicted is not None:
            error = line.shown[1] * (line.measured - line.predicted)
            largest = max(largest, float(np.nanmax(np.abs(error), initial=0.0)))
            axes.plot(*decimate(time, error), color=PALETTE.pair(place)[1], linewidth=0.8)
    axes.set_ylim(-1.15 * largest or -1, 1.15 * largest or 1)
    axes.set_ylabel(f"residual\n[{row.lines[0].shown[0]}]", color=PALETTE.ink, fontsize=8)
    axes.locator_params(axis="y", nbins=3)


def _key(figure: Figure) -> None:
    """What the two kinds of line mean."""
    handles = [
        Line2D([], [], color=PALETTE.faint, linewidth=2.6, label="measured"),
        Line2D([], [], color=PALETTE.ink, linewidth=1.3, linestyle=DOTS, label="predicted"),
    ]
    figure.legend(
        handles=handles, loc="upper right", ncols=2, fontsize=9, frameon=False, labelcolor=PALETTE.ink
    )
