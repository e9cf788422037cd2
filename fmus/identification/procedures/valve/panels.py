"""Fig. 5 again: C_R over the command, measured, fitted, by a polynomial; the fitted flow; the residual."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.valve.law import Constants, Law, flow, resistance
from fmus.identification.procedures.valve.points import Points
from fmus.identification.procedures.valve.polynomial import polynomial

Array = NDArray[np.float64]

COMMAND = "command [V]"


def panels(every: Points, law: Law, constants: Constants) -> tuple[Panel, ...]:
    """C_R with the fit, flow over root of drop with what is masked, C_R with the polynomial, residual."""
    good = every.measured
    fine = np.linspace(good.command.min(), constants.full_command, 400)
    return (
        _curve(every, fine, law, constants),
        _gain(every, law, constants),
        _compared(good, fine, law, constants),
        _residual(every, law, constants),
    )


def _curve(every: Points, fine: Array, law: Law, constants: Constants) -> Panel:
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
