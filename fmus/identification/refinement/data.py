"""Recordings on the model's names: which samples count and how much, where the trajectory may start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError, Subsystem, quantities, symbolic
from fmus.identification.recordings.gaps import bridged
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.problem import Run
from fmus.identification.refinement.smoothing import derivative, smoothed
from fmus.identification.refinement.usable import changes, span_of, usable_samples
from fmus.parameters import Values, values

Array = NDArray[np.float64]

_SPEED_WINDOW = 0.1  # s over which an angle is differentiated


@dataclass(frozen=True)
class Mapped:
    """How recordings become runs of a subsystem.

    outputs    that are fitted
    compared   outputs that are only compared, such as speeds that nobody measured
    signals    input or output -> signal of the recordings; a name that is missing is its own
    smooth     input -> longest window [s] over which its noise is smoothed away
    rest       states that stand still when a recording begins at rest, which its outputs tell
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
        there = [self._name(name) in recording.signals for name in shown]
        measured = np.zeros((len(recording.time), len(shown)))
        usable = np.zeros(measured.shape, dtype=bool)
        weight = np.zeros(measured.shape)
        for k, name in enumerate(shown):
            if there[k]:
                measured[:, k] = recording[self._name(name)]
                usable[:, k] = usable_samples(recording, self._name(name))
        for k, name in enumerate(self.outputs):
            if there[k]:
                weight[:, k] = usable[:, k] / self._sd(recording, name)
        inputs = {name: self._input(recording, name) for name in quantities(self.sub.inputs)}
        return Run(
            name=recording.source.stem,
            time=recording.time,
            inputs={name: u for name, (u, _) in inputs.items()},
            measured=np.where(usable, measured, 0.0),
            weight=weight,
            compared=usable,
            scale=np.array(
                [span_of(column[there]) for column, there in zip(measured.T, usable.T, strict=True)]
            ),
            guess=self._guess(recording),
            rest=tuple(self.rest) if self._at_rest(recording) else (),
            input_noise={
                name: (recording.sensor(self._name(name)).sd, window)
                for name, (_, window) in inputs.items()
                if window
            },
        )

    def _name(self, name: str) -> str:
        return self.signals.get(name, name)

    def _at_rest(self, recording: Recording) -> bool:
        """Does nothing that is measured change as the recording begins?"""
        return not any(
            changes(recording, self._name(name))
            for name in self.outputs
            if self._name(name) in recording.signals
        )

    def _check(self, recording: Recording, shown: Sequence[str]) -> None:
        declared = {**quantities(self.sub.inputs), **quantities(self.sub.outputs)}
        if not any(self._name(name) in recording.signals for name in self.outputs):
            wanted = ", ".join(self._name(name) for name in self.outputs)
            raise ModelError(f"{recording.source}: nothing to compare is measured, expected one of {wanted}")
        for name in shown:
            if name not in quantities(self.sub.outputs):
                raise ModelError(
                    f"{recording.source}: {name} is to be fitted, expected an output of {self.sub.name}"
                )
        for name, q in declared.items():
            if recording.units.get(self._name(name), q.unit) != q.unit:
                found = recording.unit_in_words(self._name(name))
                raise ModelError(f"{recording.source}: {self._name(name)} is in {found}, expected {q.unit}")

    def _sd(self, recording: Recording, name: str) -> float:
        told = self.sd.get(name, recording.sensor(self._name(name)).sd)
        if not told > 0:
            raise ModelError(
                f"{recording.source}: {self._name(name)} has no noise and no resolution, expected one of them"
            )
        return told

    def _input(self, recording: Recording, name: str) -> tuple[Array, int]:
        """An input, and over how many samples it was smoothed; 0 for one that is known exactly."""
        own = self._name(name)
        if own not in recording.signals:
            return np.full(len(recording.time), (self.numbers or values(self.sub)).u[name]), 0
        signal, noise = bridged(recording, own), recording.sensor(own).sd
        if not noise > 0:
            return signal, 0
        if name not in self.smooth:
            return signal, 1
        return smoothed(recording.time, signal, self.smooth[name], noise)

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
                found[rate] = derivative(recording.time, found[name], _SPEED_WINDOW)
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
