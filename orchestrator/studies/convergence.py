"""Error of a coupled run over its communication step, for each way of coupling: settings, reference, runs.

A run is compared with samples of a reference, or of one run that is finer than all others. A reference has
its own instants, often far apart. A run is compared at the instants that both have: between them a straight
line would be less accurate than a good master.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from math import log
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.coupling import MASTERS, Coupling
from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.units import linear
from orchestrator.data.recording import Recording
from orchestrator.data.trace import Trace
from orchestrator.engine.result import RunFailed
from orchestrator.engine.run import run
from orchestrator.results.comparison import QUANTITIES, REST, quantity
from orchestrator.results.metrics import constant
from orchestrator.ssp.swap import used_ports
from orchestrator.ssp.system import System

Array = NDArray[np.float64]
SAME = 1e-6  # of a step: two instants that are nearer to each other are one
ENOUGH = 200  # instants, where each is a step that has to end there
FEWEST = 10  # instants in common, else a root mean square means little
LOST = 1.0  # of its range: a signal that was once further off has left its place for good
ROUNDING = 1e-12  # NRMSE: below it a change says nothing about the order
USUAL = ("speed", "pressure")  # quantities that are compared if the user names no signals


@dataclass(frozen=True)
class Setting:
    """One way of coupling.

    bare  without the wires of rate ports: what a master from a textbook would get
    own   for masters that choose their steps: what varies in place of the step, by name, such as a tolerance
    """

    label: str
    coupling: Coupling
    bare: bool = False
    own: Mapping[str, Coupling] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """The settings that are drawn in one colour."""
        return "plain" if self.bare else "own steps" if self.own else self.coupling.master

    def fits(self, name: str) -> bool:
        """Is the name that of the master, or a pattern that the label matches?"""
        return name == self.coupling.master or fnmatchcase(self.label, name)


TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
SETTINGS = (
    Setting("jacobi plain", Coupling("jacobi", 0), bare=True),
    Setting("gauss-seidel plain", Coupling("gauss-seidel", 0), bare=True),
    Setting("jacobi order 0", Coupling("jacobi", 0)),
    Setting("jacobi order 1", Coupling("jacobi", 1)),
    Setting("jacobi order 2", Coupling("jacobi", 2)),
    Setting("gauss-seidel order 0", Coupling("gauss-seidel", 0)),
    Setting("gauss-seidel order 1", Coupling("gauss-seidel", 1)),
    Setting("gauss-seidel order 2", Coupling("gauss-seidel", 2)),
    Setting("hermite 1 pass", Coupling("hermite", passes=1, guard=0)),  # the same as gauss-seidel of order 3
    Setting("hermite 2 passes", Coupling("hermite", passes=2, guard=0)),
    Setting("hermite to tolerance", Coupling("hermite", guard=0)),
    Setting("hermite", Coupling("hermite")),
    Setting("interface-jacobian unguarded", Coupling("interface-jacobian", guard=0)),
    Setting("interface-jacobian", Coupling("interface-jacobian")),
    Setting(
        "hermite adaptive",
        Coupling("hermite"),
        own={f"{tolerance:.0e}": Coupling("hermite", adaptive=tolerance) for tolerance in TOLERANCES},
    ),
)
FINEST = Coupling("hermite", passes=20, tolerance=1e-9)  # where there is no reference


def choose(names: Iterable[str]) -> tuple[Setting, ...]:
    """The settings with these names: masters, labels or patterns of labels; all if there are no names."""
    wanted = tuple(names)
    for name in wanted:
        if not any(setting.fits(name) for setting in SETTINGS):
            known = [*MASTERS, *(setting.label for setting in SETTINGS)]
            near = suggest(name, known) or f"; there are {', '.join(known)}"
            raise Problem(f"masters {name}: no setting of that name{near}")
    return tuple(s for s in SETTINGS if not wanted or any(s.fits(name) for name in wanted))


def rates(system: System) -> tuple[str, ...]:
    """The connected inputs that are derivatives of others: they carry no power, and are optional."""
    return tuple(
        f"{component.name}.{name}"
        for component in system.components.values()
        for name, use in used_ports(system, component).items()
        if use.optional and use.connections and use.declared.causality == "input"
    )


def possible(settings: Sequence[Setting], held: Sequence[str]) -> list[Setting]:
    """Without connections to leave out, a bare setting equals that of order 0 and is left out."""
    return [setting for setting in settings if held or not setting.bare]


@dataclass(frozen=True)
class SignalDeviation:
    """Error of one signal.

    nrmse    root mean square over the range of the whole reference
    maximum  largest difference, in `unit`
    span     that range, in `unit`
    """

    signal: str
    nrmse: float
    maximum: float
    span: float
    unit: str


@dataclass(frozen=True)
class TrueSignal:
    """One signal of the truth, shape (n,), in `unit`; signals of a group are shown together."""

    name: str
    values: Array
    unit: str
    group: str
    span: float | None = None


@dataclass(frozen=True)
class Truth:
    """What runs are compared with: signals by group over a time axis of shape (n,) [s]; a span is a range."""

    title: str
    time: Array
    groups: Mapping[str, tuple[TrueSignal, ...]]
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """All signals."""
        return list(dict.fromkeys(s.name for signals in self.groups.values() for s in signals))

    def check(self, system: System) -> None:
        """Raise UnknownSignal where the system lacks a signal."""
        for name in self.names:
            if name not in system.outputs and name not in system.names():
                raise UnknownSignal(name, [*system.outputs, *system.names()], f"{self.title}: ")

    def interval(self, start: float, stop: float | None, step: float) -> float:
        """Record step of a run with this communication step [s], so that both have instants in common."""
        last = self.time[-1] if stop is None else min(stop, self.time[-1])
        points: Array = start + step * np.arange(int((last - start) / step + SAME) + 1.0)
        count = len(_shared(points, self.time, step)[0])
        if count < FEWEST:
            wanted = f"{FEWEST} or more instants in common with {self.title}"
            raise Problem(f"step {step:g} s: expected {wanted}, got {count}")
        apart = float(self.time[1] - self.time[0])
        whole = round(apart / step)
        even = abs(start - self.time[0]) < SAME * step and np.ptp(np.diff(self.time)) < SAME * step
        return whole * step if even and whole and abs(apart / step - whole) < SAME else step

    def coarse(self, start: float) -> float:
        """Record step of a run that chooses its communication steps [s]: it has to hit these instants."""
        spaces = len(self.time) - 1
        even = np.ptp(np.diff(self.time)) < SAME * (self.time[-1] - self.time[0])
        off = (start - self.time[0]) * spaces / (self.time[-1] - self.time[0])
        if not even or abs(off - round(off)) > SAME:
            raise Problem(f"{self.title}: expected equally spaced samples from {start:g} s on")
        return float(self.time[max(spaces // ENOUGH, 1)] - self.time[0])

    def errors(self, trace: Trace, step: float) -> dict[str, tuple[SignalDeviation, ...]]:
        """Group -> errors of its signals, the largest first."""
        own, mine = _shared(trace.time, self.time, step)
        return {
            group: tuple(sorted((_error(s, trace, own, mine) for s in signals), key=lambda e: -e.nrmse))
            for group, signals in self.groups.items()
        }


def _shared(run: Array, truth: Array, step: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the instants that both have, in the run and in the reference."""
    at = np.minimum(np.searchsorted(run, truth - SAME * step), len(run) - 1)
    both = np.flatnonzero(np.abs(run[at] - truth) <= SAME * step)
    return at[both], both


