"""Steps of the hose test; the laws of its pressure drop, each fitted with the errors of drop and flow.

Two transducers never show quite the same without flow, and a tenth of a bar is a hundredth of a hose's drop.
So this zero is found along with the law that fits best and taken off; its error counts in all laws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.components import hose
from fmus.contract import ModelError
from fmus.identification.procedures.shared.regression import Guess, Regression, fit
from fmus.identification.procedures.shared.standing import NEEDED, standing
from fmus.identification.procedures.shared.step_means import StepMeans, left_out, step_means
from fmus.identification.recordings.recording import Recording

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
    """Q sqrt(R^2 + (C_R Q)^2), laminar below R/C_R as in `fmus.components.line`; R^2 may be negative."""
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
        raise ModelError(
            f"{recording.source}: expected flows that stand for {NEEDED:g} s or longer, found none"
        )
    return step_means(recording, parts)


def fit_laws(given: StepMeans, transition_flow: float) -> HoseFit:
    """All laws on the measured steps."""
    good = given.measured
    if good.flow.size < LEAST:
        lost = left_out(given.dead, given.clipped, given.good)
        raise ModelError(
            f"hose_resistance: {good.flow.size} steady steps are measured, expected at least {LEAST}; "
            f"left out of {given.flow.size} steps: {lost or 'none'}"
        )
    return _laws(good, transition_flow)


def _laws(given: StepMeans, transition_flow: float) -> HoseFit:
    turbulent = given.flow * np.abs(given.flow)
    start = float(np.cov(turbulent, given.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise ModelError(
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
