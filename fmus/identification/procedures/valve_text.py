"""Remarks and panels of the valve procedure (Fig. 5): C_R, opening with its band, the paper's polynomials."""

import math
from collections.abc import Iterator

import numpy as np
import statsmodels.api as sm
from numpy.polynomial import Polynomial

from fmus.identification.balance import UNLIKELY
from fmus.identification.procedures.experiment_data import pressure_offset_remark
from fmus.identification.procedures.openings import SAME, OpeningCurve, Openings, ValveSteps
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Curve, Estimate, Panel
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

TINY = 1e-9  # smaller probabilities are not told apart
COMMAND, RESISTANCE = "command [V]", "C_R [Pa.s2/m6]"  # labels of axes


def remarks(steps: ValveSteps, found: Openings, zero: Estimate, declared: bool) -> Iterator[str]:
    """All remarks; `steps` are corrected for the zero of the pressures.

    declared   whether the zero of the flow meter is declared
    """
    good, dead, c = steps[steps.good], steps[steps.dead], found.known
    if dead.command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. The curve in this "
            "region is extrapolated."
        )
    if omissions := steps[~steps.dead].omissions():
        yield f"Other steps are left out: {omissions}."
    yield from _line_or_curve(found)
    for edge, nodes in found.nodes.items():
        if (highest := float(nodes.command[-1])) < c.full_command * (1 - SAME):
            yield (
                f"{edge}: no flow was measured above {highest:.3g} V, so the area at {c.full_command:.3g} V "
                "is extrapolated. Hold the full command twice in such an experiment."
            )
    yield _edges_remark(found)
    for label, steps_of, _ in _by_curve(good, found):
        prefix = f"{label}: " if label else ""
        yield prefix + _polynomial_remark(steps_of, c.full_command)
        yield prefix + _logarithm_remark(steps_of)
    yield from pressure_offset_remark(zero)
    density = ", ".join(f"{x:.4g}" for x in np.unique(steps.density))
    yield f"Known: C_d = {c.discharge_coefficient:.4g}, density {density} kg/m3."
    percent = 100 * BAR[1] / (2 * float(good.drop.mean()))  # A ~ Q / sqrt(dp)
    yield (
        "The intervals cover the noise of the instruments, but not calibration errors. An error of "
        "1 % in the gain of the flow meter changes the area by 1 %, and an error of 1 bar between "
        f"the two pressures by {percent:.2g} %."
    )
    if not found.flow_zero:
        volts = 0.1 * LITRES_PER_MINUTE[1] * float(np.ptp(good.command) / np.ptp(good.flow))
        limit = found.known.flow_zero * math.sqrt(3) / LITRES_PER_MINUTE[1]
        covered = f"cover {limit:.2g} L/min, not more" if declared else "do not cover it (`zero_error`)"
        yield (
            f"No reading shows the zero of the flow meter: the intervals {covered}, and 0.1 L/min moves the "
            f"start of the opening by {volts:.1g} V. A recording at rest shows it, unless the meter has a "
            "dead zone."
        )


def _line_or_curve(found: Openings) -> Iterator[str]:
    edge, line = min(found.lines.items(), key=lambda item: item[1].p)
    test = f"test of the residuals, {edge}: {_chance(line.p)}"
    if found.straight:
        yield f"A straight line with a dead band suffices ({test})."
        if found.line and "rounding" not in found.line.names:
            yield (
                "No flow was measured at the rounded start of the opening, so the data determine "
                "only the zero of the extrapolated straight part. The dead band is this zero minus "
                f"half the known rounding of {found.line.law()[2]:.3g} V: a rounding that is 0.1 "
                "V larger makes the dead band 0.05 V smaller."
            )
        return
    yield (
        f"A straight line does not suffice ({test}). The openings are tables, valve_pa_commands, "
        "valve_pa_openings and so on, which the machine reads in place of valve_dead_band."
    )
    for edge, curve in found.distinct().items():
        half = (curve.high - curve.low) / 2 / curve.area.clip(1e-12)
        percent = 100 * float(np.median(half[curve.command >= curve.first_measured]))
        low, high = np.quantile(curve.start, [0.025, 0.975])
        yield (
            f"{edge}: the opening starts at {curve.commands[0]:.3g} V ({low:.3g} to {high:.3g} V). The 95 % "
            f"band is {percent:.2g} % wide to either side above {curve.first_measured:.3g} V."
        )


def _edges_remark(found: Openings) -> str:
    edges = list(found.curves)
    if len(edges) < 2:
        return f"Only the edge {edges[0]} was tested."
    if found.equal > UNLIKELY:
        return f"The {len(edges)} edges do not differ significantly (chi-square test, p = {found.equal:.2g})."
    by_edge = ", ".join(f"{e} {curve.areas[-1] * 1e6:.4g} mm2" for e, curve in found.curves.items())
    return f"The edges differ significantly (chi-square test, {_chance(found.equal)}): {by_edge}."


def _chance(probability: float) -> str:
    return f"p = {probability:.2g}" if probability > TINY else f"p < {TINY:g}"


