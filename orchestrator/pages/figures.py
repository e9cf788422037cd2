"""Figures of signals over time, and of curves over other quantities: what they show, their style, and their
form in an HTML page.

A page has the data of each figure and a table of its extremes. uPlot draws it on the screen, where it can be
zoomed, and in print (`templates/plot.js`). `orchestrator.pages.plotting` draws the same figures with
matplotlib, for files that are asked for.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from orchestrator.base.text import TextTable, number, typeset
from orchestrator.base.units import pretty

Array = NDArray[np.float64]
Style = Mapping[str, Any]

DOTS: tuple[float, tuple[float, float]] = (0, (1, 1.4))
DASHES: tuple[float, tuple[float, float]] = (0, (5, 2))
# Line styles that differ without colour.
_STROKES = (4, 2), (1, 1.2), (6, 1.5, 1, 1.5), (3, 1), (8, 2)
LINE_STYLES: tuple[Any, ...] = ("-", *((0, strokes) for strokes in _STROKES))


@dataclass(frozen=True)
class Palette:
    """Colours that differ in hue and in lightness, for colour-blind readers and for print (Okabe and Ito).

    Each has a contrast of at least 3 : 1 with white (WCAG 2.1, 1.4.11), `ink` and `soft` of 4.5 : 1.

    soft     small type
    pairs    (light, dark) for reference and simulation, or for measurement and fit
    series   colours of curves that are not shown in pairs
    """

    ink: str = "#1c2024"
    soft: str = "#5b626b"
    faint: str = "#8a9099"
    grid: str = "#dfe2e6"
    good: str = "#2f7d4f"
    bad: str = "#c2341d"
    pairs: tuple[tuple[str, str], ...] = (
        ("#4c97c8", "#06406b"),
        ("#c77f14", "#7a3300"),
        ("#3f9f7b", "#00513a"),
        ("#b779b1", "#6b2a66"),
    )
    series: tuple[str, ...] = ("#0b5fa5", "#b34700", "#00735a", "#8f3f8f", "#7a6400", "#333333")

    def pair(self, index: int) -> tuple[str, str]:
        """Light and dark colour of pair `index`, in cyclic order."""
        return self.pairs[index % len(self.pairs)]

    def colour(self, index: int) -> str:
        """Colour of curve `index`, in cyclic order."""
        return self.series[index % len(self.series)]

    def variables(self) -> dict[str, str]:
        """Name of the CSS variable of each colour, which follows the theme of the page -> colour."""
        colours = {name: getattr(self, name) for name in ("ink", "soft", "faint", "grid", "good", "bad")}
        for k, (light, dark) in enumerate(self.pairs):
            colours |= {f"light{k}": light, f"dark{k}": dark}
        return colours | {f"series{k}": colour for k, colour in enumerate(self.series)}


PALETTE = Palette()
REFERENCE = {"color": PALETTE.faint, "linewidth": 2.6}
SIMULATION = {"color": PALETTE.ink, "linewidth": 1.3, "linestyle": DOTS}


def curve_style(colour: int, dashes: int) -> dict[str, Any]:
    """A colour and a line style by their numbers, in cyclic order."""
    pattern = LINE_STYLES[dashes % len(LINE_STYLES)]
    return {"color": PALETTE.colour(colour), "linewidth": 1.3, "linestyle": pattern}


# Two samples per bucket are about the width of a screen in pixels: no visible peak is lost.
BUCKETS = 600


def decimate(x: Array, y: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """Reduce a curve to the smallest and the largest sample of each bucket, in their order.

    x, y   shape (n,)

    The result has at most 2 buckets + 2 samples, including the first and the last one. A bucket that
    contains only NaN keeps its first sample, so that a gap remains visible.
    """
    if len(x) <= 2 * buckets:
        return x, y
    edges = np.linspace(0, len(x), buckets + 1).astype(int)
    selected = {0, len(x) - 1}
    for a, b in itertools.pairwise(edges):
        finite = a + np.flatnonzero(np.isfinite(y[a:b]))
        if finite.size:
            selected |= {int(finite[y[finite].argmin()]), int(finite[y[finite].argmax()])}
        else:
            selected.add(int(a))
    indices = np.array(sorted(selected))
    return x[indices], y[indices]


@dataclass(frozen=True)
class TraceLine:
    """A curve: samples over time [s], or over the figure's axis, in the unit of the panel.

    style   options of a matplotlib line: color, linewidth [pt], linestyle; marker, markerfacecolor, alpha;
            fill: the curve is the outline of bars
    name    what distinguishes the curve in its panel, such as "head"; empty if there is only one
    key     entry of the figure's key that it belongs to, such as "simulation"
    error   half the length of each error bar, or down and up, shape (2, n), of a figure with an axis
    """

    time: Array
    values: Array
    style: Style
    name: str = ""
    key: str = ""
    error: Array | None = None

    @property
    def label(self) -> str:
        """Name and key in words."""
        return ", ".join(filter(None, (self.name, self.key)))


def bars(spans: Sequence[tuple[float, float, float]], half: float, colour: str, name: str = "") -> TraceLine:
    """Horizontal bars from a begin to an end around a row: (row, begin, end) each, as one outline."""
    x = np.concatenate([[low, high, high, low, low, np.nan] for _, low, high in spans])
    sides = half * np.array([-1, -1, 1, 1, -1, np.nan])
    y = np.concatenate([row + sides for row, *_ in spans])
    return TraceLine(x, y, {"color": colour, "fill": True}, name)


@dataclass(frozen=True)
class TraceArea:
    """The area between two curves over time [s], shape (n,) each."""

    time: Array
    low: Array
    high: Array
    colour: str
    key: str = ""


@dataclass(frozen=True)
class TracePanel:
    """Signals of one quantity over time, and their errors in a strip below.

    unit         of the curves
    error_unit   of the errors
    bounds       limits of the errors: symmetric bands, drawn if they are inside the axes
    whole        the axes of the errors reach to their limits, however small the errors are
    remarks      (text, colour) on the right of the panel
    key_beside   legend on the right of the panel, not above it; pages have it above in any case
    heights      of panel and error strip, in units of `ROW_HEIGHT`
    log          logarithmic values, of a figure with an axis
    words        value -> word, in place of the labels of ticks on a page
    """

    unit: str
    lines: Sequence[TraceLine]
    label: str = ""
    title: str = ""
    errors: Sequence[TraceLine] = ()
    error_label: str = "error"
    error_unit: str = ""
    bounds: Collection[float] = ()
    whole: bool = False
    remarks: Sequence[tuple[str, str]] = ()
    heights: tuple[float, float] = (2.5, 1.0)
    areas: Sequence[TraceArea] = ()
    key_beside: bool = False
    log: bool = False
    words: Mapping[float, str] = field(default_factory=dict)

    @property
    def heading(self) -> str:
        """Label or title."""
        return self.label or self.title


@dataclass(frozen=True)
class TraceFigure:
    """Panels over a common axis.

    window   first and last time [s]; default: those of the curves
    below    a short line below the figure
    key      (text, style) of what the line styles mean
    axis     label of the axis, if it is not the time: then each curve has its own places on it, and may be
             a cloud of marks
    ticks    logarithm to the base 10, which is the place on the axis -> label; empty: a linear axis
    """

    panels: Sequence[TracePanel]
    window: tuple[float, float] | None = None
    title: str = ""
    below: str = ""
    key: Sequence[tuple[str, Style]] = ()
    axis: str = ""
    ticks: Mapping[float, str] = field(default_factory=dict)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]; around a single point in time there is a margin."""
        times = [line.time for panel in self.panels for line in panel.lines if len(line.time)]
        start, stop = self.window or (float(min(map(np.nanmin, times))), float(max(map(np.nanmax, times))))
        margin = 0.1 * abs(start) or 1.0
        if start >= stop:
            return start - margin, start + margin
        margin = MARGIN * (stop - start) if self.axis else 0.0  # marks at the ends are whole
        return start - margin, stop + margin


