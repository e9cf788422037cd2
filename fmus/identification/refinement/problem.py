"""An estimation problem: a subsystem, its free parameters with priors and bounds, and measured runs.

A recording becomes a measured run of the subsystem: usable samples and weights, smoothed inputs, and the
states that are measured. Noise of a measured input drives the simulated model, and its effect on the outputs
looks like dynamics. Inputs are therefore smoothed by local parabolas [Savitzky and Golay 1964] over the
longest window for which the removed part is no larger than the noise of the sensor.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise, permutations

import casadi as ca
import numpy as np
from scipy.ndimage import binary_dilation
from scipy.signal import savgol_filter

from fmus.contract import Subsystem, quantities, symbolic
from fmus.identification.recordings.clock import period
from fmus.identification.recordings.masks import good
from fmus.identification.refinement.compiled_model import (
    CompiledModel,
    SimulationFailed,
    delayed_inputs,
    zero_of,
)
from fmus.parameters import Values
from fmus.parameters import values as default_values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, fill_gaps
from orchestrator.data.table import Array

AT_REST = 0.1  # s: mean of the first samples for the initial state of a recording that begins at rest
MARGIN = 10  # samples next to an unusable one (clipped, stuck, in the dead zone) that are not used either
MOVES = 5.0  # standard deviations of a slope; of a dozen signals at rest one exceeds it in 10^5 recordings
SMALLEST_WINDOW = 5  # samples
CHUNK = 1.0  # s, over which the removed part is compared with the noise
CHANCE = 3.0  # standard deviations of a mean square that are attributed to chance
SPEED_WINDOW = 0.1  # s, over which an angle is differentiated


# ---- parameters --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be estimated; z is the variable of the search.

        value = exp(z)      if the parameter is positive (`log`): a change of z is a relative change
        value = scale z     otherwise

    value      initial value, mean of the prior
    sd         prior standard deviation of the value, None without a prior
    low, high  bounds of the value
    """

    name: str
    value: float
    unit: str = "1"
    sd: float | None = None
    low: float = -math.inf
    high: float = math.inf
    log: bool = False
    scale: float = 1.0


def free_parameters(
    sub: Subsystem,
    names: Sequence[str],
    priors: Mapping[str, tuple[float, float | None]] | None = None,
    values: Values | None = None,
) -> tuple[FreeParameter, ...]:
    """Free parameters with the bounds that the subsystem declares.

    priors   initial value and prior standard deviation, None for an initial value without a prior
    values   initial values of the others, by default those of the subsystem's file
    """
    declared, initial, priors = quantities(sub.parameters), (values or default_values(sub)).p, priors or {}
    unknown = [n for n in (*names, *priors) if n not in declared]
    if unknown:
        raise Problem(f"{sub.name}: {unknown[0]} is not a parameter; expected one of {', '.join(declared)}")
    free = []
    for name in names:
        q = declared[name]
        value, sd = priors.get(name, (initial[name], None))
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        if not low <= value <= high or (sd is not None and not sd > 0):
            expected = f"an initial value from {low:g} to {high:g} {q.unit} and a positive standard deviation"
            raise Problem(f"{sub.name}: {name}: expected {expected}, got {value:g} and {sd}")
        free.append(FreeParameter(name, value, q.unit, sd, low, high, low >= 0 and value > 0, q.nominal))
    return tuple(free)


# ---- runs --------------------------------------------------------------------------------------------


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
    def compared(self) -> Mask:
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

    def delayed(self, simulator: CompiledModel, p: Array) -> Array:
        """The inputs of a simulator, later by their estimated delays, see `delayed_inputs`."""
        return delayed_inputs(simulator, p, self.time, self.input_matrix(simulator.inputs))

    def initial_state(
        self, simulator: CompiledModel, p: Array, corrected: bool = True
    ) -> tuple[Array, Array]:
        """The state at the first sample, shape (nx,), and its derivatives by p, shape (nx, np).

        It is measured if possible, else that of the simulator. The estimated zeros of the sensors are
        subtracted if `corrected`.
        """
        first_inputs = self.input_matrix(simulator.inputs)[0]
        state, by_p = (values.copy() for values in simulator.start(p, first_inputs))
        count = max(1, int(np.searchsorted(self.time, self.time[0] + AT_REST))) if self.at_rest else 1
        for j, name in enumerate(simulator.states):
            if name in self.at_rest:
                state[j], by_p[j] = 0.0, 0.0
                continue
            first = self.measured_states.get(name, np.empty(0))[:count]
            if np.isfinite(first).any():
                state[j], by_p[j] = np.nanmean(first), 0.0
            if corrected and zero_of(name) in simulator.free:
                zero = simulator.free.index(zero_of(name))
                state[j] -= p[zero]
                by_p[j, zero] -= 1.0
        return state, by_p

    def segment_states(self, simulator: CompiledModel, p: Array, edges: tuple[int, ...]) -> Array:
        """Initial states of all segments, shape (segments, nx): measured if possible, else simulated."""
        states, inputs = [self.initial_state(simulator, p, corrected=False)[0]], self.delayed(simulator, p)
        for first, last in pairwise(edges[:-1]):
            part, end = slice(first, last + 1), states[-1].copy()
            with suppress(SimulationFailed):
                end = simulator.segment(end, p, self.time[part], inputs[..., part, :], False).x.copy()
            for j, name in enumerate(simulator.states):
                if name in self.measured_states and np.isfinite(self.measured_states[name][last]):
                    end[j] = self.measured_states[name][last]
            states.append(end)
        return np.array(states)


