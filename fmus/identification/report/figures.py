"""A correlation matrix as a heat map: blue is negative, red positive, numbers where they matter.

A finding as a figure: measurement and fit, the residual below, as in the paper's Figs. 5 to 9.

Panels that follow each other over the same quantity stand in one column and share their x axis; other
quantities get a column of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from fmus.identification.known import Array, Finding, Panel
from fmus.identification.report import panels
from fmus.identification.report.panels import PALETTE, WIDTH, is_residual, labelled, lines, plain_ticks
from fmus.identification.report.wording import footer

TOLD = 0.3  # magnitude from which a correlation is told as a number


def draw_matrix(names: Sequence[str], correlation: Array) -> Figure:
    """The lower triangle; names of parameters, correlation (n, n)."""
    count = len(names)
    size = 2.9 + 0.30 * count
    figure = Figure(figsize=(min(size + 1.0, 11), min(size, 10.4)), layout="constrained")
    FigureCanvasAgg(figure)
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
    for i, j in zip(*np.nonzero(np.abs(np.nan_to_num(shown)) >= TOLD), strict=True):
        value = shown[i, j]
        colour = "#ffffff" if abs(value) > 0.65 else "#000000"
        text = f"{value:.1f}".replace("-", "\N{MINUS SIGN}")
        axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5, color=colour)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=PALETTE.ink, length=2)
    return figure


COLUMNS = 2
MANY = 3  # panels over one quantity that stand beside each other, not below
TALL, FLAT = 2.35, 1.15  # in, of a panel and of a residual
LABELS = 0.95  # in, beside every column
COUNTED = ("group", "recording", "run")  # x axes with whole numbers
Column = tuple[Panel, ...]


def draw_finding(finding: Finding, kinds: Iterable[str] = (), *, titled: bool = True) -> Figure:
    """The figure of a finding; `kinds` of its recordings, for the line that says where the data are from."""
    rows = _rows(columns(finding.panels))
    room = _room(max(map(len, rows)))
    heights = [max(sum(height(panel, room) for panel in column) for column in row) for row in rows]
    layout = ConstrainedLayoutEngine(h_pad=0.03, hspace=0.02, wspace=0.06, w_pad=0.06)
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.35 * len(rows) + 0.75), layout=layout)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(rows), max(map(len, rows)), height_ratios=heights)
    shared: dict[Any, Axes] = {}
    for place, row in enumerate(rows):
        for side, column in enumerate(row):
            where = grid[place, side] if len(row) > 1 else grid[place, :]
            over = (column[0].x_label, column[0].x_unit)
            shared[over] = _column(figure, where, column, _room(len(row)), shared.get(over))
    heading(figure, finding.title if titled else "", footer(finding.figure, kinds))
    return figure


def _room(across: int) -> float:
    """Width of one of several axes beside each other [in]."""
    return WIDTH / across - LABELS


def columns(found: Sequence[Panel]) -> list[Column]:
    """Panels that follow each other over the same quantity, range included, together."""
    together = [tuple(group) for _, group in groupby(found, key=lambda p: (p.x_label, p.x_unit))]
    return _halves(together[0]) if len(together) == 1 else together


def _halves(column: Column) -> list[Column]:
    """A column that is too high beside itself, in the order of its panels."""
    if sum(not is_residual(panel) for panel in column) < MANY:
        return [column]
    sizes = np.cumsum([FLAT if is_residual(panel) else TALL for panel in column])
    cut = int(np.argmin(np.abs(sizes - sizes[-1] / 2))) + 1
    return [column[:cut], column[cut:]]


def _rows(found: list[Column]) -> list[list[Column]]:
    return [found[k : k + COLUMNS] for k in range(0, len(found), COLUMNS)]


def height(panel: Panel, room: float) -> float:
    """Of a panel with its labels [in], drawn `room` [in] wide."""
    if is_residual(panel):
        return FLAT
    return TALL + 0.2 * lines(panel, room)


def heading(figure: Figure, title: str, below: str) -> None:
    """Title on the left; below, small, where the data come from."""
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=PALETTE.ink, fontweight="bold")
    if below:
        figure.supxlabel(below, x=0.99, ha="right", fontsize=8, color=PALETTE.faint)


def _column(figure: Figure, where: Any, column: Column, room: float, first: Axes | None) -> Axes:
    """Panels over each other; only the last one tells its x axis, which they share with `first`."""
    inner: GridSpec = where.subgridspec(len(column), 1, height_ratios=[height(p, room) for p in column])
    drawn = []
    for place, panel in enumerate(column):
        axes = figure.add_subplot(inner[place, 0], sharex=first)
        first = first or axes
        panels.draw_panel(axes, panel, room)
        axes.tick_params(labelbottom=place == len(column) - 1)
        drawn.append(axes)
    if column[-1].x_label in COUNTED:
        drawn[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    plain_ticks(drawn[-1].xaxis)
    label = labelled(column[-1].x_label, column[-1].x_unit[0])
    drawn[-1].set_xlabel(label, color=PALETTE.ink, fontsize=9)
    figure.align_ylabels(drawn)
    return drawn[0]
