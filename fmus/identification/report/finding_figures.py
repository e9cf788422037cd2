"""Figures of what a procedure found: measurement and fit, the residual below, as in the paper's Figs. 5 to 9.

Kinds of curves differ without colour: measured values are marks or a broad line, a fit is a thin dark line,
masked values are hollow, what is only compared is dashed. Panels that follow each other over one quantity
stand in one column and share their x axis; other quantities get a column of their own.
"""

from __future__ import annotations

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
from orchestrator.base.plotting import (
    DASHES,
    DOTS,
    PALETTE,
    WIDTH,
    decimate,
    heading,
    legend,
    new_figure,
    power_ticks,
    style_axes,
)
from orchestrator.base.text import MINUS, name_with_unit, typeset
from orchestrator.base.units import pretty
from orchestrator.data.table import Array

COLUMNS = 2
MANY = 3  # panels over one quantity that stand next to each other, not below
TALL, FLAT = 2.35, 1.15  # in, of a panel and of a residual
LABELS = 0.95  # in, next to every column
COUNTED = ("group", "recording", "run")  # x axes with whole numbers
LINE = 13.0  # pt, height of a line of the legend
LEAST_MARK = 4.0  # pt: the points of a cloud are smaller
FLAT_LABEL = 16  # letters that fit next to a residual
CLOUD = 1500  # points: a larger cloud is drawn as a picture inside the SVG
READING = ("measured", "masked", "fit", "compared", "corrected")  # order of the legend
DRAWING = ("masked", "measured", "compared", "corrected", "fit")  # what is drawn later lies above
MARKS = ("o", "s", "^", "D")
# mark, dashes and pair of colours of the first, second ... curve that is only compared
COMPARED: tuple[tuple[str, Any, int], ...] = (
    ("D", DASHES, 1),
    ("v", (0, (1.5, 1.5, 1.5, 4)), 3),
    ("<", (0, (9, 3)), 2),
    (">", (0, (3, 1, 1, 1, 1, 1)), 0),
)
Column = tuple[Panel, ...]


def draw_finding(finding: ProcedureResult, kinds: Iterable[str] = (), *, titled: bool = True) -> Figure:
    """The figure of a finding; `kinds` of its recordings, for the line that says where the data are from."""
    columns = _columns(finding.panels)
    rows = [columns[k : k + COLUMNS] for k in range(0, len(columns), COLUMNS)]
    room = _room(max(map(len, rows)))
    heights = [max(sum(_height(panel, room) for panel in column) for column in row) for row in rows]
    height = sum(heights) + 0.35 * len(rows) + 0.75
    figure = new_figure(WIDTH, height, h_pad=0.03, hspace=0.02, wspace=0.06, w_pad=0.06)
    grid = figure.add_gridspec(len(rows), max(map(len, rows)), height_ratios=heights)
    shared: dict[Any, Axes] = {}
    for place, row in enumerate(rows):
        for side, column in enumerate(row):
            where = grid[place, side] if len(row) > 1 else grid[place, :]
            over = (column[0].x_label, column[0].x_unit)
            shared[over] = _draw_column(figure, where, column, _room(len(row)), shared.get(over))
    heading(figure, finding.title if titled else "", footer(finding.figure, kinds))
    return figure


def _room(across: int) -> float:
    """Width of one of several axes next to each other [in]."""
    return WIDTH / across - LABELS


def _columns(panels: Sequence[Panel]) -> list[Column]:
    """Panels that follow each other over the same quantity together; a single high column is halved."""
    found = [tuple(group) for _, group in groupby(panels, key=lambda p: (p.x_label, p.x_unit))]
    if len(found) > 1 or sum(not is_residual(panel) for panel in panels) < MANY:
        return found
    sizes = np.cumsum([FLAT if is_residual(panel) else TALL for panel in panels])
    cut = int(np.argmin(np.abs(sizes - sizes[-1] / 2))) + 1
    return [tuple(panels[:cut]), tuple(panels[cut:])]


