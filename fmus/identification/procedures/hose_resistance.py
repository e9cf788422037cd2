"""Hose resistance procedure (section 4(b), Fig. 6): turbulent pressure drop along a hose at stepped flows.

    P_in - P_out = C_R Q|Q|, eq. (1)        P_in - P_out = k Q^1.75, k ~ l/D^4.75, eq. (10)

Eq. (1) is the law that the machine simulates, with |Q| rounded to sqrt(Q^2 + Q_t^2) as in
`fmus.components.spool_valve.turbulent_drop`. Eq. (10) is Blasius' law, so C_R = k Q^-0.25 is valid for one
reference flow (correction E10 in docs/equations.md). Both are fitted to the means over the steps, weighted
with the errors of drop and flow. Chi-square and AIC show which law the data support.

The readings of two transducers differ slightly without flow, and a tenth of a bar is a hundredth of a hose's
drop. This offset is estimated with the law that fits best and subtracted; its error counts in all laws.

Validity: steady flow above the dead zone of the meter; eq. (10) for a smooth pipe and Re 3e3 to 1e5.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmus.components import hose
from fmus.identification.estimate import Estimate
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE, Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    SHORTEST_STRETCH,
    StepMeans,
    concatenate,
    density_ratio,
    difference_limit,
    hose_size,
    parameter_value,
    pressure_offset_remark,
    select,
    steady_stretches,
    step_means,
    training_recordings,
    zero_warning,
)
from fmus.identification.procedures.regression import Guess, Regression, fit, misfit_remark, misfit_warning
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

DropLaw = Callable[[Array, Mapping[str, float]], Array]

SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, at which C_R by eq. (10) is reported
UNIT = "Pa.s2/m6"
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
CLEARLY_BETTER = 10.0  # difference of AIC at which the worse law has no support: 5e-4 by chance
MIN_STEPS = 4  # fewer steps cannot distinguish between the laws


@dataclass(frozen=True)
class HoseFit:
    """Fits of eq. (1), of eq. (10), and of a laminar and turbulent drop together.

    mixed            None unless both other laws are misfits and the laminar part is significant
    zero_warnings    sentences if the data want a larger difference than the sensors can have
    zero, zero_sd    subtracted pressure difference without flow [Pa] and its standard deviation
    reference_flow   rms of the flows [m3/s] with their weights in C_R of eq. (1)
    """

    square: Regression
    power: Regression
    mixed: Regression | None
    zero: float
    zero_sd: float
    transition_flow: float
    reference_flow: float
    zero_warnings: tuple[str, ...] = ()

    def drops(self, flow: Array) -> tuple[Array, Array, Array | None]:
        """Drops by eq. (1), by eq. (10), and with the laminar part."""
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
    """C_R Q sqrt(Q^2 + Q_t^2), eq. (1) as the machine simulates it."""
    return v["resistance"] * flow * np.hypot(flow, transition_flow)


def scaled(resistance: float, length: float, diameter: float, to_length: float, to_diameter: float) -> float:
    """C_R or k of a hose of another length and diameter [m], from that of `length` and `diameter`, eq. (10).

    R ~ l/D^4.75, at the same flow and with the same oil.
    """
    return float(hose.scaled_resistance(resistance, to_length / length, to_diameter / diameter))


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tests = training_recordings(recordings, "hose_resistance", SIGNALS)
    steps = steady_steps(tests)
    limit = difference_limit(tests, ("pressure_in", "pressure_out"))
    laws = fit_laws(steps, parameter_value(parameters, "boom_stick.valve_transition_flow"), limit)
    length, bore = hose_size(tests)
    flow = f"at {laws.reference_flow / LITRES_PER_MINUTE[1]:.0f} L/min"
    estimates = []
    for axis in ("stick", "boom"):
        size = tuple(parameter_value(parameters, f"boom_stick.{axis}_hose_{n}") for n in ("length", "bore"))
        factor = density_ratio(tests, parameters) ** 0.75 * scaled(1.0, length, bore, *size)
        note = f"eq. (1), section 4(b), {flow}"
        if abs(factor - 1) > 1e-9:
            note += f", eq. (10) from {length:g} m to {size[0]:g} m, {size[1] * 1e3:.4g} mm"
        name = f"boom_stick.{axis}_hose_resistance"
        estimates.append(laws.square.estimate(name, UNIT, note, "resistance", factor))
    return ProcedureResult(
        procedure="hose_resistance",
        title=f"Hose resistance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(estimates),
        panels=panels(replace(steps, drop=steps.drop - laws.zero), laws),
        remarks=tuple(_remarks(steps, laws)),
        others=tuple(_others(laws, flow)),
        warnings=(*misfit_warning(laws.square.times_noise, "hose_resistance: eq. (1)"), *laws.zero_warnings),
    )


def steady_steps(recordings: Sequence[Recording]) -> StepMeans:
    """Means over the stretches of steady flow in all recordings."""
    means = []
    for recording in recordings:
        steps = steady_stretches(recording, ["flow"])
        if not steps:
            raise Problem(
                f"{recording.source}: flow: expected a steady flow for {SHORTEST_STRETCH:g} s or longer, got "
                "none"
            )
        means.append(step_means(recording, steps))
    return concatenate(means)


def fit_laws(steps: StepMeans, transition_flow: float, zero_limit: float) -> HoseFit:
    """All laws, fitted to the measured steps.

    zero_limit   largest difference of the two pressures [Pa] without flow, by the data sheets
    """
    good = steps.measured()
    if good.flow.size < MIN_STEPS:
        raise Problem(
            f"hose_resistance: expected at least {MIN_STEPS} steady steps, got {good.flow.size}; "
            f"left out of {steps.flow.size} steps: {steps.omissions() or 'none'}"
        )
    turbulent = good.flow * np.abs(good.flow)
    start = float(np.cov(turbulent, good.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "change the sign of the flow, or exchange the two pressures"
        )
    largest = float(np.abs(good.flow).max())

    def square(flow: Array, v: Mapping[str, float]) -> Array:
        return square_drop(flow, v, transition_flow)

    resistance = {"resistance": Guess(start)}
    mixed = resistance | {"laminar_square": Guess((start * largest / 10) ** 2)}
    simple = ((square, resistance), (power_drop, {"factor": Guess(start * largest**0.25)}))
    offset = (start * largest**2, zero_limit)
    both = _if_possible(lambda: _fit(good, mixed_drop, mixed, *offset))
    with_offset, by_blasius = (_fit(good, law, guess, *offset) for law, guess in simple)
    found, sd = _zero(with_offset, by_blasius, both)
    zero = float(np.clip(found, -zero_limit, zero_limit))
    by_square, by_power = (_fit_at_zero(good, law, guess, zero, sd) for law, guess in simple)
    by_both = _if_possible(lambda: _fit_at_zero(good, mixed_drop, mixed, zero, sd)) if both else None
    weights = good.flow**4 / _variance(good, square, by_square.as_dict())
    laminar = by_both and by_both["laminar_square"] > 0 and by_both.significant("laminar_square")
    return HoseFit(
        square=by_square,
        power=by_power,
        mixed=by_both if by_square.misfit and by_power.misfit and laminar else None,
        zero=zero,
        zero_sd=sd,
        transition_flow=transition_flow,
        reference_flow=float(np.sqrt(weights @ good.flow**2 / weights.sum())),
        zero_warnings=tuple(zero_warning("hose_resistance", found, sd, zero_limit, BAR)),
    )


def _if_possible(fitted: Callable[[], Regression]) -> Regression | None:
    """The fit of a law that data may contradict so much that it has no optimum; then None."""
    try:
        return fitted()
    except Problem:
        return None


def _zero(square: Regression, power: Regression, mixed: Regression | None) -> tuple[float, float]:
    """The pressure offset of the law that fits best, with its standard deviation.

    The mixed law must be clearly better than the others: a small offset and a small laminar part look alike.
    """
    best = min(square, power, key=lambda regression: regression.aic)
    if mixed and mixed.aic < best.aic - CLEARLY_BETTER and mixed["laminar_square"] > 0:
        best = mixed
    return best["zero"], best.sd("zero")


def _fit_at_zero(
    steps: StepMeans, law: DropLaw, start: Mapping[str, Guess], zero: float, sd: float
) -> Regression:
    """The fit with this pressure offset subtracted; the covariance includes the error of the offset."""
    central, low, high = (
        _fit(replace(steps, drop=steps.drop - z), law, start) for z in (zero, zero - sd, zero + sd)
    )
    change = (high.values - low.values) / 2
    return replace(central, covariance=central.covariance + np.outer(change, change))


def _variance(steps: StepMeans, law: DropLaw, v: Mapping[str, float]) -> Array:
    """Effective variance of the drop, which includes the error of the flow (errors in both variables)."""
    h = 1e-4 * np.abs(steps.flow)
    derivative = (law(steps.flow + h, v) - law(steps.flow - h, v)) / (2 * h)
    variance: Array = steps.drop_error**2 + (derivative * steps.flow_error) ** 2
    return variance


def _fit(
    steps: StepMeans,
    law: DropLaw,
    start: Mapping[str, Guess],
    zero_magnitude: float | None = None,
    zero_limit: float = math.inf,
) -> Regression:
    """Fit of a law, together with a pressure offset of this magnitude [Pa] if one is given.

    zero_limit   largest offset [Pa]: two standard deviations of its prior
    """

    def residual(v: Mapping[str, float]) -> Array:
        unweighted: Array = steps.drop - v.get("zero", 0.0) - law(steps.flow, v)
        weighted: Array = unweighted / np.sqrt(_variance(steps, law, v))
        return np.append(weighted, [2 * v["zero"] / zero_limit] if "zero" in v else [])

    zero = (
        {} if zero_magnitude is None else {"zero": Guess(0.0, magnitude=min(zero_magnitude, zero_limit / 2))}
    )
    return fit(residual, {**start, **zero}, "hose_resistance")


def panels(steps: StepMeans, laws: HoseFit) -> tuple[Panel, ...]:
    """Drop over flow with the laws, residual, C_R over flow."""
    good, dead = steps.measured(), select(steps, steps.dead)
    flows = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    square, power, mixed = laws.drops(flows)
    drop = [
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("C_R Q|Q|, eq. (1)", flows, square, "fit", line=True),
        Curve("k Q^1.75, eq. (10)", flows, power, "compared", line=True),
    ]
    fitted_square, fitted_power, fitted_mixed = laws.drops(good.flow)
    residual = [
        Curve("eq. (1)", good.flow, good.drop - fitted_square, "fit", error=good.drop_error),
        Curve("eq. (10)", good.flow, good.drop - fitted_power, "compared"),
    ]
    if mixed is not None and fitted_mixed is not None:
        drop.append(Curve("with laminar part", flows, mixed, "compared", line=True))
        residual.append(Curve("with laminar part", good.flow, good.drop - fitted_mixed, "compared"))
    constant = np.full_like(flows[1:], laws.square["resistance"])
    in_range = flows[flows >= np.abs(good.flow).min() / 2]  # eq. (10) has no limit at Q = 0
    power_resistance = laws.power["factor"] * in_range**-0.25
    resistance = (
        Curve("measured", good.flow, good.resistance, error=good.resistance_error),
        Curve("eq. (1)", flows[1:], constant, "fit", line=True),
        Curve("k Q^-0.25, eq. (10)", in_range, power_resistance, "compared", line=True),
    )
    litres = LITRES_PER_MINUTE
    return (
        Panel("flow", "pressure drop", tuple(drop), "Drop along the hose", litres, BAR),
        Panel("flow", "drop, measured - fitted", tuple(residual), "Residual", litres, BAR),
        Panel("flow", "C_R [Pa.s2/m6]", resistance, "C_R is valid for one flow", litres),
    )


def _others(laws: HoseFit, reference_flow: str) -> Iterator[Estimate]:
    yield laws.square.estimate("C_R", UNIT, f"eq. (1), the tested hose {reference_flow}", "resistance")
    note = "pressure_in - pressure_out"
    yield Estimate.normal("pressures without flow", laws.zero, "Pa", laws.zero_sd, note)
    yield laws.power.estimate("k", "Pa/(m3/s)^1.75", "eq. (10), the tested hose", "factor")
    for litres in FLOWS:
        yield laws.power.derived(
            f"C_R({litres:g} L/min)",
            UNIT,
            "k Q^-0.25, eq. (10)",
            partial(lambda flow, v: float(v["factor"] * flow**-0.25), litres * LITRES_PER_MINUTE[1]),
        )
    if laws.mixed is not None:
        note = "Q sqrt(R^2 + (C_R Q)^2)"
        yield laws.mixed.estimate("C_R with laminar part", UNIT, note, "resistance")
        yield laws.mixed.derived("R, laminar part", "Pa.s/m3", note, lambda v: math.sqrt(v["laminar_square"]))


def _remarks(steps: StepMeans, laws: HoseFit) -> Iterator[str]:
    """Steps left out, the better law, the reference flow, the offset, a laminar part, a misfit."""
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {omissions}{flat}."
    square, power = laws.square, laws.power
    better, worse = ("eq. (1)", "eq. (10)") if square.aic < power.aic else ("eq. (10)", "eq. (1)")
    yield (
        f"{better.capitalize()} fits better than {worse}: chi-square is {square.chi_square:.4g} by eq. (1), "
        f"{power.chi_square:.4g} by eq. (10), with {square.freedom} degrees of freedom."
    )
    yield (
        f"C_R is valid for {laws.reference_flow / LITRES_PER_MINUTE[1]:.0f} L/min, the weighted rms "
        "of the flows. By eq. (10) C_R would fall by 16 % for each doubling of the flow."
    )
    yield from pressure_offset_remark(laws.zero, laws.zero_sd)
    if laws.mixed is not None:
        yield (
            "The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
            f"{laws.mixed.chi_square:.4g}. The lumped hose has no such term, so C_R includes a part of it."
        )
    yield from misfit_remark(square, "Eq. (1)")
