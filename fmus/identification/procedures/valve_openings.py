"""Openings of all edges of a valve: a straight line if it suffices, else curves, equal or of each edge."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy import stats

from fmus.identification.estimate import Estimate
from fmus.identification.procedures import opening_fit
from fmus.identification.procedures.opening_fit import OpeningCurve
from fmus.identification.procedures.opening_posterior import OpeningData, OpeningPosterior
from fmus.identification.procedures.regression import SIGNIFICANT, UNLIKELY
from fmus.identification.procedures.valve_law import (
    ValveConstants,
    ValveFit,
    ValveSteps,
    asymmetry,
    fit_valve,
)
from fmus.identification.procedures.valve_panels import AreaOf
from fmus.parameters import Number
from orchestrator.base.errors import Problem

EQUAL = 0.01  # probability of equal edges below which they differ


@dataclass(frozen=True)
class Openings:
    """Openings of the tested edges.

    steps             all steps, also those in the dead zone of the meter
    zero_limit        largest difference of the two pressures without flow, by their data sheets
    line              the straight line of all edges together, if it suffices
    straight          whether a straight line suffices for each edge
    separate          straight line of each edge, if there is one
    curves            edge -> its opening with a band; the same object for equal edges
    probability       edge -> probability that data of a straight line prefer the curve as much
    equal             probability that equal edges differ as much
    zero              difference of the two pressures without flow
    scatter           scatter of steps with one command, over their noise
    falling           edge -> probability that a rising opening falls as much, and its largest fall
    idle              edge -> highest command [V] at which the meter reads nothing, in spite of the opening
    """

    steps: ValveSteps
    constants: ValveConstants
    line: ValveFit | None
    straight: bool
    separate: Mapping[str, ValveFit]
    curves: Mapping[str, OpeningCurve]
    probability: Mapping[str, float]
    equal: float
    zero: Estimate
    scatter: float
    zero_limit: float
    falling: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    idle: Mapping[str, float] = field(default_factory=dict)

    def areas(self) -> dict[str, AreaOf]:
        """Edge -> its effective area [m2] as a function of commands [V]; one function for equal edges."""
        if self.line:
            law = self.line.law()
            area = partial(opening_fit.line_area, law.area, law.dead_band, law.rounding, self.constants)
            return dict.fromkeys(self.curves, area)
        functions = {id(curve): curve.at for curve in self.curves.values()}
        return {edge: functions[id(curve)] for edge, curve in self.curves.items()}

    def distinct(self) -> dict[str, OpeningCurve]:
        """One entry for all edges with the same curve; its name is "all" then."""
        if len({id(curve) for curve in self.curves.values()}) == 1 and len(self.curves) > 1:
            return {"all": next(iter(self.curves.values()))}
        return dict(self.curves)


def fit_openings(
    steps: ValveSteps, constants: ValveConstants, rounding: Number, zero_limit: float, idle_flow: float
) -> Openings:
    """Straight line or curves of all edges.

    idle_flow   flow [m3/s] up to which the meter may read nothing
    """
    good, edges = steps.checked(), steps.edges
    separate = {e: _line(good.of(e), constants, rounding, zero_limit) for e in edges}
    lines = {edge: line for edge, line in separate.items() if line}
    data = {e: opening_fit.opening_data(steps.of(e), constants, zero_limit, idle_flow) for e in edges}
    found = {e: opening_fit.posterior(d, label=f"valve {e}") for e, d in data.items()}
    probability = {e: opening_fit.line_probability(lines[e], found[e]) if e in lines else 0.0 for e in edges}
    if min(probability.values()) > UNLIKELY / len(edges):
        openings = _straight(steps, constants, rounding, zero_limit, probability)
    else:
        pooled = opening_fit.opening_data(steps, constants, zero_limit, idle_flow)
        openings = _curved(steps, constants, pooled, found, lines, probability)
    idle = {e: opening_fit.idle_command(curve, data[e]) for e, curve in openings.curves.items()}
    falling = {e: opening_fit.falling(each.data) for e, each in found.items()}
    return replace(openings, idle={e: c for e, c in idle.items() if c is not None}, falling=falling)


def _line(
    steps: ValveSteps, constants: ValveConstants, rounding: Number, zero_limit: float
) -> ValveFit | None:
    """The straight line of some steps; None if there is none, as of an opening that is far from a line."""
    try:
        return fit_valve(steps, constants, rounding, zero_limit)
    except Problem:
        return None


def _straight(
    steps: ValveSteps,
    constants: ValveConstants,
    rounding: Number,
    zero_limit: float,
    probability: Mapping[str, float],
) -> Openings:
    """One line for all edges, or one for each if they differ."""
    good = steps.checked()
    common = fit_valve(good, constants, rounding, zero_limit)
    _check_closed(common)
    own_rounding = Number(common.law().rounding, "V", "identified", "of all edges")
    separate = {e: fit_valve(good.of(e), constants, own_rounding, zero_limit) for e in good.edges}
    equal = asymmetry(good, constants, own_rounding)[0] if len(good.edges) > 1 else 1.0
    random = np.random.default_rng(0)
    if equal > UNLIKELY:
        curve = opening_fit.line_curve(common, random)
        curves = dict.fromkeys(good.edges, curve)
    else:
        curves = {e: opening_fit.line_curve(fitted, random) for e, fitted in separate.items()}
    return Openings(
        steps=steps,
        constants=constants,
        line=common if equal > UNLIKELY else None,
        straight=True,
        separate=separate,
        curves=curves,
        probability=probability,
        equal=equal,
        zero=common.regression.estimate("pressures without flow", "Pa", "pressure_in - pressure_out", "zero"),
        scatter=1.0,
        zero_limit=zero_limit,
    )


def _check_closed(line: ValveFit) -> None:
    """Problem if a straight opening starts below 0 V, which no machine here can have."""
    law = line.law()
    start = law.dead_band + law.rounding / 2
    if start < -SIGNIFICANT * line.regression.sd("dead_band"):
        raise Problem(
            f"valve ({', '.join(line.steps.edges)}): expected closed edges at 0 V, got a straight opening "
            f"that starts at {start:.3g} V: an underlapped spool, or a command with an offset"
        )


def _curved(
    steps: ValveSteps,
    constants: ValveConstants,
    pooled: OpeningData,
    found: Mapping[str, OpeningPosterior],
    lines: Mapping[str, ValveFit],
    probability: Mapping[str, float],
) -> Openings:
    """One curve for all edges, or one for each if they differ (likelihood ratio).

    pooled   effective areas as if all edges were equal
    """
    scatter = max(each.data.scatter for each in found.values())
    together = opening_fit.posterior(pooled, scatter)
    apart = sum(opening_fit.excess(each, scatter) for each in found.values())
    freedom = opening_fit.PARAMETERS * (len(found) - 1)
    equal = float(stats.chi2.sf(opening_fit.excess(together, scatter) - apart, freedom)) if freedom else 1.0
    if equal > EQUAL:
        curves = dict.fromkeys(found, opening_fit.curve(together))
    else:
        curves = {edge: opening_fit.curve(each) for edge, each in found.items()}
    zeros = np.concatenate([curve.draws.zero for curve in {id(c): c for c in curves.values()}.values()])
    some = next(iter(curves.values()))
    return Openings(
        steps=steps,
        constants=constants,
        line=None,
        straight=False,
        separate=lines,
        curves=curves,
        probability=probability,
        equal=equal,
        zero=some.estimate("pressures without flow", "Pa", "pressure_in - pressure_out", zeros),
        scatter=scatter,
        zero_limit=pooled.zero_limit,
    )
