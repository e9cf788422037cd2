"""`harvester convergence`: all settings at all steps, with their errors against a reference and their cost.

The reference is a recording, or a run that is finer than all others. Its samples are often far apart. A run
is compared at common instants only, because linear interpolation between samples would be less accurate than
a good master.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from math import isfinite, log
from pathlib import Path
from statistics import median
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal, suggest
from orchestrator.base.files import make_folder, require_system
from orchestrator.base.options import checked, seconds, taken
from orchestrator.base.progress import doing
from orchestrator.base.signals import matching, span
from orchestrator.base.text import grouped
from orchestrator.base.units import convert, quantity
from orchestrator.data.recording import Recording, read_recording
from orchestrator.data.table import Array
from orchestrator.data.trace import SAME_TIME, Trace, rounding
from orchestrator.engine.arguments import CaseArguments, RunArguments
from orchestrator.engine.result import Result, widest_of_unit
from orchestrator.engine.run import attempt, run
from orchestrator.engine.scenario import ScenarioSource, read_scenario
from orchestrator.results.metrics import AT_REST, HUGE, Metrics, measure
from orchestrator.results.validate_system import another_model
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.load import configured
from orchestrator.ssp.masters import MASTERS
from orchestrator.ssp.swap import used_ports
from orchestrator.ssp.system import System

UNSTABLE_ERROR = 1.0  # relative to the range of a signal: a run with a larger error is unstable
ROUNDING = 1e-12  # NRMSE below which rounding errors hide the order of convergence
MOST_INSTANTS = 200  # at which an adaptive run is compared: a step has to end at each of them
FEWEST_INSTANTS = 10  # in common, for a root mean square
DEFAULT_QUANTITIES = ("speed", "pressure")  # compared if the user names no signals
FINEST = Coupling("hermite", passes=20, tolerance=1e-9)
OTHER_RUN = ("parameters", "set", "swap")  # options with which the default reference does not fit
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


@dataclass(frozen=True)
class Reference:
    """The solution that runs are compared with.

    recording   its signals, without gaps; its criteria have the range of each signal
    groups      group -> its signals, which share a table
    """

    recording: Recording
    groups: Mapping[str, Sequence[str]]
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The title of the recording."""
        return self.recording.heading

    @property
    def names(self) -> list[str]:
        """All signals."""
        return list(dict.fromkeys(name for names in self.groups.values() for name in names))

    def check(self, system: System, start: float, stop: float | None, steps: Iterable[float]) -> None:
        """Raise Problem if the system lacks a signal, or a step has too few instants in common."""
        for name in self.names:
            if name not in system.outputs and name not in system.names():
                raise UnknownSignal(name, [*system.outputs, *system.names()], f"{self.title}: ")
        time = self.recording.time
        last = time[-1] if stop is None else min(stop, time[-1])
        for step in steps:
            points: Array = start + step * np.arange(int((last - start) / step + SAME_TIME) + 1.0)
            if (count := len(_common_instants(points, time, step)[0])) < FEWEST_INSTANTS:
                expected = f"{FEWEST_INSTANTS} or more instants in common with {self.title}"
                raise Problem(f"step {step:g} s: expected {expected}, got {count}")

    def adaptive_record_step(self, start: float) -> float:
        """Record step [s] of a run with adaptive step size: steps have to end at these instants."""
        time = self.recording.time
        intervals, duration = len(time) - 1, time[-1] - time[0]
        offset = (start - time[0]) * intervals / duration
        equal = np.ptp(np.diff(time)) < SAME_TIME * duration
        if not equal or abs(offset - round(offset)) > SAME_TIME:
            raise Problem(f"{self.title}: expected equally spaced samples from {start:g} s on")
        return float(duration * max(intervals // MOST_INSTANTS, 1) / intervals)

    def errors(self, trace: Trace, step: float) -> dict[str, dict[str, Metrics]]:
        """Group -> signal -> its errors in the unit of the reference, the largest NRMSE first."""
        time = self.recording.time
        in_run, here = _common_instants(trace.time, time, step)

        def error(name: str) -> Metrics:
            unit, size = self.recording.units[name], self.recording.criterion(name).span
            # an unstable run may grow beyond all bounds
            values = np.clip(trace[name][in_run], -HUGE / 2, HUGE / 2)
            values = convert(values, trace.units.get(name, unit), unit, name)
            expected = self.recording[name][here]
            return measure(time[here], values, expected, span=size, where=name)

        errors = {name: error(name) for name in self.names}
        return {
            group: {n: errors[n] for n in sorted(names, key=lambda n: -(errors[n].nrmse or 0.0))}
            for group, names in self.groups.items()
        }


def _common_instants(run: Array, reference: Array, step: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the common instants, in the run and in the reference."""
    margin = rounding(reference, step)
    nearest = np.minimum(np.searchsorted(run, reference - margin), len(run) - 1)
    common = np.flatnonzero(np.abs(run[nearest] - reference) <= margin)
    return nearest[common], common


def from_recording(
    recording: Recording, patterns: Sequence[str] = (), quantities: Sequence[str] = DEFAULT_QUANTITIES
) -> Reference:
    """The signals of a recording that match a pattern; default: those of these quantities, else all."""
    for name, values in recording.items():
        if np.isnan(values).any():
            raise Problem(f"{recording.source}: {name}: expected a value at each time, got a gap")
    if patterns:
        return _without_rest(recording, {p: _matching(p, recording) for p in patterns})
    groups = grouped(recording, lambda n: recording.criterion(n).group or quantity(recording.units[n]))
    return _without_rest(recording, {g: groups[g] for g in quantities if g in groups} or groups)


def from_run(
    title: str, trace: Trace, patterns: Sequence[str] = (), quantities: Sequence[str] = ()
) -> Reference:
    """The same of a run; default: all quantities."""
    units = {name: trace.units.get(name, "") for name in trace}
    recording = Recording(trace.time, trace.signals, units, metadata={"title": title})
    return from_recording(recording, patterns, quantities)


def finest_run(
    system: System,
    patterns: Sequence[str],
    steps: Sequence[float],
    scenario: ScenarioSource = None,
    **options: Unpack[CaseArguments],
) -> Reference:
    """The solution if there is no recording: the outputs of `hermite` with half the smallest step."""
    outputs = [str(port) for port in system.ports("output") if system.variable(port).is_real]
    for pattern in patterns:
        _matching(pattern, outputs)
    step = min(steps) / 2
    result = run(system, scenario, master=FINEST, step=step, record=outputs, **options)
    return from_run(f"hermite at {milliseconds(step)}", result.trace, patterns, DEFAULT_QUANTITIES)


def _matching(pattern: str, names: Iterable[str]) -> list[str]:
    signals = list(names)
    if not (matches := matching(signals, pattern)):
        near = suggest(pattern, signals) or f"; there are {', '.join(signals[:6]) or 'none'}"
        raise Problem(f"signals {pattern}: no signal matches{near}")
    return matches


def _without_rest(recording: Recording, groups: Mapping[str, Sequence[str]]) -> Reference:
    """The groups without signals at rest: they have no range, alone or next to others of their unit."""
    ranges = {name: span(recording[name]) for names in groups.values() for name in names}
    widest = widest_of_unit(ranges, recording.units)
    at_rest = [name for name, size in ranges.items() if size <= AT_REST * widest[name]]
    moving = {group: [name for name in names if name not in at_rest] for group, names in groups.items()}
    moving = {group: names for group, names in moving.items() if names}
    if not moving:
        got = ", ".join(at_rest) or "none"
        raise Problem(f"{recording.heading}: expected signals that move, got {got}")
    given = {name: recording.criterion(name) for name in ranges}
    criteria = {n: replace(criterion, span=criterion.span or ranges[n]) for n, criterion in given.items()}
    notes = (f"not compared, at rest: {', '.join(at_rest)}",) if at_rest else ()
    return Reference(replace(recording, criteria=criteria), moving, notes)


# ---- the runs


@dataclass(frozen=True)
class SettingRun:
    """The run of one setting at one step. Times in [s].

    step     communication step; of an adaptive run the first one to try
    errors   group -> signal -> its errors, the largest first; empty if the run ended early or was refused
    steps    number of communication steps
    walls    wall times, one for each repetition of the run
    failure  why the run ended early; empty if it did not
    refusal  why there was no run: what the FMUs lack for this master
    """

    setting: Setting
    step: float
    errors: Mapping[str, Mapping[str, Metrics]] = field(default_factory=dict)
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
    def wall(self) -> float:
        """Median over the repetitions [s]."""
        return median(self.walls) if self.walls else float("nan")

    @property
    def cost(self) -> float:
        """Wall time over simulated time."""
        return self.wall / self.simulated if self.simulated else float("nan")

    @property
    def stable(self) -> bool:
        """The run came to the end, and no error was ever larger than the range of its signal."""
        errors = [e for group in self.errors.values() for e in group.values()]
        return bool(errors) and all(e.maximum_error < UNSTABLE_ERROR * e.normalised_by for e in errors)

    def error(self, group: str) -> float:
        """NRMSE of the worst signal of a group."""
        return next(iter(self.errors[group].values())).nrmse or 0.0


@dataclass(frozen=True)
class ConvergenceStudy:
    """All runs of a study, by setting with increasing steps."""

    reference: Reference
    runs: tuple[SettingRun, ...]
    notes: tuple[str, ...] = ()

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
        if min(small, large) < ROUNDING:
            return None
        return log(large / small) / log(setting_run.mean_step / next_finer.mean_step)


def milliseconds(step: float) -> str:
    """A step [s] as text in milliseconds."""
    return f"{1e3 * step:g} ms"


def run_settings(
    system: System,
    reference: Reference,
    settings: Sequence[Setting],
    steps: Sequence[float],
    repeats: int = 3,
    rates: Sequence[str] | None = None,
    scenario: ScenarioSource = None,
    done: list[SettingRun] | None = None,
    **options: Unpack[RunArguments],
) -> list[SettingRun]:
    """Run every setting at every step, one after the other, so that their times can be compared.

    repeats  how often a stable run is repeated; its wall time is the median
    rates    inputs whose connections a plain setting leaves out; default: those of rate ports
    done     gets the runs as they end
    options  of `run`, such as start, stop

    A plain setting without such inputs would equal that of order 0, and is left out.
    """
    start, stop = seconds(options.get("start"), "start"), seconds(options.get("stop"), "stop")
    start = (system.start or 0.0) if start is None else start
    reference.check(system, start, stop, steps)
    rates = rate_inputs(system) if rates is None else tuple(rates)
    ports = [str(system.outputs[n].source) if n in system.outputs else n for n in reference.names]
    given: dict[str, Any] = {**options, "record": list(dict.fromkeys(ports))}
    done, scenario = [] if done is None else done, read_scenario(scenario)
    plans = [
        plan
        for setting in settings
        if rates or not setting.without_rates
        for plan in [SettingRun(setting, step) for step in sorted(steps)[: 1 if setting.adaptive else None]]
    ]
    with doing("the first run") as line:
        for n, plan in enumerate(plans):
            setting, step = plan.setting, plan.step
            line.update(f"{n} of {len(plans)}  {setting.label}, {milliseconds(step)}")
            coupled = system.without(*rates) if setting.without_rates else system
            record_step = reference.adaptive_record_step(start) if setting.adaptive else step
            given |= {"master": setting.coupling, "step": step, "record_step": record_step}
            done.append(_run(plan, reference, partial(attempt, coupled, scenario, **given), repeats))
    if done and all(run.refusal for run in done):  # the user's mistake, not a limit of the FMUs
        raise Problem(done[0].refusal)
    return done


def _run(
    plan: SettingRun, reference: Reference, run: Callable[[], tuple[Result, str]], repeats: int
) -> SettingRun:
    """One run, repeated for its wall time if it was stable."""
    try:
        result, failure = run()
    except Problem as problem:
        return replace(plan, refusal=str(problem))
    card = result.card
    errors = {} if failure else reference.errors(result.trace, plan.step)
    done = replace(plan, errors=errors, steps=card.steps, simulated=card.simulated, failure=failure)
    more = (run()[0].card.wall for _ in range(repeats - 1 if done.stable else 0))
    return replace(done, walls=(card.wall, *more))


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
    **options: Unpack[CaseArguments],
) -> ConvergenceStudy:
    """Run a study, tell its tables and write its files to `out`; also what an interrupted one has finished.

    steps              times [s], the smallest first
    masters            as of `choose`
    default_reference  used if no reference is given, and if it fits this system and this run
    options            of `run`
    """
    from orchestrator.studies.convergence.convergence_report import report, write

    if repeats < 1:
        raise Problem(f"repeats: expected at least 1, got {repeats}")
    settings = choose(masters)
    given: dict[str, Any] = checked(CaseArguments, options, "convergence")
    other_run = any(given.get(name) for name in OTHER_RUN) or scenario is not None
    coupled = configured(require_system(system), **taken(given, "cut", "swap"))
    if not coupled.connections:
        raise Problem(f"{system}: expected connected FMUs, got no connection: there is nothing to couple")
    make_folder(out)
    given = {name: value for name, value in given.items() if value}
    if reference is None and default_reference and not other_run:
        names = from_recording(read_recording(default_reference)).names
        reference = default_reference if set(names) <= set(coupled.names()) else None
    if reference:
        recording = read_recording(reference)
        solution, note = from_recording(recording, signals), another_model(coupled, recording)
    else:
        solution = finest_run(coupled, signals, steps, scenario, **given)
        note = f"no reference for this run: {solution.title}, half the smallest step, is used instead"
    rates, runs = rate_inputs(coupled), list[SettingRun]()
    plain = rates and any(setting.without_rates for setting in settings)
    plain_note = f"plain: without the connections of rate ports: {', '.join(rates)}" if plain else ""
    try:
        run_settings(coupled, solution, settings, steps, repeats, rates, scenario, runs, **given)
    finally:
        notes = filter(None, (note, *solution.notes, plain_note))
        study = ConvergenceStudy(solution, tuple(runs), tuple(notes))
        if not all(run.refusal for run in runs):
            tell("\n".join([report(study).text(), "", *map(str, write(study, out))]))
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
