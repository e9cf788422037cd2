"""Figures of procedures (measurement, fit, residual, as in the paper's Figs. 5 to 9) and correlations.

Curves can be distinguished without colour: measured values are marks or a broad line, a fit is a thin dark
line, masked values are hollow marks, and compared curves are dashed. Successive panels over the same quantity
form a column and share their x axis. Other quantities get a separate column.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from fmus.identification.procedure_result import Curve, Panel, ProcedureResult
from fmus.identification.report.report_texts import footer
from orchestrator.base.text import MINUS, name_with_unit, typeset
from orchestrator.base.units import pretty
from orchestrator.data.table import Array
from orchestrator.pages.figures import DASHES, DOTS, PALETTE, decimate
from orchestrator.pages.plotting import WIDTH, heading, legend, new_figure, power_ticks, style_axes

COLUMNS = 2
MAX_COLUMN = 3  # panels over one quantity, from this number on, are split into two columns
PANEL_HEIGHT, RESIDUAL_HEIGHT = 2.35, 1.15  # in
LABEL_WIDTH = 0.95  # in, for the labels of each column
COUNTED = ("group", "recording", "run")  # x axes with integer ticks
LEGEND_LINE = 13.0  # pt, height of a line of the legend
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
LARGE_CORRELATION = 0.3  # magnitude above which a correlation is printed
Column = tuple[Panel, ...]


def draw_procedure(result: ProcedureResult, kinds: Iterable[str] = (), *, titled: bool = True) -> Figure:
    """The figure of a procedure; `kinds` of its recordings for the line on the origin of the data."""
    columns = _columns(result.panels)
    rows = [columns[k : k + COLUMNS] for k in range(0, len(columns), COLUMNS)]
    width = _axes_width(max(map(len, rows)))
    heights = [max(sum(_height(panel, width) for panel in column) for column in row) for row in rows]
    height = sum(heights) + 0.35 * len(rows) + 0.75
    figure = new_figure(WIDTH, height, h_pad=0.03, hspace=0.02, wspace=0.06, w_pad=0.06)
    grid = figure.add_gridspec(len(rows), max(map(len, rows)), height_ratios=heights)
    shared: dict[Any, Axes] = {}
    for i, row in enumerate(rows):
        for k, column in enumerate(row):
            cell = grid[i, k] if len(row) > 1 else grid[i, :]
            x_axis = (column[0].x_label, column[0].x_unit)
            shared[x_axis] = _draw_column(figure, cell, column, _axes_width(len(row)), shared.get(x_axis))
    heading(figure, result.title if titled else "", footer(result.figure, kinds))
    return figure


def _axes_width(columns: int) -> float:
    """Width of axes [in] if there are several columns."""
    return WIDTH / columns - LABEL_WIDTH


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


def _height(panel: Panel, width: float) -> float:
    """Height of a panel with its labels [in], whose axes have this width [in]."""
    return RESIDUAL_HEIGHT if is_residual(panel) else PANEL_HEIGHT + 0.2 * _legend_lines(panel, width)


def _draw_column(figure: Figure, cell: Any, column: Column, width: float, first: Axes | None) -> Axes:
    """Panels in a column; they share the x axis of `first`, and only the lowest one has labels there."""
    grid: GridSpec = cell.subgridspec(len(column), 1, height_ratios=[_height(p, width) for p in column])
    drawn = []
    for i, panel in enumerate(column):
        axes = figure.add_subplot(grid[i, 0], sharex=first)
        first = first or axes
        _draw_panel(axes, panel, width)
        axes.tick_params(labelbottom=i == len(column) - 1)
        drawn.append(axes)
    last = column[-1]
    if last.x_label in COUNTED:
        drawn[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    power_ticks(drawn[-1].xaxis)
    drawn[-1].set_xlabel(_label(last.x_label, last.x_unit[0]), color=PALETTE.ink, fontsize=9)
    figure.align_ylabels(drawn)
    return drawn[0]


def _label(text: str, unit: str) -> str:
    """A label with its unit; a unit in brackets inside the text is typeset as well."""
    return name_with_unit(re.sub(r"\[(.+)\]", lambda m: f"[{pretty(m[1])}]", text), unit)


def _draw_panel(axes: Axes, panel: Panel, width: float) -> None:
    residual = is_residual(panel)
    if residual:  # the unit on a separate line
        unit = [f"[{pretty(panel.y_unit[0])}]"] if pretty(panel.y_unit[0]) else []
        style_axes(axes, y="\n".join([*textwrap.wrap(panel.y_label, RESIDUAL_LABEL), *unit]), size=8)
    else:
        style_axes(axes, y=_label(panel.y_label, panel.y_unit[0]))
    _draw_curves(axes, panel, residual)
    if panel.title:
        pad = 4.0 if residual else 4.0 + LEGEND_LINE * _legend_lines(panel, width)
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=pad)
    if panel.log:
        axes.set_yscale("log")
    if residual:
        axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
        if not panel.log:
            largest = max(map(abs, axes.get_ylim()))
            axes.set_ylim(-largest, largest)
            axes.locator_params(axis="y", nbins=4)
    else:
        axes.margins(y=0.08)
        _draw_legend(axes, panel, width)
    power_ticks(axes.yaxis)


def _draw_curves(axes: Axes, panel: Panel, residual: bool) -> None:
    count: Counter[str] = Counter()
    measured_line = any(c.kind == "measured" and c.line for c in panel.curves)
    several = sum(c.kind in ("measured", "masked") for c in panel.curves) > 1
    for order, curve in enumerate(sorted(panel.curves, key=lambda c: DRAWING_ORDER.index(c.kind))):
        index = count[curve.kind]
        style = _style(curve, index, measured_line=measured_line, several=several)
        if residual:
            style |= _line(PALETTE.pair(index)[1], 0.8, "-") if curve.line else {"markersize": 3.5}
        count[curve.kind] += 1
        _draw_curve(axes, panel, curve, style | {"zorder": 2 + 0.1 * order})


def _style(curve: Curve, index: int, *, measured_line: bool, several: bool) -> dict[str, Any]:
    """Style of a curve with this index among those of its kind.

    measured_line   whether the measured values of the panel are a line, so that a fit must be dotted
    several         whether there are several measured curves, so that a fit has the colour of its measurement
    """
    light, dark = PALETTE.pair(index)
    mark = MARKS[index % len(MARKS)]
    if curve.kind == "measured":
        return {"color": light, "linewidth": 2.6} if curve.line else _marks(mark, light, light, 5)
    if curve.kind == "masked":
        return _line(PALETTE.grid, 7.0, "-") if curve.line else _marks(mark, PALETTE.faint, "none", 4.5)
    if curve.kind == "fit":
        colour = dark if several else PALETTE.pair(0)[1]
        return (
            _line(colour, 1.5, DOTS if measured_line else "-")
            if curve.line
            else _marks("x", colour, colour, 6)
        )
    mark, dashes, pair = CORRECTED if curve.kind == "corrected" else COMPARED[index % len(COMPARED)]
    colour = PALETTE.pair(pair)[1]
    return _line(colour, 1.3, dashes) if curve.line else _marks(mark, colour, "none", 5)


def _marks(mark: str, colour: str, face: str, size: float) -> dict[str, Any]:
    edge = 1.4 if mark == "x" else 0.9
    style = {"linestyle": "none", "marker": mark, "markersize": size, "markeredgewidth": edge}
    return style | {"color": colour, "markerfacecolor": face}


def _line(colour: str, width: float, dashes: Any) -> dict[str, Any]:
    return {"color": colour, "linewidth": width, "linestyle": dashes}


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


def _labels(panel: Panel) -> list[str]:
    """The different entries of the legend in its order."""
    ordered = sorted(panel.curves, key=lambda c: LEGEND_ORDER.index(c.kind))
    return list(dict.fromkeys(typeset(c.label) for c in ordered if c.label))


def _legend_columns(panel: Panel, width: float) -> int:
    """Entries of the legend per line over axes of this width [in]: all in one line if they fit."""
    widths = [0.062 * len(label) + 0.53 for label in _labels(panel)]
    return len(widths) if sum(widths) <= width else max(1, int(width / max(widths)))


def _legend_lines(panel: Panel, width: float) -> int:
    """Lines of the legend over axes of this width [in]."""
    return -(-len(_labels(panel)) // _legend_columns(panel, width)) if _labels(panel) else 0


def _draw_legend(axes: Axes, panel: Panel, width: float) -> None:
    """Legend above the panel, ordered from left to right, line by line."""
    labels = _labels(panel)
    if not labels:
        return
    handles, names = axes.get_legend_handles_labels()
    by_label = dict(zip(names, handles, strict=True))
    columns = _legend_columns(panel, width)
    # matplotlib fills column by column
    order = [label for k in range(columns) for label in labels[k::columns]]
    style = {"borderaxespad": 0.1, "handlelength": 2.4, "columnspacing": 1.4, "ncols": columns}
    entries = legend(axes, handles=[by_label[label] for label in order], labels=order, **style).legend_handles
    for entry in entries:
        if isinstance(entry, Line2D):
            entry.set_markersize(max(entry.get_markersize(), MIN_MARK))


def draw_correlation(names: Sequence[str], correlation: Array) -> Figure:
    """The lower triangle of a correlation matrix (n, n): blue is negative, red positive."""
    count = len(names)
    size = 2.9 + 0.30 * count
    figure = new_figure(min(size + 1.0, 11), min(size, 10.4))
    axes = figure.add_subplot()
    lower = np.where(np.tri(count, k=-1, dtype=bool), correlation, np.nan)[1:, :-1]
    cells = np.argwhere(np.isfinite(lower))
    squares = [Rectangle((float(j), float(i)), 1, 1) for i, j in cells]
    image = PatchCollection(squares, cmap="RdBu_r", edgecolor=PALETTE.grid, linewidth=0.6)
    image.set_array(lower[cells[:, 0], cells[:, 1]])
    image.set_clim(-1, 1)
    axes.add_collection(image)
    axes.set(xlim=(0, count - 1), ylim=(count - 1, 0))
    axes.set_aspect("equal")
    axes.spines[:].set_visible(False)
    ticks = np.arange(count - 1) + 0.5
    axes.set_xticks(ticks, names[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7.5)
    axes.set_yticks(ticks, names[1:], fontsize=7.5)
    axes.tick_params(length=0, colors=PALETTE.ink)
    for i, j in zip(*np.nonzero(np.abs(np.nan_to_num(lower)) >= LARGE_CORRELATION), strict=True):
        value = lower[i, j]
        colour = "#ffffff" if abs(value) > 0.65 else "#000000"
        text = f"{value:.1f}".replace("-", MINUS)
        axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5, color=colour)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=PALETTE.ink, length=2)
    return figure
