"""`harvester convergence`: all settings at all steps, with their errors against a reference and their cost.

The reference is a recording, or a run that is finer than all others. Its samples are often far apart. A run
is compared at common instants only, because linear interpolation between samples would be less accurate than
a good master.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import combinations
from math import isfinite, log
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.files import Location, make_folder, require_system
from orchestrator.base.options import chosen, given, seconds
from orchestrator.base.progress import doing
from orchestrator.base.signals import matching, span
from orchestrator.base.text import grouped
from orchestrator.base.units import quantity
from orchestrator.data.recording import Recording, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import SAME_TIME, Trace, rounding
from orchestrator.engine.arguments import CaseArguments
from orchestrator.engine.job import Job, Request
from orchestrator.engine.options import CaseOptions, RunOptions, same
from orchestrator.engine.result import widest_of_unit
from orchestrator.engine.run import co_simulate
from orchestrator.engine.scenario import ScenarioSource, read_scenario
from orchestrator.lanes.group import Status
from orchestrator.lanes.many import Runs, archives_of, many
from orchestrator.results.metrics import AT_REST
from orchestrator.results.validate_system import another_model
from orchestrator.results.validation import ValidatedSignal, Validation, validate
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.load import configured
from orchestrator.ssp.masters import MASTERS
from orchestrator.ssp.swap import used_ports
from orchestrator.ssp.system import System

if TYPE_CHECKING:
    from distributed import Client

UNSTABLE_ERROR = 1.0  # relative to the range of a signal: a run with a larger error is unstable
ROUNDING = 1e-12  # NRMSE below which rounding errors hide the order of convergence
MOST_INSTANTS = 200  # at which an adaptive run is compared: a step has to end at each of them
FEWEST_INSTANTS = 10  # in common, for a root mean square
DEFAULT_QUANTITIES = ("speed", "pressure")  # compared if the user names no signals
FINEST = Coupling("hermite", passes=20, tolerance=1e-9)
OTHER_RUN = ("parameters", "set", "swap")  # options with which the default reference does not fit
RESTING = "not compared, at rest"  # key of the metadata of a reference
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
EXTRAPOLATING = tuple(master.name for master in MASTERS.values() if not master.guarded)


# ---- the ways of coupling that are compared


@dataclass(frozen=True)
class Setting:
    """One way of coupling; with adaptive steps it is run once, not at every step.

    without_rates  without the connections of rate ports: what a textbook master would get
    """

    label: str
    coupling: Coupling
    without_rates: bool = False

    @property
    def adaptive(self) -> bool:
        """Do the steps follow from a tolerance?"""
        return self.coupling.adaptive is not None

    @property
    def family(self) -> str:
        """The settings that are drawn in one colour."""
        return "plain" if self.without_rates else "adaptive" if self.adaptive else self.coupling.method.name

    @property
    def curve(self) -> str:
        """The settings that are drawn as one curve: a setting at all steps, or adaptive ones."""
        return f"{self.coupling.method.name} adaptive" if self.adaptive else self.label

    def matches(self, pattern: str) -> bool:
        """Is the pattern the name of the master or of the curve, or does the label match it?"""
        return pattern in (self.coupling.method.name, self.curve) or fnmatchcase(self.label, pattern)


SETTINGS = (
    *(Setting(f"{master} plain", Coupling(master, 0), without_rates=True) for master in EXTRAPOLATING),
    *(Setting(f"{m} order {order}", Coupling(m, order)) for m in EXTRAPOLATING for order in range(3)),
    Setting("hermite 1 pass", Coupling("hermite", passes=1, guard=0)),  # the same as gauss-seidel of order 3
    Setting("hermite 2 passes", Coupling("hermite", passes=2, guard=0)),
    Setting("hermite to tolerance", Coupling("hermite", guard=0)),
    Setting("hermite", Coupling("hermite")),
    Setting("interface-jacobian unguarded", Coupling("interface-jacobian", guard=0)),
    Setting("interface-jacobian", Coupling("interface-jacobian")),
    *(Setting(f"hermite adaptive {e:.0e}", Coupling("hermite", adaptive=e)) for e in TOLERANCES),
)


def choose(patterns: Iterable[str]) -> tuple[Setting, ...]:
    """The settings that match: names of masters, labels or patterns of labels; all without patterns."""
    requested = tuple(patterns)
    for pattern in requested:
        if not any(setting.matches(pattern) for setting in SETTINGS):
            names = [*MASTERS, *(setting.label for setting in SETTINGS)]
            near = suggest(pattern, names) or f"; there are {', '.join(names)}"
            raise Problem(f"masters {pattern}: no setting of that name{near}")
    return tuple(s for s in SETTINGS if not requested or any(s.matches(pattern) for pattern in requested))


def rate_inputs(system: System) -> tuple[str, ...]:
    """The connected inputs that are derivatives of others: they carry no power, and are optional."""
    return tuple(
        f"{component.name}.{name}"
        for component in system.components.values()
        for name, port in used_ports(system, component).items()
        if port.optional and port.connections and port.declared.causality == "input"
    )


# ---- what they are compared with


def as_reference(
    recording: Recording, patterns: Sequence[str] = (), quantities: Sequence[str] = DEFAULT_QUANTITIES
) -> Recording:
    """The signals of a recording that match a pattern; default: those of these quantities, else all.

    The criterion of each has its group, whose signals share a table, and its range. Signals at rest are left
    out: they have no range, alone or next to others of their unit.
    """
    for name, values in recording.items():
        if np.isnan(values).any():
            raise Problem(f"{recording.source}: {name}: expected a value at each time, got a gap")
    groups = grouped(recording, lambda n: recording.criterion(n).group or quantity(recording.units[n]))
    chosen = {g: groups[g] for g in quantities if g in groups} or groups
    if patterns:
        chosen = {pattern: _matching(pattern, recording) for pattern in patterns}
        for first, second in combinations(chosen, 2):
            if common := {*chosen[first]} & {*chosen[second]}:
                got = f"expected patterns without common signals, got {min(common)} in both"
                raise Problem(f"signals {first} and {second}: {got}")
    group_of = {name: group for group, names in reversed(chosen.items()) for name in names}
    ranges = {name: span(recording[name]) for names in chosen.values() for name in names}
    widest = widest_of_unit(ranges, recording.units)
    moving = [name for name, size in ranges.items() if size > AT_REST * widest[name]]
    if not moving:
        got = ", ".join(ranges) or "none"
        raise Problem(f"{recording.heading}: expected signals that move, got {got}")
    given = {name: recording.criterion(name) for name in moving}
    criteria = {n: replace(c, group=group_of[n], span=c.span or ranges[n]) for n, c in given.items()}
    at_rest = ", ".join(name for name in ranges if name not in moving)
    metadata = {**recording.metadata, **({RESTING: at_rest} if at_rest else {})}
    return replace(recording.select(moving), criteria=criteria, metadata=metadata)


def run_as_reference(
    title: str, trace: Trace, patterns: Sequence[str] = (), quantities: Sequence[str] = ()
) -> Recording:
    """The same of a run; default: all quantities."""
    units = {name: trace.units.get(name, "") for name in trace}
    recording = Recording(trace.time, trace.signals, units, metadata={"title": title})
    return as_reference(recording, patterns, quantities)


def finest_run(
    system: System,
    patterns: Sequence[str],
    steps: Sequence[float],
    scenario: ScenarioSource = None,
    **options: Unpack[CaseArguments],
) -> Recording:
    """The solution if there is no recording: the outputs of `hermite` with half the smallest step."""
    outputs = [str(port) for port in system.ports("output") if system.variable(port).is_real]
    for pattern in patterns:
        _matching(pattern, outputs)
    step = min(steps) / 2
    case = chosen(CaseOptions, options, "finest_run")
    asked = replace(same(RunOptions, case), coupling=FINEST, step=step, record=tuple(outputs))
    result = co_simulate(Request.of(system, scenario, asked))
    return run_as_reference(f"hermite at {milliseconds(step)}", result.trace, patterns, DEFAULT_QUANTITIES)


def _matching(pattern: str, names: Iterable[str]) -> list[str]:
    signals = list(names)
    if not (matches := matching(signals, pattern)):
        near = suggest(pattern, signals) or f"; there are {', '.join(signals[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal matches{near}")
    return matches


def _check(
    reference: Recording, system: System, start: float, stop: float | None, steps: Iterable[float]
) -> None:
    """Raise Problem if the system lacks a signal, or a step has too few instants in common."""
    for name in reference:
        if name not in system.outputs and name not in system.names():
            raise UnknownSignal(name, [*system.outputs, *system.names()], f"{reference.heading}: ")
    time = reference.time
    last = time[-1] if stop is None else min(stop, time[-1])
    for step in steps:
        points: Array = start + step * np.arange(int((last - start) / step + SAME_TIME) + 1.0)
        if (count := len(_common_instants(points, time, step)[0])) < FEWEST_INSTANTS:
            expected = f"{FEWEST_INSTANTS} or more instants in common with {reference.heading}"
            raise Problem(f"step {step:g} s: expected {expected}, got {count}")


def _adaptive_record_step(reference: Recording, start: float) -> float:
    """Record step [s] of a run with adaptive step size: steps have to end at these instants."""
    time = reference.time
    intervals, duration = len(time) - 1, time[-1] - time[0]
    offset = (start - time[0]) * intervals / duration
    equal = np.ptp(np.diff(time)) < SAME_TIME * duration
    if not equal or abs(offset - round(offset)) > SAME_TIME:
        raise Problem(f"{reference.heading}: expected equally spaced samples from {start:g} s on")
    return float(duration * max(intervals // MOST_INSTANTS, 1) / intervals)


def _errors(trace: Trace, reference: Recording, step: float) -> Validation:
    """The errors at the common instants."""
    in_run, here = _common_instants(trace.time, reference.time, step)
    time = reference.time[here]
    units = {n: trace.units.get(n, "") for n in reference}
    found = Trace(time, {n: trace[n][in_run] for n in reference}, units)
    return validate(found, replace(reference, time=time, signals={n: reference[n][here] for n in reference}))


def _common_instants(run: Array, reference: Array, step: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the common instants, in the run and in the reference."""
    margin = rounding(reference, step)
    nearest = np.minimum(np.searchsorted(run, reference - margin), len(run) - 1)
    common = np.flatnonzero(np.abs(run[nearest] - reference) <= margin)
    return nearest[common], common


