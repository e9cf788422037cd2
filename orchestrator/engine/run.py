"""`run`: co-simulates a system with the user's choices; `run_to_file`: the same for the command line.

Both run the job in a process of its own, see `isolated`, unless they are asked not to.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, Unpack

from orchestrator.base.errors import Problem, Stopped
from orchestrator.base.files import Location, find, make_folder, require_system, tell_once, write_whole
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.options import checked, declarations, documented, merged, taken
from orchestrator.base.processes import size_text
from orchestrator.base.progress import Doing, overwrites
from orchestrator.base.signals import matching
from orchestrator.data.table import READABLE
from orchestrator.data.trace import SAME_TIME, Data, Trace, as_trace, read_trace
from orchestrator.data.trace_writer import RowLayout, TraceFile, TraceInMemory, TraceSink
from orchestrator.engine.accuracy import AccuracySearch, estimates_errors
from orchestrator.engine.arguments import RunArguments, SystemArguments
from orchestrator.engine.isolated import run_isolated, start_process
from orchestrator.engine.job import (
    Execution,
    Job,
    Record,
    RunEnd,
    guarded,
    open_slave,
    with_default_guard,
)
from orchestrator.engine.result import (
    Card,
    Interrupted,
    Result,
    RunFailed,
    changes,
    metadata_file,
    metadata_text,
)
from orchestrator.engine.scenario import drive, with_changes
from orchestrator.engine.time_grid import (
    RECORD_STEP,
    Grid,
    grid,
    record_interval,
    step_length,
    time_span,
)
from orchestrator.engine.until import Comparison, Until, condition
from orchestrator.fmi.description import Value
from orchestrator.ssp.coupling import Coupling, take_coupling
from orchestrator.ssp.dependencies import late_effects
from orchestrator.ssp.load import configured
from orchestrator.ssp.masters import Master
from orchestrator.ssp.parameter_sets import SUFFIX as SSV
from orchestrator.ssp.plausible import (
    doubtful_columns,
    doubtful_starts,
    doubts_told,
    refuse_long,
    with_doubts,
)
from orchestrator.ssp.provenance import built_notes, provenance
from orchestrator.ssp.system import System

FIRST_SHARE = 0.001  # of a run, from which on the time that it will take is estimated
MANY_STEPS = 10**7  # 20 s of the harvester's FMUs: from here on a run says in advance what it will take

ScenarioSource: TypeAlias = "Data | str | Path | Location | None"
Accept: TypeAlias = Callable[[System, Grid, RowLayout], None]

__all__ = [
    "Execution", "Interrupted", "Record", "Result", "RunFailed", "open_slave", "run",
]  # what a caller of `run` needs  # fmt: skip


@documented(RunArguments)
def run(
    system: System | str | Path,
    scenario: ScenarioSource = None,
    *,
    record: Record | str | Sequence[str] | None = None,
    execution: Execution | None = None,
    **options: Unpack[RunArguments],
) -> Result:
    """Co-simulate a system.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    scenario     inputs over time: a .csv, .parquet or .mat file, a Trace, a pandas DataFrame, a structured
                 array, or a mapping such as {"time": [0, 1, 1.3], "boom_command": [0, 0, 5]}, whose values
                 may be functions of the time [s]; a column has the name of an input
                 of the system, of component.variable, or of all component inputs with this name; it replaces
                 the connection to its input
    record       names of the signals to record, or patterns such as "boom_*", or a `Record`, also with step
                 and power bonds
    execution    tolerance of the FMUs, error estimate, progress bar, other component classes: see
                 `Execution`

    Quantities may have a unit: stop=2.0 is stop="2000 ms". Values of `swap`, `set` and `factors` are
    mappings, such as set={"boom_stick.oil_density": "870 kg/m3"}. `master` may be a `Coupling`.

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    request = requested(system, scenario, record, execution, options)
    return co_simulate(request, lambda _: TraceInMemory())[0]


def attempt(
    system: System | str | Path,
    scenario: ScenarioSource = None,
    record: Record | str | Sequence[str] | None = None,
    **options: Unpack[RunArguments],
) -> tuple[Result, str]:
    """The result of `run`, also if it ended early, and why it did; raises Problem if it did not begin."""
    try:
        return run(system, scenario, record=record, **options), ""
    except RunFailed as failed:
        return failed.result, str(failed)