# ---- charts: a panel is one, its error strip another


@dataclass(frozen=True)
class _Chart:
    """One pair of axes."""

    label: str
    unit: str
    lines: Sequence[TraceLine]
    height: float
    panel: TracePanel
    strip: bool = False


def _charts(figure: TraceFigure) -> Iterator[_Chart]:
    for panel in figure.panels:
        yield _Chart(panel.heading, panel.unit, panel.lines, panel.heights[0], panel)
        if panel.errors:
            height = panel.heights[1]
            yield _Chart(panel.error_label, panel.error_unit, panel.errors, height, panel, strip=True)


# ---- the plot

PIXELS_PER_POINT = 1.4
_VARIABLES = {colour: name for name, colour in PALETTE.variables().items()}


def _dashes(style: Style) -> list[float]:
    """Lengths of strokes and gaps over the line width; empty for a solid line."""
    pattern = style.get("linestyle", "-")
    return [] if isinstance(pattern, str) else [float(length) for length in pattern[1]]


def power_of_ten(low: float, high: float) -> int:
    """Common power of ten of tick labels; 0 if plain digits are as short."""
    largest = max(abs(low), abs(high))
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    return 0 if -3 <= power <= 4 else power


MARGIN = 0.02  # of an axis, beyond the outermost marks
MARKS = 2000  # of a cloud, all its groups together; a larger one is thinned evenly
SAMPLES = 2500  # of a curve; a longer one keeps the extremes of its buckets
DIGITS = 20  # bits of a value: one part in a million of the curve's range


