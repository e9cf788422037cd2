"""A first trajectory: what is measured, the rest by simulation from one segment to the next.

Which samples of a signal count, whether it moves as a recording begins, how far it ranges.

Measured inputs without their noise, and slopes: local parabolas [Savitzky and Golay 1964].

Noise of an input shakes the model, and what that does to the outputs looks like dynamics. So an input is
smoothed over as long a window as its sensor allows: what is taken off has to be no more than its noise.

Recordings on the model's names: which samples count and how much, where the trajectory may start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.signal import savgol_filter

from fmus.contract import Subsystem, quantities, symbolic
from fmus.identification.recordings.masks import good
from fmus.identification.refinement.problem import Run
from fmus.identification.refinement.simulation import Failed, Simulator
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, bridged

Array = NDArray[np.float64]

REST = 0.1  # s: a recording that starts at rest is averaged so long for its first state


def input_matrix(run: Run, simulator: Simulator) -> Array:
    """Inputs in the simulator's order, shape (n, nu)."""
    missing = [name for name in simulator.inputs if name not in run.inputs]
    if missing:
        raise Problem(f"{run.name}: input {missing[0]} is missing, expected for the simulation")
    columns = [run.inputs[name] for name in simulator.inputs]
    return np.column_stack(columns) if columns else np.zeros((len(run.time), 0))


def first_state(run: Run, simulator: Simulator, p: Array, inputs: Array) -> Array:
    """The state that a run begins from, shape (nx,): measured as far as possible."""
    state = simulator.start(p, inputs[0])[0].copy()
    span = max(1, int(np.searchsorted(run.time, run.time[0] + REST))) if run.rest else 1
    for j, name in enumerate(simulator.states):
        if name in run.rest:
            state[j] = 0.0
        elif name in run.guess and np.isfinite(run.guess[name][:span]).any():
            state[j] = np.nanmean(run.guess[name][:span])
    return state


def first_states(run: Run, simulator: Simulator, p: Array, inputs: Array, edges: tuple[int, ...]) -> Array:
    """States at the start of each segment, shape (segments, nx)."""
    states = [first_state(run, simulator, p, inputs)]
    for first, last in pairwise(edges[:-1]):
        window = slice(first, last + 1)
        try:
            end = simulator.segment(states[-1], p, run.time[window], inputs[window], False).x.copy()
        except Failed:
            end = states[-1].copy()
        for j, name in enumerate(simulator.states):
            if name in run.guess and np.isfinite(run.guess[name][last]):
                end[j] = run.guess[name][last]
        states.append(end)
    return np.array(states)


_AROUND = 10  # samples about one that is clipped, stuck or dead that do not count either
_MOVES = 5.0  # standard deviations of a slope, of a dozen signals: by chance once in 10^5 recordings


def usable_samples(recording: Recording, name: str) -> NDArray[np.bool_]:
    """Samples that the instrument can have read, and all about them too: no gap, not clipped, stuck or dead.

    Near an end of the range noise decides which samples are good, and those left would be too high.
    Where its neighbours are asked as well, it is hardly a sample's own noise that decides.
    """
    usable = good(recording, name)
    lost = np.isfinite(recording[name]) & ~usable
    return np.asarray(usable & ~binary_dilation(lost, iterations=_AROUND))


def changes(recording: Recording, name: str) -> bool:
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


def span_of(values: Array) -> float:
    """What the NRMSE divides by: the range; the magnitude of what stands still."""
    if not values.size:
        return 1.0
    span = float(np.ptp(values))
    return span or float(np.max(np.abs(values))) or 1.0


_FEWEST = 5  # samples of a window
_CHUNK = 1.0  # s over which what is taken off is compared with the noise
_DOUBT = 3.0  # standard deviations of a mean square that are still called chance


def smoothed(time: Array, signal: Array, longest: float, noise: float) -> tuple[Array, int]:
    """A signal without its noise, and the samples of the window it took, 1 if none would do.

    longest   window to try first [s], then half of it, and so on
    noise     standard deviation of a sample; if it is zero nothing is taken off
    """
    count = samples(time, longest)
    while count >= _FEWEST:
        smooth = parabolas(signal, count)
        if _noise_only(time, signal - smooth, noise):
            return smooth, count
        count = count // 2 - 1 + (count // 2) % 2
    return signal, 1


def parabolas(signal: Array, count: int) -> Array:
    """Local parabolas over so many samples."""
    return np.asarray(savgol_filter(signal, count, 2)) if count >= _FEWEST else signal


def _noise_only(time: Array, taken: Array, noise: float) -> bool:
    """Is what was taken off no larger than noise, on the whole and in each second?"""
    size = max(1, samples(time, _CHUNK))
    parts = max(1, len(taken) // size)
    squares = np.resize(taken, (parts, min(size, len(taken)))) ** 2
    # a mean of n squares of normal numbers has the relative standard deviation sqrt(2 / n)
    whole = noise**2 * (1 + _DOUBT * np.sqrt(2 / squares.size))
    part = noise**2 * (1 + (_DOUBT + 1) * np.sqrt(2 / squares.shape[1]))
    return bool(squares.mean() <= whole and squares.mean(axis=1).max() <= part)


def derivative(time: Array, signal: Array, window: float) -> Array:
    """Slope of local parabolas over `window` [s]."""
    step = float(np.median(np.diff(time)))
    return np.asarray(savgol_filter(signal, max(3, samples(time, window)), 2, deriv=1, delta=step))


def samples(time: Array, window: float) -> int:
    """Odd number of samples in a window, no more than there are."""
    count = min(round(window / float(np.median(np.diff(time)))), len(time) - 1)
    return count - 1 + count % 2


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
            raise Problem(f"{recording.source}: nothing to compare is measured, expected one of {wanted}")
        for name in shown:
            if name not in quantities(self.sub.outputs):
                raise Problem(
                    f"{recording.source}: {name} is to be fitted, expected an output of {self.sub.name}"
                )
        for name, q in declared.items():
            if recording.units.get(self._name(name), q.unit) != q.unit:
                found = recording.unit_in_words(self._name(name))
                raise Problem(f"{recording.source}: {self._name(name)} is in {found}, expected {q.unit}")

    def _sd(self, recording: Recording, name: str) -> float:
        told = self.sd.get(name, recording.sensor(self._name(name)).sd)
        if not told > 0:
            raise Problem(
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
