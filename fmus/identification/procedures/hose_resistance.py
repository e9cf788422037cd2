"""Steps of the hose test; the laws of its pressure drop, each fitted with the errors of drop and flow.

Two transducers never show quite the same without flow, and a tenth of a bar is a hundredth of a hose's drop.
So this zero is found along with the law that fits best and taken off; its error counts in all laws.

Fig. 6 again: the drop over the flow with the laws fitted to it, the residual, C_R over the flow.

Hose resistance (section 4(b), Fig. 6): the turbulent drop along a hose at stepped flows.

    P_in - P_out = C_R Q|Q|, eq. (1)        P_in - P_out = k Q^1.75, k ~ l/D^4.75, eq. (10)

Eq. (1) is what the machine simulates, with |Q| rounded to sqrt(Q^2 + Q_t^2) as in
`fmus.components.spool_valve.turbulent_drop`. Eq. (10) is Blasius' law, so C_R = k Q^-0.25 belongs to one
reference flow (correction E10 in docs/equations.md). Both are fitted to the means of the steps, weighted with
the errors of drop and flow; which one the data support is told by chi-square and AIC.

Validity: steady flow above the dead zone of the meter; eq. (10) for a smooth pipe and Re 3e3 to 1e5.

Hose resistance, section 4(b), Fig. 6: `procedure` is the experiment, `laws` are eqs. (1) and (10).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.components import hose
from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures.known_values import (
    NEEDED,
    StepMeans,
    denser,
    hose_size,
    left_out,
    standing,
    step_means,
    training,
    value,
)
from fmus.identification.procedures.regression import SURE, Guess, Regression, fit, misfit_remark, symmetrical
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
Drop = Callable[[Array, Mapping[str, float]], Array]

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


def power_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """k Q^1.75 with the sign of Q, eq. (10)."""
    return v["factor"] * np.sign(flow) * np.abs(flow) ** 1.75


def mixed_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """Q sqrt(R^2 + (C_R Q)^2), laminar below R/C_R as in `fmus.components.hose_line`; R^2 may be negative."""
    return flow * np.sqrt(np.maximum(v["laminar_square"] + (v["resistance"] * flow) ** 2, 0.0))


def square_drop(flow: Array, v: Mapping[str, float], transition_flow: float) -> Array:
    """C_R Q sqrt(Q^2 + Q_t^2), eq. (1) as the machine has it."""
    return v["resistance"] * flow * np.hypot(flow, transition_flow)


def scaled(resistance: float, length: float, diameter: float, to_length: float, to_diameter: float) -> float:
    """C_R or k of a hose of another length and diameter [m], from that of `length` and `diameter`, eq. (10).

    R ~ l/D^4.75, at the same flow and with the same oil.
    """
    return float(hose.scaled_resistance(resistance, to_length / length, to_diameter / diameter))


def steps(recordings: Sequence[Recording]) -> StepMeans:
    """The steady steps of all recordings, found by their flow."""
    each = [_of_one(recording) for recording in recordings]
    return StepMeans(**{name: np.concatenate([vars(one)[name] for one in each]) for name in vars(each[0])})


def _of_one(recording: Recording) -> StepMeans:
    parts = standing(recording, ["flow"])
    if not parts:
        raise Problem(f"{recording.source}: expected flows that stand for {NEEDED:g} s or longer, found none")
    return step_means(recording, parts)


def fit_laws(given: StepMeans, transition_flow: float) -> HoseFit:
    """All laws on the measured steps."""
    good = given.measured
    if good.flow.size < LEAST:
        lost = left_out(given.dead, given.clipped, given.good)
        raise Problem(
            f"hose_resistance: {good.flow.size} steady steps are measured, expected at least {LEAST}; "
            f"left out of {given.flow.size} steps: {lost or 'none'}"
        )
    return _fitted_laws(good, transition_flow)


def _fitted_laws(given: StepMeans, transition_flow: float) -> HoseFit:
    turbulent = given.flow * np.abs(given.flow)
    start = float(np.cov(turbulent, given.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "turn the sign of the flow or the order of the pressures"
        )
    largest = float(np.abs(given.flow).max())

    def square(flow: Array, v: Mapping[str, float]) -> Array:
        return square_drop(flow, v, transition_flow)

    resistance = {"resistance": Guess(start)}
    mixed = resistance | {"laminar_square": Guess((start * largest / 10) ** 2)}
    laws = ((square, resistance), (power_drop, {"factor": Guess(start * largest**0.25)}), (mixed_drop, mixed))
    zero, sd = _zero(*(_fit(given, law, guess, start * largest**2) for law, guess in laws))
    found, power, both = (_at_zero(given, law, guess, zero, sd) for law, guess in laws)
    weights = given.flow**4 / _variance(given, square, found.as_dict())
    laminar = both["laminar_square"] > 0 and both.seen("laminar_square")
    return HoseFit(
        square=found,
        power=power,
        mixed=both if found.misfit and power.misfit and laminar else None,
        zero=zero,
        zero_sd=sd,
        transition_flow=transition_flow,
        reference_flow=float(np.sqrt(weights @ given.flow**2 / weights.sum())),
    )


def _zero(square: Regression, power: Regression, mixed: Regression) -> tuple[float, float]:
    """Of the law that fits best, with its standard deviation.

    The third counts only if it is clearly better: a small zero and a small laminar part look alike.
    """
    best = min(square, power, key=lambda one: one.aic)
    if mixed.aic < best.aic - CLEARLY and mixed["laminar_square"] > 0:
        best = mixed
    return best["zero"], best.sd("zero")


def _at_zero(given: StepMeans, law: Drop, start: Mapping[str, Guess], zero: float, sd: float) -> Regression:
    """The fit with this zero taken off; the covariance holds its error."""
    middle, *ends = (
        _fit(replace(given, drop=given.drop - z), law, start) for z in (zero, zero - sd, zero + sd)
    )
    moved = (ends[1].values - ends[0].values) / 2
    return replace(middle, covariance=middle.covariance + np.outer(moved, moved))


def _variance(given: StepMeans, law: Drop, v: Mapping[str, float]) -> Array:
    """Of the drop, with the flow's: effective variance of a point with errors in both."""
    h = 1e-4 * np.abs(given.flow)
    slope = (law(given.flow + h, v) - law(given.flow - h, v)) / (2 * h)
    variance: Array = given.drop_error**2 + (slope * given.flow_error) ** 2
    return variance


