"""Panels of the valve's figure (Fig. 5): C_R, opening with its band, the paper's polynomials, residual."""

import math
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
from numpy.polynomial import Polynomial

from fmus.identification.procedure_result import LITRES_PER_MINUTE, Curve, Panel
from fmus.identification.procedures.experiment_data import select
from fmus.identification.procedures.opening_fit import OpeningCurve
from fmus.identification.procedures.valve_law import (
    ValveConstants,
    ValveSteps,
    flow_through,
    impossible,
    polynomial,
    resistance_of,
)
from orchestrator.data.table import Array

COMMAND, RESISTANCE = "command [V]", "C_R [Pa.s2/m6]"  # labels of axes
T = TypeVar("T")
AreaOf = Callable[[Array], Array]  # effective area [m2] at commands [V]


def panels(
    steps: ValveSteps,
    areas: Mapping[str, AreaOf],
    bands: Mapping[str, OpeningCurve],
    constants: ValveConstants,
) -> tuple[Panel, ...]:
    """C_R with the fit, K = Q/sqrt(dp) with masked steps, C_R with the paper's polynomials, residual.

    areas   edge -> its fitted opening; the same object for equal edges
    bands   edge -> the 95 % band of its opening
    """
    good, dead = steps.measured(), select(steps, steps.dead & (steps.drop > 0))
    edges = {edge: steps.of(edge).measured() for edge in steps.edges}
    fits = _distinct(areas)
    lines = []
    for (label, area), group in zip(
        _labelled(fits, "fit, eq. (2)").items(), by_curve(good, areas).values(), strict=True
    ):
        opened = np.linspace(group.command.min(), constants.full_command, 400)
        lines.append(Curve(label, opened, resistance_of(area(opened), constants), "fit", line=True))
    by_edge = [Curve(edge, s.command, s.resistance, error=s.resistance_error) for edge, s in edges.items()]
    measured = Curve("measured", good.command, good.resistance)
    return (
        Panel(COMMAND, RESISTANCE, (*by_edge, *lines), "Resistance of each edge", log=True),
        _gain_panel(good, dead, fits, _distinct(bands), constants),
        Panel(
            COMMAND,
            RESISTANCE,
            (measured, *lines, *(c for g in by_curve(good, areas).values() for c in _polynomials(g))),
            "The paper's polynomial for comparison",
        ),
        Panel(
            COMMAND,
            "flow, measured - fitted",
            tuple(_residual(edge, s, areas[edge], constants) for edge, s in edges.items()),
            "Residual",
            y_unit=LITRES_PER_MINUTE,
        ),
    )


def _distinct(by_edge: Mapping[str, T]) -> dict[str, T]:
    """One entry for all edges with the same object."""
    first = {id(item): edge for edge, item in reversed(list(by_edge.items()))}
    return {edge: by_edge[edge] for edge in by_edge if first[id(by_edge[edge])] == edge}


def _labelled(fits: Mapping[str, AreaOf], label: str) -> dict[str, AreaOf]:
    """Fits with labels; the edge is named if there are several."""
    return {label if len(fits) == 1 else f"{label}: {edge}": area for edge, area in fits.items()}


def _gain_panel(
    good: ValveSteps,
    dead: ValveSteps,
    fits: Mapping[str, AreaOf],
    bands: Mapping[str, OpeningCurve],
    constants: ValveConstants,
) -> Panel:
    """K = Q/sqrt(dp), straight above the foot of a straight opening, so it also shows the dead band."""
    commands, root = np.linspace(0.0, constants.full_command, 400), np.sqrt(good.drop)
    gain = constants.discharge_coefficient * math.sqrt(2 / constants.density)
    curves = [
        Curve("measured", good.command, good.flow / root, error=good.flow_error / root),
        Curve("masked: dead zone of the meter", dead.command, dead.flow / np.sqrt(dead.drop), "masked"),
    ]
    for label, area in _labelled(fits, "fit").items():
        curves.append(Curve(label, commands, gain * area(commands), "fit", line=True))
    for k, band in enumerate(bands.values()):
        for end in (band.low, band.high):
            label = "95 % band" if not k and end is band.low else ""
            curves.append(Curve(label, band.command, gain * end, "corrected", line=True))
    return Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", tuple(curves), "Opening, as it was fitted")


def by_curve(good: ValveSteps, fits: Mapping[str, object]) -> dict[str, ValveSteps]:
    """Steps of the edges that have one curve together; the name is "" if all have."""
    first = _distinct(fits)
    if len(first) == 1:
        return {"": good}
    return {edge: good.of(edge) for edge in first}


def log_polynomial(good: ValveSteps) -> Polynomial:
    """ln C_R over the command: the paper's form for a quantity that stays positive."""
    return polynomial(good.command, np.log(good.resistance))


def _polynomials(good: ValveSteps) -> tuple[Curve, ...]:
    """The paper's polynomial, where it is impossible, and the polynomial of ln C_R."""
    opened = np.linspace(good.command.min(), good.command.max(), 400)
    paper, log = polynomial(good.command, good.resistance), log_polynomial(good)
    bad = np.where(impossible(paper, opened), paper(opened), math.nan)
    return (
        Curve(f"polynomial of degree {paper.degree()}", opened, paper(opened), "compared", line=True),
        Curve("polynomial negative or rising", opened, bad, "masked", line=True),
        Curve(f"ln C_R of degree {log.degree()}", opened, np.exp(log(opened)), "corrected", line=True),
    )


def _residual(edge: str, steps: ValveSteps, area: AreaOf, constants: ValveConstants) -> Curve:
    """Measured minus fitted flow of one edge."""
    fitted, derivative = flow_through(area(steps.command), steps.drop, steps.supply_drop, constants)
    error = np.hypot(steps.flow_error, derivative * steps.drop_error)
    return Curve(edge, steps.command, steps.flow - fitted, error=error)