def _polynomial_remark(good: ValveSteps, full: float) -> str:
    paper = polynomial(good.command, good.resistance)
    commands = np.linspace(good.command.min(), full, 2000)
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
    fitted = polynomial(good.command, np.log(good.resistance))
    error = float(np.abs(fitted(good.command) - np.log(good.resistance)).max())
    return (
        f"The same form for the logarithm (degree {fitted.degree()} by AIC) stays positive: ln C_R = "
        f"{_in_powers(fitted)}, C_R in Pa.s2/m6, V from {good.command.min():.3g} to "
        f"{good.command.max():.3g} V; the largest error of a step is {100 * error:.2g} %."
    )


def _in_powers(curve: Polynomial) -> str:
    """A polynomial in powers of the command V."""
    powers = enumerate(map(float, curve.convert(domain=(-1, 1), window=(-1, 1)).coef))
    terms = [f"{c:.6g}" + ("" if k == 0 else " V" if k == 1 else f" V^{k}") for k, c in powers]
    return " + ".join(terms).replace("+ -", "- ")


def polynomial(x: Array, y: Array) -> Polynomial:
    """The paper's C_R(V) by unweighted least squares; the degree, up to 8, is that of the lowest AIC."""
    domain = (float(x.min()), float(x.max()))
    scaled = (2 * x - sum(domain)) / (domain[1] - domain[0])
    highest = min(8, np.unique(x).size - 2)
    fits = [sm.OLS(y, np.vander(scaled, n + 1, increasing=True)).fit() for n in range(1, max(highest, 1) + 1)]
    return Polynomial(min(fits, key=lambda fit: fit.aic).params, domain=domain, window=(-1.0, 1.0))


def impossible(curve: Polynomial, x: Array) -> Mask:
    """True if a polynomial cannot be the resistance of a valve at x: it is negative, or it rises."""
    mask: Mask = (curve(x) < 0) | (curve.deriv()(x) > 0)
    return mask


# ---- panels --------------------------------------------------------------------------------------------


def panels(steps: ValveSteps, found: Openings) -> tuple[Panel, ...]:
    """C_R with the fit, K = Q/sqrt(dp) with masked steps, C_R with the paper's polynomials, residual."""
    good, dead, c = steps[steps.good], steps[steps.dead & (steps.drop > 0)], found.known
    lines, polynomials = list[Curve](), list[Curve]()
    # K is straight above the foot of a straight opening, so it also shows the dead band
    root, gain = np.sqrt(good.drop), c.discharge_coefficient * math.sqrt(2 / c.density)
    gains = [
        Curve("measured", good.command, good.flow / root, error=good.flow_error / root),
        Curve("masked: dead zone of the meter", dead.command, dead.flow / np.sqrt(dead.drop), "masked"),
    ]
    for name, group, curve in _by_curve(good, found):
        opened, label = np.linspace(group.command.min(), c.full_command, 400), f": {name}" if name else ""
        area = np.interp(opened, curve.command, curve.area)
        lines.append(Curve(f"fit, eq. (2){label}", opened, c.resistance(area), "fit", line=True))
        # the paper's polynomial, where it is impossible, and the polynomial of ln C_R
        paper, log = (polynomial(group.command, y) for y in (group.resistance, np.log(group.resistance)))
        at = np.linspace(group.command.min(), group.command.max(), 400)
        bad = np.where(impossible(paper, at), paper(at), math.nan)
        polynomials += [
            Curve(f"polynomial of degree {paper.degree()}", at, paper(at), "compared", line=True),
            Curve("polynomial negative or rising", at, bad, "masked", line=True),
            Curve(f"ln C_R of degree {log.degree()}", at, np.exp(log(at)), "corrected", line=True),
        ]
        band = "95 % band" if len(gains) == 2 else ""
        gains.append(Curve(f"fit{label}", curve.command, gain * curve.area, "fit", line=True))
        for end, text in ((curve.low, band), (curve.high, "")):
            gains.append(Curve(text, curve.command, gain * end, "corrected", line=True))
    measured = Curve("measured", good.command, good.resistance)
    points, residuals = list[Curve](), list[Curve]()
    for edge, curve in found.curves.items():
        s = good.of(edge)
        points.append(Curve(edge, s.command, s.resistance, error=s.resistance_error))
        area, by_drop, by_flow = s.effective(c)
        error = np.hypot(s.flow_error, by_drop / by_flow * s.drop_error)
        left = (area - np.interp(s.command, curve.command, curve.area)) / by_flow
        residuals.append(Curve(edge, s.command, left, error=error))
    return (
        Panel(COMMAND, RESISTANCE, (*points, *lines), "Resistance of each edge", log=True),
        Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", tuple(gains), "Opening, as it was fitted"),
        Panel(COMMAND, RESISTANCE, (measured, *lines, *polynomials), "The paper's polynomial for comparison"),
        Panel(COMMAND, "flow, measured - fitted", tuple(residuals), "Residual", y_unit=LITRES_PER_MINUTE),
    )


def _by_curve(good: ValveSteps, found: Openings) -> list[tuple[str, ValveSteps, OpeningCurve]]:
    """Edges that have one curve together, with their steps and the curve; the name is "" if all have."""
    if len(distinct := found.distinct()) == 1:
        return [("", good, found.common)]
    return [(edge, good.of(edge), curve) for edge, curve in distinct.items()]
