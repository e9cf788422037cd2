"""The style of all figures: colours, axes, ticks, legends; signals over time with their errors below; files.

Figures leave as PNG for documents, or as SVG inside a page, whose colours then follow the page's theme.
"""

from __future__ import annotations

import base64
import io
import itertools
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from orchestrator.base.text import MINUS, typeset
from orchestrator.base.units import convert, pretty, reader_unit, superscript

Array = NDArray[np.float64]
Style = Mapping[str, Any]

WIDTH = 9.6  # [in]: 1000 pixels of a page
DOTS: tuple[float, tuple[float, float]] = (0, (1, 1.4))
DASHES: tuple[float, tuple[float, float]] = (0, (5, 2))
# Lines that differ without colour.
LINE_STYLES: tuple[Any, ...] = (
    "-",
    (0, (4, 2)),
    (0, (1, 1.2)),
    (0, (6, 1.5, 1, 1.5)),
    (0, (3, 1)),
    (0, (8, 2)),
)


@dataclass(frozen=True)
class Palette:
    """Colours that differ in hue and in lightness, for colour-blind readers and for print (Okabe and Ito).

    pairs    a light and a dark one: reference and simulation, or measurement and fit
    series   for lines that have no partner
    """

    ink: str = "#1c2024"
    faint: str = "#8a9099"
    grid: str = "#dfe2e6"
    good: str = "#2f7d4f"
    bad: str = "#c2341d"
    pairs: tuple[tuple[str, str], ...] = (
        ("#7db7dc", "#06406b"),
        ("#f0b35c", "#8c3b00"),
        ("#8fd0b5", "#00513a"),
        ("#d3a6cf", "#6b2a66"),
    )
    series: tuple[str, ...] = ("#0b5fa5", "#b34700", "#00735a", "#8f3f8f", "#7a6400", "#333333")

    def pair(self, place: int) -> tuple[str, str]:
        """The pair with this number; after the last one they begin again."""
        return self.pairs[place % len(self.pairs)]

    def colour(self, place: int) -> str:
        """The colour of the line with this number."""
        return self.series[place % len(self.series)]


PALETTE = Palette()
# Twice as many points as a screen is wide: the eye sees every peak, the file stays small.
BUCKETS = 600


