"""Reference solution of a convergence study: a recording, or a run that is finer than all others.

The samples of a reference are often far apart. A run is compared at common instants only, because linear
interpolation between samples would be less accurate than a good master.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.text import grouped
from orchestrator.base.units import QUANTITIES, factor_and_offset, quantity
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, rms, span
from orchestrator.engine.run import run
from orchestrator.results.metrics import AT_REST
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.system import System

Indices = NDArray[np.intp]

SAME_INSTANT = 1e-6  # relative to the step: instants that are closer than this are the same
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
class ReferenceSignal:
    """One signal of the reference solution, shape (n,), in `unit`; signals of a group share a table."""

    name: str
    values: Array
    unit: str
    group: str
    span: float | None = None


@dataclass(frozen=True)
class ReferenceSolution:
    """The solution that runs are compared with: signals by group over a time axis of shape (n,) [s]."""

    title: str
    time: Array
    groups: Mapping[str, tuple[ReferenceSignal, ...]]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """All signals."""
        return list(dict.fromkeys(s.name for signals in self.groups.values() for s in signals))

    def check(self, system: System) -> None:
        """Raise UnknownSignal if the system lacks a signal."""
        for name in self.names:
            if name not in system.outputs and name not in system.names():
                raise UnknownSignal(name, [*system.outputs, *system.names()], f"{self.title}: ")

    def record_step(self, start: float, stop: float | None, step: float) -> float:
        """Record step [s] of a run with this communication step, so that both have instants in common."""
        last = self.time[-1] if stop is None else min(stop, self.time[-1])
        points: Array = start + step * np.arange(int((last - start) / step + SAME_INSTANT) + 1.0)
        count = len(_common_instants(points, self.time, step)[0])
        if count < FEWEST_INSTANTS:
            expected = f"{FEWEST_INSTANTS} or more instants in common with {self.title}"
            raise Problem(f"step {step:g} s: expected {expected}, got {count}")
        interval = float(self.time[1] - self.time[0])
        steps = round(interval / step)
        equal = max(abs(start - self.time[0]), np.ptp(np.diff(self.time))) < SAME_INSTANT * step
        return steps * step if equal and steps and abs(interval / step - steps) < SAME_INSTANT else step

    def adaptive_record_step(self, start: float) -> float:
        """Record step [s] of a run with adaptive step size: steps have to end at these instants."""
        intervals = len(self.time) - 1
        duration = self.time[-1] - self.time[0]
        offset = (start - self.time[0]) * intervals / duration
        equal = np.ptp(np.diff(self.time)) < SAME_INSTANT * duration
        if not equal or abs(offset - round(offset)) > SAME_INSTANT:
            raise Problem(f"{self.title}: expected equally spaced samples from {start:g} s on")
        return float(self.time[max(intervals // MOST_INSTANTS, 1)] - self.time[0])

    def errors(self, trace: Trace, step: float) -> dict[str, tuple[SignalDeviation, ...]]:
        """Group -> errors of its signals, the largest first."""
        indices = _common_instants(trace.time, self.time, step)
        return {
            group: tuple(sorted((_deviation(s, trace, *indices) for s in signals), key=lambda e: -e.nrmse))
            for group, signals in self.groups.items()
        }


def _common_instants(run: Array, reference: Array, step: float) -> tuple[Indices, Indices]:
    """Indices of the common instants, in the run and in the reference."""
    nearest = np.minimum(np.searchsorted(run, reference - SAME_INSTANT * step), len(run) - 1)
    common = np.flatnonzero(np.abs(run[nearest] - reference) <= SAME_INSTANT * step)
    return nearest[common], common


def _deviation(
    signal: ReferenceSignal, trace: Trace, in_run: Indices, in_reference: Indices
) -> SignalDeviation:
    unit = trace.units.get(signal.name, signal.unit)
    factor, offset = factor_and_offset(unit, signal.unit, signal.name) if unit != signal.unit else (1.0, 0.0)
    with np.errstate(over="ignore"):  # an unstable run may grow beyond all bounds
        error = factor * trace[signal.name][in_run] + offset - signal.values[in_reference]
        rmse = rms(error)
    size = signal.span or 1.0
    return SignalDeviation(signal.name, rmse / size, float(np.abs(error).max()), size, signal.unit)


def from_recording(recording: Recording, patterns: Sequence[str] = ()) -> ReferenceSolution:
    """The signals of a recording that match a pattern; default: its speeds and pressures, else all."""
    signals = []
    for name, values in recording.signals.items():
        unit, criterion = recording.units[name], recording.criterion(name)
        if np.isnan(values).any():
            raise Problem(f"{recording.source}: {name}: expected a value at each time, got a gap")
        signals.append(ReferenceSignal(name, values, unit, criterion.group or quantity(unit), criterion.span))
    by_name = {s.name: s for s in signals}
    if patterns:
        chosen = {p: [by_name[name] for name in _matching(p, by_name)] for p in patterns}
        return _without_rest(recording.heading, recording.time, chosen)
    groups = grouped(signals, attrgetter("group"))
    default = {g: groups[g] for g in DEFAULT_QUANTITIES if g in groups} or groups
    return _without_rest(recording.heading, recording.time, default)


def from_run(title: str, trace: Trace) -> ReferenceSolution:
    """The signals of a run, one group for each quantity."""
    units = {name: trace.units.get(name, "") for name in trace.signals}
    signals = (ReferenceSignal(n, v, units[n], quantity(units[n])) for n, v in trace.signals.items())
    return _without_rest(title, trace.time, grouped(signals, attrgetter("group")))


def finest_run(
    system: System, signals: Sequence[str], steps: Sequence[float], **options: Any
) -> ReferenceSolution:
    """The solution if there is no recording: a run of `hermite` with half the smallest step."""
    step = min(steps) / 2
    result = run(system, master=FINEST, step=step, record=list(signals), **options)
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
    matching = [name for name in signals if fnmatchcase(name, pattern)]
    if not matching:
        near = suggest(pattern, signals) or f"; there are {', '.join(signals[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal matches{near}")
    return matching


def _without_rest(
    title: str, time: Array, groups: Mapping[str, Sequence[ReferenceSignal]]
) -> ReferenceSolution:
    """The groups without signals at rest: they have no range, alone or next to others of their unit."""
    signals = [s for members in groups.values() for s in members]
    ranges = {s.name: span(s.values) for s in signals}
    widest = {s.unit: max(ranges[other.name] for other in signals if other.unit == s.unit) for s in signals}
    at_rest = [s.name for s in signals if ranges[s.name] <= AT_REST * widest[s.unit]]
    moving = {
        group: tuple(replace(s, span=s.span or ranges[s.name]) for s in members if s.name not in at_rest)
        for group, members in groups.items()
    }
    moving = {group: members for group, members in moving.items() if members}
    if not moving:
        raise Problem(f"{title}: expected signals that move, got {', '.join(at_rest) or 'none'}")
    notes = (f"not compared, at rest: {', '.join(dict.fromkeys(at_rest))}",) if at_rest else ()
    return ReferenceSolution(title, time, moving, notes)
