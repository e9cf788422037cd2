"""What a run is: a system and all choices for it, and what it results in."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from orchestrator.base.errors import Problem
from orchestrator.base.options import checked, declarations
from orchestrator.base.processes import machine_memory
from orchestrator.base.signals import matching
from orchestrator.base.text import first_names
from orchestrator.data.trace import SAME_TIME, Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.arguments import RunArguments, SystemArguments
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
from orchestrator.engine.until import Comparison, condition
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.ssp.coupling import SHORTER_STEP_GUARD, Coupling, take_coupling
from orchestrator.ssp.load import configured
from orchestrator.ssp.masters import Master
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


# Of `run`, in SI units, without those that nobody chose; deadline: end of the time limit of all runs of a
# command, by `time.monotonic` [s].
Options: TypeAlias = Mapping[str, Any]


def begun(
    system: System | str | Path, scenario: ScenarioSource, options: Options
) -> tuple[System, ScenarioFile, Options]:
    """The system with the choices of the options, the scenario read, and the options, whose time begins.

    If that has been done, all of them as they are.
    """
    if isinstance(system, System) and isinstance(scenario, ScenarioFile) and "deadline" in options:
        return system, scenario, options
    given = checked(RunArguments, options, "run")
    given["deadline"] = time.monotonic() + given.get("time_limit", math.inf)
    of_system = {name: value for name, value in given.items() if name in declarations(SystemArguments)}
    return configured(system, **of_system), read_scenario(scenario), given


def is_late(options: Options) -> bool:
    """Has the time limit passed?"""
    deadline: float = options.get("deadline", math.inf)
    return time.monotonic() >= deadline


def isolated(options: Options) -> bool:
    """Is the run in a process of its own?"""
    return bool(options.get("isolate", True)) and options.get("open", open_slave) is open_slave


def _check(options: Options, own: Master | None) -> None:
    """Refuse options that have no effect, and limits that cannot be enforced; own: a user's master."""
    if options.get("accuracy_of") and "accuracy" not in options:
        raise Problem(f"accuracy_of {options['accuracy_of'][0]}: expected an accuracy, got none")
    if (estimate := options.get("error_estimate", False)) not in (True, False, "fast"):
        raise Problem(f'error_estimate: expected True, False or "fast", got {estimate!r}')
    here = [] if options.get("isolate", True) else ["isolate=False"]
    here += [] if options.get("open", open_slave) is open_slave else ["a function `open`"]
    here += [f"master {own.name}"] if own else []
    for name in ("time_limit", "memory_limit"):
        limit = options.get(name, math.inf)
        if not limit > 0:
            raise Problem(f"{name}: expected a positive number, got {limit:g}")
        if limit < math.inf and here:
            got = f"got {here[0]}, which needs the calling process"
            raise Problem(f"{name}: expected a run in a process of its own, {got}")


@dataclass(frozen=True)
class Job:
    """A run: a system, its communication points and all other choices.

    options      of `run`; `record` has names only
    provenance   of files and values
    """

    system: System
    scenario: Scenario | None
    times: Grid
    coupling: Coupling
    options: Options = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)

    @classmethod
    def of(
        cls,
        system: System | str | Path,
        scenario: ScenarioSource = None,
        options: Options | None = None,
    ) -> Job:
        """The job of a run with the arguments of `run`; raises Problem for a mistake."""
        system, given, options = begun(system, scenario, options or {})
        choices = take_coupling({**options})
        system = system.coupled(choices) if choices else system
        coupling = system.coupling or Coupling()
        _check(options, coupling.method if coupling.method.own else None)
        if coupling.method.own:
            options = {**options, "isolate": False}
        step, start, stop = (options.get(name) for name in ("step", "start", "stop"))
        (trace, label, file), set_values = given, dict(system.by_element(options.get("set") or {}))
        if fault := options.get("fault"):
            ends = time_span(system, trace, start, stop)
            trace, label = with_changes(system, trace, fault, ends[:2], label), label if trace else "fault"
        columns = trace.signals if trace is not None else ()
        system = system.noted(
            *system.suggestion.notes(step is not None),
            *built_notes(system),
            *system.differences(system.common),
            *system.without_effect([*set_values, *columns]),
            *system.without_ticks(),
        )
        driving = None if trace is None else drive(system, trace, label)
        if driving:
            system = driving.released(system)
            system = system.noted(*driving.overruled(system, set_values))
        system = with_doubts(system, doubtful_starts(system))
        if driving and trace is not None:
            if stop is None and not options.get("yes"):
                refuse_long(system, trace, label)
            system = with_doubts(system, doubtful_columns(system, trace, driving.columns, label))
        system = with_default_guard(system, step)
        coupling = system.coupling or Coupling()
        coupling.check(system.components)
        divides = coupling.adaptive is not None or guarded(system, coupling)
        span, fitted = (step, start, stop), "accuracy" in options
        times = grid(system, trace, *span, options.get("record_step"), fitted)
        system = system.noted(*uneven_steps(system, coupling, times))
        if driving:
            driving, times = driving.on(times, system, divides)
        options = _resolved(options, system)
        ssv = [s for s in options.get("parameters") or () if str(s).endswith(SSV)]
        files = [*ssv, *([file] if file else [])]
        return Job(system, driving, times, coupling, options, provenance(system, files))

    @property
    def signals(self) -> Sequence[str] | None:
        """The names of the signals to record; None: all outputs and inputs."""
        record: Sequence[str] | None = self.options.get("record")
        return record

    @property
    def worker_limits(self) -> WorkerLimits:
        """The limits of a process; their time begins with the command."""
        memory = min(1e9 * self.options.get("memory_limit", math.inf), machine_memory())
        return WorkerLimits(total_time=self.options.get("time_limit", math.inf), memory=memory)

    @property
    def command_began(self) -> float:
        """When the command began, by `time.monotonic` [s]; of use only with a time limit.

        Infinite if the limit is that of a run, without the start of its process.
        """
        began: float = self.options.get("deadline", math.inf) - self.options.get("time_limit", math.inf)
        return began

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


def _resolved(options: Options, system: System) -> Options:
    """The options with a condition in place of a text, and with names in place of patterns."""
    found = {**options}
    until, record = options.get("until"), options.get("record")
    if until is not None:
        found["until"] = until = condition(system, until)
    if record is not None:
        names = [str(port) for causality in ("output", "input") for port in system.ports(causality)]
        wanted = [name for pattern in record for name in matching(names, pattern) or [pattern]]
        wanted += [until.signal] if isinstance(until, Comparison) else []
        found["record"] = tuple(dict.fromkeys(wanted))
    return found
