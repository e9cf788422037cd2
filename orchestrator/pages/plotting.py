"""Figures drawn by matplotlib, for files and notebooks: common style, panels of signals over time with their
errors, PNG, SVG and PDF.

HTML pages contain figures that scripts draw, see `orchestrator.pages.figures`.
"""

from __future__ import annotations

import base64
import io
import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from orchestrator.base.text import MINUS, typeset
from orchestrator.base.units import pretty, reader_unit, superscript
from orchestrator.pages.figures import (
    PALETTE,
    Array,
    Style,
    TraceFigure,
    TraceLine,
    TracePanel,
    decimate,
    power_of_ten,
)
from orchestrator.pages.signal_figure import default_signals, signal_figure

WIDTH = 9.6  # [in], 1000 pixels in a page


class ShownFigure(Figure):
    """A figure that notebooks show, although it does not belong to pyplot."""

    def _repr_png_(self) -> bytes:
        return png(self, 100)


def new_figure(width: float, height: float, **padding: float) -> Figure:
    """An empty figure of this size [in]; `padding`: options of matplotlib's constrained layout."""
    options: dict[str, Any] = {**padding}
    layout = ConstrainedLayoutEngine(**options)
    figure = ShownFigure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def style_axes(axes: Axes, x: str = "", y: str = "", size: float = 9) -> None:
    """Apply the common style: left and bottom spine, a faint grid, labels of the axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALETTE.faint)
    axes.tick_params(which="both", colors=PALETTE.ink, labelsize=8, length=3)
    axes.grid(True, color=PALETTE.grid, linewidth=0.6)
    axes.set_axisbelow(True)
    if x:
        axes.set_xlabel(x, color=PALETTE.ink, fontsize=size)
    if y:
        axes.set_ylabel(y, color=PALETTE.ink, fontsize=size)


def power_ticks(axis: Axis) -> None:
    """Tick labels with a common power of ten; above the axes it would collide with a legend."""
    power = power_of_ten(*axis.get_view_interval())
    if not power or axis.get_scale() != "linear":
        return
    suffix = f"·10{superscript(str(power))}"
    axis.set_major_formatter(
        lambda value, _: f"{value / 10.0**power:.3g}{suffix if value else ''}".replace("-", MINUS)
    )


def heading(figure: Figure, title: str, below: str = "") -> None:
    """Add a title on the left, and `below`, the source of the data, in small type below the figure."""
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=PALETTE.ink, fontweight="bold")
    if below:
        figure.supxlabel(below, x=0.99, ha="right", fontsize=8, color=PALETTE.soft)


def legend(parent: Figure | Axes, **options: object) -> Any:
    """A legend above a figure or axes, where it covers no curve."""
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    position = {"loc": "outside upper left"} if isinstance(parent, Figure) else above
    style = {"fontsize": 8, "frameon": False, "labelcolor": PALETTE.ink, "ncols": 3}
    chosen: dict[str, Any] = {**style, **position, **options}
    return parent.legend(**chosen)


CLOUD = 1500  # marks from which on they are a bitmap inside of an SVG
ROW_HEIGHT = 0.46  # [in] per unit of `TracePanel.heights`


def draw(shown: TraceFigure) -> Figure:
    """The figure, drawn by matplotlib."""
    heights = [height for panel in shown.panels for height in panel.heights[: 2 if panel.errors else 1]]
    figure = new_figure(WIDTH, ROW_HEIGHT * sum(heights) + 0.9, h_pad=0.02, hspace=0.0)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    remaining = iter(axes)
    for panel in shown.panels:
        _draw_panel(next(remaining), panel)
        if panel.errors:
            _draw_errors(next(remaining), panel)
    axes[-1].set_xlabel(shown.axis or "time [s]", color=PALETTE.ink)
    if shown.ticks:
        low, high = shown.span
        inside = {place: label for place, label in shown.ticks.items() if low <= place <= high}
        if len(inside) < 2:  # a short axis
            round_values = MaxNLocator(5).tick_values(10**low, 10**high)
            inside = {np.log10(v): f"{v:g}" for v in round_values if 10**low <= v <= 10**high}
        axes[-1].set_xticks([*inside], [*inside.values()])
    else:
        power_ticks(axes[-1].xaxis)
    if shown.window:
        axes[-1].set_xlim(*shown.window)
    heading(figure, shown.title, shown.below)
    if handles := [Line2D([], [], label=label, **style) for label, style in shown.key]:
        corner = "upper right" if shown.title else "outside upper center"
        legend(figure, handles=handles, loc=corner, ncols=min(len(handles), 4), fontsize=9)
    figure.align_ylabels()
    return figure


def _draw_panel(axes: Axes, panel: TracePanel) -> None:
    unit = "" if panel.words else f"[{pretty(panel.unit) or '1'}]"
    style_axes(axes, y=f"{panel.label}\n{unit}".strip())
    for area in panel.areas:
        axes.fill_between(area.time, area.low, area.high, color=area.colour, alpha=0.4, linewidth=0)
    named = set[str]()
    for line in panel.lines:
        label = line.name if line.name not in named else None  # a name has one entry in the legend
        named.add(line.name)
        _draw_line(axes, line, {**line.style, "label": label or None})
    axes.margins(y=0.12)
    if panel.log:
        axes.set_yscale("log")
    if panel.words:
        axes.set_yticks([*panel.words], [*panel.words.values()])
    else:
        power_ticks(axes.yaxis)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=3)
    if any(line.name for line in panel.lines):
        beside: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "ncols": 1}
        above: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
        legend(axes, **(beside if panel.key_beside else above))
    for row, (text, colour) in enumerate(panel.remarks):
        position = (1.01, 0.98 - 0.4 * row)
        style: dict[str, Any] = {"color": colour, "fontsize": 8, "va": "top", "ha": "left"}
        axes.annotate(typeset(text), position, xycoords="axes fraction", **style)


def _draw_line(axes: Axes, line: TraceLine, style: Style) -> None:
    """A line, marks or the outline of bars; the first two may have error bars."""
    if "fill" in style:
        axes.fill(line.time, line.values, color=style["color"], label=style["label"])
        return
    if line.error is not None:
        style = {"capsize": 2.5, "elinewidth": 1.1, **style, "yerr": line.error}
    if "marker" in style:
        style = {"linestyle": "none", "markersize": 4.5, **style, "rasterized": len(line.time) > CLOUD}
    x, y = (
        (line.time, line.values)
        if line.error is not None or "marker" in style
        else decimate(line.time, line.values)
    )
    (axes.plot if line.error is None else axes.errorbar)(x, y, **style)


def _draw_errors(axes: Axes, panel: TracePanel) -> None:
    """Draw the error strip of a panel, with a separate scale."""
    style_axes(axes, y=f"{panel.error_label}\n[{pretty(panel.error_unit) or '1'}]", size=8)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    for line in panel.errors:
        _draw_line(axes, line, {**line.style, "linewidth": 0.9})
    largest = 1.2 * max(float(np.nanmax(np.abs(line.values), initial=0.0)) for line in panel.errors) or 1.0
    axes.set_ylim(-largest, largest)
    axes.locator_params(axis="y", nbins=3)
    power_ticks(axes.yaxis)
    for bound in panel.bounds:
        if bound < largest:
            axes.axhspan(-bound, bound, color=PALETTE.good, alpha=0.13, linewidth=0)


def small_figure(time: Array, signals: Mapping[str, Array], units: Mapping[str, str]) -> str:
    """Up to three signals of each of four quantities as a small picture; empty without samples."""
    groups = itertools.groupby(default_signals(signals, units), lambda n: reader_unit(units.get(n, "")))
    chosen = [name for _, names in groups for name in itertools.islice(names, 3)]
    if not len(time) or not chosen:
        return ""
    figure = signal_figure({"": (time, {n: signals[n] for n in chosen})}, units)
    panels = [replace(panel, heights=(1.8, 0.0)) for panel in figure.panels]
    drawn = base64.b64encode(png(draw(replace(figure, panels=panels)), 90)).decode()
    return f'<img alt="signals over time" style="max-width: 60em" src="data:image/png;base64,{drawn}">'


def svg(figure: Figure) -> str:
    """The figure as reproducible SVG; texts are stored as text, not as paths."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "harvester", "path.simplify_threshold": 0.2}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as PNG with a white background."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def pdf(figure: Figure) -> bytes:
    """The figure as reproducible PDF."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()
