"""A finding as a figure: measurement and fit, the residual below, as in the paper's Figs. 5 to 9.

Panels that follow each other over the same quantity stand in one column and share their x axis; other
quantities get a column of their own. What a curve is, one sees without colour: measured values are marks
or a broad line, a fit is a thin dark line, masked values are hollow, what is only compared is dashed.
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
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from fmus.identification.finding import Array, Curve, Finding, Panel
from fmus.identification.report.captions import footer
from fmus.identification.report.style import (
    DASHES,
    DOTS,
    PALETTE,
    WIDTH,
    decimate,
    frame,
    plain_ticks,
    pretty,
    prose,
)

COLUMNS = 2
MANY = 3  # panels over one quantity that stand beside each other, not below
TALL, FLAT = 2.35, 1.15  # in, of a panel and of a residual
LABELS = 0.95  # in, beside every column
FLAT_LABEL = 16  # letters that fit beside a residual
CLOUD = 1500  # points: a larger cloud is drawn as a picture inside the SVG
COUNTED = ("group", "recording", "run")  # x axes with whole numbers
LEAST_MARK = 4.0  # pt, in the legend: the points of a cloud are smaller
MARKS = ("o", "s", "^", "D")
Column = tuple[Panel, ...]


def draw(finding: Finding, kinds: Iterable[str] = (), *, titled: bool = True) -> Figure:
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


def columns(panels: Sequence[Panel]) -> list[Column]:
    """Panels that follow each other over the same quantity, range included, together."""
    together = [tuple(found) for _, found in groupby(panels, key=lambda p: (p.x_label, p.x_unit))]
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


def is_residual(panel: Panel) -> bool:
    """A residual is flat and symmetrical about zero."""
    return "residual" in f"{panel.title} {panel.y_label}".lower()


def height(panel: Panel, room: float) -> float:
    """Of a panel with its labels [in], drawn `room` [in] wide."""
    if is_residual(panel):
        return FLAT
    return TALL + 0.2 * _legend_lines(panel, room)


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
        _panel(axes, panel, room)
        axes.tick_params(labelbottom=place == len(column) - 1)
        drawn.append(axes)
    if column[-1].x_label in COUNTED:
        drawn[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    plain_ticks(drawn[-1].xaxis)
    label = _labelled(column[-1].x_label, column[-1].x_unit[0])
    drawn[-1].set_xlabel(label, color=PALETTE.ink, fontsize=9)
    figure.align_ylabels(drawn)
    return drawn[0]


def _panel(axes: Axes, panel: Panel, room: float) -> None:
    frame(axes)
    places: Counter[str] = Counter()
    joined = any(c.kind == "measured" and c.line for c in panel.curves)
    measured = sum(c.kind in ("measured", "masked") for c in panel.curves)
    for order, curve in enumerate(sorted(panel.curves, key=lambda c: ORDER.index(c.kind))):
        look = style(curve, places[curve.kind], joined=joined, several=measured > 1)
        if is_residual(panel):
            look |= (
                _line(PALETTE.pair(places[curve.kind])[1], 0.8, "-") if curve.line else {"markersize": 3.5}
            )
        places[curve.kind] += 1
        _curve(axes, panel, curve, look | {"zorder": 2 + 0.1 * order})
    _ylabel(axes, panel)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=_pad(panel, room))
    if panel.log:
        axes.set_yscale("log")
    if is_residual(panel):
        _residual(axes)
    else:
        axes.margins(y=0.08)
        _legend(axes, panel, room)
    plain_ticks(axes.yaxis)


# what is drawn later lies above
ORDER = ("masked", "measured", "compared", "corrected", "fit")


def style(curve: Curve, place: int, *, joined: bool, several: bool) -> dict[str, Any]:
    """How a curve is drawn: the `place`-th of its kind.

    joined    are the measured values of the panel a line?
    several   are there several measured curves? Then a fit has the dark colour of its own measurement
    """
    light, dark = PALETTE.pair(place)
    mark = MARKS[place % len(MARKS)]
    drawn = not curve.line
    if curve.kind == "measured":
        return _marks(mark, light, face=light, size=5) if drawn else {"color": light, "linewidth": 2.6}
    if curve.kind == "masked":
        return _marks(mark, PALETTE.faint, face="none", size=4.5) if drawn else _line(PALETTE.grid, 7.0, "-")
    if curve.kind == "fit":
        colour = dark if several else PALETTE.pair(0)[1]
        return (
            _marks("x", colour, face=colour, size=6) if drawn else _line(colour, 1.5, DOTS if joined else "-")
        )
    colour = PALETTE.pair(1)[1] if curve.kind == "compared" else PALETTE.pair(2)[1]
    other = "D" if curve.kind == "compared" else "P"
    dashes = DASHES if curve.kind == "compared" else (0, (6, 1.5, 1, 1.5))
    return _marks(other, colour, face="none", size=5) if drawn else _line(colour, 1.3, dashes)


def _marks(mark: str, colour: str, *, face: str, size: float) -> dict[str, Any]:
    return {
        "linestyle": "none",
        "marker": mark,
        "color": colour,
        "markerfacecolor": face,
        "markersize": size,
        "markeredgewidth": 1.4 if mark == "x" else 0.9,
    }


def _line(colour: str, width: float, dashes: Any) -> dict[str, Any]:
    return {"color": colour, "linewidth": width, "linestyle": dashes}


def _curve(axes: Axes, panel: Panel, curve: Curve, look: dict[str, Any]) -> None:
    x, y = curve.x / panel.x_unit[1], curve.y / panel.y_unit[1]
    if curve.line and curve.error is None and bool(np.all(np.diff(x) > 0)):
        x, y = decimate(x, y)
    if len(x) > CLOUD and not curve.line:
        look = look | {"rasterized": True, "markersize": 1.6, "markeredgewidth": 0.3}
    label = prose(curve.label) or None
    if curve.error is None:
        axes.plot(x, y, label=label, **look)
    else:
        error: Array = curve.error / panel.y_unit[1]
        axes.errorbar(x, y, error, label=label, capsize=2.5, elinewidth=1.1, ecolor=_dark(look), **look)


def _dark(look: dict[str, Any]) -> str:
    """Bars in the dark partner of a light colour: thin, they must be seen."""
    colour: str = look["color"]
    return dict(PALETTE.pairs).get(colour, colour)


def _ylabel(axes: Axes, panel: Panel) -> None:
    """A flat panel has the unit on a line of its own."""
    label, unit = panel.y_label, panel.y_unit[0]
    if not is_residual(panel):
        axes.set_ylabel(_labelled(label, unit), color=PALETTE.ink, fontsize=9)
        return
    told = textwrap.wrap(label, FLAT_LABEL) + ([f"[{pretty(unit)}]"] if unit and unit != "1" else [])
    axes.set_ylabel("\n".join(told), color=PALETTE.ink, fontsize=8)


def _residual(axes: Axes) -> None:
    """Symmetrical about zero."""
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    if axes.get_yscale() == "linear":
        largest = max(map(abs, axes.get_ylim()))
        axes.set_ylim(-largest, largest)
        axes.locator_params(axis="y", nbins=4)


def _labelled(label: str, unit: str) -> str:
    shown = re.sub(r"\[(.+)\]", lambda m: f"[{pretty(m[1])}]", label)
    return f"{shown} [{pretty(unit)}]" if unit and unit != "1" else shown


READING = ("measured", "masked", "fit", "compared", "corrected")


def _labels(panel: Panel) -> list[str]:
    """What the legend tells, each once, measurement first."""
    ordered = sorted(panel.curves, key=lambda c: READING.index(c.kind))
    return list(dict.fromkeys(prose(c.label) for c in ordered if c.label))


def _legend_columns(panel: Panel, room: float) -> int:
    """Entries beside each other, in an axes `room` [in] wide: all in one line if they fit."""
    widths = [0.062 * len(label) + 0.53 for label in _labels(panel)]
    return len(widths) if sum(widths) <= room else max(1, int(room / max(widths)))


def _legend_lines(panel: Panel, room: float) -> int:
    return -(-len(_labels(panel)) // _legend_columns(panel, room)) if _labels(panel) else 0


def _pad(panel: Panel, room: float) -> float:
    """Room of the legend between panel and title [pt]."""
    return 4.0 if is_residual(panel) else 4.0 + 13.0 * _legend_lines(panel, room)


def _legend(axes: Axes, panel: Panel, room: float) -> None:
    """Above the panel: inside it would lie on the curves. Read from left to right, line by line."""
    labels = _labels(panel)
    if not labels:
        return
    handles = dict(reversed(list(zip(*reversed(axes.get_legend_handles_labels()), strict=True))))
    across = _legend_columns(panel, room)
    # matplotlib fills columns first
    order = [label for side in range(across) for label in labels[side::across]]
    legend = axes.legend(
        [handles[label] for label in order],
        order,
        fontsize=8,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.1,
        handlelength=2.4,
        columnspacing=1.4,
        ncols=across,
        labelcolor=PALETTE.ink,
    )
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D):
            handle.set_markersize(max(handle.get_markersize(), LEAST_MARK))
