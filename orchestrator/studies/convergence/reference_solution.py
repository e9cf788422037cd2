"""Reference solution of a convergence study: a recording, or a run that is finer than all others.

The samples of a reference are often far apart. A run is compared at common instants only, because linear
interpolation between samples would be less accurate than a good master.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.signals import matching, rms, span
from orchestrator.base.text import grouped
from orchestrator.base.units import QUANTITIES, factor_and_offset, quantity
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array
from orchestrator.data.trace import SAME_TIME, Trace, rounding
from orchestrator.engine.arguments import CaseArguments
from orchestrator.engine.result import widest_of_unit
from orchestrator.engine.run import run
from orchestrator.engine.scenario import ScenarioSource
from orchestrator.results.metrics import AT_REST
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.system import System

Indices = NDArray[np.intp]

MOST_INSTANTS = 200  # at which an adaptive run is compared: a step has to end at each of them
FEWEST_INSTANTS = 10  # in common, for a root mean square
DEFAULT_QUANTITIES = ("speed", "pressure")  # compared if the user names no signals
FINEST = Coupling("hermite", passes=20, tolerance=1e-9)


@dataclass(frozen=True)
class SignalDeviation:
    """Error of one signal.

    nrmse    root mean square error over the range of the whole reference
    maximum  largest difference, in `unit`
    span     range of the whole reference, in `unit`
    """

    signal: str
    nrmse: float
    maximum: float
    span: float
    unit: str


@dataclass(frozen=True)
class ReferenceSolution:
    """The solution that runs are compared with.

    recording   its signals, without gaps
    groups      group -> its signals, which share a table
    spans       signal -> its range
    """

    recording: Recording
    groups: Mapping[str, Sequence[str]]
    spans: Mapping[str, float]
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The title of the recording."""
        return self.recording.heading

    @property
    def time(self) -> Array:
        """The times of the samples [s], shape (n,)."""
        return self.recording.time

    @property
    def names(self) -> list[str]:
        """All signals."""
        return list(dict.fromkeys(name for names in self.groups.values() for name in names))

    def check(self, system: System) -> None:
        """Raise UnknownSignal if the system lacks a signal."""
        for name in self.names:
            if name not in system.outputs and name not in system.names():
                raise UnknownSignal(name, [*system.outputs, *system.names()], f"{self.title}: ")

    def record_step(self, start: float, stop: float | None, step: float) -> float:
        """Record step [s] of a run with this communication step, so that both have instants in common."""
        last = self.time[-1] if stop is None else min(stop, self.time[-1])
        points: Array = start + step * np.arange(int((last - start) / step + SAME_TIME) + 1.0)
        count = len(_common_instants(points, self.time, step)[0])
        if count < FEWEST_INSTANTS:
            expected = f"{FEWEST_INSTANTS} or more instants in common with {self.title}"
            raise Problem(f"step {step:g} s: expected {expected}, got {count}")
        interval = float(self.time[1] - self.time[0])
        steps = round(interval / step)
        equal = max(abs(start - self.time[0]), np.ptp(np.diff(self.time))) < SAME_TIME * step
        return steps * step if equal and steps and abs(interval / step - steps) < SAME_TIME else step

    def adaptive_record_step(self, start: float) -> float:
        """Record step [s] of a run with adaptive step size: steps have to end at these instants."""
        intervals = len(self.time) - 1
        duration = self.time[-1] - self.time[0]
        offset = (start - self.time[0]) * intervals / duration
        equal = np.ptp(np.diff(self.time)) < SAME_TIME * duration
        if not equal or abs(offset - round(offset)) > SAME_TIME:
            raise Problem(f"{self.title}: expected equally spaced samples from {start:g} s on")
        return float(duration * max(intervals // MOST_INSTANTS, 1) / intervals)

    def errors(self, trace: Trace, step: float) -> dict[str, tuple[SignalDeviation, ...]]:
        """Group -> errors of its signals, the largest first."""
        indices = _common_instants(trace.time, self.time, step)
        errors = {name: self._deviation(name, trace, *indices) for name in self.names}
        return {
            group: tuple(sorted((errors[name] for name in names), key=lambda e: -e.nrmse))
            for group, names in self.groups.items()
        }

    def _deviation(self, name: str, trace: Trace, in_run: Indices, in_reference: Indices) -> SignalDeviation:
        unit, size = self.recording.units[name], self.spans[name] or 1.0
        of_run = trace.units.get(name, unit)
        factor, offset = factor_and_offset(of_run, unit, name) if of_run != unit else (1.0, 0.0)
        with np.errstate(over="ignore"):  # an unstable run may grow beyond all bounds
            error = factor * trace[name][in_run] + offset - self.recording[name][in_reference]
            rmse = rms(error)
        return SignalDeviation(name, rmse / size, float(np.abs(error).max()), size, unit)


def _common_instants(run: Array, reference: Array, step: float) -> tuple[Indices, Indices]:
    """Indices of the common instants, in the run and in the reference."""
    margin = rounding(reference, step)
    nearest = np.minimum(np.searchsorted(run, reference - margin), len(run) - 1)
    common = np.flatnonzero(np.abs(run[nearest] - reference) <= margin)
    return nearest[common], common


def from_recording(recording: Recording, patterns: Sequence[str] = ()) -> ReferenceSolution:
    """The signals of a recording that match a pattern; default: its speeds and pressures, else all."""
    for name, values in recording.items():
        if np.isnan(values).any():
            raise Problem(f"{recording.source}: {name}: expected a value at each time, got a gap")
    if patterns:
        return _without_rest(recording, {p: _matching(p, recording) for p in patterns})
    groups = _groups(recording)
    return _without_rest(recording, {g: groups[g] for g in DEFAULT_QUANTITIES if g in groups} or groups)


def from_run(title: str, trace: Trace) -> ReferenceSolution:
    """The signals of a run, one group for each quantity."""
    units = {name: trace.units.get(name, "") for name in trace}
    recording = Recording(trace.time, trace.signals, units, metadata={"title": title})
    return _without_rest(recording, _groups(recording))


def _groups(recording: Recording) -> dict[str, list[str]]:
    """The signals by group, else by quantity."""
    return grouped(recording, lambda n: recording.criterion(n).group or quantity(recording.units[n]))


def finest_run(
    system: System,
    signals: Sequence[str],
    steps: Sequence[float],
    scenario: ScenarioSource = None,
    **options: Unpack[CaseArguments],
) -> ReferenceSolution:
    """The solution if there is no recording: a run of `hermite` with half the smallest step."""
    step = min(steps) / 2
    result = run(system, scenario, master=FINEST, step=step, record=list(signals), **options)
    return from_run(f"hermite at {1e3 * step:g} ms", result.trace)


def default_signals(system: System, patterns: Sequence[str] = ()) -> list[str]:
    """The outputs of a system that match a pattern; default: of its first two named quantities."""
    outputs = [str(port) for port in system.ports("output") if system.variable(port).is_real]
    if patterns:
        return list(dict.fromkeys(name for p in patterns for name in _matching(p, outputs)))
    units = {str(p): u.name for p in system.ports("output") if (u := system.variable(p).unit)}
    quantities = {name: quantity(units.get(name, "")) for name in outputs}
    order = [*DEFAULT_QUANTITIES, *(q for q in QUANTITIES if q not in DEFAULT_QUANTITIES)]
    first_two = [q for q in order if q in quantities.values()][:2]
    return [name for q in first_two for name in outputs if quantities[name] == q] or outputs


def _matching(pattern: str, names: Iterable[str]) -> list[str]:
    signals = list(names)
    if not (matches := matching(signals, pattern)):
        near = suggest(pattern, signals) or f"; there are {', '.join(signals[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal matches{near}")
    return matches


def _without_rest(recording: Recording, groups: Mapping[str, Sequence[str]]) -> ReferenceSolution:
    """The groups without signals at rest: they have no range, alone or next to others of their unit."""
    ranges = {name: span(recording[name]) for names in groups.values() for name in names}
    widest = widest_of_unit(ranges, recording.units)
    at_rest = [name for name, size in ranges.items() if size <= AT_REST * widest[name]]
    moving = {group: [name for name in names if name not in at_rest] for group, names in groups.items()}
    moving = {group: names for group, names in moving.items() if names}
    if not moving:
        got = ", ".join(at_rest) or "none"
        raise Problem(f"{recording.heading}: expected signals that move, got {got}")
    spans = {name: recording.criterion(name).span or size for name, size in ranges.items()}
    notes = (f"not compared, at rest: {', '.join(at_rest)}",) if at_rest else ()
    return ReferenceSolution(recording, moving, spans, notes)
