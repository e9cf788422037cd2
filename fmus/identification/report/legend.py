"""The legend of a panel: above it, read from left to right, line by line."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from fmus.identification.finding import Panel
from fmus.identification.report.style import PALETTE, prose

LINE = 13.0  # pt, height of a line
LEAST_MARK = 4.0  # pt: the points of a cloud are smaller
READING = ("measured", "masked", "fit", "compared", "corrected")


def _labels(panel: Panel) -> list[str]:
    """What the legend tells, each once, measurement first."""
    ordered = sorted(panel.curves, key=lambda c: READING.index(c.kind))
    return list(dict.fromkeys(prose(c.label) for c in ordered if c.label))


def _across(panel: Panel, room: float) -> int:
    """Entries beside each other, in an axes `room` [in] wide: all in one line if they fit."""
    widths = [0.062 * len(label) + 0.53 for label in _labels(panel)]
    return len(widths) if sum(widths) <= room else max(1, int(room / max(widths)))


def lines(panel: Panel, room: float) -> int:
    """How many lines it takes above axes `room` [in] wide."""
    return -(-len(_labels(panel)) // _across(panel, room)) if _labels(panel) else 0


def draw(axes: Axes, panel: Panel, room: float) -> None:
    """Above the panel: inside it would lie on the curves. Read from left to right, line by line."""
    labels = _labels(panel)
    if not labels:
        return
    found, names = axes.get_legend_handles_labels()
    handles = dict(zip(names, found, strict=True))
    across = _across(panel, room)
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
