"""Fit of the opening law to the steps of the valve test, weighted, with the rounding if the data tell it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.procedures.shared.regression import UNLIKELY, Guess, Regression, fit
from fmus.identification.procedures.valve.law import Constants, Law, flow
from fmus.identification.procedures.valve.points import Points
from fmus.parameters import Number

Array = NDArray[np.float64]

WELL_TOLD = 0.25  # largest relative standard deviation of a rounding that the data tell
ROUNDINGS = (1e-3, 2.0)  # V, within which it is searched
# of the mean drop: standard deviation of what two transducers may differ by, 0.25 % of their range each
ZERO = 0.007


@dataclass(frozen=True)
class ValveFit:
    """A fit of `points`.

    rounded   the data told the rounding of the foot
    zeroed    what the two pressures differ by without flow is found along
    """

    points: Points
    regression: Regression
    constants: Constants
    rounding: float
    rounded: bool = False
    zeroed: bool = False

    @property
    def zero(self) -> float:
        """Difference of the pressures without flow [Pa], as far as the data tell it."""
        return self.regression["zero"] if self.zeroed else 0.0

    def law(self, values: Mapping[str, float] | None = None) -> Law:
        """The law of these values, by default of the fitted ones."""
        v = self.regression.as_dict() if values is None else values
        return Law(v["area"], v["dead_band"], v.get("rounding", self.rounding))


def fitted(given: Points, constants: Constants, rounding: Number, zero: bool = True) -> ValveFit:
    """Weighted fit of the flow; the rounding is fitted only if the data tell it, else taken as known.

    Where no step falls on the rounded foot, dead band and rounding w show in the sum V_db + w/2 alone.

    zero   find along what the pressures differ by without flow
    """
    fixed = ValveFit(
        given, _fit(given, constants, rounding, zero=zero), constants, rounding.value, zeroed=zero
    )
    law = fixed.law()
    if np.count_nonzero(given.command < law.dead_band + law.rounding) < 2:
        return fixed
    free = _fit(given, constants, rounding, zero=zero, free=True)
    low, high = ROUNDINGS
    if free.sd("rounding") > WELL_TOLD * free["rounding"] or not 1.01 * low < free["rounding"] < 0.99 * high:
        return fixed
    return replace(fixed, regression=free, rounded=True)


def _fit(
    given: Points, constants: Constants, rounding: Number, *, zero: bool, free: bool = False
) -> Regression:
    """The fit with a rounding that is free, or held by its standard deviation [V], or fixed."""
    start, held = _guess(given, constants, rounding.value), dict[str, tuple[float, float]]()
    if free or rounding.sd:
        start["rounding"] = Guess(rounding.value, low=ROUNDINGS[0], high=ROUNDINGS[1])
    if rounding.sd and not free:
        held["rounding"] = (rounding.value, rounding.sd)
    if zero:
        sd = ZERO * float(given.drop.mean())
        start["zero"], held["zero"] = Guess(0.0, scale=sd), (0.0, sd)

    def residual(v: Mapping[str, float]) -> Array:
        law = Law(v["area"], v["dead_band"], v.get("rounding", rounding.value))
        modelled, slope = flow(given.command, given.drop - v.get("zero", 0.0), given.whole, law, constants)
        weighted: Array = (given.flow - modelled) / np.hypot(given.flow_error, slope * given.drop_error)
        return np.append(weighted, [(v[n] - value) / sd for n, (value, sd) in held.items()])

    return fit(residual, start, f"valve ({', '.join(given.edges)})")


def _guess(given: Points, constants: Constants, rounding: float) -> dict[str, Guess]:
    """From the straight line of K = Q/sqrt(dp) over the command."""
    slope, offset = np.polyfit(given.command, given.flow / np.sqrt(given.drop), 1)
    foot = float(np.clip(-offset / slope, 0.0, given.command.min()))
    gain = slope * (constants.full_command - foot)
    area = gain / (constants.discharge_coefficient * np.sqrt(2 / constants.density))
    return {
        "area": Guess(float(area), low=0.0),
        "dead_band": Guess(max(foot - rounding / 2, 0.05), scale=1.0),
    }


def asymmetry(given: Points, constants: Constants, rounding: Number) -> tuple[float, dict[str, float]]:
    """Probability of the edges' differences if they are equal, and the area [m2] of each.

    Chi-square of the common fit less those of each edge, without a zero of the pressures: all edges have the
    same, and it would take a difference of theirs for its own.
    """
    common = _fit(given, constants, rounding, zero=False)
    own = {edge: _fit(given.of(edge), constants, rounding, zero=False) for edge in given.edges}
    alone = sum(one.chi_square for one in own.values())
    freedom = sum(one.freedom for one in own.values())
    scale = alone / freedom if stats.chi2.sf(alone, freedom) < UNLIKELY else 1.0
    gained = (common.chi_square - alone) / scale
    areas = {edge: one["area"] for edge, one in own.items()}
    return (float(stats.chi2.sf(gained, common.freedom - freedom)) if len(own) > 1 else 1.0), areas