def plot(figure: TraceFigure, name: str) -> Markup:
    """The figure for a page: data of the plot, and a table of the extremes, which is there without scripts.

    name   what the figure shows, for readers who do not see it; the figure's title by default

    Bars have no such table: their numbers are in the text. The page must have `plot_scripts`.
    """
    name = figure.title or name
    folded = Markup("<details><summary>Extremes of {}</summary>{}</details>")
    bars = any("fill" in line.style for panel in figure.panels for line in panel.lines)
    return Markup(
        '<div class="plot" role="group" aria-label="{name}">'
        '<script type="application/json">{spec}</script>{table}</div>'
    ).format(
        name=name,
        spec=script_data(_spec(figure)),
        table="" if bars else folded.format(name, _extremes(figure).html()),
    )


def script_data(data: Any) -> Markup:
    """Data as JSON for a script element; `<` is escaped, because it could end the element."""
    return Markup(json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c"))


def _extremes(figure: TraceFigure) -> TextTable:
    """Least and largest value of each curve in the window, with their times: the figure in numbers."""
    rows, (start, stop) = [], figure.span
    for chart in _charts(figure):
        for line in chart.lines:
            inside = (line.time >= start) & (line.time <= stop) & np.isfinite(line.values)
            time, values = line.time[inside], line.values[inside]
            if not values.size:
                continue
            label = " ".join(filter(None, (chart.panel.heading, chart.label if chart.strip else "")))
            cells = [label + (f": {line.label}" if line.label else ""), pretty(chart.unit) or "1"]
            for k in (int(values.argmin()), int(values.argmax())):
                at = 10 ** time[k] if figure.ticks else time[k]
                cells += [
                    typeset(number(float(values[k]), 4)),
                    number(float(at), 4) if figure.axis else f"{at:.2f}",
                ]
            rows.append(cells)
    at = f"at {figure.axis}" if figure.axis else "at [s]"
    return TextTable(["curve", "unit", "least", at, "largest", at], rows, left=(0, 1))


def _spec(figure: TraceFigure) -> dict[str, Any]:
    """What plot.js needs: charts with their lines, and one packed block of samples.

    Charts with the same times share a column.
    """
    columns: list[Array] = []
    charts = []
    for chart in _charts(figure):
        lines = [*chart.lines, *([] if chart.strip else _edges(chart.panel.areas))]
        entry: dict[str, Any] = {"label": chart.label, "unit": pretty(chart.unit), "height": chart.height}
        if figure.axis:
            entry |= _cloud(chart, columns)
        else:
            time, values = _common(lines, figure.span)
            at = next((k for k, c in enumerate(columns) if np.array_equal(c, time)), len(columns))
            columns += [time] if at == len(columns) else []
            entry["time"] = at
            entry["lines"] = [_line_spec(line, len(columns) + k, chart) for k, line in enumerate(lines)]
            columns += values
        entry |= {"words": list(chart.panel.words.items())} if chart.panel.words else {}
        if chart.strip:
            entry |= {"strip": 1, "bounds": [float(f"{b:.6g}") for b in sorted(chart.panel.bounds)]}
            entry |= {"whole": 1} if chart.panel.whole else {}
        elif chart.panel.remarks:
            remarks = [(typeset(text).replace("\n", ", "), _name(c)) for text, c in chart.panel.remarks]
            entry["remarks"] = remarks
        charts.append(entry)
    return {
        "charts": charts,
        "key": [{"label": label, **_style_spec(style)} for label, style in figure.key],
        "window": list(figure.span),
        "below": figure.below,
        "axis": figure.axis,
        **({"ticks": list(figure.ticks.items())} if figure.ticks else {}),
        **pack(columns),
    }


def _cloud(chart: _Chart, columns: list[Array]) -> dict[str, Any]:
    """Curves with places of their own, whose columns are added: places, values, ends of the error bars.

    Values of a logarithmic panel are logarithms to the base 10.
    """
    log = chart.panel.log and not chart.strip
    lines, ends = list[dict[str, Any]](), list[Array]()
    counts = np.cumsum([0] + [len(line.time) if "marker" in line.style else 0 for line in chart.lines])
    shares = np.diff(counts * MARKS // max(int(counts[-1]), 1))
    for line, share in zip(chart.lines, shares, strict=True):
        count = len(line.time)
        most = min(count, int(share) if "marker" in line.style else MARKS)
        kept = np.linspace(0, count - 1, most).astype(int)
        shown = [line.values]
        if line.error is not None:
            down, up = np.broadcast_to(line.error, (2, len(line.values)))
            shown += [line.values - down, line.values + up]
        with np.errstate(all="ignore"):  # what has no logarithm is not drawn
            values = [(np.log10(v) if log else v)[kept] for v in shown]
        names = dict(zip(("x", "column", "low", "high"), range(len(columns), len(columns) + 4), strict=True))
        spec = _line_spec(line, 0, chart) | dict(list(names.items())[: 1 + len(values)])
        lines.append(spec)
        columns += [line.time[kept], *values]
        ends += values
    finite = np.concatenate([v[np.isfinite(v)] for v in ends] or [np.zeros(0)])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    return {"lines": lines, "low": low, "high": high, "log": int(log)}


def _edges(areas: Iterable[TraceArea]) -> Iterator[TraceLine]:
    """Lower and upper edge of each area as curves without stroke."""
    for area in areas:
        for values in (area.low, area.high):
            yield TraceLine(area.time, values, {"color": area.colour, "area": True}, key=area.key)


def _line_spec(line: TraceLine, column: int, chart: _Chart) -> dict[str, Any]:
    style = {**line.style, "linewidth": 1.0} if chart.strip else line.style
    names = {"name": line.name, "key": line.key}
    return {"column": column, **{k: v for k, v in names.items() if v}, **_style_spec(style)}


def _style_spec(style: Style) -> dict[str, Any]:
    width = PIXELS_PER_POINT * float(style.get("linewidth", 1.2))
    spec: dict[str, Any] = {"colour": _name(style["color"]), "width": round(width, 2)}
    spec |= {"dash": [round(length * width, 1) for length in _dashes(style)]} if _dashes(style) else {}
    spec |= {"alpha": style["alpha"]} if "alpha" in style else {}
    if "marker" in style:
        spec |= {"mark": style["marker"], "hollow": int(style.get("markerfacecolor") == "none")}
    return spec | {name: 1 for name in ("area", "fill") if name in style}


def _name(colour: str) -> str:
    """Name of the CSS variable of a colour, or the colour."""
    return _VARIABLES.get(colour, colour)


def _common(lines: Sequence[TraceLine], span: tuple[float, float]) -> tuple[Array, list[Array]]:
    """The times of all lines together, thinned, and the values there, shape (n,) each.

    A curve keeps its extremes. Where only another curve has a sample, it is interpolated.
    """
    inside = [_inside(line, span) for line in lines]
    times = [line.time for line in inside]
    if not all(np.array_equal(times[0], time) for time in times) or len(times[0]) > SAMPLES:
        buckets = max(SAMPLES // (2 * len(lines)), 200)
        times = [decimate(line.time, line.values, buckets)[0] for line in inside]
    time = np.unique(np.concatenate(times))
    return time, [np.interp(time, line.time, line.values, np.nan, np.nan) for line in inside]


def _inside(line: TraceLine, span: tuple[float, float]) -> TraceLine:
    """The samples in the window; all, if none is."""
    chosen = (line.time >= span[0]) & (line.time <= span[1])
    return replace(line, time=line.time[chosen], values=line.values[chosen]) if chosen.any() else line


def pack(columns: Sequence[Array]) -> dict[str, Any]:
    """Columns of numbers as one short text.

    A value is rounded to its place among 2^DIGITS between the least and the largest of its column; the last
    place stands for NaN. Differences of successive places are stored in three bytes each, first bytes first,
    and compressed (zlib, base64).

    columns   [samples, least value, step between places] of each column
    """
    heads, planes = [], []
    for column in columns:
        finite = column[np.isfinite(column)]
        low = float(finite.min()) if finite.size else 0.0
        step = ((float(finite.max()) - low) if finite.size else 0.0) / (2**DIGITS - 2) or 1.0
        places = np.full(len(column), 2**DIGITS - 1, dtype=np.int64)
        places[np.isfinite(column)] = np.rint((finite - low) / step)
        differences = np.diff(places, prepend=0) & 0xFFFFFF
        planes += [(differences >> shift & 0xFF).astype(np.uint8).tobytes() for shift in (0, 8, 16)]
        heads.append([len(column), low, step])
    data = zlib.compress(b"".join(planes), 9)
    return {"columns": heads, "data": base64.b64encode(data).decode()}


VENDOR = Path(__file__).with_name("vendor") / "uplot"
TEMPLATES = Path(__file__).with_name("templates")


def plot_scripts() -> Markup:
    """Style and scripts of all plots of a page: uPlot as its authors distribute it, and plot.js."""
    library, style, licence = (
        (VENDOR / name).read_text(encoding="utf-8")
        for name in ("uPlot.iife.min.js", "uPlot.min.css", "LICENSE")
    )
    script = (TEMPLATES / "plot.js").read_text(encoding="utf-8")
    script = re.sub(r"^ +(//.*\n)?", "", script, flags=re.MULTILINE)  # without indentation and comments
    return Markup(
        f"<style>{style}</style>\n<script>\n/*\n{licence}*/\n{library}</script>\n<script>\n{script}</script>"
    )
