"""Valve procedure (section 4(a), Fig. 5): C_R over the command, from steps of the command.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

The data are means over each step with their standard errors. The flow is fitted, not C_R: small flows have
the largest relative error, and 1/Q^2 would bias the fit. The error of a point consists of that of the mean
flow and that of the mean drop times dQ/d(dp). The opening law (`valve_law`) keeps C_R positive and monotone.
All edges are fitted together, because the spools are symmetrical, and each edge separately for comparison.
The difference of the two pressures without flow, an offset of the transducers, is estimated as well.

Validity: steady flow above the dead zone of the meter. Only the product C_d A sqrt(2/rho) is measured: the
area is valid for the known C_d and density.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE, Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    difference_limit,
    parameter,
    pressure_offset_remark,
    select,
    training_recordings,
    zero_warning,
)
from fmus.identification.procedures.regression import misfit_remark, misfit_warning
from fmus.identification.procedures.valve_law import (
    OpeningLaw,
    ValveConstants,
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

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, at which C_R is reported
ROUNDING = "boom_stick.valve_command_rounding"
COMMAND, RESISTANCE = "command [V]", "C_R [Pa.s2/m6]"  # labels of axes


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Area and dead band of the valve's edges, and C_R over the command."""
    tests = training_recordings(recordings, "valve", SIGNALS)
    steps, limit = valve_steps(tests), difference_limit(tests, ("pressure_in", "pressure_out"))
    constants = ValveConstants.of(parameters)
    common = fit_valve(steps.checked(), constants, parameter(parameters, ROUNDING), limit)
    corrected = replace(steps, drop=steps.drop - common.regression["zero"])
    rounding = Number(common.law().rounding, "V", "identified", "of all edges")
    separate = {
        edge: fit_valve(steps.of(edge).measured(), constants, rounding, limit) for edge in steps.edges
    }
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_estimates(common)),
        panels=panels(corrected, common.law(), constants),
        remarks=tuple(_remarks(corrected, common, rounding)),
        others=(*_curve(common), *(e for edge, fitted in separate.items() for e in _estimates(fitted, edge))),
        warnings=(
            *misfit_warning(common.regression.times_noise, "valve: the opening law"),
            *zero_warning("valve", *common.zero_wanted, limit, BAR),
        ),
    )


def _estimates(fitted: ValveFit, edge: str = "") -> Iterator[Estimate]:
    fit, suffix = fitted.regression, f"[{edge}]" if edge else ""
    note = f"fit of {len(fitted.steps.flow)} steps, section 4(a)"
    yield fit.estimate(f"valve_area{suffix}", "m2", f"{note}, with C_d and density as known", "area")
    rounding = "" if fitted.rounding_estimated else f", rounding {fitted.rounding:g} V as known"
    yield fit.estimate(f"valve_dead_band{suffix}", "V", note + rounding, "dead_band")
    if fitted.rounding_estimated:
        yield fit.estimate(f"valve_command_rounding{suffix}", "V", note, "rounding")


def _curve(fitted: ValveFit) -> Iterator[Estimate]:
    """C_R at the voltages of `VOLTAGES`, the pressure offset, and the foot of the straight opening."""
    law, fit = fitted.law(), fitted.regression
    for voltage in VOLTAGES:
        if law.dead_band + law.rounding / 4 < voltage <= fitted.constants.full_command:
            yield fit.derived(
                f"C_R({voltage:g} V)",
                "Pa.s2/m6",
                "eq. (2) with the fitted opening",
                partial(
                    lambda v, p: float(resistance(np.array([v]), fitted.law(p), fitted.constants)[0]), voltage
                ),
            )
    yield fit.estimate("pressures without flow", "Pa", "pressure_in - pressure_out", "zero")
    yield fit.derived(
        "dead_band + rounding/2",
        "V",
        "zero of the straight part of the opening, extrapolated",
        lambda p: p["dead_band"] + p.get("rounding", fitted.rounding) / 2,
    )