# ---- the runs


@dataclass(frozen=True)
class SettingRun:
    """The run of one setting at one step. Times in [s].

    step     communication step; of an adaptive run the first one to try
    errors   of each signal; None if the run ended early or was refused
    steps    number of communication steps
    walls    wall times, one for each repetition of the run
    failure  why the run ended early; empty if it did not
    refusal  why there was no run: what the FMUs lack for this master
    """

    setting: Setting
    step: float
    errors: Validation | None = None
    steps: int = 0
    simulated: float = 0.0
    walls: tuple[float, ...] = ()
    failure: str = ""
    refusal: str = ""

    @property
    def mean_step(self) -> float:
        """Simulated time over number of steps [s]; `step` if there was none."""
        return self.simulated / self.steps if self.steps else self.step

    @property
    def cost(self) -> float:
        """Median wall time over simulated time."""
        return median(self.walls) / self.simulated if self.walls and self.simulated else float("nan")

    @property
    def rows(self) -> Sequence[ValidatedSignal]:
        """The errors; empty if the run ended early or was refused."""
        return self.errors.rows if self.errors else ()

    @property
    def stable(self) -> bool:
        """The run came to the end, and no error was ever larger than the range of its signal."""
        found = [row.metrics for row in self.rows]
        return bool(found) and all(m.maximum_error < UNSTABLE_ERROR * m.normalised_by for m in found)

    def worst(self, group: str) -> ValidatedSignal | None:
        """The signal of a group with the largest NRMSE; None without errors."""
        rows = self.errors.groups[group] if self.errors else []
        return max(rows, key=lambda row: row.metrics.nrmse or 0.0, default=None)

    def error(self, group: str) -> float:
        """NRMSE of the worst signal of a group."""
        worst = self.worst(group)
        return (worst and worst.metrics.nrmse) or 0.0


