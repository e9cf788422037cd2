"""What a run is: a system and all choices for it, and what it results in."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.base.errors import Problem
from orchestrator.base.processes import machine_memory
from orchestrator.base.signals import matching
from orchestrator.base.text import first_names
from orchestrator.data.trace import SAME_TIME, Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.options import RunOptions
from orchestrator.engine.result import (
    DIVIDED,
    SHORTER,
    Card,
    Interrupted,
    Result,
    RunEnd,
    RunFailed,
    relative_errors,
    unreliable_energies,
    unreliable_errors,
    unreliable_outputs,
    unseen_notes,
)
from orchestrator.engine.scenario import (
    Scenario,
    ScenarioFile,
    ScenarioSource,
    drive,
    read_scenario,
    with_changes,
)
from orchestrator.engine.time_grid import Grid, grid, time_span
from orchestrator.engine.until import Comparison, Condition, condition
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.ssp.coupling import SHORTER_STEP_GUARD, Coupling
from orchestrator.ssp.load import configured
from orchestrator.ssp.parameter_sets import SUFFIX as SSV
from orchestrator.ssp.plausible import doubtful_columns, doubtful_starts, refuse_long, with_doubts
from orchestrator.ssp.provenance import Provenance, built_notes, provenance
from orchestrator.ssp.system import Component, System
from orchestrator.worker.process import WorkerLimits

if TYPE_CHECKING:
    from orchestrator.fmi.calls import Slave

ENDS_EARLY = "the run ends early: "  # begins the note on a run that an FMU asked to end


def open_slave(component: Component) -> Slave:
    """Instantiate the FMU of a component."""
    if component.source is None:
        raise Problem(f"{component.name}: expected an FMU file, got none")
    if component.interface.kind == MODEL_EXCHANGE:
        from orchestrator.engine.stepped_fmu import SteppedFmu

        return SteppedFmu(component, component.source)
    from orchestrator.fmi.cosimulation import CoSimulationFmu

    return CoSimulationFmu(component.name, component.interface, component.source, component.whole_start)


def isolated(options: RunOptions) -> bool:
    """Is the run in a process of its own?"""
    return options.isolate and options.open in (None, open_slave)


@dataclass(frozen=True)
class Request:
    """A run that is asked for.

    system     with the choices of the options for it
    deadline   end of the time limit of all runs of a command, by `time.monotonic` [s]
    """

    system: System
    scenario: ScenarioFile
    options: RunOptions
    deadline: float = math.inf

    @classmethod
    def of(
        cls, system: System | str | Path, scenario: ScenarioSource = None, options: RunOptions | None = None
    ) -> Request:
        """The request of a run with the arguments of `run`, whose time begins; reads the scenario."""
        o = options or RunOptions()
        deadline = time.monotonic() + o.time_limit
        chosen = configured(system, cut=o.cut, swap=o.swap, parameters=o.parameters, set=o.set)
        return Request(chosen, read_scenario(scenario), o, deadline)

    @property
    def is_late(self) -> bool:
        """Has the time limit passed?"""
        return time.monotonic() >= self.deadline

    def with_options(self, options: RunOptions) -> Request:
        """The request with other choices, except of those that the system has already."""
        return replace(self, options=options)

    def job(self) -> Job:
        """The job of the run; raises Problem for a mistake."""
        draft = _Draft(self, self.system, self.scenario.trace, self.scenario.label)
        for step in PREPARATION:
            draft = step(draft)
        system, options = draft.system, draft.options
        assert draft.times is not None
        coupling = system.coupling or Coupling()
        options = replace(options, isolate=options.isolate and not coupling.method.own)
        until = None if options.until is None else condition(system, options.until)
        ssv = [s for s in options.parameters if str(s).endswith(SSV)]
        files = [*ssv, *([self.scenario.file] if self.scenario.file else [])]
        return Job(
            system=system,
            scenario=draft.driving,
            times=draft.times,
            coupling=coupling,
            options=replace(options, record=_recorded(options.record, until, system), until=None),
            until=until,
            provenance=provenance(system, files),
            deadline=self.deadline,
        )


@dataclass(frozen=True)
class _Draft:
    """What becomes a job, step by step.

    trace, label   the scenario, with what changes during the run, and its name in messages
    driving        the trace at the inputs of the system
    """

    request: Request
    system: System
    trace: Trace | None
    label: str
    driving: Scenario | None = None
    times: Grid | None = None

    @property
    def options(self) -> RunOptions:
        """All choices."""
        return self.request.options


def _coupled(d: _Draft) -> _Draft:
    """With the chosen coupling; refuses options that have no effect."""
    system = d.system.coupled(d.options.coupling)
    _check(d.options, system.coupling)
    return replace(d, system=system)


def _changed(d: _Draft) -> _Draft:
    """With the faults in the scenario, whose values change during the run."""
    if not d.options.fault:
        return d
    ends = time_span(d.system, d.trace, d.options.start, d.options.stop)
    trace = with_changes(d.system, d.trace, d.options.fault, ends[:2], d.label)
    return replace(d, trace=trace, label=d.label if d.trace else "fault")


def _noted(d: _Draft) -> _Draft:
    """With the notes that follow from the system before it is driven."""
    system, columns = d.system, d.trace.signals if d.trace is not None else ()
    return replace(
        d,
        system=system.noted(
            *system.suggestion.notes(d.options.step is not None),
            *built_notes(system),
            *system.differences(system.common),
            *system.without_effect([*_set_values(d), *columns]),
            *system.without_ticks(),
        ),
    )


def _driven(d: _Draft) -> _Draft:
    """With the scenario at the inputs, in place of their connections."""
    if d.trace is None:
        return d
    driving = drive(d.system, d.trace, d.label)
    system = driving.released(d.system)
    return replace(d, system=system.noted(*driving.overruled(system, _set_values(d))), driving=driving)


def _doubted(d: _Draft) -> _Draft:
    """With warnings of start values and columns that may be wrong; refuses a scenario that may be in ms."""
    system = with_doubts(d.system, doubtful_starts(d.system))
    if d.driving and d.trace is not None:
        if d.options.stop is None and not d.options.yes:
            refuse_long(system, d.trace, d.label)
        system = with_doubts(system, doubtful_columns(system, d.trace, d.driving.columns, d.label))
    return replace(d, system=system)


def _guarded(d: _Draft) -> _Draft:
    """With the guard that shorter steps of FMUs ask for."""
    system = with_default_guard(d.system, d.options.step)
    (system.coupling or Coupling()).check(system.components)
    return replace(d, system=system)


def _timed(d: _Draft) -> _Draft:
    """With the communication points, to which the scenario fits."""
    o, coupling = d.options, d.system.coupling or Coupling()
    divides = coupling.adaptive is not None or guarded(d.system, coupling)
    times = grid(d.system, d.trace, o.step, o.start, o.stop, o.record_step, o.accuracy is not None)
    system = d.system.noted(*uneven_steps(d.system, coupling, times))
    if d.driving is None:
        return replace(d, system=system, times=times)
    driving, times = d.driving.on(times, system, divides)
    return replace(d, system=system, driving=driving, times=times)


# each needs what those before it have done
PREPARATION = (_coupled, _changed, _noted, _driven, _doubted, _guarded, _timed)


def _set_values(d: _Draft) -> dict[str, Any]:
    """The chosen start values, those of arrays by element."""
    return dict(d.system.by_element(d.options.set))


def _check(options: RunOptions, coupling: Coupling | None) -> None:
    """Refuse options that have no effect, and limits that cannot be enforced."""
    if options.accuracy_of and options.accuracy is None:
        raise Problem(f"accuracy_of {options.accuracy_of[0]}: expected an accuracy, got none")
    if options.error_estimate not in (True, False, "fast"):
        raise Problem(f'error_estimate: expected True, False or "fast", got {options.error_estimate!r}')
    here = [] if options.isolate else ["isolate=False"]
    here += [] if options.open in (None, open_slave) else ["a function `open`"]
    here += [f"master {coupling.method.name}"] if coupling and coupling.method.own else []
    for name, limit in (("time_limit", options.time_limit), ("memory_limit", options.memory_limit)):
        if not limit > 0:
            raise Problem(f"{name}: expected a positive number, got {limit:g}")
        if limit < math.inf and here:
            got = f"got {here[0]}, which needs the calling process"
            raise Problem(f"{name}: expected a run in a process of its own, {got}")


@dataclass(frozen=True)
class Job:
    """A run: a system, its communication points and all other choices.

    options      of `run`; `record` has names only, and `until` is apart
    provenance   of files and values
    deadline     see `Request`
    until        a condition that ends the run
    """

    system: System
    scenario: Scenario | None
    times: Grid
    coupling: Coupling
    options: RunOptions = field(default_factory=RunOptions)
    provenance: Provenance = field(default_factory=Provenance)
    deadline: float = math.inf
    until: Condition | None = None

    @classmethod
    def of(
        cls, system: System | str | Path, scenario: ScenarioSource = None, options: RunOptions | None = None
    ) -> Job:
        """The job of a run with the arguments of `run`; raises Problem for a mistake."""
        return Request.of(system, scenario, options).job()

    @property
    def signals(self) -> Sequence[str] | None:
        """The names of the signals to record; None: all outputs and inputs."""
        return self.options.record

    @property
    def worker_limits(self) -> WorkerLimits:
        """The limits of a process; their time begins with the command."""
        memory = min(1e9 * self.options.memory_limit, machine_memory())
        return WorkerLimits(total_time=self.options.time_limit, memory=memory)

    @property
    def command_began(self) -> float:
        """When the command began, by `time.monotonic` [s]; of use only with a time limit.

        Infinite if the limit is that of a run, without the start of its process.
        """
        return self.deadline - self.options.time_limit if self.deadline < math.inf else math.inf

    def result(self, end: RunEnd, sink: TraceSink) -> Result:
        """The result of a complete run; raises RunFailed or Interrupted with the result of another one."""
        trace = sink.trace
        messages = sorted((m for log in end.logs for m in log.messages), key=lambda m: m.time)
        card = self._card(end, sink, trace)
        result = Result(
            self.system,
            trace,
            card,
            tuple(messages),
            end.complete,
            self.coupling,
            self.provenance,
            sink.errors,
        )
        if end.interrupted and not end.closing:
            raise Interrupted(result, str(end.problem or ""))
        if end.problem:
            cause = card.likely_cause(self.coupling.method.repeats)
            problem = Problem(f"{end.problem}; {cause}") if cause else end.problem
            raise RunFailed(problem, result, end.died) from end.problem
        return result

    def _card(self, end: RunEnd, sink: TraceSink, trace: Trace) -> Card:
        """The accuracy card of a run that has ended, with this trace."""
        times, adaptive, simulated = self.times, self.coupling.adaptive, end.t - self.times.start
        interfaces = {name: component.interface for name, component in self.system.components.items()}
        left_out = (f"{n}: {i.unsupported_note}" for n, i in interfaces.items() if i.unsupported)
        same = ("steps", "passes", "repeated", "lengths", "wall", "bonds", "inside", "events", "texts")
        errors = relative_errors(end.errors, trace, self.system.nominals)
        card = Card(
            master=self.coupling.text,
            step=times.step if adaptive is None else simulated / max(end.steps, 1),
            record_step=times.every * times.step if not times.free else 0.0,
            simulated=simulated,
            adaptive=adaptive,
            warnings=(*self.system.warnings, *(line for log in end.logs for line in log.warnings(sink))),
            notes=(*self.system.notes, *left_out, *end.notes, *unseen_notes(end.unseen)),
            unseen=end.unseen,
            errors=errors,
            errors_of_inputs=bool(end.errors),
            **{name: getattr(end, name) for name in same},
        )
        divisible = guarded(self.system, Coupling("hermite"))  # which has a guard by default
        unguarded = divisible and not self.coupling.estimates_error and not self.coupling.method.step
        energies = unreliable_energies(end.bonds, DIVIDED if unguarded else SHORTER)
        unseen = unreliable_outputs(end.unseen)
        return card.doubted(*energies, *unreliable_errors(errors, self.system), *unseen)

    def stricter(self) -> Job:
        """The same adaptive run at a tenth of its tolerance."""
        c = self.coupling
        assert c.adaptive is not None
        tolerance = None if c.tolerance is None else c.tolerance / 10
        return replace(self, coupling=replace(c, adaptive=c.adaptive / 10, tolerance=tolerance))


def uneven_steps(system: System, coupling: Coupling, times: Grid) -> Iterator[str]:
    """Notes on FMUs with a fixed step that get steps of another length."""
    for name, component in system.components.items():
        fixed, step = component.interface.fixed_step, times.step / coupling.factors.get(name, 1)
        if fixed and abs(step - max(round(step / fixed), 1) * fixed) > SAME_TIME * step:
            yield f"{name}: expected multiples of its step, {fixed:g} s, got steps of {step:g} s"


def guarded(system: System, coupling: Coupling) -> bool:
    """Are steps with too large an error divided? All components need rollback and steps of any length."""
    interfaces = [component.interface for component in system.components.values()]
    return coupling.guard_tolerance > 0 and all(i.rollback and i.variable_step for i in interfaces)


def with_default_guard(system: System, step: float | None) -> System:
    """The system with a guard if an FMU suggests a shorter step than the system does, unless one is chosen.

    It holds for steps of any length: the suggestion is that of the FMU's own parameters.

    step   of the run [s], chosen by the user; None: the suggested one
    """
    coupling = system.coupling or Coupling()
    if coupling.guard is not None or coupling.estimates_error or system.step is None:
        return system
    length, limit = step or system.step, system.step * (1.0 - SAME_TIME)
    steps = {name: c.interface.step or math.inf for name, c in system.components.items()}
    shorter = {name: s for name, s in steps.items() if s < limit}
    if not shorter:
        return system
    note = f"{first_names(shorter)}: steps of {min(shorter.values()):g} s are suggested"
    guard = replace(coupling, guard=SHORTER_STEP_GUARD)
    if not guarded(system, guard):
        return system.noted(f"{note}; this run has steps of {length:g} s")
    reason = f"those of {length:g} s are divided where an input is off by {SHORTER_STEP_GUARD:g} (guard)"
    return replace(system, suggestion=replace(system.suggestion, coupling=guard)).noted(f"{note}; {reason}")


def _recorded(
    patterns: Sequence[str] | None, until: Condition | None, system: System
) -> tuple[str, ...] | None:
    """The names that patterns and a condition mean; None: all."""
    if patterns is None:
        return None
    names = [str(port) for causality in ("output", "input") for port in system.ports(causality)]
    wanted = [name for pattern in patterns for name in matching(names, pattern) or [pattern]]
    wanted += [until.signal] if isinstance(until, Comparison) else []
    return tuple(dict.fromkeys(wanted))