def _error(
    signal: TrueSignal, trace: Trace, own: NDArray[np.intp], mine: NDArray[np.intp]
) -> SignalDeviation:
    unit = trace.units.get(signal.name, signal.unit)
    factor, offset = linear(unit, signal.unit, signal.name) if unit != signal.unit else (1.0, 0.0)
    with np.errstate(over="ignore"):  # of a run that grows beyond all bounds
        apart = factor * trace[signal.name][own] + offset - signal.values[mine]
        rms = float(np.sqrt(np.mean(np.square(apart))))
    span = signal.span or 1.0
    return SignalDeviation(signal.name, rms / span, float(np.abs(apart).max()), span, signal.unit)


def from_reference(reference: Recording, patterns: Sequence[str] = ()) -> Truth:
    """The signals of a reference that fit a pattern; default: its speeds and pressures, else all."""
    named = []
    for name, values in reference.signals.items():
        unit, criterion = reference.units[name], reference.criterion(name)
        if np.isnan(values).any():
            raise Problem(f"{reference.source}: {name}: expected a value at each time, got a gap")
        named.append(TrueSignal(name, values, unit, criterion.group or quantity(unit), criterion.span))
    by_name = {s.name: s for s in named}
    if patterns:
        chosen = {p: [by_name[name] for name in _matching(p, by_name)] for p in patterns}
        return _moving(reference.heading, reference.time, chosen)
    groups = list(dict.fromkeys(s.group for s in named))
    return _moving(
        reference.heading, reference.time, _grouped(named, [g for g in USUAL if g in groups] or groups)
    )


