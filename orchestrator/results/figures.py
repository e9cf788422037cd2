"""Traces over each other as in the paper's Figs. 10 and 11, each with its error below.

Which signals stand in which row is data: a `FigureSpec` of `Panel`s. The reference is a broad solid line, the
simulation a dotted one; the strip below each panel shows simulation - reference on a scale of its own.

Figures inside an HTML page: SVG that follows the page's colours, or PNG where that would be too large.
"""

from __future__ import annotations

import base64
import io
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.units import convert, linear, shown
from orchestrator.data.trace import Trace
from orchestrator.results import summary
from orchestrator.results.compare import Row, Validation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Panel:
    """One row of a figure: signals of one quantity over time; `names` tells two of them apart."""

    label: str
    signals: tuple[str, ...]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class FigureSpec:
    """A figure: its rows from top to bottom."""

    title: str
    panels: tuple[Panel, ...]
    caption: str = ""


@dataclass(frozen=True)
class Palette:
    """Colours that differ in hue and in lightness, for colour-blind readers and for print (Okabe and Ito).

    pairs   per signal of a panel: colour of the reference, colour of the simulation
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
    )


PALETTE = Palette()
# Twice as many points as a screen is wide: the eye sees every peak, the file stays small.
BUCKETS = 600


@dataclass(frozen=True)
class _Line:
    """What is drawn of one signal, in its display unit; reference and row are None for the run alone."""

    place: int
    name: str
    unit: str
    time: Array
    simulation: Array
    reference: Array | None
    row: Row | None

    @property
    def colours(self) -> tuple[str, str]:
        """Of reference and simulation."""
        return PALETTE.pairs[self.place % len(PALETTE.pairs)]


def decimate(time: Array, values: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """The smallest and the largest sample of each bucket, in their order: no peak is lost.

    time, values   shape (n,); returned with at most 2 buckets + 2 samples, first and last among them
    """
    if len(time) <= 2 * buckets:
        return time, values
    edges = np.linspace(0, len(time), buckets + 1).astype(int)
    picks = {0, len(time) - 1}
    for a, b in itertools.pairwise(edges):
        picks |= {int(a + values[a:b].argmin()), int(a + values[a:b].argmax())}
    kept = np.array(sorted(picks))
    return time[kept], values[kept]


def draw(spec: FigureSpec, validation: Validation, trace: Trace | None = None) -> Figure:
    """The figure of a validation; signals that were not compared, such as commands, come from the trace."""
    panels = [(panel, list(_lines(spec, panel, validation, trace))) for panel in spec.panels]
    strips = [[line for line in lines if _has_error(line, validation)] for _, lines in panels]
    heights: list[float] = []
    for strip in strips:
        heights += [2.5, 1.0] if strip else [1.5]
    layout = ConstrainedLayoutEngine(h_pad=0.02, hspace=0.0)
    figure = Figure(figsize=(9.6, 0.46 * sum(heights) + 0.9), layout=layout)
    FigureCanvasAgg(figure)
    axes = iter(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    for (panel, lines), strip in zip(panels, strips, strict=True):
        _curves(top := next(axes), panel, lines)
        if strip:
            _errors(top := next(axes), strip)
    top.set_xlabel("time [s]", color=PALETTE.ink)
    top.set_xlim(*validation.window)
    _legend(figure, spec)
    figure.align_ylabels()
    return figure


def _has_error(line: _Line, validation: Validation) -> bool:
    """Judged signals have their error drawn; all compared ones where the reference states no limits."""
    return line.row is not None and (line.row.passed is not None or not validation.judged)


def _lines(spec: FigureSpec, panel: Panel, validation: Validation, trace: Trace | None) -> Iterator[_Line]:
    """The panel's signals, from the comparison where there is one, else from the trace."""
    rows: Mapping[str, Row] = {row.signal: row for row in validation.rows}
    for place, signal in enumerate(panel.signals):
        name = panel.names[place] if place < len(panel.names) else ""
        row = rows.get(signal)
        if row is not None:
            to = shown(row.unit)
            values = [convert(y, row.unit, to, signal) for y in (row.simulation, row.reference)]
            yield _Line(place, name, to, row.time, values[0], values[1], row)
        elif trace is not None and signal in trace.signals:
            unit = trace.units.get(signal, "")
            to = shown(unit)
            values = [convert(trace[signal], unit, to, signal)]
            yield _Line(place, name, to, trace.time, values[0], None, None)
        else:
            raise Problem(f"figure {spec.title!r}: signal {signal!r} is neither compared nor in the run")