def panels(steps: ValveSteps, law: OpeningLaw, constants: ValveConstants) -> tuple[Panel, ...]:
    """C_R with the fit, K = Q/sqrt(dp) with masked steps, C_R with the paper's polynomial, residual."""
    good, dead = steps.measured(), select(steps, steps.dead & (steps.drop > 0))
    edges = {edge: steps.of(edge).measured() for edge in steps.edges}
    opened = np.linspace(good.command.min(), constants.full_command, 400)
    fit = Curve("fit, eq. (2)", opened, resistance(opened, law, constants), "fit", line=True)
    by_edge = [Curve(edge, s.command, s.resistance, error=s.resistance_error) for edge, s in edges.items()]
    # K = Q/sqrt(dp) is a straight line above the rounded foot, so it also shows the dead band
    commands = np.linspace(0.0, constants.full_command, 400)
    root = np.sqrt(good.drop)
    gain = (
        Curve("measured", good.command, good.flow / root, error=good.flow_error / root),
        Curve("masked: dead zone of the meter", dead.command, dead.flow / np.sqrt(dead.drop), "masked"),
        Curve("fit", commands, 1 / np.sqrt(resistance(commands, law, constants)), "fit", line=True),
    )
    paper = polynomial(good.command, good.resistance)
    bad = np.where(impossible(paper, opened), paper(opened), math.nan)
    compared = (
        Curve("measured", good.command, good.resistance),
        fit,
        Curve(f"polynomial of degree {paper.degree()}", opened, paper(opened), "compared", line=True),
        Curve("polynomial negative or rising", opened, bad, "masked", line=True),
    )
    residual = []
    for edge, s in edges.items():
        fitted, derivative = flow(s.command, s.drop, s.supply_drop, law, constants)
        error = np.hypot(s.flow_error, derivative * s.drop_error)
        residual.append(Curve(edge, s.command, s.flow - fitted, error=error))
    return (
        Panel(COMMAND, RESISTANCE, (*by_edge, fit), "Resistance of each edge", log=True),
        Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", gain, "Opening, as it was fitted"),
        Panel(COMMAND, RESISTANCE, compared, "The paper's polynomial for comparison"),
        Panel(COMMAND, "flow, measured - fitted", tuple(residual), "Residual", y_unit=LITRES_PER_MINUTE),
    )


def _remarks(steps: ValveSteps, common: ValveFit, rounding: Number) -> Iterator[str]:
    """Masked steps, undetermined parameters, differences between the edges, the polynomial, calibration."""
    good, dead = steps.measured(), select(steps, steps.dead)
    if dead.command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. The curve in this "
            "region is the extrapolated opening law."
        )
    if omissions := select(steps, ~steps.dead).omissions():
        yield f"Other steps are left out: {omissions}."
    if not common.rounding_estimated:
        yield (
            "No flow was measured on the rounded foot of the opening, so the data determine only the zero of "
            "the extrapolated straight part. The dead band is half a rounding less, with the known rounding "
            f"of {common.rounding:.3g} V: a rounding that is 0.1 V larger makes the dead band 0.05 V smaller."
        )
    yield _edges_remark(common, rounding)
    yield _polynomial_remark(good, common.constants)
    yield from misfit_remark(common.regression, "The opening law")
    yield from pressure_offset_remark(common.regression["zero"], common.regression.sd("zero"))
    percent = 100 * BAR[1] / (2 * float(good.drop.mean()))  # A ~ Q / sqrt(dp)
    yield (
        "The intervals cover the noise of the instruments, not errors of their calibration: 1 % of the flow "
        f"meter's gain is 1 % of the area, and 1 bar between the two pressures is {percent:.2g} %."
    )


def _edges_remark(common: ValveFit, rounding: Number) -> str:
    edges = common.steps.edges
    if len(edges) < 2:
        return f"Only the edge {edges[0]} was tested."
    probability, areas = asymmetry(common.steps, common.constants, rounding)
    if probability > 0.01:
        return f"The {len(areas)} edges do not differ significantly (chi-square test, p = {probability:.2g})."
    by_edge = ", ".join(f"{edge} {area * 1e6:.4g} mm2" for edge, area in areas.items())
    return f"The edges differ significantly (chi-square test, p = {probability:.1g}): {by_edge}."


def _polynomial_remark(good: ValveSteps, constants: ValveConstants) -> str:
    paper = polynomial(good.command, good.resistance)
    commands = np.linspace(good.command.min(), constants.full_command, 2000)
    bad = impossible(paper, commands)
    subject = f"The paper's form, a polynomial (degree {paper.degree()} by AIC),"
    if not bad.any():
        return f"{subject} stays positive and falls."
    voltages, negative = commands[bad], "is negative or " if (paper(commands) < 0).any() else ""
    return (
        f"{subject} is shown but not used: between {voltages.min():.2g} and {voltages.max():.2g} V it "
        f"{negative}rises with the command in places, which is impossible for C_R."
    )