def is_residual(panel: Panel) -> bool:
    """A residual is flat and symmetrical about zero."""
    return "residual" in f"{panel.title} {panel.y_label}".lower()


def _height(panel: Panel, room: float) -> float:
    """Of a panel with its labels [in], drawn `room` [in] wide."""
    return FLAT if is_residual(panel) else TALL + 0.2 * _legend_lines(panel, room)


def _draw_column(figure: Figure, where: Any, column: Column, room: float, first: Axes | None) -> Axes:
    """Panels over each other; only the last one has labels at its x axis, which they share with `first`."""
    inner: GridSpec = where.subgridspec(len(column), 1, height_ratios=[_height(p, room) for p in column])
    drawn = []
    for place, panel in enumerate(column):
        axes = figure.add_subplot(inner[place, 0], sharex=first)
        first = first or axes
        _draw_panel(axes, panel, room)
        axes.tick_params(labelbottom=place == len(column) - 1)
        drawn.append(axes)
    last = column[-1]
    if last.x_label in COUNTED:
        drawn[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    power_ticks(drawn[-1].xaxis)
    drawn[-1].set_xlabel(_label(last.x_label, last.x_unit[0]), color=PALETTE.ink, fontsize=9)
    figure.align_ylabels(drawn)
    return drawn[0]


def _label(text: str, unit: str) -> str:
    """A label with its unit; a unit inside the text is printed, too."""
    return name_with_unit(re.sub(r"\[(.+)\]", lambda m: f"[{pretty(m[1])}]", text), unit)


def _draw_panel(axes: Axes, panel: Panel, room: float) -> None:
    flat = is_residual(panel)
    if flat:  # the unit on a line of its own
        unit = [f"[{pretty(panel.y_unit[0])}]"] if pretty(panel.y_unit[0]) else []
        style_axes(axes, y="\n".join([*textwrap.wrap(panel.y_label, FLAT_LABEL), *unit]), size=8)
    else:
        style_axes(axes, y=_label(panel.y_label, panel.y_unit[0]))
    _draw_curves(axes, panel, flat)
    if panel.title:
        pad = 4.0 if flat else 4.0 + LINE * _legend_lines(panel, room)
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=pad)
    if panel.log:
        axes.set_yscale("log")
    if flat:
        axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
        if not panel.log:
            largest = max(map(abs, axes.get_ylim()))
            axes.set_ylim(-largest, largest)
            axes.locator_params(axis="y", nbins=4)
    else:
        axes.margins(y=0.08)
        _draw_legend(axes, panel, room)
    power_ticks(axes.yaxis)


def _draw_curves(axes: Axes, panel: Panel, flat: bool) -> None:
    places: Counter[str] = Counter()
    joined = any(c.kind == "measured" and c.line for c in panel.curves)
    several = sum(c.kind in ("measured", "masked") for c in panel.curves) > 1
    for order, curve in enumerate(sorted(panel.curves, key=lambda c: DRAWING.index(c.kind))):
        place = places[curve.kind]
        style = _style(curve, place, joined=joined, several=several)
        if flat:
            style |= _line(PALETTE.pair(place)[1], 0.8, "-") if curve.line else {"markersize": 3.5}
        places[curve.kind] += 1
        _draw_curve(axes, panel, curve, style | {"zorder": 2 + 0.1 * order})


