"""Remarks on a valve's openings: masked steps, line or curve, equal edges, polynomials, calibration."""

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import Polynomial

from fmus.identification.procedure_result import BAR
from fmus.identification.procedures.experiment_data import pressure_offset_remark, select
from fmus.identification.procedures.opening_fit import SAME
from fmus.identification.procedures.regression import misfit_remark
from fmus.identification.procedures.valve_law import ValveConstants, ValveSteps, impossible, polynomial
from fmus.identification.procedures.valve_openings import EQUAL, Openings
from fmus.identification.procedures.valve_panels import by_curve, log_polynomial

TINY = 1e-9  # smaller probabilities are not told apart


def remarks(steps: ValveSteps, openings: Openings) -> Iterator[str]:
    """All remarks; `steps` are corrected for the offset of the transducers."""
    good, dead = steps.measured(), select(steps, steps.dead)
    if dead.command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. The curve in this "
            f"region is {'the extrapolated opening law' if openings.straight else 'extrapolated'}."
        )
    if omissions := select(steps, ~steps.dead).omissions():
        yield f"Other steps are left out: {omissions}."
    yield from _line_or_curve(openings)
    yield from _full_command(good, openings.constants.full_command)
    yield _edges_remark(openings)
    for edge, steps_of in by_curve(good, openings.curves).items():
        label = f"{edge}: " if edge else ""
        yield label + _polynomial_remark(steps_of, openings.constants)
        yield label + _logarithm_remark(steps_of)
    if openings.line:
        yield from misfit_remark(openings.line.regression, "The opening law")
    yield from pressure_offset_remark(openings.zero.value, openings.zero.sd)
    percent = 100 * BAR[1] / (2 * float(good.drop.mean()))  # A ~ Q / sqrt(dp)
    yield (
        "The intervals cover the noise of the instruments, but not calibration errors. An error of "
        "1 % in the gain of the flow meter changes the area by 1 %, and an error of 1 bar between "
        f"the two pressures by {percent:.2g} %."
    )


def _line_or_curve(openings: Openings) -> Iterator[str]:
    edge, probability = min(openings.probability.items(), key=lambda item: item[1])
    test = f"likelihood ratio test against a curve, {edge}: {_chance(probability)}"
    if openings.straight:
        yield f"A straight line with a dead band suffices ({test})."
        if openings.line and not openings.line.rounding_estimated:
            yield (
                "No flow was measured at the rounded start of the opening, so the data determine "
                "only the zero of the extrapolated straight part. The dead band is this zero minus "
                f"half the known rounding of {openings.line.rounding:.3g} V: a rounding that is 0.1 "
                "V larger makes the dead band 0.05 V smaller."
            )
        return
    yield (
        f"A straight line does not suffice ({test}). The openings are tables, valve_pa_commands, "
        "valve_pa_openings and so on, which the machine reads in place of valve_dead_band."
    )
    for edge, curve in openings.distinct().items():
        half = (curve.high - curve.low) / 2 / curve.area.clip(1e-12)
        percent = 100 * float(np.median(half[curve.command >= curve.first_measured]))
        low, high = np.quantile(curve.draws.start, [0.025, 0.975])
        exponent = float(np.median(curve.draws.exponent))
        yield (
            f"{edge}: the opening starts at {curve.commands[0]:.3g} V ({low:.3g} to {high:.3g} V) and rises "
            f"about as the power {exponent:.3g} of the command behind it. The 95 % band is "
            f"{percent:.2g} % wide to either side above {curve.first_measured:.3g} V."
        )


def _full_command(good: ValveSteps, full: float) -> Iterator[str]:
    """A sentence if an edge was not measured at full command, where its area is defined."""
    for edge in good.edges:
        highest = float(good.of(edge).command.max())
        if highest < full - SAME:
            yield (
                f"{edge}: no flow was measured above {highest:.3g} V, so the area at {full:.3g} V is "
                "extrapolated. Hold the full command twice in such an experiment."
            )


def _edges_remark(openings: Openings) -> str:
    edges = list(openings.curves)
    if len(edges) < 2:
        return f"Only the edge {edges[0]} was tested."
    kind = "chi-square test" if openings.straight else "likelihood ratio test"
    if openings.equal > EQUAL:
        return f"The {len(edges)} edges do not differ significantly ({kind}, p = {openings.equal:.2g})."
    areas = {
        edge: openings.separate[edge].regression["area"] if openings.straight else curve.areas[-1]
        for edge, curve in openings.curves.items()
    }
    by_edge = ", ".join(f"{edge} {area * 1e6:.4g} mm2" for edge, area in areas.items())
    return f"The edges differ significantly ({kind}, {_chance(openings.equal)}): {by_edge}."


def _chance(probability: float) -> str:
    return f"p = {probability:.2g}" if probability > TINY else f"p < {TINY:g}"


def _polynomial_remark(good: ValveSteps, constants: ValveConstants) -> str:
    paper = polynomial(good.command, good.resistance)
    commands = np.linspace(good.command.min(), constants.full_command, 2000)
    bad = impossible(paper, commands)
    subject = f"The paper's form, a polynomial (degree {paper.degree()} by AIC),"
    if not bad.any():
        return f"{subject} stays positive and falls: C_R = {_in_powers(paper)} Pa.s2/m6, V in volts."
    voltages, negative = commands[bad], "is negative or " if (paper(commands) < 0).any() else ""
    return (
        f"{subject} is shown but not used: between {voltages.min():.2g} and {voltages.max():.2g} V it "
        f"{negative}rises with the command in places, which is impossible for C_R."
    )


def _logarithm_remark(good: ValveSteps) -> str:
    fitted = log_polynomial(good)
    error = float(np.abs(fitted(good.command) - np.log(good.resistance)).max())
    return (
        f"The same form for the logarithm (degree {fitted.degree()} by AIC) stays positive: ln C_R = "
        f"{_in_powers(fitted)}, C_R in Pa.s2/m6, V from {good.command.min():.3g} to "
        f"{good.command.max():.3g} V; the largest error of a step is {100 * error:.2g} %."
    )


def _in_powers(curve: Polynomial) -> str:
    """A polynomial in powers of the command V."""
    terms = [f"{c:.6g}" + ("" if k == 0 else " V" if k == 1 else f" V^{k}") for k, c in _terms(curve)]
    return " + ".join(terms).replace("+ -", "- ")


def _terms(curve: Polynomial) -> Iterator[tuple[int, float]]:
    return enumerate(map(float, curve.convert(domain=(-1, 1), window=(-1, 1)).coef))
