"""One panel of a figure, in its units.

What a curve is, one sees without colour: measured values are marks or a broad line, a fit is a thin dark
line, masked values are hollow, what is only compared is dashed.
"""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from fmus.identification.finding import Array, Curve, Panel
from fmus.identification.report import legend
from fmus.identification.report.style import (
    DASHES,
    DOTS,
    PALETTE,
    decimate,
    frame,
    plain_ticks,
    pretty,
    prose,
)

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


def draw(axes: Axes, panel: Panel, room: float) -> None:
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
    pad = 4.0 if is_residual(panel) else 4.0 + legend.LINE * legend.lines(panel, room)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9, color=PALETTE.ink, pad=pad)
    if panel.log:
        axes.set_yscale("log")
    if is_residual(panel):
        _residual(axes)
    else:
        axes.margins(y=0.08)
        legend.draw(axes, panel, room)
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
