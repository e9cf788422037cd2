"""What the reader of the valve's figure must know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fmus.identification.procedures.shared.regression import misfit_remark
from fmus.identification.procedures.valve.fit import ValveFit, asymmetry
from fmus.identification.procedures.valve.law import Constants
from fmus.identification.procedures.valve.points import Points
from fmus.identification.procedures.valve.polynomial import polynomial


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
            f"{dead.command.size} of {every.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. There the curve "
            "is the opening law, extended."
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
    paper = polynomial(good.command, good.resistance)
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
