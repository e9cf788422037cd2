"""What runs are held against: samples of a reference, or of one run that is finer than all others.

A reference has its own instants, often far apart. It is compared only at instants that a run has too: between
them a straight line would be further off than a good master is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from orchestrator.comparison.compare import QUANTITIES, REST, quantity
from orchestrator.errors import Problem, UnknownSignal, suggest
from orchestrator.files.trace import Trace
from orchestrator.symbols import linear
from orchestrator.system.system import System
from orchestrator.validation.metrics import constant
from orchestrator.validation.reference import Reference, Signal

USUAL = ("speed", "pressure")  # of these groups, where a reference has them
SAME = 1e-6  # of a step: instants that are nearer are one
ENOUGH = 200  # instants, where each is a step that has to end there
FEWEST = 10  # instants in common, else a root mean square says little


@dataclass(frozen=True)
class Error:
    """How far one signal is off.

    nrmse     root mean square over the range of the whole truth
    maximum   largest difference, in `unit`
    span      that range, in `unit`
    """

    signal: str
    nrmse: float
    maximum: float
    span: float
    unit: str


@dataclass(frozen=True)
class Truth:
    """Signals by group over a time axis of shape (n,) [s]; the span of each is its range."""

    title: str
    time: NDArray[np.float64]
    groups: Mapping[str, tuple[Signal, ...]]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """All signals."""
        return list(dict.fromkeys(s.name for signals in self.groups.values() for s in signals))

    def check(self, system: System) -> None:
        """Refuse a signal that the system has not."""
        for name in self.names:
            if name not in system.outputs and name not in system.names():
                raise UnknownSignal(name, [*system.outputs, *system.names()], f"{self.title}: ")

    def interval(self, start: float, stop: float | None, step: float) -> float:
        """How far apart a run of this step is to be recorded [s], if it is to have instants in common."""
        last = self.time[-1] if stop is None else min(stop, self.time[-1])
        points: NDArray[np.float64] = start + step * np.arange(int((last - start) / step + SAME) + 1.0)
        found = len(_shared(points, self.time, step)[0])
        if found < FEWEST:
            wanted = f"{FEWEST} or more instants in common with {self.title}"
            raise Problem(f"step {step:g} s: expected {wanted}, got {found}")
        apart = float(self.time[1] - self.time[0])
        whole = round(apart / step)
        even = abs(start - self.time[0]) < SAME * step and np.ptp(np.diff(self.time)) < SAME * step
        return whole * step if even and whole and abs(apart / step - whole) < SAME else step

    def coarse(self, start: float) -> float:
        """How far apart a run that chooses its steps is to be recorded [s]: it has to hit these instants."""
        spaces = len(self.time) - 1
        even = np.ptp(np.diff(self.time)) < SAME * (self.time[-1] - self.time[0])
        off = (start - self.time[0]) * spaces / (self.time[-1] - self.time[0])
        if not even or abs(off - round(off)) > SAME:
            raise Problem(f"{self.title}: expected equally spaced samples from {start:g} s on")
        return float(self.time[max(spaces // ENOUGH, 1)] - self.time[0])

    def errors(self, trace: Trace, step: float) -> dict[str, tuple[Error, ...]]:
        """Of each group the errors of all signals, the largest first."""
        own, mine = _shared(trace.time, self.time, step)
        found = {}
        for group, signals in self.groups.items():
            errors = [_error(signal, trace, own, mine) for signal in signals]
            found[group] = tuple(sorted(errors, key=lambda e: -e.nrmse))
        return found


def _shared(
    run: NDArray[np.float64], truth: NDArray[np.float64], step: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Places of the instants that both have, in either."""
    at = np.minimum(np.searchsorted(run, truth - SAME * step), len(run) - 1)
    both = np.flatnonzero(np.abs(run[at] - truth) <= SAME * step)
    return at[both], both