@dataclass(frozen=True)
class Request:
    """A system with the connections and FMUs that a user chose, and all other choices for its run.

    coupling   settings by the names of the fields of `Coupling`, which change those of the system
    """

    system: System
    scenario: ScenarioSource
    record: Record
    execution: Execution
    coupling: Mapping[str, Any]
    step: float | None = None
    start: float | None = None
    stop: float | None = None
    parameters: Sequence[str | Path] = ()
    set: Mapping[str, Value | str] = field(default_factory=dict)
    yes: bool | None = None
    fault: Mapping[str, Value | str] = field(default_factory=dict)

    def search(self) -> AccuracySearch | None:
        """The search for the accuracy that is asked for; None without one.

        Raises Problem if it is asked for together with a choice that it makes.
        """
        accuracy = self.execution.accuracy
        if accuracy is None:
            return None
        given = {"step": self.step, **self.coupling}
        if isinstance(master := given.get("master"), Master):
            given["master"] = master.name
        for name, value in given.items():
            if value is not None:
                asked = f"accuracy {accuracy:g}"
                raise Problem(f"{asked}: expected no {name}, which follows from it, got {value}")
        return AccuracySearch(self.system, self.execution, accuracy)

    def next_of(self, search: AccuracySearch) -> Request:
        """This request with the settings of the next run of a search."""
        settings, record = search.settings, self.record
        if record.signals is not None:
            record = replace(record, signals=tuple(dict.fromkeys((*record.signals, *search.signals))))
        execution = replace(self.execution, tolerance=settings.tolerance, error_estimate=True)
        system = self.system.coupled(settings.coupling)
        return replace(self, system=system, record=record, execution=execution, step=settings.step)

    @property
    def coupled(self) -> System:
        """The system with the coupling that is asked for."""
        return self.system.coupled(self.coupling) if self.coupling else self.system

    def job(self) -> Job:
        """The job of a run."""
        system, scenario, record, execution = self.coupled, self.scenario, self.record, self.execution
        own = system.coupling.method if system.coupling and system.coupling.method.own else None
        execution.check(own)
        execution = replace(execution, isolate=execution.isolate and own is None)
        if execution.isolated:
            start_process()
        system = replace(system, notes=system.notes + system.suggestion.notes(self.step is not None))
        differences = system.differences(system.common)
        system = replace(system, notes=(*system.notes, *built_notes(system), *differences))
        (scenario, trace, label), driving = scenario_trace(scenario), None
        if self.fault:
            ends = time_span(system, trace, self.start, self.stop)
            trace, label = with_changes(system, trace, self.fault, ends[:2]), label if trace else "fault"
        columns = trace.signals if trace is not None else ()
        system = replace(system, notes=system.notes + system.without_effect([*self.set, *columns]))
        if trace is not None:
            driving = drive(system, trace, label)
            system = driving.released(system)
            system = replace(system, notes=system.notes + driving.overruled(system, self.set))
        system = with_doubts(system, doubtful_starts(system))
        if driving and trace is not None:
            if self.stop is None and not self.yes:
                refuse_long(system, trace, label)
            system = with_doubts(system, doubtful_columns(system, trace, driving.columns, label))
        system = with_default_guard(system, self.step)
        coupling = system.coupling or Coupling()
        coupling.check(system.components)
        divides = coupling.adaptive is not None or guarded(system, coupling)
        span, fitted = (self.step, self.start, self.stop), execution.accuracy is not None
        times = grid(system, trace, *span, record.step, fitted)
        if driving:
            driving, times = driving.on(times, system, divides)
        if execution.until is not None:
            execution = replace(execution, until=condition(system, execution.until))
            if record.signals is not None and isinstance(execution.until, Comparison):
                record = replace(record, signals=(*record.signals, execution.until.signal))
        if record.signals is not None:
            names = [str(port) for causality in ("output", "input") for port in system.ports(causality)]
            wanted = (name for pattern in record.signals for name in matching(names, pattern) or [pattern])
            record = replace(record, signals=tuple(dict.fromkeys(wanted)))
        ssv = [s for s in self.parameters if str(s).endswith(SSV)]
        files = [*ssv, *([scenario] if isinstance(scenario, Path | Location) else [])]
        return Job(system, driving, times, coupling, record, execution, provenance(system, files))


