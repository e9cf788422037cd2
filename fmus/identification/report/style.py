"""How figures look: colours, axes, numbers and units as print has them."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from numpy.typing import NDArray

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
