"""Hose resistance procedure (section 4(b), eqs. (1), (10), Fig. 6): friction of one hose in steady flow.

    P_in - P_out = dp(Q)

dp is the friction of the machine (`hose.Friction`): laminar by the viscosity of the oil, above the critical
flow Blasius' law, whose C_R is stated at 170 L/min (correction E10 in docs/equations.md). The viscosity is an
unknown if the small flows contradict the known one, and so are the zeros of the instruments. C_R is scaled to
the machine's hoses by eq. (10).

Validity: a smooth pipe up to Re 1e5, flows above the dead zone of the meter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fmus.components import hose
from fmus.identification import balance
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import StepMeans
from fmus.identification.procedures.fit import Course, Fit, Quantity
from fmus.identification.procedures.procedure import Parameters, Parts, Procedure, Recordings, law_of
from fmus.identification.procedures.tested_hose import AXES, TestedHose, friction
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Curve, Estimate, Finding, Panel
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

SIGNALS = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
UNIT = "Pa.s2/m6"
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, at which C_R by Blasius' law is reported
REFERENCE = f"{hose.REFERENCE_FLOW / LITRES_PER_MINUTE[1]:.0f} L/min"
STARTS = (-1.0, 0.0, 1.0, 2.0)  # of the logarithm of the viscosity over the known one, in its search
FURTHER = 12.0  # by which the chi-square of a free viscosity is less: 1 in 2000 by chance
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
LEVEL = 0.02  # of C_R: a change over the flows that is no contradiction, the bar of the project for a value


def drop(p_in: Any, p_out: Any, flow: Any, u: Any, *known: Any) -> Any:
    """The law."""
    return ((p_in - p_out - friction(u.C_R, known, u.viscosity).drop(flow),),)


def known(tests: Recordings, parameters: Parameters) -> tuple[TestedHose, StepMeans, Course]:
    """The hose, the steps of the flow, and their `course`."""
    return TestedHose.of(tests, parameters), *data.flow_steps(tests)


def _samples(_: Recordings, known: Any) -> Parts:
    tested, steps, along = known
    good, none = steps[steps.good], np.zeros(np.count_nonzero(steps.good))
    # only the difference of the pressures counts, so that at the outlet is taken as zero
    means, errors = np.array([good.drop, none, good.flow]), np.array([good.drop_error, none, good.flow_error])
    law = law_of(drop, len(SIGNALS), ("C_R", "viscosity"), 4)
    return [(balance.samples_of(law, SIGNALS, means, errors, tested.constants), along)]


def _start(known: Any, thicker: float = 0.0) -> dict[str, float]:
    """C_R as if all flows were turbulent, and the logarithm of the viscosity over the known one."""
    good = known[1][known[1].good]
    turbulent = good.flow * np.abs(good.flow)
    start = float(np.cov(turbulent, good.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "change the sign of the flow, or exchange the two pressures"
        )
    return {"C_R": start / math.exp(thicker / 4), "viscosity": thicker}


def _refined(fit: Fit, again: Callable[..., Fit]) -> Fit:
    """With the viscosity as an unknown, if that explains the data far better and they tell it.

    Else a misfit of another cause, such as a drift, would be taken for a viscosity.
    """
    for thicker in STARTS if fit.solution.fit.misfit else ():
        with suppress(Problem):  # with a viscosity that is far off
            other = again(tested=(), start=partial(_start, thicker=thicker))
            found = other.solution.fit
            told = found.sd("viscosity") < balance.DETERMINED and found.significant("viscosity")
            if told and other.solution.cost < fit.solution.cost - FURTHER:
                fit = other
    return fit


def _estimates(fit: Fit) -> list[Quantity]:
    tested: TestedHose = fit.known[0]
    thicker = tested.to_density**0.75
    return tested.scaled(
        *("resistance", UNIT, "C_R", AXES),
        lambda length, bore: float(hose.scaled_resistance(thicker, length, bore)),
        *(f"Blasius, section 4(b), at {REFERENCE}", ", eq. (10) from {own.length:g} m to {size}"),
    )


def _others(fit: Fit) -> Iterator[Estimate]:
    yield fit.estimate(Quantity("C_R", UNIT, "C_R", "the tested hose"))
    yield data.pressure_offset(fit.solution)
    for q in FLOWS:
        factor = (hose.REFERENCE_FLOW / (q * LITRES_PER_MINUTE[1])) ** 0.25
        note = "Blasius, where the flow is turbulent"
        yield fit.estimate(Quantity(f"C_R({q:g} L/min)", UNIT, "C_R", note, factor))
    if "viscosity" in fit.solution.fit.names:
        note = "of the tested oil over the known one, by the small flows"
        yield fit.solution.fit.derived("viscosity ratio", "1", note, "viscosity", math.exp)


def _by_flow(fit: Fit) -> Array:
    """The column of a C_R that changes with the flow."""
    return fit.over("C_R", np.abs(fit.solution.samples[0].raw[2]))


def _findings(fit: Fit) -> Iterator[Finding]:
    change, sd = fit.solution.effect(_by_flow(fit))
    percent = 100 / fit["C_R"]
    yield Finding(
        "model",
        balance.probability(change, sd, LEVEL * fit["C_R"]),
        f"hose_resistance: C_R changes by {percent * change:+.3g} +- {percent * sd:.2g} % from "
        "the smallest to the largest flow",
    )


def _remarks(fit: Fit) -> Iterator[str]:
    tested, steps, _ = fit.known
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {omissions}{flat}."
    yield f"C_R is valid for {REFERENCE}. It falls by 16 % for each doubling of the flow."
    if "viscosity" in fit.solution.fit.names:
        yield (
            f"The small flows are those of {math.exp(fit['viscosity']):.3g} times the viscosity. C_R is "
            "converted to the machine's oil by eq. (10)."
        )
    if "flow" not in fit.solution.limits:
        yield "The description of the flow meter has no `zero_error`: the intervals do not cover its zero."
    yield from data.pressure_offset_remark(data.pressure_offset(fit.solution))
    yield tested.remark()


def _panels(fit: Fit) -> tuple[Panel, Panel]:
    """Drop over flow with the law, and the residual."""
    steps, sample = (
        fit.known[1].without_zero(data.pressure_offset(fit.solution).value),
        fit.solution.samples[0],
    )
    good, dead = steps[steps.good], steps[steps.dead]
    flows = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    theta = np.array([fit[n] if n in fit.solution.fit.names else 0.0 for n in sample.names])
    none = np.zeros_like(flows)
    law = -np.array(sample.law.terms(np.array([none, none, flows]), theta, sample.known)[0])[0]
    curves = (
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("laminar to turbulent", flows, law, "fit", line=True),
    )
    left = Curve("measured - fit", good.flow, fit.residual(), error=good.drop_error)
    panel = Panel("flow", "pressure drop", curves, "Drop along the hose", LITRES_PER_MINUTE, BAR)
    return panel, replace(panel, y_label="residual", title="", curves=(left,))


HOSE_RESISTANCE = Procedure(
    name="hose_resistance",
    title="Hose resistance: {0[0].size}",
    figure=6,
    signals=SIGNALS,
    law="The hose's law",
    known=known,
    samples=_samples,
    start=_start,
    limits=lambda tests: (
        data.zero_limits(tests, ("pressure_in", "pressure_out")) | data.declared_limits(tests, ["flow"])
    ),
    tested=["viscosity"],
    refined=_refined,
    estimates=_estimates,
    others=_others,
    panels=_panels,
    remarks=_remarks,
    findings=_findings,
    given=lambda fit: [_by_flow(fit)],
    drift={"C_R": "C_R"},
)
