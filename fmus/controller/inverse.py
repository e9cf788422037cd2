"""Joint angles for a place of the stick end, in closed form: cosines in the triangle of both links.

The stick hangs below the line from the boom pivot to the tip (angle < 0), as its cylinder has it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from fmus.contract import ModelError


def joints(radius: float, height: float, p: Mapping[str, float]) -> tuple[float, float]:
    """Boom and stick angle [rad] that bring the stick end to (radius, height) [m]; p by name."""
    x, z = radius - p["boom_pivot_x"], height - p["boom_pivot_z"]
    upper, lower = math.hypot(p["stick_pivot_x"], p["stick_pivot_z"]), p["stick_length"]
    reach = math.hypot(x, z)
    if not abs(upper - lower) <= reach <= upper + lower:
        raise ModelError(
            f"tip at radius {radius:g} m, height {height:g} m is {reach:.3g} m from the boom pivot,"
            f" expected {abs(upper - lower):.3g} to {upper + lower:.3g} m"
        )
    inner = math.acos(_within((upper**2 + reach**2 - lower**2) / (2 * upper * reach)))
    bend = math.acos(_within((reach**2 - upper**2 - lower**2) / (2 * upper * lower)))
    crank = math.atan2(p["stick_pivot_z"], p["stick_pivot_x"])  # of the upper link in the boom's frame
    return math.atan2(z, x) + inner - crank, crank - bend


def _within(cosine: float) -> float:
    return max(-1.0, min(1.0, cosine))