def _error(signal: Signal, trace: Trace, own: NDArray[np.intp], mine: NDArray[np.intp]) -> Error:
    unit = trace.units.get(signal.name, signal.unit)
    factor, offset = linear(unit, signal.unit, signal.name) if unit != signal.unit else (1.0, 0.0)
    with np.errstate(over="ignore"):  # of a run that grows beyond all bounds
        apart = factor * trace[signal.name][own] + offset - signal.values[mine]
        rms = float(np.sqrt(np.mean(np.square(apart))))
    span = signal.span or 1.0
    return Error(signal.name, rms / span, float(np.abs(apart).max()), span, signal.unit)


def from_reference(reference: Reference, patterns: Sequence[str] = ()) -> Truth:
    """The signals of a reference that fit a pattern; default: its speeds and pressures, else all."""
    named = [replace(s, group=s.group or quantity(s.unit)) for s in reference.signals.values()]
    groups = [s.group for s in named]
    usual = [group for group in USUAL if group in groups]
    chosen = _matching(named, patterns) if patterns else _grouped(named, usual or dict.fromkeys(groups))
    return _moving(reference.title, reference.time, chosen)


def from_run(title: str, trace: Trace) -> Truth:
    """The signals of a run, one group for each quantity."""
    named = [
        Signal(name, values, unit, group=quantity(unit))
        for name, values in trace.signals.items()
        for unit in (trace.units.get(name, ""),)
    ]
    return _moving(title, trace.time, _grouped(named, dict.fromkeys(s.group for s in named)))


def usual(system: System, patterns: Sequence[str] = ()) -> list[str]:
    """The outputs of a system that fit a pattern; default: of its first two named quantities."""
    outputs = [str(port) for port in system.ports("output") if system.variable(port).is_real]
    if patterns:
        return list(dict.fromkeys(name for p in patterns for name in _fitting(p, outputs)))
    units = {str(p): u.name for p in system.ports("output") if (u := system.variable(p).unit)}
    kinds = {name: quantity(units.get(name, "")) for name in outputs}
    order = [*USUAL, *(q for q in QUANTITIES if q not in USUAL)]
    first = [q for q in order if q in kinds.values()][:2]
    return [name for q in first for name in outputs if kinds[name] == q] or outputs


def _fitting(pattern: str, names: Iterable[str]) -> list[str]:
    known = list(names)
    found = [name for name in known if fnmatchcase(name, pattern)]
    if not found:
        near = suggest(pattern, known) or f"; there are {', '.join(known[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal fits{near}")
    return found


def _matching(signals: Sequence[Signal], patterns: Sequence[str]) -> dict[str, list[Signal]]:
    """A group for each pattern."""
    by_name = {s.name: s for s in signals}
    return {p: [by_name[name] for name in _fitting(p, by_name)] for p in patterns}


def _grouped(signals: Sequence[Signal], groups: Iterable[str]) -> dict[str, list[Signal]]:
    return {group: [s for s in signals if s.group == group] for group in groups}


def _moving(title: str, time: NDArray[np.float64], groups: Mapping[str, Sequence[Signal]]) -> Truth:
    """Without the signals that stand still, alone or beside others of their unit: they have no range."""
    everything = [s for signals in groups.values() for s in signals]
    ranges = {s.name: 0.0 if constant(s.values) else float(np.ptp(s.values)) for s in everything}
    widest = {s.unit: max(ranges[o.name] for o in everything if o.unit == s.unit) for s in everything}
    still = [n for s in everything if ranges[n := s.name] <= REST * widest[s.unit]]
    kept = {
        group: tuple(replace(s, span=s.span or ranges[s.name]) for s in signals if s.name not in still)
        for group, signals in groups.items()
    }
    kept = {group: signals for group, signals in kept.items() if signals}
    if not kept:
        raise Problem(f"{title}: expected signals that move, got {', '.join(still) or 'none'}")
    notes = (f"not compared, at rest: {', '.join(dict.fromkeys(still))}",) if still else ()
    return Truth(title, time, kept, notes)
