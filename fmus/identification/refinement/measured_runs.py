"""Measured runs of a subsystem from recordings: usable samples and weights, smoothed inputs, initial states.

Noise of a measured input drives the simulated model, and its effect on the outputs looks like dynamics.
Inputs are therefore smoothed by local parabolas [Savitzky and Golay 1964] over the longest window for which
the removed part is no larger than the noise of the sensor.
"""

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
from fmus.identification.recordings.clock import period
from fmus.identification.recordings.masks import good
from fmus.identification.refinement.compiled_model import SimulationFailed, Simulator, zero_of
from fmus.parameters import Values
from fmus.parameters import values as default_values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, fill_gaps
from orchestrator.data.table import Array

AT_REST = 0.1  # s: mean of the first samples for the initial state of a recording that begins at rest
_MARGIN = 10  # samples next to an unusable one (clipped, stuck, in the dead zone) that are not used either
_MOVES = 5.0  # standard deviations of a slope; of a dozen signals at rest one exceeds it in 10^5 recordings
_SMALLEST_WINDOW = 5  # samples
_CHUNK = 1.0  # s, over which the removed part is compared with the noise
_CHANCE = 3.0  # standard deviations of a mean square that are attributed to chance
_SPEED_WINDOW = 0.1  # s, over which an angle is differentiated


