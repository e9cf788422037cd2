"""Valve (section 4(a), Fig. 5): C_R over the command from pressures and flow at stepped voltages.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

Of every step the means are taken, with their standard errors. What is fitted is the flow, not C_R: small
flows have the largest relative error, and 1/Q^2 would bend it. The error of a point is that of the mean flow
and that of the mean drop times dQ/d(dp); the opening law of the valve (`valve_law`) keeps C_R positive and
monotone. All edges are fitted together, as the spools are symmetrical, and each on its own for comparison.
What the two pressures differ by without flow, a zero of the transducers, is estimated along.

Validity: steady flow above the dead zone of the meter. Only the product C_d A sqrt(2/rho) is measured: the
area belongs to the C_d and the density that are known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.identification.estimate import Curve, Estimate, Panel, ProcedureResult
from fmus.identification.procedures.bench_data import BAR, LITRES, left_out, number, training, where
from fmus.identification.procedures.regression import misfit_remark
from fmus.identification.procedures.valve_law import (
    Constants,
    Law,
    ValveFit,
    ValveSteps,
    asymmetry,
    fit_valve,
    flow,
    impossible,
    polynomial,
    resistance,
    valve_steps,
)
from fmus.parameters import Number
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, where C_R is reported
ROUNDING = "boom_stick.valve_command_rounding"
COMMAND = "command [V]"


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> ProcedureResult:
    """Area and dead band of the valve's edges, and C_R over the command."""
    every = valve_steps(training(recordings, "valve", SIGNALS))
    constants = Constants.of(known)
    common = fit_valve(every.enough(), constants, number(known, ROUNDING))
    shown = replace(every, drop=every.drop - common.regression["zero"])
    rounding = Number(common.law().rounding, "V", "identified", "of all edges")
    own = {edge: fit_valve(every.of(edge).measured, constants, rounding) for edge in every.edges}
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_estimates(common)),
        panels=panels(shown, common.law(), constants),
        remarks=tuple(_remarks(shown, common, rounding)),
        others=(*_curve(common), *(e for edge, one in own.items() for e in _estimates(one, edge))),
    )


def _estimates(of: ValveFit, edge: str = "") -> Iterator[Estimate]:
    fit, where_ = of.regression, f"[{edge}]" if edge else ""
    steps = f"fit of {len(of.steps.flow)} steps, section 4(a)"
    yield fit.estimate(f"valve_area{where_}", "m2", f"{steps}, with C_d and density as known", of="area")
    note = steps if of.rounded else f"{steps}, rounding {of.rounding:g} V as known"
    yield fit.estimate(f"valve_dead_band{where_}", "V", note, of="dead_band")
    if of.rounded:
        yield fit.estimate(f"valve_command_rounding{where_}", "V", steps, of="rounding")


def _curve(of: ValveFit) -> Iterator[Estimate]:
    """C_R at the voltages of `VOLTAGES`, the zero, and where the straight part of the opening begins."""
    law, fit = of.law(), of.regression
    for v in VOLTAGES:
        if law.dead_band + law.rounding / 4 < v <= of.constants.full_command:
            yield fit.derived(
                f"C_R({v:g} V)",
                "Pa.s2/m6",
                "eq. (2) with the fitted opening",
                partial(lambda v, p: float(resistance(np.array([v]), of.law(p), of.constants)[0]), v),
            )
    yield fit.estimate("pressures without flow", "Pa", "pressure_in - pressure_out", "zero")
    yield fit.derived(
        "dead_band + rounding/2",
        "V",
        "where the straight part of the opening, extended, meets zero",
        lambda p: p["dead_band"] + p.get("rounding", of.rounding) / 2,
    )


