"""Hose resistance (section 4(b), Fig. 6): the turbulent drop along a hose at stepped flows.

    P_in - P_out = C_R Q|Q|, eq. (1)        P_in - P_out = k Q^1.75, k ~ l/D^4.75, eq. (10)

Eq. (1) is what the machine simulates, with |Q| rounded to sqrt(Q^2 + Q_t^2) as in
`fmus.components.spool_valve.turbulent_drop`. Eq. (10) is Blasius' law, so C_R = k Q^-0.25 belongs to one
reference flow (correction E10 in docs/equations.md). Both are fitted to the means of the steps, weighted with
the errors of drop and flow; chi-square and AIC tell which one the data support.

Two transducers never show quite the same without flow, and a tenth of a bar is a hundredth of a hose's drop.
So this zero is estimated along with the law that fits best and taken off; its error counts in all laws.

Validity: steady flow above the dead zone of the meter; eq. (10) for a smooth pipe and Re 3e3 to 1e5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.components import hose
from fmus.identification.estimate import Curve, Estimate, Panel, ProcedureResult
from fmus.identification.procedures.bench_data import (
    BAR,
    LITRES,
    NEEDED,
    StepMeans,
    density_ratio,
    hose_size,
    joined,
    left_out,
    standing,
    step_means,
    training,
    value,
    where,
)
from fmus.identification.procedures.regression import SIGNIFICANT, Guess, Regression, fit, misfit_remark
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
Drop = Callable[[Array, Mapping[str, float]], Array]

SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, where C_R is reported
UNIT = "Pa.s2/m6"
TINY = 1e-30  # (m3/s)^4: no division by the variance of flows that are equal
CLEARLY = 10.0  # difference of AIC that leaves the worse law without support: 5e-4 by chance
LEAST = 4  # steps: with fewer the laws cannot be told apart


@dataclass(frozen=True)
class HoseFit:
    """Fits of eq. (1), of eq. (10) and of the laminar and turbulent drop together.

    zero             [Pa] of the pressures' difference, taken off; `zero_sd` its standard deviation
    mixed            only if neither law explains the data and this one does better
    reference_flow   [m3/s] rms of the flows with the weights that they have in C_R of eq. (1)
    """

    square: Regression
    power: Regression
    mixed: Regression | None
    zero: float
    zero_sd: float
    transition_flow: float
    reference_flow: float

    def drops(self, flow: Array) -> tuple[Array, Array, Array | None]:
        """By eq. (1), by eq. (10), and with the laminar part."""
        return (
            square_drop(flow, self.square.as_dict(), self.transition_flow),
            power_drop(flow, self.power.as_dict()),
            None if self.mixed is None else mixed_drop(flow, self.mixed.as_dict()),
        )


def power_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """k Q^1.75 with the sign of Q, eq. (10)."""
    return v["factor"] * np.sign(flow) * np.abs(flow) ** 1.75


def mixed_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """Q sqrt(R^2 + (C_R Q)^2), laminar below R/C_R as in `fmus.components.hose`; R^2 may be negative."""
    return flow * np.sqrt(np.maximum(v["laminar_square"] + (v["resistance"] * flow) ** 2, 0.0))


def square_drop(flow: Array, v: Mapping[str, float], transition_flow: float) -> Array:
    """C_R Q sqrt(Q^2 + Q_t^2), eq. (1) as the machine has it."""
    return v["resistance"] * flow * np.hypot(flow, transition_flow)


def scaled(resistance: float, length: float, diameter: float, to_length: float, to_diameter: float) -> float:
    """C_R or k of a hose of another length and diameter [m], from that of `length` and `diameter`, eq. (10).

    R ~ l/D^4.75, at the same flow and with the same oil.
    """
    return float(hose.scaled_resistance(resistance, to_length / length, to_diameter / diameter))


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> ProcedureResult:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tested = training(recordings, "hose_resistance", SIGNALS)
    steps = steady_steps(tested)
    laws = fit_laws(steps, value(known, "boom_stick.valve_transition_flow"))
    length, bore = hose_size(tested)
    reference = f"at {laws.reference_flow / LITRES[1]:.0f} L/min"
    estimates = []
    for axis in ("stick", "boom"):
        own = tuple(value(known, f"boom_stick.{axis}_hose_{name}") for name in ("length", "bore"))
        factor = density_ratio(tested, known) ** 0.75 * scaled(1.0, length, bore, *own)
        note = f"eq. (1), section 4(b), {reference}"
        if abs(factor - 1) > 1e-9:
            note += f", eq. (10) from {length:g} m to {own[0]:g} m, {own[1] * 1e3:.4g} mm"
        name = f"boom_stick.{axis}_hose_resistance"
        estimates.append(laws.square.estimate(name, UNIT, note, "resistance", factor))
    return ProcedureResult(
        procedure="hose_resistance",
        title=f"Hose resistance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(estimates),
        panels=panels(replace(steps, drop=steps.drop - laws.zero), laws),
        remarks=tuple(_remarks(steps, laws)),
        others=tuple(_others(laws, reference)),
    )


def steady_steps(recordings: Sequence[Recording]) -> StepMeans:
    """The steady steps of all recordings, found by their flow."""
    means = []
    for recording in recordings:
        parts = standing(recording, ["flow"])
        if not parts:
            raise Problem(
                f"{recording.source}: expected flows that stand for {NEEDED:g} s or longer, found none"
            )
        means.append(step_means(recording, parts))
    return joined(means)


def fit_laws(steps: StepMeans, transition_flow: float) -> HoseFit:
    """All laws on the measured steps."""
    good = steps.measured
    if good.flow.size < LEAST:
        lost = left_out(steps.dead, steps.clipped, steps.good)
        raise Problem(
            f"hose_resistance: {good.flow.size} steady steps are measured, expected at least {LEAST}; "
            f"left out of {steps.flow.size} steps: {lost or 'none'}"
        )
    turbulent = good.flow * np.abs(good.flow)
    start = float(np.cov(turbulent, good.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "turn the sign of the flow or the order of the pressures"
        )
    largest = float(np.abs(good.flow).max())

    def square(flow: Array, v: Mapping[str, float]) -> Array:
        return square_drop(flow, v, transition_flow)

    resistance = {"resistance": Guess(start)}
    mixed = resistance | {"laminar_square": Guess((start * largest / 10) ** 2)}
    laws = ((square, resistance), (power_drop, {"factor": Guess(start * largest**0.25)}), (mixed_drop, mixed))
    zero, sd = _zero(*(_fit(good, law, guess, start * largest**2) for law, guess in laws))
    by_square, power, both = (_at_zero(good, law, guess, zero, sd) for law, guess in laws)
    weights = good.flow**4 / _variance(good, square, by_square.as_dict())
    laminar = both["laminar_square"] > 0 and both.significant("laminar_square")
    return HoseFit(
        square=by_square,
        power=power,
        mixed=both if by_square.misfit and power.misfit and laminar else None,
        zero=zero,
        zero_sd=sd,
        transition_flow=transition_flow,
        reference_flow=float(np.sqrt(weights @ good.flow**2 / weights.sum())),
    )


def _zero(square: Regression, power: Regression, mixed: Regression) -> tuple[float, float]:
    """Of the law that fits best, with its standard deviation.

    The third counts only if it is clearly better: a small zero and a small laminar part look alike.
    """
    best = min(square, power, key=lambda one: one.aic)
    if mixed.aic < best.aic - CLEARLY and mixed["laminar_square"] > 0:
        best = mixed
    return best["zero"], best.sd("zero")


def _at_zero(steps: StepMeans, law: Drop, start: Mapping[str, Guess], zero: float, sd: float) -> Regression:
    """The fit with this zero taken off; the covariance holds its error."""
    middle, *ends = (
        _fit(replace(steps, drop=steps.drop - z), law, start) for z in (zero, zero - sd, zero + sd)
    )
    moved = (ends[1].values - ends[0].values) / 2
    return replace(middle, covariance=middle.covariance + np.outer(moved, moved))


def _variance(steps: StepMeans, law: Drop, v: Mapping[str, float]) -> Array:
    """Of the drop, with the flow's: effective variance of a point with errors in both."""
    h = 1e-4 * np.abs(steps.flow)
    slope = (law(steps.flow + h, v) - law(steps.flow - h, v)) / (2 * h)
    variance: Array = steps.drop_error**2 + (slope * steps.flow_error) ** 2
    return variance


