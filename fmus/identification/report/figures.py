"""Figures of procedures, of a predicted recording, and of correlations, as in the paper's Figs. 5 to 11.

Curves can be distinguished without colour: measured values are marks or a broad line, a fit is a thin dark
line, masked values are hollow marks, and compared curves are dashed. Successive panels over the same quantity
form a column and share their x axis. Other quantities get a separate column.

Of a predicted recording, the measurement is a solid line, the prediction a dotted one, and the strip below
each panel shows the residual.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from fmus.identification.report.prediction import RecordingComparison
from fmus.identification.report.report_texts import footer, percentage
from fmus.identification.results import Curve, Estimate, Panel, ProcedureResult
from orchestrator.base.text import MINUS, display_unit, name_with_unit, typeset
from orchestrator.base.units import pretty
from orchestrator.data.table import Array
from orchestrator.pages.figures import (
    DASHES,
    DOTS,
    PALETTE,
    REFERENCE,
    SIMULATION,
    TraceArea,
    TraceFigure,
    TraceLine,
    TracePanel,
    decimate,
)
from orchestrator.pages.plotting import WIDTH, heading, legend, new_figure, power_ticks, style_axes

# ---- procedures

COLUMNS = 2
MAX_COLUMN = 3  # panels over one quantity, from this number on, are split into two columns
PANEL_HEIGHT, RESIDUAL_HEIGHT, LEGEND_HEIGHT = 2.35, 1.15, 0.2  # in; the last one of a line
LABEL_WIDTH = 0.95  # in, for the labels of each column
COUNTED = ("group", "recording", "run")  # x axes with integer ticks
MIN_MARK = 4.0  # pt, in the legend; the points of a cloud are smaller
RESIDUAL_LABEL = 16  # letters per line of the label of a residual
CLOUD = 1500  # points above which a cloud is drawn as a bitmap inside the SVG
LEGEND_ORDER = ("measured", "masked", "fit", "compared", "corrected")
DRAWING_ORDER = ("masked", "measured", "compared", "corrected", "fit")  # later curves are on top
MARKS = ("o", "s", "^", "D")
# mark, dashes and colour pair of the first, second ... compared curve
COMPARED: tuple[tuple[str, Any, int], ...] = (
    ("D", DASHES, 1),
    ("v", (0, (1.5, 1.5, 1.5, 4)), 3),
    ("<", (0, (9, 3)), 2),
    (">", (0, (3, 1, 1, 1, 1, 1)), 0),
)
CORRECTED: tuple[str, Any, int] = ("P", (0, (6, 1.5, 1, 1.5)), 2)
Column = tuple[Panel, ...]


def draw_procedure(result: ProcedureResult, kinds: Iterable[str] = (), *, titled: bool = True) -> Figure:
    """The figure of a procedure; `kinds` of its recordings for the line on the origin of the data."""
    columns = _columns(result.panels)
    rows = [columns[k : k + COLUMNS] for k in range(0, len(columns), COLUMNS)]
    count = max(map(len, rows))
    heights = [max(sum(_height(panel, count) for panel in column) for column in row) for row in rows]
    height = sum(heights) + 0.35 * len(rows) + 0.75
    figure = new_figure(WIDTH, height, h_pad=0.03, hspace=0.02, wspace=0.06, w_pad=0.06)
    grid = figure.add_gridspec(len(rows), count, height_ratios=heights)
    shared: dict[Any, Axes] = {}
    for i, row in enumerate(rows):
        for k, column in enumerate(row):
            cell = grid[i, k] if len(row) > 1 else grid[i, :]
            x_axis = (column[0].x_label, column[0].x_unit)
            shared[x_axis] = _draw_column(figure, cell, column, len(row), shared.get(x_axis))
    heading(figure, result.title if titled else "", footer(result.figure, kinds))
    return figure


def opening_panel(listed: Sequence[Estimate]) -> Panel | None:
    """The tables of the openings with their intervals; None if there is none, as for a straight line."""
    lists = {name: tuple(points) for name, points in groupby(listed, key=lambda e: e.listed)}
    tables: dict[tuple[Any, ...], list[str]] = {}
    for name, commands in lists.items():
        stem, _, kind = name.rpartition("_")
        if kind == "commands" and commands[-1].value > 0:
            points = zip(commands, lists[f"{stem}_openings"], strict=True)
            table = tuple((command.value, e.value, e.low, e.high) for command, e in points)
            tables.setdefault(table, []).append("-".join(stem.rpartition("_")[2].upper()))
    curves = [
        Curve(", ".join(edges), x, y, "compared", line=True, error=np.array([y - low, up]))
        for table, edges in tables.items()
        for x, y, low, high in [np.array(table).T]
        for up in [np.where(np.isfinite(high), high - y, 0.0)]  # an open end has no bar
    ]
    return (
        Panel("command [V]", "opening", tuple(curves), "Tables with 95 % intervals of their points")
        if curves
        else None
    )


def _columns(panels: Sequence[Panel]) -> list[Column]:
    """Successive panels over the same quantity as columns; a single high column is divided into two."""
    columns = [tuple(group) for _, group in groupby(panels, key=lambda p: (p.x_label, p.x_unit))]
    if len(columns) > 1 or sum(not is_residual(panel) for panel in panels) < MAX_COLUMN:
        return columns
    sizes = np.cumsum([RESIDUAL_HEIGHT if is_residual(panel) else PANEL_HEIGHT for panel in panels])
    cut = int(np.argmin(np.abs(sizes - sizes[-1] / 2))) + 1
    return [tuple(panels[:cut]), tuple(panels[cut:])]


def is_residual(panel: Panel) -> bool:
    """Whether a panel shows a residual, which is drawn flat and symmetrical about zero."""
    return "residual" in f"{panel.title} {panel.y_label}".lower()


def _height(panel: Panel, columns: int) -> float:
    """Height of a panel with its labels [in], in a figure with several columns."""
    if is_residual(panel):
        return RESIDUAL_HEIGHT
    return PANEL_HEIGHT + LEGEND_HEIGHT * len(_legend_lines(panel, columns))


def _legend_lines(panel: Panel, columns: int) -> list[list[str]]:
    """The different entries of the legend, line by line: all in one line if they fit over the axes."""
    ordered = sorted(panel.curves, key=lambda c: LEGEND_ORDER.index(c.kind))
    labels = list(dict.fromkeys(typeset(c.label) for c in ordered if c.label))
    width = WIDTH / columns - LABEL_WIDTH
    widths = [0.062 * len(label) + 0.53 for label in labels]  # in, of a usual letter, and of the mark
    count = len(labels) if sum(widths) <= width else int(width / max(widths))
    return [labels[k : k + max(1, count)] for k in range(0, len(labels), max(1, count))]


def _draw_column(figure: Figure, cell: SubplotSpec, column: Column, columns: int, first: Axes | None) -> Axes:
    """Panels in a column; they share the x axis of `first`, and only the lowest one has labels there."""
    grid = cell.subgridspec(len(column), 1, height_ratios=[_height(p, columns) for p in column])
    drawn = list[Axes]()
    for i, panel in enumerate(column):
        drawn.append(figure.add_subplot(grid[i, 0], sharex=first or (drawn[0] if drawn else None)))
        _draw_panel(drawn[-1], panel, columns)
        drawn[-1].tick_params(labelbottom=i == len(column) - 1)
    lowest, last = drawn[-1], column[-1]
    if last.x_label in COUNTED:
        lowest.xaxis.set_major_locator(MaxNLocator(integer=True))
    power_ticks(lowest.xaxis)
    lowest.set_xlabel(_label(last.x_label, last.x_unit[0]), color=PALETTE.ink, fontsize=9)
    figure.align_ylabels(drawn)
    return drawn[0]


def _label(text: str, unit: str) -> str:
    """A label with its unit; a unit in brackets inside the text is typeset as well."""
    return name_with_unit(re.sub(r"\[(.+)\]", lambda m: f"[{pretty(m[1])}]", text), unit)


def _draw_panel(axes: Axes, panel: Panel, columns: int) -> None:
    residual, unit, count = is_residual(panel), panel.y_unit[0], Counter[str]()
    measured_line = any(c.kind == "measured" and c.line for c in panel.curves)
    several = sum(c.kind in ("measured", "masked") for c in panel.curves) > 1
    for order, curve in enumerate(sorted(panel.curves, key=lambda c: DRAWING_ORDER.index(c.kind))):
        index = count[curve.kind]
        style = _style(curve, index, measured_line=measured_line, several=several)
        if residual:
            thin = {"color": PALETTE.pair(index)[1], "linewidth": 0.8, "linestyle": "-"}
            style |= thin if curve.line else {"markersize": 3.5}
        count[curve.kind] += 1
        _draw_curve(axes, panel, curve, style | {"zorder": 2 + 0.1 * order})
    if panel.log:
        axes.set_yscale("log")
    if residual:  # the unit on a separate line
        label = [*textwrap.wrap(panel.y_label, RESIDUAL_LABEL), f"[{pretty(unit)}]" if pretty(unit) else ""]
        style_axes(axes, y="\n".join(filter(None, label)), size=8)
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=4)
        axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
        if not panel.log:
            largest = max(map(abs, axes.get_ylim()))
            axes.set_ylim(-largest, largest)
            axes.locator_params(axis="y", nbins=4)
    else:
        style_axes(axes, y=_label(panel.y_label, unit))
        axes.margins(y=0.08)
        _draw_legend(axes, panel, columns)
    power_ticks(axes.yaxis)


def _style(curve: Curve, index: int, *, measured_line: bool, several: bool) -> dict[str, Any]:
    """Style of a curve with this index among those of its kind.

    measured_line   whether the measured values of the panel are a line, so that a fit must be dotted
    several         whether there are several measured curves, so that a fit has the colour of its measurement
    """
    light, dark = PALETTE.pair(index)
    other, dashes, pair = CORRECTED if curve.kind == "corrected" else COMPARED[index % len(COMPARED)]
    compared, fitted = PALETTE.pair(pair)[1], dark if several else PALETTE.pair(0)[1]
    mark = MARKS[index % len(MARKS)]
    # of a line its colour, width and dashes; of marks the mark, colour, face and size
    line, marks = {
        "measured": ((light, 2.6, "-"), (mark, light, light, 5)),
        "masked": ((PALETTE.grid, 7.0, "-"), (mark, PALETTE.faint, "none", 4.5)),
        "fit": ((fitted, 1.5, DOTS if measured_line else "-"), ("x", fitted, fitted, 6)),
    }.get(curve.kind, ((compared, 1.3, dashes), (other, compared, "none", 5)))
    if curve.line:
        return dict(zip(("color", "linewidth", "linestyle"), line, strict=True))
    style = dict(zip(("marker", "color", "markerfacecolor", "markersize"), marks, strict=True))
    return style | {"linestyle": "none", "markeredgewidth": 1.4 if marks[0] == "x" else 0.9}


def _draw_curve(axes: Axes, panel: Panel, curve: Curve, style: dict[str, Any]) -> None:
    x, y = curve.x / panel.x_unit[1], curve.y / panel.y_unit[1]
    if curve.line and curve.error is None and bool(np.all(np.diff(x) > 0)):
        x, y = decimate(x, y)
    if len(x) > CLOUD and not curve.line:
        style = style | {"rasterized": True, "markersize": 1.6, "markeredgewidth": 0.3}
    label = typeset(curve.label) or None
    if curve.error is None:
        axes.plot(x, y, label=label, **style)
        return
    # error bars are thin, so they have the dark colour of the pair
    dark = dict(PALETTE.pairs).get(style["color"], style["color"])
    error = curve.error / panel.y_unit[1]
    axes.errorbar(x, y, error, label=label, capsize=2.5, elinewidth=1.1, ecolor=dark, **style)


def _draw_legend(axes: Axes, panel: Panel, columns: int) -> None:
    """Title and legend above the panel, ordered from left to right, line by line."""
    lines = _legend_lines(panel, columns) or [[]]
    # matplotlib fills column by column
    order = [line[k] for k in range(len(lines[0])) for line in lines if k < len(line)]
    handles = {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    shown = legend(
        axes,
        handles=[handles[label] for label in order],
        labels=order,
        ncols=max(1, len(lines[0])),
        title=panel.title or None,
        title_fontsize=9,
        alignment="left",
        borderaxespad=0.1,
        borderpad=0.2,
        handlelength=2.4,
        columnspacing=1.4,
    )
    shown.get_title().set_color(PALETTE.ink)
    for entry in shown.legend_handles:
        if isinstance(entry, Line2D):
            entry.set_markersize(max(entry.get_markersize(), MIN_MARK))


# ---- a predicted recording

JOINT_FIGURES = {"swing": 10, "stick": 11, "boom": 0}  # number in the paper, which has none of the boom
CYLINDER = ("boom_stick", "flow into head", "head_flow", {"head_pressure": "head", "rod_pressure": "rod"})
# joint -> label of a panel -> signals and labels of its curves, as in the paper's Figs. 10 and 11
SIGNALS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    joint: {
        "command": {f"{part}.{joint}_command": ""},
        "angle": {f"manipulator.{joint}_angle": ""},
        "speed": {f"manipulator.{joint}_speed": ""},
        flow: {f"{part}.{joint}_{meter}": ""},
        "pressure": {f"{part}.{joint}_{port}": label for port, label in ports.items()},
    }
    for joint, part, flow, meter, ports in (
        ("swing", "swing", "flow into A", "flow_a", {"pressure_a": "line A", "pressure_b": "line B"}),
        ("boom", *CYLINDER),
        ("stick", *CYLINDER),
    )
}


def joint_figure(comparison: RecordingComparison, joint: str) -> TraceFigure:
    """Command, angle, speed, flow and pressures of a joint, if they were measured."""
    recording, time = comparison.recording, comparison.recording.time
    panels = [
        _trace_panel(label, measured, comparison)
        for label, curves in SIGNALS[joint].items()
        if (measured := {n: curve for n, curve in curves.items() if n in comparison.measured})
    ]
    return TraceFigure(
        panels,
        (float(time[0]), float(time[-1])),
        f"{joint.capitalize()}: {recording.title}",
        footer(JOINT_FIGURES[joint], [recording.kind]),
        (("measured", REFERENCE), ("predicted", SIMULATION)),
    )


def _trace_panel(label: str, curves: Mapping[str, str], comparison: RecordingComparison) -> TracePanel:
    """Signals of one quantity with their residuals and NRMSE; a command is an input and has none."""
    time, unit = comparison.recording.time, display_unit(comparison.units[next(iter(curves))])
    lines, residuals, areas = list[TraceLine](), list[TraceLine](), list[TraceArea]()
    remarks, errors = list[tuple[str, str]](), comparison.nrmse()
    for index, (signal, curve) in enumerate(curves.items()):
        light, dark = PALETTE.pair(index)
        measured = unit.factor * comparison.measured[signal]
        if signal not in comparison.predicted:
            lines.append(TraceLine(time, measured, {"color": dark, "linewidth": 1.2}))
            continue
        predicted = unit.factor * comparison.predicted[signal]
        broad, dotted = {"color": light, "linewidth": 2.6}, {**SIMULATION, "color": dark}
        lines.append(TraceLine(time, measured, broad, curve, "measured"))
        lines.append(TraceLine(time, predicted, dotted, curve, "predicted"))
        if signal in comparison.sd:
            low, high = (unit.factor * end for end in comparison.band(signal))
            areas.append(TraceArea(time, low, high, light, "95 % band"))
        residuals.append(TraceLine(time, measured - predicted, {"color": dark}, curve))
        if (error := errors.get(signal)) is not None:
            remarks.append((f"{curve}\nNRMSE {percentage(error)}".strip(), dark))
    return TracePanel(
        unit.display,
        lines,
        label,
        errors=residuals,
        error_label="residual",
        error_unit=unit.display,
        remarks=remarks,
        areas=areas,
        heights=(2.7 if residuals else 1.6, 1.2),
    )


# ---- estimates

REACHES = (1.1, 1.5, 2, 5, 10)  # factors up to which the axis of all estimates may reach


def estimates_picture(parameters: Sequence[Mapping[str, Any]]) -> tuple[float, list[tuple[Any, list[float]]]]:
    """Reach of an axis, and for each parameter the places [%] of low end, value and high end on it.

    The axis is the logarithm of a value over the one before, from 1 / reach to reach, which is cut off at 10;
    without a value before, or with one of another sign, over the value itself. A value of 0 has no place.
    """
    ratios = []
    for p in parameters:
        e, before = p["estimate"], p["prior"] or 0.0
        if base := before if before * e.value > 0 else e.value:
            ratios.append((p, sorted(x / base for x in (e.low, e.value, e.high))))
    needed = [max(r, 1 / r) for _, ends in ratios for r in ends if r > 0]
    reach = next((r for r in REACHES if r >= max(needed, default=1.0)), REACHES[-1])
    whole = np.log(reach)

    def place(ratio: float) -> float:
        return float(50 + 50 * np.clip(np.log(ratio) / whole, -1, 1)) if ratio > 0 else 0.0

    return reach, [(p, [place(r) for r in ends]) for p, ends in ratios]


# ---- correlations

LARGE_CORRELATION = 0.3  # magnitude above which a correlation is printed


def draw_correlation(names: Sequence[str], correlation: Array) -> Figure:
    """The lower triangle of a correlation matrix (n, n): blue is negative, red positive."""
    count = len(names)
    size = 2.9 + 0.30 * count
    figure = new_figure(min(size + 1.0, 11), min(size, 10.4))
    axes = figure.add_subplot()
    rows, columns = np.tril_indices(count - 1)
    cells = [(j, i, r) for i, j in zip(rows, columns, strict=True) if np.isfinite(r := correlation[i + 1, j])]
    squares = [Rectangle((float(x), float(y)), 1, 1) for x, y, _ in cells]
    image = PatchCollection(squares, cmap="RdBu_r", edgecolor=PALETTE.grid, linewidth=0.6)
    image.set_array([r for *_, r in cells])
    image.set_clim(-1, 1)
    axes.add_collection(image)
    for x, y, r in cells:
        if abs(r) >= LARGE_CORRELATION:
            colour = "#ffffff" if abs(r) > 0.65 else "#000000"
            place: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6.5}
            axes.text(x + 0.5, y + 0.5, f"{r:.1f}".replace("-", MINUS), color=colour, **place)
    axes.set(xlim=(0, count - 1), ylim=(count - 1, 0), aspect="equal")
    axes.spines[:].set_visible(False)
    ticks = np.arange(count - 1) + 0.5
    axes.set_xticks(ticks, names[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7.5)
    axes.set_yticks(ticks, names[1:], fontsize=7.5)
    axes.tick_params(length=0, colors=PALETTE.ink)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=PALETTE.ink, length=2)
    return figure