@dataclass(frozen=True)
class MeasuredRun:
    """One recording in terms of the model's variables.

    time              shape (n,) [s]
    inputs            input -> shape (n,), linear between the samples
    measured          outputs, shape (n, ny); NaN allowed where the weight is zero
    weight            shape (n, ny): 1 / standard deviation of a sample, 0 for a sample that is not used
    scale             range of each output over the whole run, the denominator of the NRMSE
    measured_states   state -> its trajectory (n,), NaN where it is not measured; initial states come from it
    at_rest           states whose initial value is known to be zero, because the run begins at rest
    input_noise       measured input -> standard deviation of a sample, smoothing window [samples]
    """

    name: str
    time: Array
    inputs: Mapping[str, Array]
    measured: Array
    weight: Array
    scale: Array
    measured_states: Mapping[str, Array] = field(default_factory=dict)
    at_rest: tuple[str, ...] = ()
    input_noise: Mapping[str, tuple[float, int]] = field(default_factory=dict)

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Samples that are used, shape (n, ny)."""
        return np.asarray(self.weight > 0)

    def input_matrix(self, names: Sequence[str]) -> Array:
        """Inputs in the order of `names`, shape (n, nu)."""
        for name in names:
            if name not in self.inputs:
                raise Problem(
                    f"{self.name}: expected the input {name}, got none: the simulation needs this input"
                )
        return np.column_stack([self.inputs[n] for n in names]) if names else np.zeros((len(self.time), 0))

    def initial_state(
        self, simulator: Simulator, p: Array, inputs: Array, corrected: bool = True
    ) -> tuple[Array, Array]:
        """The state at the first sample, shape (nx,), and its derivatives by p, shape (nx, np).

        It is measured if possible, else that of the simulator. The estimated zeros of the sensors are
        subtracted if `corrected`.
        """
        state, by_p = (values.copy() for values in simulator.start(p, inputs[0]))
        count = max(1, int(np.searchsorted(self.time, self.time[0] + AT_REST))) if self.at_rest else 1
        for j, name in enumerate(simulator.states):
            if name in self.at_rest:
                state[j], by_p[j] = 0.0, 0.0
            elif name in self.measured_states:
                first = self.measured_states[name][:count]
                if np.isfinite(first).any():
                    state[j], by_p[j] = np.nanmean(first), 0.0
            if corrected and zero_of(name) in simulator.free and name not in self.at_rest:
                zero = simulator.free.index(zero_of(name))
                state[j] -= p[zero]
                by_p[j, zero] -= 1.0
        return state, by_p

    def segment_states(self, simulator: Simulator, p: Array, inputs: Array, edges: tuple[int, ...]) -> Array:
        """Initial states of all segments, shape (segments, nx): measured if possible, else simulated."""
        states = [self.initial_state(simulator, p, inputs, corrected=False)[0]]
        for first, last in pairwise(edges[:-1]):
            window = slice(first, last + 1)
            try:
                end = simulator.segment(states[-1], p, self.time[window], inputs[window], False).x.copy()
            except SimulationFailed:
                end = states[-1].copy()
            for j, name in enumerate(simulator.states):
                if name in self.measured_states and np.isfinite(self.measured_states[name][last]):
                    end[j] = self.measured_states[name][last]
            states.append(end)
        return np.array(states)


def usable_samples(recording: Recording, name: str) -> NDArray[np.bool_]:
    """Samples of a signal to fit: not missing, and neither clipped, stuck, in the dead zone, nor next to one.

    Near an end of the range, noise decides which samples are good, so that the good ones are biased. With the
    neighbours excluded, a sample's own noise has hardly any influence on its selection.
    """
    usable = good(recording, name)
    faulty = np.isfinite(recording[name]) & ~usable
    return np.asarray(usable & ~binary_dilation(faulty, iterations=_MARGIN))


def moves_at_start(recording: Recording, name: str) -> bool:
    """Is the slope of a signal over the first `AT_REST` seconds larger than noise explains?"""
    first = recording.time - recording.time[0] <= AT_REST
    usable = first & usable_samples(recording, name)
    if int(usable.sum()) < 3:
        return False
    time = recording.time[usable] - recording.time[usable].mean()
    spread = float(time @ time)
    slope = float(time @ recording[name][usable]) / spread
    return abs(slope) > _MOVES * recording.sensor(name).sd / math.sqrt(spread)


def smoothed(time: Array, signal: Array, longest: float, noise: float) -> tuple[Array, int]:
    """The smoothed signal and the window [samples], 1 if no window is admissible.

    longest   longest window [s]; it is halved until it is admissible
    noise     standard deviation of a sample; if it is zero, nothing is removed

    A window is admissible if the removed part is no larger than noise, over the whole signal and in each
    chunk. A mean of n squares of normal numbers has the relative standard deviation sqrt(2 / n).
    """
    window = _odd_samples(time, longest)
    while window >= _SMALLEST_WINDOW:
        smooth = local_parabolas(signal, window)
        removed = signal - smooth
        size = max(1, _odd_samples(time, _CHUNK))
        chunks = max(1, len(removed) // size)
        squares = np.resize(removed, (chunks, min(size, len(removed)))) ** 2
        total_limit = noise**2 * (1 + _CHANCE * np.sqrt(2 / squares.size))
        chunk_limit = noise**2 * (1 + (_CHANCE + 1) * np.sqrt(2 / squares.shape[1]))
        if squares.mean() <= total_limit and squares.mean(axis=1).max() <= chunk_limit:
            return smooth, window
        window = window // 2 - 1 + (window // 2) % 2
    return signal, 1


def local_parabolas(signal: Array, window: int) -> Array:
    """The signal smoothed by parabolas over `window` samples."""
    return np.asarray(savgol_filter(signal, window, 2)) if window >= _SMALLEST_WINDOW else signal


def _odd_samples(time: Array, seconds: float) -> int:
    """Odd number of samples in a window, at most the length of the signal."""
    count = min(round(seconds / period(time)), len(time) - 1)
    return count - 1 + count % 2


@dataclass(frozen=True)
class RecordingMap:
    """Mapping from recordings to measured runs of a subsystem.

    outputs    outputs to be fitted
    signals    input or output -> signal of the recordings; by default a signal has the variable's name
    smooth     input -> longest window [s] for smoothing
    rest       states that are zero at the start of a recording whose outputs do not move there
    sd         output -> standard deviation that replaces that of the sensor
    values     values of inputs that are not measured, by default those of the subsystem's file
    """

    sub: Subsystem
    outputs: Sequence[str]
    signals: Mapping[str, str] = field(default_factory=dict)
    smooth: Mapping[str, float] = field(default_factory=dict)
    rest: Sequence[str] = ()
    sd: Mapping[str, float] = field(default_factory=dict)
    values: Values | None = None

    def run(self, recording: Recording) -> MeasuredRun:
        """The measured run of one recording."""
        self._check(recording)
        measured = np.zeros((len(recording.time), len(self.outputs)))
        usable = np.zeros(measured.shape, dtype=bool)
        weight, scale = np.zeros(measured.shape), np.ones(len(self.outputs))
        for k, name in enumerate(self.outputs):
            signal = self._signal(name)
            if signal not in recording.signals:
                continue
            measured[:, k], usable[:, k] = recording[signal], usable_samples(recording, signal)
            weight[:, k] = usable[:, k] / self._sd(recording, name)
            if usable[:, k].any():  # the range; for a constant signal the magnitude
                samples = measured[usable[:, k], k]
                scale[k] = float(np.ptp(samples)) or float(np.max(np.abs(samples))) or 1.0
        inputs = {name: self._input(recording, name) for name in quantities(self.sub.inputs)}
        signals = [self._signal(n) for n in self.outputs if self._signal(n) in recording.signals]
        return MeasuredRun(
            name=recording.source.stem,
            time=recording.time,
            inputs={name: u for name, (u, _) in inputs.items()},
            measured=np.where(usable, measured, 0.0),
            weight=weight,
            scale=scale,
            measured_states=self._measured_states(recording),
            at_rest=() if any(moves_at_start(recording, s) for s in signals) else tuple(self.rest),
            input_noise={
                name: (recording.sensor(self._signal(name)).sd, window)
                for name, (_, window) in inputs.items()
                if window
            },
        )

    def _signal(self, name: str) -> str:
        return self.signals.get(name, name)

    def _check(self, recording: Recording) -> None:
        declared = {**quantities(self.sub.inputs), **quantities(self.sub.outputs)}
        if not any(self._signal(name) in recording.signals for name in self.outputs):
            expected = ", ".join(self._signal(name) for name in self.outputs)
            raise Problem(f"{recording.source}: no output is measured, expected one of {expected}")
        for name in self.outputs:
            if name not in quantities(self.sub.outputs):
                raise Problem(f"{recording.source}: {name} is not an output of {self.sub.name}")
        for name, q in declared.items():
            if recording.units.get(self._signal(name), q.unit) != q.unit:
                unit = recording.unit_label(self._signal(name))
                raise Problem(f"{recording.source}: {self._signal(name)} is in {unit}, expected {q.unit}")

    def _sd(self, recording: Recording, name: str) -> float:
        sd = self.sd.get(name, recording.sensor(self._signal(name)).sd)
        if not sd > 0:
            expected = "expected a sensor with noise or resolution"
            raise Problem(f"{recording.source}: {self._signal(name)}: {expected}, got none")
        return sd

    def _input(self, recording: Recording, name: str) -> tuple[Array, int]:
        """An input and its smoothing window [samples]; 0 for an input without noise."""
        signal = self._signal(name)
        if signal not in recording.signals:
            return np.full(len(recording.time), (self.values or default_values(self.sub)).u[name]), 0
        samples, noise = fill_gaps(recording, signal), recording.sensor(signal).sd
        if not noise > 0:
            return samples, 0
        if name not in self.smooth:
            return samples, 1
        return smoothed(recording.time, samples, self.smooth[name], noise)

    def _measured_states(self, recording: Recording) -> dict[str, Array]:
        """Trajectories of the states that are measured outputs, and of those that are the rate of one."""
        states, outputs = list(quantities(self.sub.states)), quantities(self.sub.outputs)
        trajectories: dict[str, Array] = {}
        for name in states:
            signal = self._signal(name)
            if name in outputs and signal in recording.signals:
                trajectories[name] = np.where(usable_samples(recording, signal), recording[signal], np.nan)
        model, step = symbolic(self.sub), period(recording.time)
        window = max(3, _odd_samples(recording.time, _SPEED_WINDOW))
        for (i, name), (j, rate) in permutations(enumerate(states), 2):
            if name not in trajectories or rate in trajectories or not np.isfinite(trajectories[name]).all():
                continue
            if ca.is_equal(model.dx[i], model.x[j], 2):
                derivative = savgol_filter(trajectories[name], window, 2, deriv=1, delta=step)
                trajectories[rate] = np.asarray(derivative)
        return trajectories