@dataclass(frozen=True)
class ConvergenceStudy:
    """All runs of a study, by setting with increasing steps."""

    reference: Recording
    runs: tuple[SettingRun, ...]
    notes: tuple[str, ...] = ()

    @property
    def groups(self) -> dict[str, list[str]]:
        """Group -> its signals, which share a table."""
        return grouped(self.reference, lambda name: self.reference.criterion(name).group)

    @property
    def steps(self) -> list[float]:
        """The communication steps of the study [s], the smallest first."""
        return sorted({r.step for r in self.runs if not r.setting.adaptive})

    @property
    def curves(self) -> list[list[SettingRun]]:
        """The runs of each curve, the smallest step first."""
        curves = grouped(self.runs, lambda run: run.setting.curve).values()
        return [sorted(runs, key=lambda r: (r.step, r.mean_step)) for runs in curves]

    def order(self, setting_run: SettingRun, group: str) -> float | None:
        """Observed order of convergence against the next smaller step; None unless both runs are stable."""
        label, step = setting_run.setting.label, setting_run.step
        finer = [r for r in self.runs if r.setting.label == label and r.step < step]
        next_finer = max(finer, key=lambda r: r.step, default=None)
        if next_finer is None or not (next_finer.stable and setting_run.stable):
            return None
        small, large = next_finer.error(group), setting_run.error(group)
        if min(small, large) < ROUNDING or setting_run.mean_step <= next_finer.mean_step:
            return None
        return log(large / small) / log(setting_run.mean_step / next_finer.mean_step)