def scenario_trace(scenario: ScenarioSource) -> tuple[ScenarioSource, Trace | None, str]:
    """The scenario, with the file that was found, its trace if there is one, and its name in messages."""
    if isinstance(scenario, str | Path):
        scenario = find(scenario, READABLE)
    if isinstance(scenario, Path | Location):
        return scenario, read_trace(scenario), str(scenario)
    return scenario, None if scenario is None else as_trace(scenario, "scenario"), "scenario"


def requested(
    system: System | str | Path,
    scenario: ScenarioSource,
    record: Record | str | Sequence[str] | None,
    execution: Execution | None,
    options: Mapping[str, Any],
) -> Request:
    """What is asked for by the arguments of `run`."""
    given = checked(RunArguments, options, "run")
    if not isinstance(record, Record):
        record = Record((record,) if isinstance(record, str) else record and tuple(record))
    record = merged(record, taken(given, record_step="step", bonds="bonds"), step="record_step")
    execution = merged(execution or Execution(), taken(given, *(f.name for f in fields(Execution))))
    coupling, of_system = take_coupling(given), taken(given, *declarations(SystemArguments))
    values = {name: v for name, v in of_system.items() if name in ("parameters", "set")}
    system = configured(system, **of_system)
    return Request(system, scenario, record, execution.begun(), coupling, **values, **given)


Sink = TypeVar("Sink", bound=TraceSink)


def co_simulate(
    request: Request,
    new_sink: Callable[[Job], Sink],
    keep: Callable[[Result, Sink, Callable[[], None]], None] = lambda *_: None,
) -> tuple[Result, Sink]:
    """The result of the run that is asked for, or of the last of those of a search, and its sink.

    new_sink   makes the sink of a run
    keep       called with the result, its sink, and a function that raises KeyboardInterrupt if the user has
               interrupted meanwhile
    """
    search = request.search()
    while True:
        job = (request.next_of(search) if search else request).job()
        if search and (alone := search.sources_alone(job)):
            looks = TraceInMemory()
            search.heed(simulate(alone, looks), looks)
            job = request.next_of(search).job()
        if search and search.runs and request.execution.progress:
            tell_once(f"note: {search.cost(job.times.stop - job.times.start)}")
        sink = new_sink(job)
        try:
            end = simulate(job, sink)
            with DeferredInterrupts(second_at_once=False) as interrupts:
                result: Result | None = finished(job, end, sink)
                if search and result is not None:
                    result = search.judge(result)
                if result is not None:  # one without signals is false
                    keep(result, sink, interrupts.check)
        except RunFailed as failed:
            if not (search and not failed.final and not failed.result.complete and search.goes_on()):
                raise
            result = None
        finally:
            sink.close()
        if result is not None:
            estimate = request.execution.error_estimate and not search
            return with_error_estimate(job, result) if estimate else result, sink


def prepare(
    system: System | str | Path,
    scenario: ScenarioSource = None,
    record: Record | str | Sequence[str] | None = None,
    execution: Execution | None = None,
    **options: Unpack[RunArguments],
) -> Job:
    """The job of a run; arguments of `run`."""
    return requested(system, scenario, record, execution, options).job()


def simulate(job: Job, sink: TraceSink) -> RunEnd:
    """Run a job, in a process of its own or in this one; the rows go to `sink`."""
    until = Until(job.execution.until, sink) if job.execution.until is not None else None
    job = replace(job, execution=replace(job.execution, until=None))  # functions stay in this process
    times = job.times
    with ProgressBar(times.stop - times.start, job.execution.progress) as bar, doubts_told(job.system):

        def between(t: float) -> bool:
            bar.update(t - times.start)
            return until is not None and until.reached is not None

        if job.execution.isolated:
            end = run_isolated(job, until or sink, between)
        else:
            from orchestrator.engine.open_job import run_job  # a process that only supervises needs it not

            end = run_job(job, until or sink, between)
        return until.ended(end) if until else end