def _fit(steps: StepMeans, law: Drop, start: Mapping[str, Guess], zero: float | None = None) -> Regression:
    """A law, with a free zero of this magnitude [Pa] in addition if one is given."""

    def residual(v: Mapping[str, float]) -> Array:
        left: Array = steps.drop - v.get("zero", 0.0) - law(steps.flow, v)
        return left / np.sqrt(_variance(steps, law, v))

    offset = {} if zero is None else {"zero": Guess(0.0, scale=zero)}
    return fit(residual, {**start, **offset}, "hose_resistance")


def panels(steps: StepMeans, laws: HoseFit) -> tuple[Panel, ...]:
    """Drop over flow with the laws, residual, C_R over flow."""
    good, dead = steps.measured, where(steps, steps.dead)
    fine = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    square, power, mixed = laws.drops(fine)
    drop = [
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("C_R Q|Q|, eq. (1)", fine, square, "fit", line=True),
        Curve("k Q^1.75, eq. (10)", fine, power, "compared", line=True),
    ]
    at_square, at_power, at_mixed = laws.drops(good.flow)
    residual = [
        Curve("eq. (1)", good.flow, good.drop - at_square, "fit", error=good.drop_error),
        Curve("eq. (10)", good.flow, good.drop - at_power, "compared"),
    ]
    if mixed is not None and at_mixed is not None:
        drop.append(Curve("with laminar part", fine, mixed, "compared", line=True))
        residual.append(Curve("with laminar part", good.flow, good.drop - at_mixed, "compared"))
    measured = good.drop / (good.flow * np.abs(good.flow))
    relative = np.hypot(good.drop_error / good.drop, 2 * good.flow_error / good.flow)
    constant = np.full_like(fine[1:], laws.square["resistance"])
    within = fine[fine >= np.abs(good.flow).min() / 2]  # eq. (10) has no limit at Q = 0
    resistance = (
        Curve("measured", good.flow, measured, error=np.abs(measured * relative)),
        Curve("eq. (1)", fine[1:], constant, "fit", line=True),
        Curve("k Q^-0.25, eq. (10)", within, laws.power["factor"] * within**-0.25, "compared", line=True),
    )
    return (
        Panel("flow", "pressure drop", tuple(drop), "Drop along the hose", LITRES, BAR),
        Panel("flow", "drop, measured - fitted", tuple(residual), "Residual", LITRES, BAR),
        Panel("flow", "C_R [Pa.s2/m6]", resistance, "C_R belongs to one flow", LITRES),
    )