def decimate(x: Array, y: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """The smallest and the largest sample of each bucket, in their order: no peak is lost.

    x, y   shape (n,); returned with at most 2 buckets + 2 samples, first and last among them; a bucket
           without any number keeps its first sample, so that a gap stays one
    """
    if len(x) <= 2 * buckets:
        return x, y
    edges = np.linspace(0, len(x), buckets + 1).astype(int)
    picks = {0, len(x) - 1}
    for a, b in itertools.pairwise(edges):
        known = a + np.flatnonzero(np.isfinite(y[a:b]))
        picks |= {int(known[y[known].argmin()]), int(known[y[known].argmax()])} if known.size else {int(a)}
    kept = np.array(sorted(picks))
    return x[kept], y[kept]


def new_figure(width: float, height: float, **padding: Any) -> Figure:
    """An empty figure [in]; `padding` as of matplotlib's constrained layout."""
    layout = ConstrainedLayoutEngine()
    layout.set(**padding)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def style_axes(axes: Axes, x: str = "", y: str = "", size: float = 9) -> None:
    """Left and bottom spine only, a faint grid, and the labels of the axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALETTE.faint)
    axes.tick_params(which="both", colors=PALETTE.ink, labelsize=8, length=3)
    axes.grid(True, color=PALETTE.grid, linewidth=0.6)
    axes.set_axisbelow(True)
    if x:
        axes.set_xlabel(x, color=PALETTE.ink, fontsize=size)
    if y:
        axes.set_ylabel(y, color=PALETTE.ink, fontsize=size)


def limit_ticks(axis: Axis, count: int = 5) -> None:
    """At most `count` ticks; the power of ten of very large and small numbers stands in the label."""
    axis.set_major_locator(MaxNLocator(count))
    low, high = axis.get_view_interval()
    power = _power(axis)
    scale = 10.0**power
    span = abs(high - low) / scale
    digits = min(4, max(0, 1 - math.floor(math.log10(span)))) if span > 0 else 2

    def text(value: float, _: object) -> str:
        found = f"{value / scale:.{digits}f}"
        found = found.rstrip("0").rstrip(".") if "." in found else found
        return "0" if found == "-0" else found.replace("-", MINUS)

    axis.set_major_formatter(text)
    if power:
        name, bracket, unit = axis.get_label_text().partition("[")
        axis.set_label_text(f"{name.rstrip()} [10{superscript(str(power))}{f' {unit}' if bracket else ']'}")


def power_ticks(axis: Axis) -> None:
    """Large and small numbers with their power of ten at each tick; above the axes it would hit a legend."""
    power = _power(axis)
    if not power or axis.get_scale() != "linear":
        return
    ending = f"·10{superscript(str(power))}"
    axis.set_major_formatter(
        lambda value, _: f"{value / 10.0**power:.3g}{ending if value else ''}".replace("-", MINUS)
    )


def _power(axis: Axis) -> int:
    """The power of ten of the largest number in view; 0 where digits are as short."""
    largest = max(map(abs, axis.get_view_interval()))
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    return 0 if -3 <= power <= 4 else power


def heading(figure: Figure, title: str, below: str = "") -> None:
    """Title on the left; below, small, where the data come from."""
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=PALETTE.ink, fontweight="bold")
    if below:
        figure.supxlabel(below, x=0.99, ha="right", fontsize=8, color=PALETTE.faint)


def legend(of: Figure | Axes, **options: Any) -> Any:
    """A legend above what it explains: inside it would lie on the curves."""
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    place = {"loc": "outside upper left"} if isinstance(of, Figure) else above
    return of.legend(
        **{"fontsize": 8, "frameon": False, "labelcolor": PALETTE.ink, "ncols": 3, **place, **options}
    )


def legend_entry(label: str, **style: Any) -> Line2D:
    """An entry of a legend."""
    return Line2D([], [], label=label, **style)


REFERENCE = {"color": PALETTE.faint, "linewidth": 2.6}
SIMULATION = {"color": PALETTE.ink, "linewidth": 1.3, "linestyle": DOTS}
ROW_HEIGHT = 0.46  # [in] for each unit of height


@dataclass(frozen=True)
class TraceLine:
    """Samples over time [s], in the unit of their panel."""

    time: Array
    values: Array
    style: Style
    name: str = ""


@dataclass(frozen=True)
class TracePanel:
    """Signals of one quantity over time, and in a strip below their errors.

    unit, error_unit   of the lines, and of the errors
    bounds             limits of the errors: symmetric bands, drawn where they are in sight
    remarks            texts with their colour, at the right of the panel
    heights            of panel and strip, in units of `ROW`
    """

    unit: str
    lines: Sequence[TraceLine]
    label: str = ""
    title: str = ""
    errors: Sequence[TraceLine] = ()
    error_label: str = "error"
    error_unit: str = ""
    bounds: Collection[float] = ()
    remarks: Sequence[tuple[str, str]] = ()
    heights: tuple[float, float] = (2.5, 1.0)


def draw_traces(
    panels: Sequence[TracePanel],
    window: tuple[float, float] | None = None,
    title: str = "",
    below: str = "",
    key: Iterable[Line2D] = (),
) -> Figure:
    """The panels over a common time axis.

    window   first and last time [s]
    below    a short line below the figure
    key      what the kinds of lines mean
    """
    heights = [height for panel in panels for height in panel.heights[: 2 if panel.errors else 1]]
    figure = new_figure(WIDTH, ROW_HEIGHT * sum(heights) + 0.9, h_pad=0.02, hspace=0.0)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    places = iter(axes)
    for panel in panels:
        _draw_panel(next(places), panel)
        if panel.errors:
            _draw_errors(next(places), panel)
    axes[-1].set_xlabel("time [s]", color=PALETTE.ink)
    if window:
        axes[-1].set_xlim(*window)
    heading(figure, title, below)
    if handles := list(key):
        corner = "upper right" if title else "outside upper center"
        legend(figure, handles=handles, loc=corner, ncols=min(len(handles), 4), fontsize=9)
    figure.align_ylabels()
    return figure


def _draw_panel(axes: Axes, panel: TracePanel) -> None:
    unit = f"[{pretty(panel.unit) or '1'}]"
    style_axes(axes, y=f"{panel.label}\n{unit}" if panel.label else unit)
    for line in panel.lines:
        axes.plot(*decimate(line.time, line.values), label=line.name or None, **line.style)
    axes.margins(y=0.12)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=3)
    if any(line.name for line in panel.lines):
        legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
    for place, (text, colour) in enumerate(panel.remarks):
        at = (1.01, 0.98 - 0.4 * place)
        axes.annotate(
            typeset(text), at, xycoords="axes fraction", color=colour, fontsize=8, va="top", ha="left"
        )


def _draw_errors(axes: Axes, panel: TracePanel) -> None:
    """The strip below a panel, with a scale of its own."""
    style_axes(axes, y=f"{panel.error_label}\n[{pretty(panel.error_unit) or '1'}]", size=8)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    for line in panel.errors:
        axes.plot(*decimate(line.time, line.values), **{**line.style, "linewidth": 0.9})
    largest = 1.2 * max(float(np.nanmax(np.abs(line.values), initial=0.0)) for line in panel.errors) or 1.0
    axes.set_ylim(-largest, largest)
    axes.locator_params(axis="y", nbins=3)
    power_ticks(axes.yaxis)
    for bound in panel.bounds:
        if bound < largest:
            axes.axhspan(-bound, bound, color=PALETTE.good, alpha=0.13, linewidth=0)


def plot_signals(
    time: Array, signals: Mapping[str, Array], units: Mapping[str, str], title: str = ""
) -> Figure:
    """Signals over time [s], a panel for each display unit, in the order of the signals."""
    panels: dict[str, list[TraceLine]] = {}
    for name, values in signals.items():
        unit = units.get(name, "")
        lines = panels.setdefault(reader_unit(unit), [])
        dashes = LINE_STYLES[len(lines) % len(LINE_STYLES)]
        style = {"color": PALETTE.colour(len(lines)), "linewidth": 1.3, "linestyle": dashes}
        lines.append(TraceLine(time, convert(values, unit, reader_unit(unit), name), style, name))
    found = [TracePanel(unit, lines, heights=(4.5, 0.0)) for unit, lines in panels.items()]
    return draw_traces(found, (float(time[0]), float(time[-1])), title)


def svg(figure: Figure) -> str:
    """The figure as SVG text: text stays text, the same figure gives the same bytes."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "harvester", "path.simplify_threshold": 0.2}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()


def png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as PNG on white."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


# An SVG above this size [characters] is embedded as PNG instead.
SVG_LIMIT = 700_000


def embed(figure: Figure, prefix: str, title: str) -> Markup:
    """The figure for HTML: SVG whose colours follow the page's theme, or PNG if that would be too large.

    prefix   of all ids in it, different for each figure of a page
    """
    text = svg(figure)
    if len(text) > SVG_LIMIT:
        data = Markup(base64.b64encode(png(figure)).decode())
        return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(title, data)
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    role = f'role="img" aria-label="{Markup.escape(title)}"'
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r'\1width="100%"', text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', lambda m: m[1] + role, text, count=1)
    text = re.sub(r'\bid="|href="#|url\(#', lambda m: m[0] + prefix, text)
    text = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    colours = {name: getattr(PALETTE, name) for name in ("ink", "faint", "grid", "good", "bad")}
    for k, (light, dark) in enumerate(PALETTE.pairs):
        colours |= {f"light{k}": light, f"dark{k}": dark}
    for name, colour in colours.items():
        text = text.replace(colour, f"var(--fig-{name}, {colour})")
    return Markup(re.sub(r"\s*\n\s*", "\n", text))
