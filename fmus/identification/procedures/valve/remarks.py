"""What the reader of the valve's figure must know."""

from __future__ import annotations

import numpy as np

from fmus.identification.procedures.shared.regression import misfit_remark
from fmus.identification.procedures.valve.fit import ValveFit, asymmetry
from fmus.identification.procedures.valve.law import Constants
from fmus.identification.procedures.valve.points import Points
from fmus.identification.procedures.valve.polynomial import polynomial
from fmus.parameters import Number

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
