"""Valve (section 4(a), Fig. 5): C_R over the command from pressures and flow at stepped voltages.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

Of every step the means are taken, with their standard errors. What is fitted is the flow, not C_R: small
flows have the largest relative error, and 1/Q^2 would bend it. The error of a point is that of the mean flow
and that of the mean drop times dQ/d(dp); the opening law of the valve (`law`) keeps C_R positive and
monotone. All edges are fitted together, as the spools are symmetrical, and each on its own for comparison.
What the two pressures differ by without flow, a zero of the transducers, is found along.

Validity: steady flow above the dead zone of the meter. Only the product C_d A sqrt(2/rho) is measured: the
area belongs to the C_d and the density that are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.shared.given import number, training
from fmus.identification.procedures.valve.fit import ValveFit, fitted
from fmus.identification.procedures.valve.law import Constants, resistance
from fmus.identification.procedures.valve.panels import panels
from fmus.identification.procedures.valve.points import points
from fmus.identification.procedures.valve.remarks import remarks
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

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
