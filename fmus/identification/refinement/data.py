"""Recordings by the model's names: which samples count and how much, where the trajectory may start.

Noise of an input shakes the model, and what that does to the outputs looks like dynamics. So an input is
smoothed by local parabolas [Savitzky and Golay 1964] over as long a window as its sensor allows: what is
removed has to be no more than its noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, permutations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.signal import savgol_filter

from fmus.contract import Subsystem, quantities, symbolic
from fmus.identification.recordings.masks import good
from fmus.identification.refinement.problem import MeasuredRun
from fmus.identification.refinement.simulation import SimulationFailed, Simulator
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, fill_gaps

Array = NDArray[np.float64]

REST = 0.1  # s: a recording that starts at rest is averaged so long for its first state
_AROUND = 10  # samples about one that is clipped, stuck or dead that do not count either
_MOVES = 5.0  # standard deviations of a slope, of a dozen signals: by chance once in 10^5 recordings
_FEWEST = 5  # samples of a window
_CHUNK = 1.0  # s over which what is removed is compared with the noise
_DOUBT = 3.0  # standard deviations of a mean square that are still called chance
_SPEED_WINDOW = 0.1  # s over which an angle is differentiated


def input_matrix(run: MeasuredRun, simulator: Simulator) -> Array:
    """Inputs in the simulator's order, shape (n, nu)."""
    missing = [name for name in simulator.inputs if name not in run.inputs]
    if missing:
        raise Problem(f"{run.name}: input {missing[0]} is missing, expected for the simulation")
    columns = [run.inputs[name] for name in simulator.inputs]
    return np.column_stack(columns) if columns else np.zeros((len(run.time), 0))


def first_state(run: MeasuredRun, simulator: Simulator, p: Array, inputs: Array) -> Array:
    """The state that a run begins from, shape (nx,): measured as far as possible."""
    state = simulator.start(p, inputs[0])[0].copy()
    span = max(1, int(np.searchsorted(run.time, run.time[0] + REST))) if run.rest else 1
    for j, name in enumerate(simulator.states):
        if name in run.rest:
            state[j] = 0.0
        elif name in run.guess and np.isfinite(run.guess[name][:span]).any():
            state[j] = np.nanmean(run.guess[name][:span])
    return state


def first_states(
    run: MeasuredRun, simulator: Simulator, p: Array, inputs: Array, edges: tuple[int, ...]
) -> Array:
    """States at the start of each segment, shape (segments, nx): measured, else by simulation up to there."""
    states = [first_state(run, simulator, p, inputs)]
    for first, last in pairwise(edges[:-1]):
        window = slice(first, last + 1)
        try:
            end = simulator.segment(states[-1], p, run.time[window], inputs[window], False).x.copy()
        except SimulationFailed:
            end = states[-1].copy()
        for j, name in enumerate(simulator.states):
            if name in run.guess and np.isfinite(run.guess[name][last]):
                end[j] = run.guess[name][last]
        states.append(end)
    return np.array(states)


def usable_samples(recording: Recording, name: str) -> NDArray[np.bool_]:
    """Samples that the instrument can have read, and all about them too: no gap, not clipped, stuck or dead.

    Near an end of the range noise decides which samples are good, and those left would be too high.
    Where its neighbours count as well, a sample's own noise hardly decides.
    """
    usable = good(recording, name)
    lost = np.isfinite(recording[name]) & ~usable
    return np.asarray(usable & ~binary_dilation(lost, iterations=_AROUND))


def moves_at_start(recording: Recording, name: str) -> bool:
    """Is the slope of a signal over the first moments more than its noise makes?"""
    first = recording.time - recording.time[0] <= REST
    usable = first & usable_samples(recording, name)
    count, noise = int(usable.sum()), recording.sensor(name).sd
    if count < 3:
        return False
    time = recording.time[usable] - recording.time[usable].mean()
    spread = float(time @ time)
    slope = float(time @ recording[name][usable]) / spread
    return abs(slope) > _MOVES * noise / math.sqrt(spread)