def milliseconds(step: float) -> str:
    """A step [s] as text in milliseconds."""
    return f"{1e3 * step:g} ms"


class SettingRuns:
    """The runs of settings on this computer, one task for each, which is its index.

    plans      the runs, without results
    jobs       of the plans, all of a system
    repeats    see `run_settings`
    archives   see `archives_of`
    """

    compiled = False

    def __init__(
        self,
        system: System,
        reference: Recording,
        plans: Sequence[SettingRun],
        jobs: Sequence[Job],
        repeats: int,
        archives: Mapping[Location, bytes] | None = None,
    ) -> None:
        self._given = system, reference, plans, jobs, repeats
        self._runs = Runs([system], archives)
        self.stop, self.close = self._runs.stop, self._runs.close

    def __reduce__(self) -> tuple[Any, ...]:
        """Opened anew, with the FMUs as bytes."""
        return SettingRuns, (*self._given, archives_of([self._given[0]]))

    def lost(self, index: int, reason: str) -> SettingRun:
        """A run that cannot take place."""
        return replace(self._given[2][index], failure=reason)

    def run(self, index: int) -> SettingRun:
        """A run, repeated for its wall time if it was stable."""
        _, reference, plans, jobs, repeats = self._given
        plan, job = plans[index], replace(jobs[index], system=self._runs.copied(jobs[index].system))
        result, end = self._runs.alone(job)
        failure = end.reason if end and (result is None or end.status == Status.FAILED) else ""
        if result is None:
            return replace(plan, refusal=failure)
        card = result.card
        ended = replace(plan, steps=card.steps, simulated=card.simulated, failure=failure)
        if not failure:
            try:
                ended = replace(ended, errors=_errors(result.trace, reference, plan.step))
            except Problem as problem:  # values beyond all bounds
                ended = replace(ended, failure=str(problem))
        again = (self._runs.alone(job)[0] for _ in range(repeats - 1 if ended.stable else 0))
        walls = (card.wall, *(other.card.wall for other in again if other))
        return replace(ended, walls=walls if repeats else ())


def run_settings(
    system: System,
    reference: Recording,
    settings: Sequence[Setting],
    steps: Sequence[float],
    repeats: int = 3,
    rates: Sequence[str] | None = None,
    scenario: ScenarioSource = None,
    done: list[SettingRun] | None = None,
    client: Client | None = None,
    **options: Unpack[CaseArguments],
) -> list[SettingRun]:
    """Run every setting at every step, one after the other, so that their times can be compared.

    repeats  how often a stable run is repeated; its wall time is the median
    rates    inputs whose connections a plain setting leaves out; default: those of rate ports
    done     gets the runs as they end
    client   a connection to a Dask cluster for the runs, which are not timed: `repeats` has no effect
    options  of `run`: what is run, such as start, stop

    A plain setting without such inputs would equal that of order 0, and is left out.
    """
    case = chosen(CaseOptions, options, "run_settings")
    start = (system.start or 0.0) if case.start is None else case.start
    _check(reference, system, start, case.stop, steps)
    rates = rate_inputs(system) if rates is None else tuple(rates)
    ports = [str(system.outputs[n].source) if n in system.outputs else n for n in reference]
    asked = replace(same(RunOptions, case), record=tuple(dict.fromkeys(ports)))
    done, scenario = [] if done is None else done, read_scenario(scenario)
    able_to = [setting for setting in settings if rates or not setting.without_rates]
    plans = [SettingRun(s, step) for s in able_to for step in sorted(steps)[: 1 if s.adaptive else None]]

    def job(plan: SettingRun) -> Job:
        record_step = _adaptive_record_step(reference, start) if plan.setting.adaptive else plan.step
        own = replace(asked, coupling=plan.setting.coupling, step=plan.step, record_step=record_step)
        return Job.of(system.without(*rates) if plan.setting.without_rates else system, scenario, own)

    with doing("the first run") as line:
        jobs, able = list[Job](), list[SettingRun]()
        for plan in plans:
            try:
                jobs.append(job(plan))
                able.append(plan)
            except Problem as problem:
                done.append(replace(plan, refusal=str(problem)))

        def keep(found: list[SettingRun]) -> None:
            done.extend(found)
            last = found[-1]
            line.update(f"{len(done)} of {len(plans)}  {last.setting.label}, {milliseconds(last.step)}")

        with closing(SettingRuns(system, reference, able, jobs, 0 if client else repeats)) as runs:
            try:
                many(runs, range(len(able)), keep, client or 1)
            finally:
                order = {(plan.setting.label, plan.step): i for i, plan in enumerate(plans)}
                done.sort(key=lambda run: order[run.setting.label, run.step])
    if done and all(run.refusal for run in done):  # the user's mistake, not a limit of the FMUs
        raise Problem(done[0].refusal)
    return done