def usable_samples(recording: Recording, name: str) -> Mask:
    """Samples of a signal to fit: not missing, and neither clipped, stuck, in the dead zone, nor next to one.

    Near an end of the range, noise decides which samples are good, so that the good ones are biased. With the
    neighbours excluded, a sample's own noise has hardly any influence on its selection.
    """
    usable = good(recording, name)
    faulty = np.isfinite(recording[name]) & ~usable
    return np.asarray(usable & ~binary_dilation(faulty, iterations=MARGIN))


def moves_at_start(recording: Recording, name: str) -> bool:
    """Is the slope of a signal over the first `AT_REST` seconds larger than noise explains?"""
    first = recording.time - recording.time[0] <= AT_REST
    usable = first & usable_samples(recording, name)
    if int(usable.sum()) < 3:
        return False
    time = recording.time[usable] - recording.time[usable].mean()
    spread = float(time @ time)
    slope = float(time @ recording[name][usable]) / spread
    return abs(slope) > MOVES * recording.sensor(name).sd / math.sqrt(spread)


def smoothed(time: Array, signal: Array, longest: float, noise: float) -> tuple[Array, int]:
    """The smoothed signal and the window [samples], 1 if no window is admissible.

    longest   longest window [s]; it is halved until it is admissible
    noise     standard deviation of a sample; if it is zero, nothing is removed

    A window is admissible if the removed part is no larger than noise, over the whole signal and in each
    chunk. A mean of n squares of normal numbers has the relative standard deviation sqrt(2 / n).
    """
    window = _odd_samples(time, longest)
    while window >= SMALLEST_WINDOW:
        smooth = local_parabolas(signal, window)
        removed = signal - smooth
        size = max(1, _odd_samples(time, CHUNK))
        chunks = max(1, len(removed) // size)
        squares = np.resize(removed, (chunks, min(size, len(removed)))) ** 2
        total_limit = noise**2 * (1 + CHANCE * np.sqrt(2 / squares.size))
        chunk_limit = noise**2 * (1 + (CHANCE + 1) * np.sqrt(2 / squares.shape[1]))
        if squares.mean() <= total_limit and squares.mean(axis=1).max() <= chunk_limit:
            return smooth, window
        window = window // 2 - 1 + (window // 2) % 2
    return signal, 1


def local_parabolas(signal: Array, window: int) -> Array:
    """The signal smoothed by parabolas over `window` samples."""
    return np.asarray(savgol_filter(signal, window, 2)) if window >= SMALLEST_WINDOW else signal


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
        shape, moving = (len(recording.time), len(self.outputs)), False
        measured, weight, scale = np.zeros(shape), np.zeros(shape), np.ones(len(self.outputs))
        for k, name in enumerate(self.outputs):
            if (signal := self._signal(name)) not in recording.signals:
                continue
            usable = usable_samples(recording, signal)
            measured[usable, k] = samples = recording[signal][usable]
            sd = self.sd.get(name, recording.sensor(signal).sd)
            if not sd > 0:
                expected = "expected a sensor with noise or resolution"
                raise Problem(f"{recording.source}: {signal}: {expected}, got none")
            weight[:, k] = usable / sd
            if samples.size:  # the range; for a constant signal the magnitude
                scale[k] = float(np.ptp(samples)) or float(np.max(np.abs(samples))) or 1.0
            moving = moving or moves_at_start(recording, signal)
        inputs = {name: self._input(recording, name) for name in quantities(self.sub.inputs)}
        return MeasuredRun(
            name=recording.source.stem,
            time=recording.time,
            inputs={name: u for name, (u, _) in inputs.items()},
            measured=measured,
            weight=weight,
            scale=scale,
            measured_states=self._measured_states(recording),
            at_rest=() if moving else tuple(self.rest),
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
        for name, q in declared.items():
            if recording.units.get(self._signal(name), q.unit) != q.unit:
                unit = recording.unit_label(self._signal(name))
                raise Problem(f"{recording.source}: {self._signal(name)} is in {unit}, expected {q.unit}")

    def _input(self, recording: Recording, name: str) -> tuple[Array, int]:
        """An input and its smoothing window [samples]; 0 for an input without noise."""
        signal = self._signal(name)
        if signal not in recording.signals:
            return np.full(len(recording.time), (self.values or default_values(self.sub)).u[name]), 0
        samples, noise = fill_gaps(recording, signal), recording.sensor(signal).sd
        if noise > 0 and name in self.smooth:
            return smoothed(recording.time, samples, self.smooth[name], noise)
        return samples, int(noise > 0)

    def _measured_states(self, recording: Recording) -> dict[str, Array]:
        """Trajectories of the states that are measured outputs, and of those that are the rate of one."""
        states, outputs = list(quantities(self.sub.states)), quantities(self.sub.outputs)
        trajectories = {
            name: np.where(usable_samples(recording, signal), recording[signal], np.nan)
            for name in states
            if name in outputs and (signal := self._signal(name)) in recording.signals
        }
        model, step = symbolic(self.sub), period(recording.time)
        window = max(3, _odd_samples(recording.time, SPEED_WINDOW))
        for (i, name), (j, rate) in permutations(enumerate(states), 2):
            if name not in trajectories or rate in trajectories or not np.isfinite(trajectories[name]).all():
                continue
            if ca.is_equal(model.dx[i], model.x[j], 2):
                derivative = savgol_filter(trajectories[name], window, 2, deriv=1, delta=step)
                trajectories[rate] = np.asarray(derivative)
        return trajectories


# ---- problem -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class EstimationProblem:
    """A subsystem, its free parameters, the runs to fit and the runs held out.

    fixed    values of the other parameters, inputs and states; None: those of the subsystem's file
    labels   parameter or output -> its name in the results; by default its own
    """

    sub: Subsystem
    outputs: tuple[str, ...]
    free: tuple[FreeParameter, ...]
    training: tuple[MeasuredRun, ...]
    held_out: tuple[MeasuredRun, ...] = ()
    fixed: Values | None = None
    labels: Mapping[str, str] = field(default_factory=dict)

    def label(self, name: str) -> str:
        """Name of a parameter or an output in the results."""
        return self.labels.get(name, name)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the outputs in the results."""
        return tuple(map(self.label, self.outputs))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(f.name for f in self.free)

    @property
    def seconds(self) -> float:
        """Length of all runs to fit [s]."""
        return sum(float(run.time[-1] - run.time[0]) for run in self.training)

    @property
    def _log(self) -> Mask:
        return np.array([f.log for f in self.free], dtype=bool)

    def _each(self, name: str) -> Array:
        """A number of all free parameters, shape (np,)."""
        return np.array([getattr(f, name) for f in self.free], dtype=np.float64)

    def z_of(self, values: Array) -> Array:
        """z of parameter values, shape (np,); minus infinity for zero if z is logarithmic."""
        with np.errstate(divide="ignore"):
            logarithm = np.log(np.where(self._log, np.maximum(values, 0.0), 1.0))
        return np.where(self._log, logarithm, values / self._each("scale"))

    def values_of(self, z: Array) -> Array:
        """Parameter values of z, shape (np,)."""
        return np.where(self._log, np.exp(np.where(self._log, z, 0.0)), self._each("scale") * z)

    def derivatives(self, z: Array) -> Array:
        """d value / dz, shape (np,)."""
        return np.where(self._log, self.values_of(z), self._each("scale"))

    def initial(self) -> Array:
        """z of the initial values, shape (np,)."""
        return self.z_of(self._each("value"))

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of z, each of shape (np,)."""
        return self.z_of(self._each("low")), self.z_of(self._each("high"))

    def prior_sd(self) -> Array:
        """Prior standard deviations of z, shape (np,), infinite without a prior."""
        sd = np.array([math.inf if f.sd is None else f.sd for f in self.free])
        return np.asarray(sd / self.derivatives(self.initial()))

    def by_name(self, z: Array) -> dict[str, float]:
        """Parameter values of z by name."""
        return dict(zip(self.names, self.values_of(z).tolist(), strict=True))
