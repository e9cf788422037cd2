"""The colour of a pressure: one scale for cylinders, hoses, gauges and the legend.

Plasma of matplotlib (Smith and van der Walt 2015): even steps of lightness, so it can be read without any
sense of colour, and with red-green or blue-yellow blindness. Its palest end is left out: on light ground it
is lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib import colormaps
from matplotlib.colors import to_hex

STEPS = 33  # colours that are told apart: a browser is sent one only when it changes
UNKNOWN = "#8b9196"

SCALE: Sequence[str] = tuple(to_hex(colormaps["plasma"](0.04 + 0.88 * k / (STEPS - 1))) for k in range(STEPS))


def colour(pressure: float, full: float) -> str:
    """The colour of a pressure [Pa] between zero and `full`; grey for what is not known."""
    if not math.isfinite(pressure) or full <= 0:
        return UNKNOWN
    share = min(1.0, max(0.0, pressure / full))
    return SCALE[round(share * (STEPS - 1))]


def gradient() -> str:
    """The scale as a gradient of a style sheet, low to high from left to right."""
    return f"linear-gradient(to right, {', '.join(SCALE[::4])})"
