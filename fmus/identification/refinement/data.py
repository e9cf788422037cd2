"""Recordings on the model's names: which samples count and how much, where the trajectory may start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from fmus.contract import ModelError, Subsystem, quantities, symbolic
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.problem import Run
from fmus.parameters import Values, values

Array = NDArray[np.float64]

_EDGE = 3.0  # standard deviations that a value must be away from where its instrument ends
_SPEED_WINDOW = 0.1  # s over which an angle is differentiated


@dataclass(frozen=True)
class Mapped:
    """How recordings become runs of a subsystem.

    outputs    that are fitted
    compared   outputs that are only compared, such as speeds that nobody measured
    signals    input or output -> signal of the recordings; a name that is missing is its own
    smooth     input -> window [s] over which it is smoothed, for an input that is measured with noise
    rest       states that stand still when a recording begins
    sd         output -> standard deviation, where the sensor does not tell
    """

    sub: Subsystem
    outputs: Sequence[str]
    compared: Sequence[str] = ()
    signals: Mapping[str, str] = field(default_factory=dict)
    smooth: Mapping[str, float] = field(default_factory=dict)
    rest: Sequence[str] = ()
    sd: Mapping[str, float] = field(default_factory=dict)
    numbers: Values | None = None

    def run(self, recording: Recording) -> Run:
        """The run of one recording."""
        shown = (*self.outputs, *self.compared)
        self._check(recording, shown)
        measured = np.column_stack([self._signal(recording, name) for name in shown])
        usable = np.column_stack([usable_samples(recording, self._name(name)) for name in shown])
        weight = np.zeros(measured.shape)
        for k, name in enumerate(self.outputs):
            weight[:, k] = usable[:, k] / self._sd(recording, name)
        return Run(
            name=recording.source.stem,
            time=recording.time,
            inputs={name: self._input(recording, name) for name in quantities(self.sub.inputs)},
            measured=np.where(usable, measured, 0.0),
            weight=weight,
            compared=usable,
            scale=np.array([_range(column[good]) for column, good in zip(measured.T, usable.T, strict=True)]),
            guess=self._guess(recording),
            rest=tuple(self.rest),
        )

    def _name(self, name: str) -> str:
        return self.signals.get(name, name)

    def _signal(self, recording: Recording, name: str) -> Array:
        return recording[self._name(name)]

    def _check(self, recording: Recording, shown: Sequence[str]) -> None:
        declared = {**quantities(self.sub.inputs), **quantities(self.sub.outputs)}
        for name in shown:
            if name not in quantities(self.sub.outputs):
                raise ModelError(
                    f"{recording.source}: {name} is to be fitted, expected an output of {self.sub.name}"
                )
        for name, q in declared.items():
            found = recording.units.get(self._name(name), q.unit)
            if found != q.unit:
                raise ModelError(f"{recording.source}: {self._name(name)} is in {found}, expected {q.unit}")

    def _sd(self, recording: Recording, name: str) -> float:
        told = self.sd.get(name, recording.sensor(self._name(name)).sd)
        if not told > 0:
            raise ModelError(
                f"{recording.source}: {self._name(name)} has no noise and no resolution, expected one of them"
            )
        return told

    def _input(self, recording: Recording, name: str) -> Array:
        if self._name(name) not in recording.signals:
            return np.full(len(recording.time), (self.numbers or values(self.sub)).u[name])
        signal = filled(recording, self._name(name))
        return smoothed(recording.time, signal, self.smooth[name]) if name in self.smooth else signal

    def _guess(self, recording: Recording) -> dict[str, Array]:
        """States that are measured, and those of which one is the rate."""
        states, outputs = quantities(self.sub.states), quantities(self.sub.outputs)
        found: dict[str, Array] = {}
        for name in states:
            signal = self._name(name)
            if name in outputs and signal in recording.signals:
                found[name] = np.where(usable_samples(recording, signal), recording[signal], np.nan)
        for name, rate in rates(self.sub).items():
            if name in found and rate not in found and np.isfinite(found[name]).all():
                found[rate] = derivative(recording.time, found[name])
        return found


def rates(sub: Subsystem) -> dict[str, str]:
    """Pairs of states of which the second is the time derivative of the first."""
    model, names = symbolic(sub), list(quantities(sub.states))
    return {
        a: b
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i != j and ca.is_equal(model.dx[i], model.x[j], 2)
    }


def usable_samples(recording: Recording, name: str) -> NDArray[np.bool_]:
    """Samples of a signal that its instrument can have read: no gap, not clipped, above the dead zone."""
    signal, sensor = recording[name], recording.sensor(name)
    good = np.isfinite(signal)
    value = np.where(good, signal, 0.0)
    good &= (value > sensor.low) & (value < sensor.high)
    if sensor.dead_zone > 0:
        good &= np.abs(value) > sensor.dead_zone + _EDGE * sensor.sd
    return good


def filled(recording: Recording, name: str) -> Array:
    """A signal without gaps: straight lines over them."""
    signal = recording[name]
    good = np.isfinite(signal)
    if not good.any():
        raise ModelError(f"{recording.source}: {name} has no sample, expected an input of the simulation")
    return np.interp(recording.time, recording.time[good], signal[good])


def smoothed(time: Array, signal: Array, window: float) -> Array:
    """Local parabolas over `window` [s]."""
    count = _samples(time, window)
    return signal if count < 5 else np.asarray(savgol_filter(signal, count, 2))


def derivative(time: Array, signal: Array) -> Array:
    """Slope of local parabolas."""
    step = float(np.median(np.diff(time)))
    count = max(3, _samples(time, _SPEED_WINDOW))
    return np.asarray(savgol_filter(signal, count, 2, deriv=1, delta=step))


def _samples(time: Array, window: float) -> int:
    """Odd number of samples in a window, no more than there are."""
    count = min(round(window / float(np.median(np.diff(time)))), len(time) - 1)
    return count - 1 + count % 2


def _range(values: Array) -> float:
    """What the NRMSE divides by: the range; the magnitude of what stands still."""
    if not values.size:
        return 1.0
    span = float(np.ptp(values))
    return span or float(np.max(np.abs(values))) or 1.0
