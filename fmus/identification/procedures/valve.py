"""Valve (section 4(a), Fig. 5): C_R over the command from pressures and flow at stepped voltages.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

Of every step the means are taken, with their standard errors. What is fitted is the flow, not C_R: small
flows have the largest relative error, and 1/Q^2 would bend it. The error of a point is that of the mean flow
and that of the mean drop times dQ/d(dp); the opening law of the valve (`valve_law`) keeps C_R positive and
monotone. All edges are fitted together, as the spools are symmetrical, and each on its own for comparison.

Validity: steady flow above the dead zone of the meter. Only the product C_d A sqrt(2/rho) is measured: the
area belongs to the C_d and the density that are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.contract import ModelError
from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures import valve_panels
from fmus.identification.procedures.given import number, training
from fmus.identification.procedures.regression import UNLIKELY, Guess, Regression, fit, misfit_remark
from fmus.identification.procedures.valve_law import Constants, Law, flow, resistance
from fmus.identification.procedures.valve_points import Points, points
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

Array = NDArray[np.float64]

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, where C_R is told
ROUNDING = "boom_stick.valve_command_rounding"
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


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Area and dead band of the valve's edges, and C_R over the command."""
    every = points(training(recordings, "valve"))
    constants = Constants.of(known)
    common = fitted(every.measured, constants, number(known, ROUNDING))
    rounding = Number(common.law().rounding, "V", "identified", "of all edges")
    own = {edge: fitted(every.of(edge).measured, constants, rounding) for edge in every.edges}
    return Finding(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_estimates(common)),
        panels=valve_panels.panels(every, common.law(), constants),
        remarks=remarks(every, common, own),
        others=(*_curve(common), *(e for edge, one in own.items() for e in _estimates(one, edge))),
    )


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
        modelled, slope = flow(given.command, given.drop, law, constants)
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
    """Probability of such differences if all edges are equal: chi-square of the common fit less that of each."""
    alone = sum(one.regression.chi_square for one in own.values())
    freedom = sum(one.regression.freedom for one in own.values())
    scale = alone / freedom if stats.chi2.sf(alone, freedom) < UNLIKELY else 1.0
    gained = (common.regression.chi_square - alone) / scale
    return float(stats.chi2.sf(gained, common.regression.freedom - freedom)) if len(own) > 1 else 1.0


def _estimates(of: ValveFit, edge: str = "") -> list[Estimate]:
    fit, where = of.regression, f"[{edge}]" if edge else ""
    steps = f"fit of {len(of.points.flow)} steps, section 4(a)"
    told = "" if of.rounded else f", rounding {of.rounding:g} V as known"
    found = [
        fit.estimate(f"valve_area{where}", "m2", f"{steps}, with C_d and density as known", of="area"),
        fit.estimate(f"valve_dead_band{where}", "V", f"{steps}{told}", of="dead_band"),
    ]
    if of.rounded:
        found.append(fit.estimate(f"valve_command_rounding{where}", "V", steps, of="rounding"))
    return found


def _resistance(of: ValveFit, command: float, values: Mapping[str, float]) -> float:
    return float(resistance(np.array([command]), of.law(values), of.constants)[0])


def _curve(of: ValveFit) -> list[Estimate]:
    """C_R at the voltages of `VOLTAGES`, and where the straight part of the opening begins."""
    closed = of.law().dead_band
    found = [
        of.regression.derived(
            f"C_R({v:g} V)",
            "Pa.s2/m6",
            "eq. (2) with the fitted opening",
            partial(_resistance, of, v),
        )
        for v in VOLTAGES
        if v > closed + of.law().rounding / 4 and v <= of.constants.full_command
    ]
    foot = of.regression.derived(
        "dead_band + rounding/2",
        "V",
        "where the straight part of the opening, extended, meets zero",
        lambda p: p["dead_band"] + p.get("rounding", of.rounding) / 2,
    )
    return [*found, foot]


def remarks(every: Points, common: ValveFit, own: Mapping[str, ValveFit]) -> tuple[str, ...]:
    """What was masked, what the data cannot tell, whether the edges differ, what the polynomial does."""
    return (
        *_masked(every),
        *_foot(common),
        *_edges(common, own),
        *_polynomial(every.measured, common.constants),
        *misfit_remark(common.regression, "The opening law"),
        "The intervals hold the noise of the instruments, not an error of their calibration.",
    )


def _masked(every: Points) -> list[str]:
    dead, rest = every.where(every.dead), every.where(~every.good & ~every.dead)
    found = []
    if dead.command.size:
        found.append(
            f"{dead.command.size} of {every.command.size} steps, at commands up to {dead.command.max():.3g} V, "
            "are masked: the flow is in the dead zone of the meter. This is the flat region of Fig. 5; there the "
            "curve is the opening law, extended."
        )
    if rest.command.size:
        found.append(f"{rest.command.size} steps are masked: an instrument is at the end of its range.")
    return found


def _foot(common: ValveFit) -> list[str]:
    if common.rounded:
        return []
    return [
        "The data do not tell the rounded foot of the opening, only dead_band + rounding/2. "
        f"The dead band is that less half the known rounding of {common.rounding:.3g} V: a rounding that is "
        "0.1 V larger makes it 0.05 V smaller."
    ]


def _edges(common: ValveFit, own: Mapping[str, ValveFit]) -> list[str]:
    probability = asymmetry(common, own)
    if len(own) < 2:
        return [f"Only the edge {', '.join(own)} was tested."]
    if probability > 0.01:
        return [f"The {len(own)} edges do not differ significantly (chi-square test, p = {probability:.2g})."]
    areas = ", ".join(f"{edge} {one.regression['area'] * 1e6:.4g} mm2" for edge, one in own.items())
    return [f"The edges differ significantly (chi-square test, p = {probability:.1g}): {areas}."]


def _polynomial(good: Points, constants: Constants) -> list[str]:
    paper = valve_panels.fitted_polynomial(good)
    fine = np.linspace(good.command.min(), constants.full_command, 2000)
    values, wrong = paper(fine), paper.wrong(fine)
    if not wrong.any():
        return [f"A polynomial of degree {paper.degree} (chosen by AIC) stays positive and falls."]
    low, high = fine[values < 0], fine[wrong & (values >= 0)]
    parts = [
        f"is {word} at places from {part.min():.3g} to {part.max():.3g} V"
        for word, part in (("negative", low), ("positive but rising", high))
        if part.size
    ]
    return [f"The paper's form, a polynomial (degree {paper.degree} by AIC), {' and '.join(parts)}."]