def frame(axes: Axes) -> None:
    """A quiet frame: left and bottom only, faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALETTE.faint)
    axes.tick_params(colors=PALETTE.ink, labelsize=8, length=3)
    axes.grid(True, color=PALETTE.grid, linewidth=0.6)
    axes.set_axisbelow(True)


def _curves(axes: Axes, panel: Panel, lines: list[_Line]) -> None:
    """The panel itself: reference solid, simulation dotted."""
    frame(axes)
    units = {line.unit for line in lines}
    axes.set_ylabel(f"{panel.label}\n[{', '.join(sorted(units)) or '1'}]", color=PALETTE.ink, fontsize=9)
    for line in lines:
        solid, dotted = line.colours
        if line.reference is None:
            axes.plot(*decimate(line.time, line.simulation), color=dotted, linewidth=1.2, label=line.name)
            continue
        axes.plot(*decimate(line.time, line.reference), color=solid, linewidth=2.6, label=line.name)
        axes.plot(*decimate(line.time, line.simulation), color=dotted, linewidth=1.3, linestyle=(0, (1, 1.4)))
    if any(line.name for line in lines):
        axes.legend(
            fontsize=8,
            frameon=False,
            loc="lower right",  # above the panel: inside it would lie on the curves
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.0,
            ncols=3,
            labelcolor=PALETTE.ink,
        )
    axes.margins(y=0.12)
    for place, line in enumerate([line for line in lines if line.row]):
        _verdict(axes, line, place)


def _errors(axes: Axes, lines: list[_Line]) -> None:
    """The strip below a panel: simulation - reference, its limit if it is in sight."""
    frame(axes)
    axes.axhline(0, color=PALETTE.faint, linewidth=0.8)
    largest = 0.0
    for line in lines:
        if line.reference is None:
            continue
        error = line.simulation - line.reference
        largest = max(largest, float(np.abs(error).max()))
        axes.plot(*decimate(line.time, error), color=line.colours[1], linewidth=0.9)
    axes.set_ylim(-1.2 * largest or -1, 1.2 * largest or 1)
    axes.set_ylabel(f"error\n[{lines[0].unit}]", color=PALETTE.ink, fontsize=8)
    axes.locator_params(axis="y", nbins=3)
    for bound in {_bound(line) for line in lines if line.row}:
        if bound is not None and bound < 1.2 * largest:
            axes.axhspan(-bound, bound, color=PALETTE.good, alpha=0.13, linewidth=0)


def _verdict(axes: Axes, line: _Line, place: int) -> None:
    """The judged number at the right of the panel, several from top to bottom."""
    row = line.row
    if row is None or row.tolerance is None:
        return
    colour = PALETTE.good if row.passed else PALETTE.bad
    value = summary.judged(row, row.judged_value)
    mark = "✓" if row.passed else "✗"
    text = f"{mark} {line.name} {value}\n{summary.limit(row)}".replace("  ", " ")
    at = (1.01, 0.98 - 0.4 * place)
    axes.annotate(text, at, xycoords="axes fraction", color=colour, fontsize=8, va="top", ha="left")


def _bound(line: _Line) -> float | None:
    """The limit as an error in the display unit, for metrics that have one."""
    row = line.row
    if row is None or row.tolerance is None or row.tolerance.metric not in ("nrmse", "rmse", "maximum"):
        return None
    scale = 1.0 if row.tolerance.in_unit else row.metrics.normalised_by
    return row.tolerance.limit * scale * linear(row.unit, line.unit, row.signal)[0]


def _legend(figure: Figure, spec: FigureSpec) -> None:
    """Title on the left, the meaning of the two line styles on the right."""
    handles = [
        Line2D([], [], color=PALETTE.faint, linewidth=2.6, label="reference"),
        Line2D([], [], color=PALETTE.ink, linewidth=1.3, linestyle=(0, (1, 1.4)), label="simulation"),
    ]
    figure.suptitle(spec.title, x=0.01, ha="left", fontsize=12, color=PALETTE.ink, fontweight="bold")
    figure.legend(
        handles=handles, loc="upper right", ncols=2, fontsize=9, frameon=False, labelcolor=PALETTE.ink
    )


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
    """The figure for HTML: SVG whose colours follow the page's theme, or PNG if that would be too large."""
    text = svg(figure)
    if len(text) > SVG_LIMIT:
        data = base64.b64encode(png(figure)).decode()
        return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(
            title, Markup(data)
        )
    return Markup(_inline(text, prefix))


def _inline(text: str, prefix: str) -> str:
    """An SVG file as an HTML element: no prologue, no metadata, own ids, colours as CSS variables."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r'\1width="100%"', text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', r'\1role="img"', text, count=1)
    text = re.sub(r'\bid="|href="#|url\(#', lambda match: match[0] + prefix, text)
    text = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for name, colour in _theme().items():
        text = text.replace(colour, f"var(--{name}, {colour})")
    return re.sub(r"\s*\n\s*", "\n", text)


def _theme() -> dict[str, str]:
    """CSS variable -> the colour it stands for in the light theme."""
    pairs = {
        f"{part}{k}": c for k, pair in enumerate(PALETTE.pairs) for part, c in zip("rs", pair, strict=True)
    }
    words = ("ink", "faint", "grid", "good", "bad")
    return {
        **{f"fig-{word}": getattr(PALETTE, word) for word in words},
        **{f"fig-{k}": v for k, v in pairs.items()},
    }
