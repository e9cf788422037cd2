"""Steps of the hose test; the laws of its pressure drop, each fitted with the errors of drop and flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.components import hose
from fmus.contract import ModelError
from fmus.identification.procedures.shared.given import noise_of
from fmus.identification.procedures.shared.regression import Guess, Regression, fit
from fmus.identification.procedures.shared.step_means import SETTLE, SHORTEST, StepMeans, step_means
from fmus.identification.recordings.masks import steady
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import uniform_rate

Array = NDArray[np.float64]
Drop = Callable[[Array, Mapping[str, float]], Array]

SAME = 8.0  # standard deviations of the flow from the mean of its step: noise does not part it
LATE = 0.1  # s, cut off the end of a step: the flow shows the next one later than the pressures do


@dataclass(frozen=True)
class HoseFit:
    """Fits of eq. (1), of eq. (10) and of the laminar and turbulent drop together.

    mixed            only if neither law explains the data and this one does better
    reference_flow   [m3/s] rms of the flows with the weights that they have in C_R of eq. (1)
    """

    square: Regression
    power: Regression
    mixed: Regression | None
    transition_flow: float
    reference_flow: float


def power_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """k Q^1.75 with the sign of Q, eq. (10)."""
    return v["factor"] * np.sign(flow) * np.abs(flow) ** 1.75


def mixed_drop(flow: Array, v: Mapping[str, float]) -> Array:
    """Q sqrt(R^2 + (C_R Q)^2), laminar below Q = R/C_R as in `fmus.components.line`; R^2 may be negative."""
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
    width = SAME * noise_of(recording, "flow") + recording.sensor("flow").resolution
    found = steady(recording, "flow", SETTLE, SHORTEST + LATE, width)
    late = round(LATE * uniform_rate(recording))
    return step_means(recording, [slice(part.start, part.stop - late) for part in found])


def fit_laws(given: StepMeans, transition_flow: float) -> HoseFit:
    """All laws on the measured steps."""
    if given.flow.size < 4:
        raise ModelError(
            f"hose_resistance: {given.flow.size} steady steps above the dead zone of the flow meter, "
            "expected at least 4"
        )
    start = float(given.drop @ given.flow**2 / (given.flow**2 @ given.flow**2))
    largest = float(np.abs(given.flow).max())

    def square(flow: Array, v: Mapping[str, float]) -> Array:
        return square_drop(flow, v, transition_flow)

    found = _fit(given, square, {"resistance": Guess(start)})
    power = _fit(given, power_drop, {"factor": Guess(start * largest**0.25)})
    weights = given.flow**4 / _variance(given, square, found.as_dict())
    return HoseFit(
        square=found,
        power=power,
        mixed=_mixed(given, start, largest) if found.misfit and power.misfit else None,
        transition_flow=transition_flow,
        reference_flow=float(np.sqrt(weights @ given.flow**2 / weights.sum())),
    )


def _mixed(given: StepMeans, resistance: float, flow: float) -> Regression | None:
    """The fit with a laminar part, if there is one."""
    start = {"resistance": Guess(resistance), "laminar_square": Guess((resistance * flow / 10) ** 2)}
    found = _fit(given, mixed_drop, start)
    return found if found["laminar_square"] > 2 * found.sd("laminar_square") else None


def _variance(given: StepMeans, law: Drop, v: Mapping[str, float]) -> Array:
    """Of the drop, with the flow's: effective variance of a point with errors in both."""
    h = 1e-4 * np.abs(given.flow)
    slope = (law(given.flow + h, v) - law(given.flow - h, v)) / (2 * h)
    variance: Array = given.drop_error**2 + (slope * given.flow_error) ** 2
    return variance


def _fit(given: StepMeans, law: Drop, start: Mapping[str, Guess]) -> Regression:
    def residual(v: Mapping[str, float]) -> Array:
        weighted: Array = (given.drop - law(given.flow, v)) / np.sqrt(_variance(given, law, v))
        return weighted

    return fit(residual, start, "hose_resistance")