def finished(job: Job, outcome: RunEnd, sink: TraceSink) -> Result:
    """The result of a complete run; raises RunFailed or Interrupted with the result of another one."""
    trace = sink.trace
    messages = sorted((m for log in outcome.logs for m in log.messages), key=lambda m: m.time)
    card = job.card(outcome, sink, trace)
    result = Result(
        job.system, trace, card, tuple(messages), outcome.complete, job.coupling, job.provenance, sink.errors
    )
    if outcome.interrupted:
        raise Interrupted(result, str(outcome.problem or ""))
    if outcome.problem:
        cause = card.likely_cause(job.coupling.method.repeats)
        problem = Problem(f"{outcome.problem}; {cause}") if cause else outcome.problem
        raise RunFailed(problem, result, outcome.died) from outcome.problem
    return result


def with_error_estimate(job: Job, result: Result) -> Result:
    """A complete run with error estimates on its card, or with a note if a further run fails.

    If the run itself has estimated its errors, there are no further runs.
    """
    if late := late_effects(job.system):
        reason = f"effects of {late} may come up to a step late, also in a run at half the step"
        return replace(result, errors=None).noted(f"no error estimate: {reason}", errors=())
    if result.card.errors_of_inputs:
        return result

    def repeated(job: Job) -> Result:
        sink = TraceInMemory()
        return finished(job, simulate(job, sink), sink)

    times = job.times
    short = result.card.simulated < (1.0 - SAME_TIME) * (times.stop - times.start)
    if short and job.execution.until is not None:
        return result.noted("no error estimate: the run ended before its stop time")
    if times.free:
        reason = "two adaptive runs have common times only with a record step; set --record-step"
        return result.noted(f"no error estimate: {reason}")
    adaptive = job.coupling.adaptive is not None
    try:
        fine = repeated(job.stricter() if adaptive else replace(job, times=times.finer()))
        coarse = None
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                coarse = repeated(replace(job, times=times.coarser()))
    except Problem as failed:
        setting = "a tenth of the tolerance" if adaptive else "half the step"
        return result.noted(f"no error estimate, the run at {setting} failed: {failed}")
    except Interrupted as interrupted:
        raise Interrupted(result, str(interrupted)) from None
    errors = changes(coarse, result, fine)
    notes = () if errors else ("no error estimate: no output changes",)
    return result.noted(*notes, errors=errors)


class ProgressBar(AbstractContextManager["ProgressBar"]):
    """Shows on a terminal or in a notebook how much of `total` [s] is simulated, if it takes long.

    delay   wall time until it appears [s]
    """

    delay = 1.0

    def __init__(self, total: float, enabled: bool) -> None:
        self._total, self._enabled = total, enabled and overwrites(sys.stderr)
        self._began, self._simulated = time.perf_counter(), -1.0
        self._line: Doing | None = None

    def __exit__(self, *_: object) -> None:
        if self._line is not None:
            self._line.end()

    def update(self, simulated: float) -> None:
        """Show that `simulated` [s] are simulated."""
        passed = time.perf_counter() - self._began
        if not self._enabled or simulated == self._simulated or (self._line is None and passed < self.delay):
            return
        self._simulated = simulated
        share = simulated / self._total if self._total else 1.0
        bar = f"{'#' * round(30 * share):.<30}"
        left = f", {passed * (1 / share - 1):.0f} s left" if share > FIRST_SHARE else ""
        text = f"{simulated:.2f} of {self._total:g} s simulated [{bar}]{left}"
        if self._line is None:
            self._line = Doing(text)
        self._line.update(text)


# ---- for the command line


