"""Fig. 5 again: C_R over the command, measured, fitted, by a polynomial; the fitted flow; the residual.

What the reader of the valve's figure must know.

Valve (section 4(a), Fig. 5): C_R over the command from pressures and flow at stepped voltages.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

Of every step the means are taken, with their standard errors. What is fitted is the flow, not C_R: small
flows have the largest relative error, and 1/Q^2 would bend it. The error of a point is that of the mean flow
and that of the mean drop times dQ/d(dp); the opening law of the valve (`law`) keeps C_R positive and
monotone. All edges are fitted together, as the spools are symmetrical, and each on its own for comparison.
What the two pressures differ by without flow, a zero of the transducers, is found along.

Validity: steady flow above the dead zone of the meter. Only the product C_d A sqrt(2/rho) is measured: the
area belongs to the C_d and the density that are known.

Valve, section 4(a), Fig. 5: `procedure` is the experiment, `points`, `fit` and `law` are its steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures.known_values import number, training
from fmus.identification.procedures.regression import misfit_remark
from fmus.identification.procedures.valve_law import (
    Constants,
    Law,
    Points,
    ValveFit,
    asymmetry,
    fitted,
    flow,
    points,
    polynomial,
    resistance,
)
from fmus.parameters import Number
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]

COMMAND = "command [V]"


def panels(every: Points, law: Law, constants: Constants) -> tuple[Panel, ...]:
    """C_R with the fit, flow over root of drop with what is masked, C_R with the polynomial, residual."""
    good = every.measured
    fine = np.linspace(good.command.min(), constants.full_command, 400)
    return (
        _curve_panel(every, fine, law, constants),
        _gain(every, law, constants),
        _compared(good, fine, law, constants),
        _residual(every, law, constants),
    )


def _curve_panel(every: Points, fine: Array, law: Law, constants: Constants) -> Panel:
    each = [
        Curve(edge, one.command, one.resistance, error=one.resistance_error)
        for edge in every.edges
        for one in [every.of(edge).measured]
    ]
    fit = Curve("fit, eq. (2)", fine, resistance(fine, law, constants), "fit", line=True)
    return Panel(COMMAND, "C_R [Pa.s2/m6]", (*each, fit), "Resistance of each edge", log=True)


def _gain(every: Points, law: Law, constants: Constants) -> Panel:
    """Q/sqrt(dp), which is K: a straight line above the rounded foot, with the steps in the dead zone."""
    good, dead = every.measured, every.where(every.dead & (every.drop > 0))
    fine = np.linspace(0.0, constants.full_command, 400)
    curves = (
        Curve(
            "measured",
            good.command,
            good.flow / np.sqrt(good.drop),
            error=good.flow_error / np.sqrt(good.drop),
        ),
        Curve("masked: dead zone of the meter", dead.command, dead.flow / np.sqrt(dead.drop), "masked"),
        Curve("fit", fine, 1 / np.sqrt(resistance(fine, law, constants)), "fit", line=True),
    )
    return Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", curves, "Opening, as it was fitted")


def _compared(good: Points, fine: Array, law: Law, constants: Constants) -> Panel:
    paper = polynomial(good.command, good.resistance)
    values = paper(fine)
    wrong = paper.wrong(fine)
    curves = (
        Curve("measured", good.command, good.resistance),
        Curve("fit, eq. (2)", fine, resistance(fine, law, constants), "fit", line=True),
        Curve(f"polynomial of degree {paper.degree}", fine, values, "compared", line=True),
        Curve("polynomial negative or rising", fine, np.where(wrong, values, math.nan), "masked", line=True),
    )
    return Panel(COMMAND, "C_R [Pa.s2/m6]", curves, "The paper's polynomial for comparison")


def _residual(every: Points, law: Law, constants: Constants) -> Panel:
    def of(edge: str) -> Curve:
        one = every.of(edge).measured
        modelled, slope = flow(one.command, one.drop, one.whole, law, constants)
        error = np.hypot(one.flow_error, slope * one.drop_error)
        return Curve(edge, one.command, one.flow - modelled, error=error)

    curves = tuple(map(of, every.edges))
    return Panel(COMMAND, "flow, measured - fitted", curves, "Residual", y_unit=("L/min", 1e-3 / 60))


BAR = 1e5


def remarks(every: Points, common: ValveFit) -> tuple[str, ...]:
    """What was masked, what the data cannot tell, whether the edges differ, what the polynomial does."""
    return (
        *_masked(every),
        *_foot(common),
        *_edges(common),
        *_polynomial(every.measured, common.constants),
        *misfit_remark(common.regression, "The opening law"),
        *_zero(common),
        _calibration(every.measured),
    )


def _masked(every: Points) -> list[str]:
    dead, rest = every.where(every.dead), every.where(~every.dead)
    found = []
    if dead.command.size:
        found.append(
            f"{dead.command.size} of {every.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. There the curve "
            "is the opening law, extended."
        )
    if rest.left_out:
        found.append(f"Other steps are left out: {rest.left_out}.")
    return found


def _foot(common: ValveFit) -> list[str]:
    if common.rounded:
        return []
    return [
        "No flow was measured on the rounded foot of the opening, so the data tell only where its straight "
        "part, extended, begins. The dead band is half a rounding less, with the known rounding of "
        f"{common.rounding:.3g} V: one that is 0.1 V larger makes the dead band 0.05 V smaller."
    ]


def _zero(common: ValveFit) -> list[str]:
    if not (common.zeroed and common.regression.seen("zero")):
        return []
    return [
        f"Without flow the two pressures would differ by {common.zero / BAR:.2g} +- "
        f"{common.regression.sd('zero') / BAR:.1g} bar. That is taken off as an error of their zeros."
    ]


def _calibration(good: Points) -> str:
    """What errors of calibration do: A ~ Q / sqrt(dp)."""
    share = 100 * BAR / (2 * float(good.drop.mean()))
    return (
        "The intervals hold the noise of the instruments, not errors of their calibration: 1 % of the flow "
        f"meter's gain is 1 % of the area, and 1 bar between the two pressures {share:.2g} %."
    )


def _edges(common: ValveFit) -> list[str]:
    edges, rounding = common.points.edges, Number(common.law().rounding, "V", "identified", "of all edges")
    if len(edges) < 2:
        return [f"Only the edge {edges[0]} was tested."]
    probability, own = asymmetry(common.points, common.constants, rounding)
    if probability > 0.01:
        return [f"The {len(own)} edges do not differ significantly (chi-square test, p = {probability:.2g})."]
    areas = ", ".join(f"{edge} {area * 1e6:.4g} mm2" for edge, area in own.items())
    return [f"The edges differ significantly (chi-square test, p = {probability:.1g}): {areas}."]


def _polynomial(good: Points, constants: Constants) -> list[str]:
    paper = polynomial(good.command, good.resistance)
    fine = np.linspace(good.command.min(), constants.full_command, 2000)
    values, wrong = paper(fine), paper.wrong(fine)
    if not wrong.any():
        return [f"The paper's form, a polynomial (degree {paper.degree} by AIC), stays positive and falls."]
    places, sunk = fine[wrong], "is negative or " if (values < 0).any() else ""
    return [
        f"The paper's form, a polynomial (degree {paper.degree} by AIC), is shown but not used: at places "
        f"from {places.min():.2g} to {places.max():.2g} V it {sunk}rises with the command, which no C_R does."
    ]


SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, where C_R is told
ROUNDING = "boom_stick.valve_command_rounding"


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Area and dead band of the valve's edges, and C_R over the command."""
    every = points(training(recordings, "valve", SIGNALS))
    constants = Constants.of(known)
    common = fitted(every.enough(), constants, number(known, ROUNDING))
    shown = replace(every, drop=every.drop - common.zero)
    rounding = Number(common.law().rounding, "V", "identified", "of all edges")
    own = {edge: fitted(every.of(edge).measured, constants, rounding) for edge in every.edges}
    return Finding(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_estimates(common)),
        panels=panels(shown, common.law(), constants),
        remarks=remarks(shown, common),
        others=(*_curve(common), *(e for edge, one in own.items() for e in _estimates(one, edge))),
    )


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
    if of.zeroed:
        found.append(
            of.regression.estimate("pressures without flow", "Pa", "pressure_in - pressure_out", "zero")
        )
    return [*found, foot]


__all__ = ["SIGNALS", "identify"]