# ---- for the command line


def convergence(
    system: Path,
    out: Path,
    steps: Sequence[float],
    masters: Sequence[str] = (),
    signals: Sequence[str] = (),
    repeats: int = 3,
    reference: Path | None = None,
    default_reference: Path | None = None,
    scenario: Path | None = None,
    tell: Callable[[str], object] = print,
    client: Client | None = None,
    **options: Unpack[CaseArguments],
) -> ConvergenceStudy:
    """Run a study, tell its tables and write its files to `out`; also what an interrupted one has finished.

    steps              times [s], the smallest first
    masters            as of `choose`
    default_reference  used if no reference is given, and if it fits this system and this run
    client             a connection to a Dask cluster for the runs, which are not timed then
    options            of `run`
    """
    from orchestrator.studies.convergence.convergence_report import report, write

    if repeats < 1:
        raise Problem(f"repeats: expected at least 1, got {repeats}")
    settings = choose(masters)
    case = chosen(CaseOptions, options, "convergence")
    other_run = any(getattr(case, name) for name in OTHER_RUN) or scenario is not None
    coupled = configured(require_system(system), cut=case.cut, swap=case.swap)
    if not coupled.connections:
        raise Problem(f"{system}: expected connected FMUs, got no connection: there is nothing to couple")
    make_folder(out)
    case = replace(case, cut=(), swap={})
    if reference is None and default_reference and not other_run:
        names = as_reference(read_recording(default_reference))
        reference = default_reference if set(names) <= set(coupled.names()) else None
    if reference:
        recording = read_recording(reference)
        solution, note = as_reference(recording, signals), another_model(coupled, recording)
    else:
        solution = finest_run(coupled, signals, steps, scenario, **given(case))
        note = f"no reference for this run: {solution.heading}, half the smallest step, is used instead"
    rates, runs = rate_inputs(coupled), list[SettingRun]()
    plain = rates and any(setting.without_rates for setting in settings)
    plain_note = f"plain: without the connections of rate ports: {', '.join(rates)}" if plain else ""
    try:
        run_settings(
            coupled, solution, settings, steps, repeats, rates, scenario, runs, client, **given(case)
        )
    finally:
        resting = f"{RESTING}: {solution.metadata[RESTING]}" if RESTING in solution.metadata else ""
        study = ConvergenceStudy(solution, tuple(runs), tuple(filter(None, (note, resting, plain_note))))
        if not all(run.refusal for run in runs):
            tell(report(study).text() + "\n")
            tell("\n".join(map(str, write(study, out))))
    return study


def read_steps(text: str) -> list[float]:
    """Steps [s] from a list with commas, the smallest first."""
    steps = [seconds(item, f"steps {text}") or 0.0 for item in items(text)]
    wrong = next((step for step in steps if not (step > 0 and isfinite(step))), None)
    if wrong is not None:
        raise Problem(f"steps {text}: expected positive times, got {wrong:g}")
    if not steps:
        raise Problem("steps: expected at least one, got none")
    return sorted(set(steps))


def items(text: str) -> list[str]:
    """The items of a list with commas."""
    return [part.strip() for part in text.split(",") if part.strip()]