def from_run(title: str, trace: Trace) -> Truth:
    """The signals of a run, one group for each quantity."""
    named = [
        TrueSignal(name, values, unit, quantity(unit))
        for name, values in trace.signals.items()
        for unit in (trace.units.get(name, ""),)
    ]
    return _moving(title, trace.time, _grouped(named, dict.fromkeys(s.group for s in named)))


def usual(system: System, patterns: Sequence[str] = ()) -> list[str]:
    """The outputs of a system that fit a pattern; default: of its first two named quantities."""
    outputs = [str(port) for port in system.ports("output") if system.variable(port).is_real]
    if patterns:
        return list(dict.fromkeys(name for p in patterns for name in _matching(p, outputs)))
    units = {str(p): u.name for p in system.ports("output") if (u := system.variable(p).unit)}
    kinds = {name: quantity(units.get(name, "")) for name in outputs}
    order = [*USUAL, *(q for q in QUANTITIES if q not in USUAL)]
    first = [q for q in order if q in kinds.values()][:2]
    return [name for q in first for name in outputs if kinds[name] == q] or outputs


def _matching(pattern: str, names: Iterable[str]) -> list[str]:
    known = list(names)
    matching = [name for name in known if fnmatchcase(name, pattern)]
    if not matching:
        near = suggest(pattern, known) or f"; there are {', '.join(known[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal fits{near}")
    return matching


def _grouped(signals: Sequence[TrueSignal], groups: Iterable[str]) -> dict[str, list[TrueSignal]]:
    return {group: [s for s in signals if s.group == group] for group in groups}


def _moving(title: str, time: Array, groups: Mapping[str, Sequence[TrueSignal]]) -> Truth:
    """The groups without constant signals, which have no range, alone or next to others of their unit."""
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


@dataclass(frozen=True)
class SettingRun:
    """The run of one setting at one step. Times in [s].

    step     communication step; where the setting chooses it, the first one to try
    case     of a setting that chooses its steps: the name of its coupling in `own`
    errors   group -> errors of its signals, the largest first; empty if the run ended early or was refused
    taken    communication steps
    walls    of each repetition of the run
    ended    why the run ended early; empty if it did not
    refused  why there was no run: the FMUs lack what the master needs
    """

    setting: Setting
    step: float
    case: str = ""
    errors: Mapping[str, tuple[SignalDeviation, ...]] = field(default_factory=dict)
    taken: int = 0
    simulated: float = 0.0
    walls: tuple[float, ...] = ()
    ended: str = ""
    refused: str = ""

    @property
    def mean_step(self) -> float:
        """[s] of the steps that were taken."""
        return self.simulated / self.taken if self.taken else self.step

    @property
    def wall(self) -> float:
        """Median over the repetitions [s]."""
        return median(self.walls) if self.walls else float("nan")

    @property
    def cost(self) -> float:
        """Wall time over simulated time."""
        return self.wall / self.simulated if self.simulated else float("nan")

    @property
    def stable(self) -> bool:
        """It came to the end, and no error was ever larger than the range of its signal."""
        errors = [e for group in self.errors.values() for e in group]
        return bool(errors) and all(e.maximum < LOST * e.span for e in errors)

    def error(self, group: str) -> float:
        """NRMSE of the worst signal of a group."""
        return self.errors[group][0].nrmse

    def maximum(self, group: str) -> SignalDeviation:
        """The signal of a group with the largest difference."""
        return max(self.errors[group], key=lambda e: e.maximum)