def run_to_file(
    system: Path,
    scenario: Path | Trace | None,
    out: Path,
    every_point: bool = True,
    default_accuracy: float | None = None,
    accept: Accept = lambda *_: None,
    **options: Unpack[RunArguments],
) -> tuple[Result, str]:
    """Co-simulate with a progress bar, and write the rows to the file `out` while they are made.

    The file gets its name at the end of a complete run, together with its metadata. The rows of a run that
    ends early stay in a partial file, see `trace_writer`. Returns the result and a line about the file.

    every_point   without a record step an adaptive run records every communication point, else every 5 ms;
                  equal steps: every point of the largest multiple of the step up to 5 ms, at least one step
    default_accuracy   of a run without an accuracy, if neither the user nor the system chooses step or
                       coupling, and the FMUs declare what the estimate of errors needs
    accept        called before the first step with the system, the times and the signals that the file will
                  have; a Problem that it raises ends the run
    """
    start_process()
    given = checked(RunArguments, options, "run")
    request = requested(require_system(system), scenario, None, None, {"progress": True, **given})
    execution, record = request.execution, request.record
    free = execution.accuracy is None and chooses_freely(request.system, request.step, request.coupling)
    if free and default_accuracy:
        request = replace(request, execution=replace(execution, accuracy=default_accuracy))
    coupling = request.coupled.coupling
    if record.step is None and (request.execution.accuracy or (coupling and coupling.adaptive is not None)):
        record = replace(record, step=None if every_point else RECORD_STEP)
    elif record.step is None:
        record = replace(record, step=record_interval(step_length(request.coupled, request.step)))
    make_folder(out.parent)
    output = _Output(out, {**given, "scenario": None if isinstance(scenario, Trace) else scenario}, accept)
    try:
        return co_simulate(replace(request, record=record), output.begun, output.keep)[0], output.line
    except RunFailed as failed:
        output.explain(failed, failed.result)
        raise
    except KeyboardInterrupt as interrupt:  # the library of the command line would drop its message
        stopped = Stopped(str(interrupt) or output.line)
        output.explain(stopped, getattr(interrupt, "result", None))
        raise stopped from None


class _Output:
    """A file with the rows of a run, and its metadata; line: about the complete file."""

    def __init__(self, path: Path, given: Mapping[str, Any], accept: Accept) -> None:
        self._path, self._given, self._accept = path, given, accept
        self._file = TraceFile(path)  # raises Problem for a wrong name
        self._complete: Result | None = None
        self.line = ""

    def begun(self, job: Job) -> TraceFile:
        """The file of a run, which says before the first step what a long run will take."""

        def accept(layout: RowLayout) -> None:
            times = job.times
            if times.steps >= MANY_STEPS:
                rows = size_text(times.rows, len(layout.names), self._file.number_size)
                tell_once(f"note: {times.steps:.3g} steps of {times.step:g} s up to {times.stop:g} s, {rows}")
            self._accept(job.system, times, layout)

        self._file = TraceFile(self._path)
        self._file.accept = accept
        return self._file

    def keep(self, result: Result, file: TraceFile, check: Callable[[], None]) -> None:
        """Give the file of a complete run its name."""
        file.origin = metadata_text(result, "", self._given, file.layout)
        complete, digest = file.finish(check)
        metadata = metadata_text(result, digest, self._given, file.layout)
        file.publish(complete, {metadata_file(file.path): metadata})
        self._complete, self.line = result, self._summary(result.card, file.path)

    def explain(self, error: Exception, result: Result | None) -> None:
        """Add to an error what is kept of a run with this result; a part of a run gets its metadata."""
        if self._complete:
            error.add_note(self._complete.card.text())
        elif result and not result.complete:
            file = self._file
            if file.partial.is_file():  # CSV; Parquet contains the units
                with suppress(OSError, Problem):  # the disk may be full
                    text = metadata_text(result, file.sha256, self._given, file.layout)
                    write_whole(metadata_file(file.partial), text)
            end = f" up to t = {file.last:.6g} s" if file.rows else ""
            summary = self._summary(result.card, file.partial)
            error.add_note(f"{result.card.text()}\n\nthe run ended early; the trace{end} is in {summary}")

    def _summary(self, card: Card, name: Path) -> str:
        """A file with its number of signals and rows, and the record step."""
        has_interval = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
        interval = f", every {card.record_step:g} s" if has_interval else ""
        return f"{name}: {len(self._file.layout.names)} signals, {self._file.rows} rows{interval}"


def chooses_freely(system: System, step: float | None, coupling: Mapping[str, Any] | None) -> bool:
    """May a default accuracy choose the coupling, because neither the user nor the system does?"""
    suggestion = system.suggestion
    chosen = step is not None or coupling or suggestion.step or suggestion.coupling or suggestion.refusal
    return not chosen and estimates_errors(system)