def panels(every: ValveSteps, law: Law, constants: Constants) -> tuple[Panel, ...]:
    """C_R with the fit, flow over root of drop with what is masked, C_R with the polynomial, residual."""
    good, dead = every.measured, where(every, every.dead & (every.drop > 0))
    edges = {edge: every.of(edge).measured for edge in every.edges}
    fine = np.linspace(good.command.min(), constants.full_command, 400)
    fit = Curve("fit, eq. (2)", fine, resistance(fine, law, constants), "fit", line=True)
    each = [
        Curve(edge, one.command, one.resistance, error=one.resistance_error) for edge, one in edges.items()
    ]
    # K = Q/sqrt(dp), a straight line above the rounded foot, with the steps in the dead zone
    whole = np.linspace(0.0, constants.full_command, 400)
    root = np.sqrt(good.drop)
    gain = (
        Curve("measured", good.command, good.flow / root, error=good.flow_error / root),
        Curve("masked: dead zone of the meter", dead.command, dead.flow / np.sqrt(dead.drop), "masked"),
        Curve("fit", whole, 1 / np.sqrt(resistance(whole, law, constants)), "fit", line=True),
    )
    paper = polynomial(good.command, good.resistance)
    bad = np.where(impossible(paper, fine), paper(fine), math.nan)
    compared = (
        Curve("measured", good.command, good.resistance),
        fit,
        Curve(f"polynomial of degree {paper.degree()}", fine, paper(fine), "compared", line=True),
        Curve("polynomial negative or rising", fine, bad, "masked", line=True),
    )
    residual = []
    for edge, one in edges.items():
        modelled, slope = flow(one.command, one.drop, one.whole, law, constants)
        error = np.hypot(one.flow_error, slope * one.drop_error)
        residual.append(Curve(edge, one.command, one.flow - modelled, error=error))
    return (
        Panel(COMMAND, "C_R [Pa.s2/m6]", (*each, fit), "Resistance of each edge", log=True),
        Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", gain, "Opening, as it was fitted"),
        Panel(COMMAND, "C_R [Pa.s2/m6]", compared, "The paper's polynomial for comparison"),
        Panel(COMMAND, "flow, measured - fitted", tuple(residual), "Residual", y_unit=LITRES),
    )


def _remarks(every: ValveSteps, common: ValveFit, rounding: Number) -> Iterator[str]:
    """What was masked, what the data leave open, whether the edges differ, what the polynomial does."""
    good, dead, rest = every.measured, where(every, every.dead), where(every, ~every.dead)
    if dead.command.size:
        yield (
            f"{dead.command.size} of {every.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. There the curve "
            "is the opening law, extended."
        )
    if lost := left_out(rest.dead, rest.clipped, rest.good):
        yield f"Other steps are left out: {lost}."
    if not common.rounded:
        yield (
            "No flow was measured on the rounded foot of the opening, so the data tell only where its "
            "straight part, extended, begins. The dead band is half a rounding less, with the known rounding "
            f"of {common.rounding:.3g} V: one that is 0.1 V larger makes the dead band 0.05 V smaller."
        )
    yield _edges_remark(common, rounding)
    yield _polynomial_remark(good, common.constants)
    yield from misfit_remark(common.regression, "The opening law")
    if common.regression.significant("zero"):
        yield (
            f"Without flow the two pressures would differ by {common.regression['zero'] / BAR[1]:.2g} +- "
            f"{common.regression.sd('zero') / BAR[1]:.1g} bar. That is taken off as an error of their zeros."
        )
    share = 100 * BAR[1] / (2 * float(good.drop.mean()))  # A ~ Q / sqrt(dp)
    yield (
        "The intervals hold the noise of the instruments, not errors of their calibration: 1 % of the flow "
        f"meter's gain is 1 % of the area, and 1 bar between the two pressures {share:.2g} %."
    )


def _edges_remark(common: ValveFit, rounding: Number) -> str:
    edges = common.steps.edges
    if len(edges) < 2:
        return f"Only the edge {edges[0]} was tested."
    probability, own = asymmetry(common.steps, common.constants, rounding)
    if probability > 0.01:
        return f"The {len(own)} edges do not differ significantly (chi-square test, p = {probability:.2g})."
    areas = ", ".join(f"{edge} {area * 1e6:.4g} mm2" for edge, area in own.items())
    return f"The edges differ significantly (chi-square test, p = {probability:.1g}): {areas}."


def _polynomial_remark(good: ValveSteps, constants: Constants) -> str:
    paper = polynomial(good.command, good.resistance)
    fine = np.linspace(good.command.min(), constants.full_command, 2000)
    bad = impossible(paper, fine)
    form = f"The paper's form, a polynomial (degree {paper.degree()} by AIC),"
    if not bad.any():
        return f"{form} stays positive and falls."
    places, negative = fine[bad], "is negative or " if (paper(fine) < 0).any() else ""
    return (
        f"{form} is shown but not used: at places from {places.min():.2g} to {places.max():.2g} V it "
        f"{negative}rises with the command, which no C_R does."
    )