def _fit(given: StepMeans, law: Drop, start: Mapping[str, Guess], zero: float | None = None) -> Regression:
    """A law, with a zero of this magnitude [Pa] free beside it if one is given."""

    def residual(v: Mapping[str, float]) -> Array:
        left: Array = given.drop - v.get("zero", 0.0) - law(given.flow, v)
        return left / np.sqrt(_variance(given, law, v))

    beside = {} if zero is None else {"zero": Guess(0.0, scale=zero)}
    return fit(residual, {**start, **beside}, "hose_resistance")


FLOW, LITRES, BAR = "flow", ("L/min", 1e-3 / 60), ("bar", 1e5)


def panels(every: StepMeans, laws: HoseFit) -> tuple[Panel, ...]:
    """Drop, residual, C_R."""
    good = every.measured
    dead = every.where(every.dead)
    fine = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    square, power = _laws(laws, fine)
    drop: tuple[Curve, ...] = (
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("C_R Q|Q|, eq. (1)", fine, square, "fit", line=True),
        Curve("k Q^1.75, eq. (10)", fine, power, "compared", line=True),
    )
    if laws.mixed is not None:
        mixed = mixed_drop(fine, laws.mixed.as_dict())
        drop += (Curve("with laminar part", fine, mixed, "compared", line=True),)
    return (
        Panel(FLOW, "pressure drop", drop, "Drop along the hose", LITRES, BAR),
        _residual(good, laws),
        _resistance(good, laws, fine[1:]),
    )


def _laws(laws: HoseFit, flow: Array) -> tuple[Array, Array]:
    return (
        square_drop(flow, laws.square.as_dict(), laws.transition_flow),
        power_drop(flow, laws.power.as_dict()),
    )


def _residual(good: StepMeans, laws: HoseFit) -> Panel:
    square, power = _laws(laws, good.flow)
    curves: tuple[Curve, ...] = (
        Curve("eq. (1)", good.flow, good.drop - square, "fit", error=good.drop_error),
        Curve("eq. (10)", good.flow, good.drop - power, "compared"),
    )
    if laws.mixed is not None:
        mixed = mixed_drop(good.flow, laws.mixed.as_dict())
        curves += (Curve("with laminar part", good.flow, good.drop - mixed, "compared"),)
    return Panel(FLOW, "drop, measured - fitted", curves, "Residual", LITRES, BAR)


def _resistance(good: StepMeans, laws: HoseFit, fine: Array) -> Panel:
    drop = good.drop
    measured = drop / (good.flow * np.abs(good.flow))
    relative = np.hypot(good.drop_error / drop, 2 * good.flow_error / good.flow)
    constant = np.full_like(fine, laws.square["resistance"])
    within = fine >= np.abs(good.flow).min() / 2  # eq. (10) has no limit at Q = 0
    curves = (
        Curve("measured", good.flow, measured, error=np.abs(measured * relative)),
        Curve("eq. (1)", fine, constant, "fit", line=True),
        Curve(
            "k Q^-0.25, eq. (10)",
            fine[within],
            laws.power["factor"] * fine[within] ** -0.25,
            "compared",
            True,
        ),
    )
    return Panel(FLOW, "C_R [Pa.s2/m6]", curves, "C_R belongs to one flow", LITRES)


SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, where C_R is told
LITRES_PROCEDURE = 1e-3 / 60  # m3/s in one L/min
UNIT, BAR_PROCEDURE = "Pa.s2/m6", 1e5


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tested = training(recordings, "hose_resistance", SIGNALS)
    every = steps(tested)
    laws = fit_laws(every, value(known, "boom_stick.valve_transition_flow"))
    size, thicker = hose_size(tested), denser(tested, known) ** 0.75
    return Finding(
        procedure="hose_resistance",
        title=f"Hose resistance: {size[0]:g} m, bore {size[1] * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(_machine(laws, axis, size, thicker, known) for axis in ("stick", "boom")),
        panels=panels(replace(every, drop=every.drop - laws.zero), laws),
        remarks=_remarks(every, laws),
        others=tuple(_others(laws)),
    )


def _machine(
    laws: HoseFit, axis: str, size: tuple[float, float], thicker: float, known: Mapping[str, Number]
) -> Estimate:
    own = tuple(value(known, f"boom_stick.{axis}_hose_{name}") for name in ("length", "bore"))
    factor = thicker * scaled(1.0, *size, own[0], own[1])
    note = f"eq. (1), section 4(b), at {laws.reference_flow / LITRES_PROCEDURE:.0f} L/min"
    if abs(factor - 1) > 1e-9:
        note += f", eq. (10) from {size[0]:g} m to {own[0]:g} m, {own[1] * 1e3:.4g} mm"
    return laws.square.estimate(f"boom_stick.{axis}_hose_resistance", UNIT, note, "resistance", factor)


def _others(laws: HoseFit) -> list[Estimate]:
    found = [
        laws.square.estimate(
            "C_R",
            UNIT,
            f"eq. (1), the tested hose at {laws.reference_flow / LITRES_PROCEDURE:.0f} L/min",
            "resistance",
        ),
        symmetrical("pressures without flow", laws.zero, "Pa", laws.zero_sd, "pressure_in - pressure_out"),
        laws.power.estimate("k", "Pa/(m3/s)^1.75", "eq. (10), the tested hose", "factor"),
    ]
    for litres in FLOWS:
        at = partial(_at_flow, litres * LITRES_PROCEDURE)
        found.append(laws.power.derived(f"C_R({litres:g} L/min)", UNIT, "k Q^-0.25, eq. (10)", at))
    if laws.mixed is not None:
        found += [
            laws.mixed.estimate("C_R beside laminar part", UNIT, "Q sqrt(R^2 + (C_R Q)^2)", "resistance"),
            laws.mixed.derived("R, laminar part", "Pa.s/m3", "Q sqrt(R^2 + (C_R Q)^2)", _laminar),
        ]
    return found


def _laminar(values: Mapping[str, float]) -> float:
    return math.sqrt(values["laminar_square"])


def _at_flow(flow: float, values: Mapping[str, float]) -> float:
    return float(values["factor"] * flow**-0.25)


def _remarks(every: StepMeans, laws: HoseFit) -> tuple[str, ...]:
    return tuple(
        text
        for text in (
            _masked(every),
            _better(laws),
            _reference(laws),
            _zero_remark(laws),
            _mixed(laws),
            *misfit_remark(laws.square, "Eq. (1)"),
        )
        if text
    )


def _masked(every: StepMeans) -> str:
    dead, lost = int(every.dead.sum()), left_out(every.dead, every.clipped, every.good)
    if not lost:
        return ""
    flat = ", the flat region at the beginning of Fig. 6" if dead else ""
    return f"Left out of {every.flow.size} steps: {lost}{flat}."


def _better(laws: HoseFit) -> str:
    square, power = laws.square, laws.power
    better, worse = ("eq. (1)", "eq. (10)") if square.aic < power.aic else ("eq. (10)", "eq. (1)")
    return (
        f"{better.capitalize()} fits better than {worse}: chi-square is {square.chi_square:.4g} by eq. (1), "
        f"{power.chi_square:.4g} by eq. (10), with {square.freedom} degrees of freedom."
    )


def _reference(laws: HoseFit) -> str:
    return (
        f"C_R belongs to {laws.reference_flow / LITRES_PROCEDURE:.0f} L/min, where the data weigh most. By eq. (10) it "
        "would fall by 16 % per doubling of the flow."
    )


def _zero_remark(laws: HoseFit) -> str:
    if abs(laws.zero) < SURE * laws.zero_sd:
        return ""
    return (
        f"Without flow the pressures would differ by {laws.zero / BAR_PROCEDURE:.2g} +- {laws.zero_sd / BAR_PROCEDURE:.1g} bar "
        "by the law that fits best. That is taken off as an error of their zeros."
    )


def _mixed(laws: HoseFit) -> str:
    if laws.mixed is None:
        return ""
    return (
        "The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
        f"{laws.mixed.chi_square:.4g}. The lumped hose has no such term, so C_R takes its share of it."
    )


__all__ = ["SIGNALS", "identify"]