def _others(laws: HoseFit, reference: str) -> Iterator[Estimate]:
    yield laws.square.estimate("C_R", UNIT, f"eq. (1), the tested hose {reference}", "resistance")
    note = "pressure_in - pressure_out"
    yield Estimate.normal("pressures without flow", laws.zero, "Pa", laws.zero_sd, note)
    yield laws.power.estimate("k", "Pa/(m3/s)^1.75", "eq. (10), the tested hose", "factor")
    for litres in FLOWS:
        flow = litres * LITRES[1]
        yield laws.power.derived(
            f"C_R({litres:g} L/min)",
            UNIT,
            "k Q^-0.25, eq. (10)",
            partial(lambda q, v: float(v["factor"] * q**-0.25), flow),
        )
    if laws.mixed is not None:
        note = "Q sqrt(R^2 + (C_R Q)^2)"
        yield laws.mixed.estimate("C_R with laminar part", UNIT, note, "resistance")
        yield laws.mixed.derived("R, laminar part", "Pa.s/m3", note, lambda v: math.sqrt(v["laminar_square"]))


def _remarks(steps: StepMeans, laws: HoseFit) -> Iterator[str]:
    """What is left out, which law is better, the reference flow, the zero, a laminar part, a misfit."""
    lost = left_out(steps.dead, steps.clipped, steps.good)
    if lost:
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {lost}{flat}."
    square, power = laws.square, laws.power
    better, worse = ("eq. (1)", "eq. (10)") if square.aic < power.aic else ("eq. (10)", "eq. (1)")
    yield (
        f"{better.capitalize()} fits better than {worse}: chi-square is {square.chi_square:.4g} by eq. (1), "
        f"{power.chi_square:.4g} by eq. (10), with {square.freedom} degrees of freedom."
    )
    yield (
        f"C_R belongs to {laws.reference_flow / LITRES[1]:.0f} L/min, where the data weigh most. By eq. (10) "
        "it would fall by 16 % per doubling of the flow."
    )
    if abs(laws.zero) >= SIGNIFICANT * laws.zero_sd:
        yield (
            f"Without flow the pressures would differ by {laws.zero / BAR[1]:.2g} +- "
            f"{laws.zero_sd / BAR[1]:.1g} bar by the law that fits best. That is taken off as an error of "
            "their zeros."
        )
    if laws.mixed is not None:
        yield (
            "The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
            f"{laws.mixed.chi_square:.4g}. The lumped hose has no such term, so C_R takes its share of it."
        )
    yield from misfit_remark(square, "Eq. (1)")