def smoothed(time: Array, signal: Array, longest: float, noise: float) -> tuple[Array, int]:
    """A signal without its noise, and the samples of the window it took, 1 if none would do.

    longest   window to try first [s], then half of it, and so on
    noise     standard deviation of a sample; if it is zero nothing is removed

    What is removed may be no larger than noise, on the whole and in each second. A mean of n squares of
    normal numbers has the relative standard deviation sqrt(2 / n).
    """
    count = _window(time, longest)
    while count >= _FEWEST:
        smooth = parabolas(signal, count)
        removed = signal - smooth
        size = max(1, _window(time, _CHUNK))
        parts = max(1, len(removed) // size)
        squares = np.resize(removed, (parts, min(size, len(removed)))) ** 2
        whole = noise**2 * (1 + _DOUBT * np.sqrt(2 / squares.size))
        part = noise**2 * (1 + (_DOUBT + 1) * np.sqrt(2 / squares.shape[1]))
        if squares.mean() <= whole and squares.mean(axis=1).max() <= part:
            return smooth, count
        count = count // 2 - 1 + (count // 2) % 2
    return signal, 1


def parabolas(signal: Array, count: int) -> Array:
    """Local parabolas over so many samples."""
    return np.asarray(savgol_filter(signal, count, 2)) if count >= _FEWEST else signal


def _window(time: Array, seconds: float) -> int:
    """Odd number of samples in a window, no more than there are."""
    count = min(round(seconds / float(np.median(np.diff(time)))), len(time) - 1)
    return count - 1 + count % 2


@dataclass(frozen=True)
class RecordingMap:
    """How recordings become runs of a subsystem.

    outputs    that are fitted
    signals    input or output -> signal of the recordings; a name that is missing is its own
    smooth     input -> longest window [s] over which its noise is smoothed away
    rest       states that stand still when a recording begins at rest, as its outputs show
    sd         output -> standard deviation, in place of the sensor's
    """

    sub: Subsystem
    outputs: Sequence[str]
    signals: Mapping[str, str] = field(default_factory=dict)
    smooth: Mapping[str, float] = field(default_factory=dict)
    rest: Sequence[str] = ()
    sd: Mapping[str, float] = field(default_factory=dict)
    numbers: Values | None = None

    def run(self, recording: Recording) -> MeasuredRun:
        """The run of one recording."""
        self._check(recording)
        measured = np.zeros((len(recording.time), len(self.outputs)))
        usable = np.zeros(measured.shape, dtype=bool)
        weight, scale = np.zeros(measured.shape), np.ones(len(self.outputs))
        for k, name in enumerate(self.outputs):
            signal = self._name(name)
            if signal not in recording.signals:
                continue
            measured[:, k], usable[:, k] = recording[signal], usable_samples(recording, signal)
            weight[:, k] = usable[:, k] / self._sd(recording, name)
            if usable[:, k].any():  # the range; of what stands still the magnitude
                values_there = measured[usable[:, k], k]
                scale[k] = float(np.ptp(values_there)) or float(np.max(np.abs(values_there))) or 1.0
        inputs = {name: self._input(recording, name) for name in quantities(self.sub.inputs)}
        present = [self._name(n) for n in self.outputs if self._name(n) in recording.signals]
        return MeasuredRun(
            name=recording.source.stem,
            time=recording.time,
            inputs={name: u for name, (u, _) in inputs.items()},
            measured=np.where(usable, measured, 0.0),
            weight=weight,
            compared=usable,
            scale=scale,
            guess=self._guess(recording),
            rest=() if any(moves_at_start(recording, name) for name in present) else tuple(self.rest),
            input_noise={
                name: (recording.sensor(self._name(name)).sd, window)
                for name, (_, window) in inputs.items()
                if window
            },
        )

    def _name(self, name: str) -> str:
        return self.signals.get(name, name)

    def _check(self, recording: Recording) -> None:
        declared = {**quantities(self.sub.inputs), **quantities(self.sub.outputs)}
        if not any(self._name(name) in recording.signals for name in self.outputs):
            wanted = ", ".join(self._name(name) for name in self.outputs)
            raise Problem(f"{recording.source}: nothing to compare is measured, expected one of {wanted}")
        for name in self.outputs:
            if name not in quantities(self.sub.outputs):
                raise Problem(
                    f"{recording.source}: {name} is to be fitted, expected an output of {self.sub.name}"
                )
        for name, q in declared.items():
            if recording.units.get(self._name(name), q.unit) != q.unit:
                unit = recording.unit_label(self._name(name))
                raise Problem(f"{recording.source}: {self._name(name)} is in {unit}, expected {q.unit}")

    def _sd(self, recording: Recording, name: str) -> float:
        sd = self.sd.get(name, recording.sensor(self._name(name)).sd)
        if not sd > 0:
            raise Problem(
                f"{recording.source}: {self._name(name)} has no noise and no resolution, expected one of them"
            )
        return sd

    def _input(self, recording: Recording, name: str) -> tuple[Array, int]:
        """An input, and over how many samples it was smoothed; 0 for one that is known exactly."""
        own = self._name(name)
        if own not in recording.signals:
            return np.full(len(recording.time), (self.numbers or values(self.sub)).u[name]), 0
        signal, noise = fill_gaps(recording, own), recording.sensor(own).sd
        if not noise > 0:
            return signal, 0
        if name not in self.smooth:
            return signal, 1
        return smoothed(recording.time, signal, self.smooth[name], noise)

    def _guess(self, recording: Recording) -> dict[str, Array]:
        """States that are measured, and those that are the rate of a measured one."""
        states, outputs = list(quantities(self.sub.states)), quantities(self.sub.outputs)
        guess: dict[str, Array] = {}
        for name in states:
            signal = self._name(name)
            if name in outputs and signal in recording.signals:
                guess[name] = np.where(usable_samples(recording, signal), recording[signal], np.nan)
        model, step = symbolic(self.sub), float(np.median(np.diff(recording.time)))
        count = max(3, _window(recording.time, _SPEED_WINDOW))
        for (i, name), (j, rate) in permutations(enumerate(states), 2):
            if name not in guess or rate in guess or not np.isfinite(guess[name]).all():
                continue
            if ca.is_equal(model.dx[i], model.x[j], 2):
                guess[rate] = np.asarray(savgol_filter(guess[name], count, 2, deriv=1, delta=step))
        return guess