def _style(curve: Curve, place: int, *, joined: bool, several: bool) -> dict[str, Any]:
    """How a curve is drawn: the `place`-th of its kind.

    joined    are the measured values of the panel a line?
    several   are there several measured curves? Then a fit has the dark colour of its own measurement
    """
    light, dark = PALETTE.pair(place)
    mark = MARKS[place % len(MARKS)]
    if curve.kind == "measured":
        return {"color": light, "linewidth": 2.6} if curve.line else _marks(mark, light, light, 5)
    if curve.kind == "masked":
        return _line(PALETTE.grid, 7.0, "-") if curve.line else _marks(mark, PALETTE.faint, "none", 4.5)
    if curve.kind == "fit":
        colour = dark if several else PALETTE.pair(0)[1]
        return _line(colour, 1.5, DOTS if joined else "-") if curve.line else _marks("x", colour, colour, 6)
    mark, dashes, pair = COMPARED[place % len(COMPARED)]
    if curve.kind == "corrected":
        mark, dashes, pair = "P", (0, (6, 1.5, 1, 1.5)), 2
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
    # bars in the dark partner of a light colour: thin, they must be seen
    dark = dict(PALETTE.pairs).get(style["color"], style["color"])
    error = curve.error / panel.y_unit[1]
    axes.errorbar(x, y, error, label=label, capsize=2.5, elinewidth=1.1, ecolor=dark, **style)


def _labels(panel: Panel) -> list[str]:
    """The entries of the legend, each once, measurement first."""
    ordered = sorted(panel.curves, key=lambda c: READING.index(c.kind))
    return list(dict.fromkeys(typeset(c.label) for c in ordered if c.label))


def _across(panel: Panel, room: float) -> int:
    """Entries next to each other, in an axes `room` [in] wide: all in one line if they fit."""
    widths = [0.062 * len(label) + 0.53 for label in _labels(panel)]
    return len(widths) if sum(widths) <= room else max(1, int(room / max(widths)))


def _legend_lines(panel: Panel, room: float) -> int:
    """How many lines the legend takes above axes `room` [in] wide."""
    return -(-len(_labels(panel)) // _across(panel, room)) if _labels(panel) else 0


def _draw_legend(axes: Axes, panel: Panel, room: float) -> None:
    """Above the panel, read from left to right, line by line."""
    labels = _labels(panel)
    if not labels:
        return
    handles, names = axes.get_legend_handles_labels()
    found = dict(zip(names, handles, strict=True))
    across = _across(panel, room)
    # matplotlib fills columns first
    order = [label for side in range(across) for label in labels[side::across]]
    style = {"borderaxespad": 0.1, "handlelength": 2.4, "columnspacing": 1.4, "ncols": across}
    made = legend(axes, handles=[found[label] for label in order], labels=order, **style)
    for entry in made.legend_handles:
        if isinstance(entry, Line2D):
            entry.set_markersize(max(entry.get_markersize(), LEAST_MARK))


SHOWN = 0.3  # magnitude from which a correlation is shown as a number


def draw_matrix(names: Sequence[str], correlation: Array) -> Figure:
    """The lower triangle of a correlation matrix (n, n): blue is negative, red positive."""
    count = len(names)
    size = 2.9 + 0.30 * count
    figure = new_figure(min(size + 1.0, 11), min(size, 10.4))
    axes = figure.add_subplot()
    shown = np.where(np.tri(count, k=-1, dtype=bool), correlation, np.nan)[1:, :-1]
    cells = np.argwhere(np.isfinite(shown))
    squares = [Rectangle((float(j), float(i)), 1, 1) for i, j in cells]
    image = PatchCollection(squares, cmap="RdBu_r", edgecolor=PALETTE.grid, linewidth=0.6)
    image.set_array(shown[cells[:, 0], cells[:, 1]])
    image.set_clim(-1, 1)
    axes.add_collection(image)
    axes.set(xlim=(0, count - 1), ylim=(count - 1, 0))
    axes.set_aspect("equal")
    axes.spines[:].set_visible(False)
    ticks = np.arange(count - 1) + 0.5
    axes.set_xticks(ticks, names[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7.5)
    axes.set_yticks(ticks, names[1:], fontsize=7.5)
    axes.tick_params(length=0, colors=PALETTE.ink)
    for i, j in zip(*np.nonzero(np.abs(np.nan_to_num(shown)) >= SHOWN), strict=True):
        value = shown[i, j]
        colour = "#ffffff" if abs(value) > 0.65 else "#000000"
        text = f"{value:.1f}".replace("-", MINUS)
        axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5, color=colour)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=PALETTE.ink, length=2)
    return figure
