"""How figures look: colours, axes, numbers and units as print has them.

The legend of a panel: above it, read from left to right, line by line.

The ways out of a figure: PNG for documents, SVG inside a page.

One panel of a figure, in its units.

What a curve is, one sees without colour: measured values are marks or a broad line, a fit is a thin dark
line, masked values are hollow, what is only compared is dashed.
"""

from __future__ import annotations

import base64
import io
import itertools
import math
import re
import textwrap
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fmus.identification.known import Array as Array_of_finding
from fmus.identification.known import Curve, Panel

Array = NDArray[np.float64]

WIDTH = 9.6  # in; 1000 pixels of a page
# Twice as many points as a screen is wide: the eye sees every peak, the file stays small.
BUCKETS = 600
DOTS: tuple[float, tuple[float, float]] = (0, (1, 1.4))
DASHES: tuple[float, tuple[float, float]] = (0, (5, 2))


@dataclass(frozen=True)
class Palette:
    """Colours that differ in hue and in lightness, for colour-blind readers and for print (Okabe and Ito).

    pairs   colour of the measurement, colour of the fit to it
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

    def pair(self, place: int) -> tuple[str, str]:
        """The pair of the curve with this number; after the last one they begin again."""
        return self.pairs[place % len(self.pairs)]


PALETTE = Palette()


def frame(axes: Axes) -> None:
    """A quiet frame: left and bottom only, faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALETTE.faint)
    axes.tick_params(which="both", colors=PALETTE.ink, labelsize=8, length=3)
    axes.grid(True, color=PALETTE.grid, linewidth=0.6)
    axes.set_axisbelow(True)


def plain_ticks(axis: Axis) -> None:
    """Large and small numbers as powers of ten at the ticks: an exponent above would lie on the legend."""
    if axis.get_scale() != "linear":
        return
    largest = max(map(abs, axis.get_view_interval()))
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    if -3 <= power <= 4:
        return
    ending = f"·10{raised(str(power))}"

    def told(value: float, _: object) -> str:
        return f"{value / 10.0**power:.3g}{ending if value else ''}".replace("-", "\N{MINUS SIGN}")

    axis.set_major_formatter(told)


def pretty(unit: str) -> str:
    """A unit as print has it: a dot in the middle, powers raised."""
    powers = re.sub(r"(?<=[A-Za-z])\^?(-?\d)(?!\d|\.\d)", lambda m: raised(m[1]), unit)
    return re.sub(r"\.(?!\d)", "·", powers)


def prose(text: str) -> str:
    """Numbers of a program in a sentence as print has them: 2.5e-13 as 2.5·10⁻¹³, +- as ±."""
    found = re.sub(r"(?<=\d)e([+-]?\d+)\b", lambda m: f"·10{raised(str(int(m[1])))}", text)
    return found.replace("+-", "±")


def raised(digits: str) -> str:
    """Digits as an exponent."""
    return digits.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


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
        piece = y[a:b]
        known = np.flatnonzero(np.isfinite(piece))
        picks |= (
            {int(a + known[pick(piece[known])]) for pick in (np.argmin, np.argmax)} if known.size else {a}
        )
    kept = np.array(sorted(picks))
    return x[kept], y[kept]


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


def draw_legend(axes: Axes, panel: Panel, room: float) -> None:
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


DPI = 150
# An SVG above this size [characters] is embedded as PNG instead.
SVG_LIMIT = 700_000


def png(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as PNG on white."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def svg(figure: Figure) -> str:
    """The figure as SVG text: text stays text, the same figure gives the same bytes."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "harvester", "path.simplify_threshold": 0.2}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()


def embed(figure: Figure, prefix: str, title: str) -> Markup:
    """The figure for HTML: SVG whose colours follow the page's theme, or PNG if that would be too large."""
    text = svg(figure)
    if len(text) > SVG_LIMIT:
        data = Markup(base64.b64encode(png(figure)).decode())
        return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(title, data)
    return Markup(_inline(text, prefix, title))


def _inline(text: str, prefix: str, title: str) -> str:
    """An SVG file as an HTML element: no prologue, no metadata, own ids, colours as CSS variables."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    label = Markup.escape(title)
    text = re.sub(r'(<svg [^>]*?)width="[^"]*"', r'\1width="100%"', text, count=1)
    text = re.sub(r'(<svg [^>]*?)height="[^"]*"', rf'\1role="img" aria-label="{label}"', text, count=1)
    text = re.sub(r'\bid="|href="#|url\(#', lambda match: match[0] + prefix, text)
    text = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for name, colour in _theme().items():
        text = text.replace(colour, f"var(--{name}, {colour})")
    return re.sub(r"\s*\n\s*", "\n", text)


def _theme() -> dict[str, str]:
    """CSS variable -> the colour it stands for in the light theme."""
    words = {f"fig-{word}": getattr(PALETTE, word) for word in ("ink", "faint", "grid", "good", "bad")}
    for k, (measured, fit) in enumerate(PALETTE.pairs):
        words |= {f"fig-m{k}": measured, f"fig-f{k}": fit}
    return words


FLAT_LABEL = 16  # letters that fit beside a residual
CLOUD = 1500  # points: a larger cloud is drawn as a picture inside the SVG
MARKS = ("o", "s", "^", "D")
# mark and dashes of the first, second ... curve that is only compared
COMPARED: tuple[tuple[str, Any], ...] = (
    ("D", DASHES),
    ("v", (0, (1.5, 1.5, 1.5, 4))),
    ("<", (0, (9, 3))),
    (">", (0, (3, 1, 1, 1, 1, 1))),
)


def is_residual(panel: Panel) -> bool:
    """A residual is flat and symmetrical about zero."""
    return "residual" in f"{panel.title} {panel.y_label}".lower()


def draw_panel(axes: Axes, panel: Panel, room: float) -> None:
    """Draw a panel into axes `room` [in] wide."""
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
    pad = 4.0 if is_residual(panel) else 4.0 + LINE * lines(panel, room)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=pad)
    if panel.log:
        axes.set_yscale("log")
    if is_residual(panel):
        _residual(axes)
    else:
        axes.margins(y=0.08)
        draw_legend(axes, panel, room)
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
    if curve.kind == "compared":
        other, dashes = COMPARED[place % len(COMPARED)]
        colour = PALETTE.pair((1, 3, 2, 0)[place % len(COMPARED)])[1]
    else:
        other, dashes, colour = "P", (0, (6, 1.5, 1, 1.5)), PALETTE.pair(2)[1]
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
        error: Array_of_finding = curve.error / panel.y_unit[1]
        axes.errorbar(x, y, error, label=label, capsize=2.5, elinewidth=1.1, ecolor=_dark(look), **look)


def _dark(look: dict[str, Any]) -> str:
    """Bars in the dark partner of a light colour: thin, they must be seen."""
    colour: str = look["color"]
    return dict(PALETTE.pairs).get(colour, colour)


def _ylabel(axes: Axes, panel: Panel) -> None:
    """A flat panel has the unit on a line of its own."""
    label, unit = panel.y_label, panel.y_unit[0]
    if not is_residual(panel):
        axes.set_ylabel(labelled(label, unit), color=PALETTE.ink, fontsize=9)
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


def labelled(label: str, unit: str) -> str:
    """A label with its unit, as print has it."""
    shown = re.sub(r"\[(.+)\]", lambda m: f"[{pretty(m[1])}]", label)
    return f"{shown} [{pretty(unit)}]" if unit and unit != "1" else shown