@dataclass(frozen=True)
class ConvergenceStudy:
    """The outcome, rows by setting with increasing steps."""

    truth: Truth
    rows: tuple[SettingRun, ...]
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> list[float]:
        """All steps that were given [s], the smallest first."""
        return sorted({row.step for row in self.rows if not row.case})

    @property
    def settings(self) -> list[Setting]:
        """All settings, in their order."""
        return list({row.setting.label: row.setting for row in self.rows}.values())

    def of(self, setting: Setting) -> list[SettingRun]:
        """The rows of a setting, the smallest step first."""
        rows = (row for row in self.rows if row.setting.label == setting.label)
        return sorted(rows, key=lambda row: row.mean_step if row.case else row.step)

    def order(self, row: SettingRun, group: str) -> float | None:
        """Order of convergence between the next smaller step given and this one, where both are stable."""
        finer = [r for r in self.of(row.setting) if r.step < row.step]
        if not finer or not finer[-1].stable or not row.stable:
            return None
        small, large = finer[-1].error(group), row.error(group)
        if min(small, large) < ROUNDING:
            return None
        return log(large / small) / log(row.mean_step / finer[-1].mean_step)


def run_settings(
    system: System,
    truth: Truth,
    settings: Sequence[Setting],
    steps: Sequence[float],
    repeats: int = 3,
    bare: Sequence[str] | None = None,
    **options: Any,
) -> Iterator[SettingRun]:
    """Run every setting at every step.

    repeats  how often a stable run is repeated; its wall time is the median
    bare     the connections that bare settings leave out; default: those of rate ports
    options  of `run`, such as scenario, start, stop
    """
    truth.check(system)
    held = rates(system) if bare is None else tuple(bare)
    start = float(next((t for t in (options.get("start"), system.start) if t is not None), 0.0))
    lengths = sorted(steps)
    record_steps = {h: truth.interval(start, options.get("stop"), h) for h in lengths}
    ports = [str(system.outputs[n].source) if n in system.outputs else n for n in truth.names]
    options = {"record": list(dict.fromkeys(ports))} | options
    any_run = False
    for setting in possible(settings, held):
        whole = system.without(*held) if setting.bare else system
        rows = [SettingRun(setting, step) for step in lengths]
        if setting.own:
            rows = [SettingRun(setting, lengths[0], case) for case in setting.own]
        for row in rows:
            coupling = setting.own.get(row.case, setting.coupling)
            record_step = truth.coarse(start) if row.case else record_steps[row.step]
            given = {"master": coupling, "step": row.step, "record_step": record_step} | options
            try:
                row = _run(row, truth, whole, repeats, given)
            except Problem as problem:
                if not any_run:  # then nothing runs at all: the user's mistake, not a limit of the FMUs
                    raise
                row = replace(row, refused=str(problem))
            any_run = True
            yield row


def _run(row: SettingRun, truth: Truth, system: System, repeats: int, given: Mapping[str, Any]) -> SettingRun:
    """One run, then again for its wall time if it was stable."""
    try:
        result, ended = run(system, **given), ""
    except RunFailed as failed:
        result, ended = failed.result, str(failed)
    card = result.card
    errors = {} if ended else truth.errors(result.trace, row.step)
    row = replace(row, errors=errors, taken=card.steps, simulated=card.simulated, ended=ended)
    more = repeats - 1 if row.stable else 0
    return replace(row, walls=(card.wall, *(run(system, **given).card.wall for _ in range(more))))


def finest(system: System, signals: Sequence[str], steps: Sequence[float], **options: Any) -> Truth:
    """What runs are compared with if there is no reference: `hermite` at half the smallest step."""
    step = min(steps) / 2
    result = run(system, master=FINEST, step=step, record=list(signals), **options)
    return from_run(f"hermite at {1e3 * step:g} ms", result.trace)
