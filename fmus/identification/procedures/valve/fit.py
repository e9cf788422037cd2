"""Fit of the opening law to the steps of the valve test, weighted, with the rounding if the data tell it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.contract import ModelError
from fmus.identification.procedures.shared.regression import UNLIKELY, Guess, Regression, fit
from fmus.identification.procedures.valve.law import Constants, Law, flow
from fmus.identification.procedures.valve.points import Points
from fmus.parameters import Number

Array = NDArray[np.float64]

WELL_TOLD = 0.25  # largest relative standard deviation of a rounding that the data tell


@dataclass(frozen=True)
class ValveFit:
    """A fit of `points`; `rounded` if the data told the rounding of the foot."""

    points: Points
    regression: Regression
    constants: Constants
    rounding: float
    rounded: bool

    def law(self, values: Mapping[str, float] | None = None) -> Law:
        """The law of these values, by default of the fitted ones."""
        v = self.regression.as_dict() if values is None else values
        return Law(v["area"], v["dead_band"], v.get("rounding", self.rounding))


def fitted(given: Points, constants: Constants, rounding: Number) -> ValveFit:
    """Weighted fit of the flow. The rounding is fitted only if the data tell it, else taken as known.

    Where no step falls on the rounded foot, dead band and rounding w show in the sum V_db + w/2 alone.
    """
    fixed = ValveFit(
        given, _fit(given, constants, rounding.value, False, rounding.sd), constants, rounding.value, False
    )
    law = fixed.law()
    if np.count_nonzero(given.command < law.dead_band + law.rounding) < 2:
        return fixed
    free = _fit(given, constants, rounding.value, True, None)
    if free.sd("rounding") > WELL_TOLD * free["rounding"]:
        return fixed
    return ValveFit(given, free, constants, rounding.value, True)


def _fit(given: Points, constants: Constants, rounding: float, free: bool, prior: float | None) -> Regression:
    """The fit with a rounding that is free, free with a prior standard deviation [V], or fixed."""
    start = _guess(given, constants, rounding)
    if free or prior:
        start["rounding"] = Guess(rounding, low=1e-3, high=2.0)

    def residual(v: Mapping[str, float]) -> Array:
        law = Law(v["area"], v["dead_band"], v.get("rounding", rounding))
        modelled, slope = flow(given.command, given.drop, given.whole, law, constants)
        weighted: Array = (given.flow - modelled) / np.hypot(given.flow_error, slope * given.drop_error)
        if prior and not free:
            return np.append(weighted, (v["rounding"] - rounding) / prior)
        return weighted

    return fit(residual, start, f"valve ({', '.join(given.edges)})")


def _guess(given: Points, constants: Constants, rounding: float) -> dict[str, Guess]:
    """From the straight line of K = Q/sqrt(dp) over the command."""
    voltages = np.unique(given.command).size
    if voltages < 3:
        raise ModelError(
            f"valve {', '.join(given.edges)}: flow above the dead zone of the meter at {voltages} voltages, "
            "expected at least 3"
        )
    slope, offset = np.polyfit(given.command, given.flow / np.sqrt(given.drop), 1)
    foot = float(np.clip(-offset / slope, 0.0, given.command.min()))
    gain = slope * (constants.full_command - foot)
    area = gain / (constants.discharge_coefficient * np.sqrt(2 / constants.density))
    return {
        "area": Guess(float(area), low=0.0),
        "dead_band": Guess(max(foot - rounding / 2, 0.05), scale=1.0),
    }


def asymmetry(common: ValveFit, own: Mapping[str, ValveFit]) -> float:
    """Probability of the differences if edges are equal: chi-square of the common fit less those of each."""
    alone = sum(one.regression.chi_square for one in own.values())
    freedom = sum(one.regression.freedom for one in own.values())
    scale = alone / freedom if stats.chi2.sf(alone, freedom) < UNLIKELY else 1.0
    gained = (common.regression.chi_square - alone) / scale
    return float(stats.chi2.sf(gained, common.regression.freedom - freedom)) if len(own) > 1 else 1.0
