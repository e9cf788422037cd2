"""`run`: co-simulates a system with the user's choices; `run_to_file`: the same for the command line.

Both run the job in a process of its own, see `isolated`, unless they are asked not to.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias, Unpack

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Problem, Stopped
from orchestrator.base.files import Location, find, make_folder, require_system, tell_once
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.options import (
    FIELDS,
    CouplingArguments,
    RunArguments,
    chosen,
    declarations,
    documented,
)
from orchestrator.base.processes import size_text
from orchestrator.base.progress import Doing, overwrites
from orchestrator.data.table import SUFFIXES
from orchestrator.data.trace import Data, Trace, as_trace, read_trace
from orchestrator.data.trace_writer import RowLayout, TraceFile, TraceInMemory, TraceSink
from orchestrator.engine.accuracy import AccuracySearch, estimates_errors
from orchestrator.engine.isolated import run_isolated, start_process
from orchestrator.engine.job import Execution, Job, Record, RunEnd, guarded, open_slave
from orchestrator.engine.result import (
    Card,
    Interrupted,
    Result,
    RunFailed,
    compare,
    metadata_file,
    metadata_text,
    relative_errors,
)
from orchestrator.engine.scenario import Scenario, drive
from orchestrator.engine.time_grid import (
    RECORD_STEP,
    Grid,
    free_grid,
    grid,
    record_interval,
    step_length,
    with_events,
)
from orchestrator.fmi.description import Value
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import SUFFIX as SSV
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.plausible import doubtful_columns, doubtful_end, doubtful_starts, with_doubts
from orchestrator.ssp.provenance import built_notes, provenance
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

MANY_STEPS = 10**7  # 20 s of the harvester's FMUs: from here on a run says in advance what it will take

ScenarioSource: TypeAlias = "Data | str | Path | Location | None"

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
    scenario     inputs over time: a .csv, .parquet or .mat file, a Trace, a pandas DataFrame, or a mapping
                 such as {"time": [0, 1, 1.3], "boom_command": [0, 0, 5]}; a column has the name of an input
                 of the system, of component.variable, or of all component inputs with this name; it replaces
                 the connection to its input
    record       names of the signals to record, or a `Record`, also with step and power bonds
    execution    tolerance of the FMUs, error estimate, progress bar, other component classes: see
                 `Execution`

    Quantities may have a unit: stop=2.0 is stop="2000 ms". Values of `swap`, `set` and `factors` are
    mappings, such as set={"boom_stick.oil_density": "870 kg/m3"}. `master` may be a `Coupling`.

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    given = chosen(RunArguments, options, "run")
    record, execution = _take_execution(given, record, execution)
    coupling, system = take_coupling(given), opened(system, given)
    search = accuracy_search(system, execution, {"step": given.get("step"), **coupling})
    system = system.coupled(coupling) if coupling else system
    while True:
        job, times = _trial(search, system, scenario, record, execution, given)
        sink = TraceInMemory()
        try:
            result = finished(job, times, simulate(job, times, sink), sink, sink.trace)
        except RunFailed as failed:
            if search and not failed.final and search.goes_on():
                continue
            raise
        if search is None:
            return with_error_estimate(job, times, result) if execution.error_estimate else result
        if accurate := search.judge(result):
            return accurate


def take_coupling(given: dict[str, Any]) -> dict[str, Any]:
    """The options of the coupling, by the names of the fields of `Coupling`, taken out of those of a run."""
    names = [name for name in declarations(CouplingArguments) if name in given]
    choices = {FIELDS.get(name, name): given.pop(name) for name in names}
    whole = choices.get("master")
    return {**vars(whole), **choices, "master": whole.master} if isinstance(whole, Coupling) else choices


def opened(system: System | str | Path, given: dict[str, Any], exchange: bool = False) -> System:
    """The system with the connections and FMUs of the options, which are taken out of those of a run."""
    system = system if isinstance(system, System) else load(system, exchange)
    return with_swaps(system.without(*given.pop("cut", ())), given.pop("swap", {}), exchange)


def _take_execution(
    given: dict[str, Any], record: Record | str | Sequence[str] | None, execution: Execution | None
) -> tuple[Record, Execution]:
    """The record and the execution, with single options, which are taken out of those of a run."""
    if not isinstance(record, Record):
        record = Record((record,) if isinstance(record, str) else record and tuple(record))
    of_record = {"record_step": "step", "bonds": "bonds"}
    record = replace(record, **{of_record[name]: given.pop(name) for name in of_record.keys() & given.keys()})
    names = {f.name for f in fields(Execution)} & given.keys()
    execution = replace(execution or Execution(), **{name: given.pop(name) for name in names})
    return record, execution.begun()


def accuracy_search(
    system: System, execution: Execution, choices: Mapping[str, Any]
) -> AccuracySearch | None:
    """The search for the accuracy that is asked for; None without one.

    choices   of coupling and step, by name; None: no choice

    Raises Problem if it is asked for together with a choice that it makes.
    """
    if execution.accuracy is None:
        return None
    for name, value in choices.items():
        if value is not None:
            asked = f"accuracy {execution.accuracy:g}"
            raise Problem(f"{asked}: expected no {name}, which follows from it, got {value}")
    return AccuracySearch(system, execution, execution.accuracy)


def _trial(
    search: AccuracySearch | None,
    system: System,
    scenario: ScenarioSource,
    record: Record,
    execution: Execution,
    given: Mapping[str, Any],
) -> tuple[Job, Grid]:
    """The job of the next run of a search, or of the only run without one, and its communication points."""
    if search is None:
        return _job(system, scenario, record, execution, **given)
    settings, again = search.settings, search.runs > 0
    if record.signals is not None:
        record = replace(record, signals=tuple(dict.fromkeys((*record.signals, *search.signals))))
    execution = replace(execution, tolerance=settings.tolerance, error_estimate=True)
    system = system.coupled(settings.coupling)
    job, times = _job(system, scenario, record, execution, **{**given, "step": settings.step})
    if again and execution.progress:
        tell_once(f"note: {search.cost(times.stop - times.start)}")
    return job, times


def prepare(
    system: System | str | Path,
    scenario: ScenarioSource = None,
    record: Record | str | Sequence[str] | None = None,
    execution: Execution | None = None,
    **options: Unpack[RunArguments],
) -> tuple[Job, Grid]:
    """The job of a run and its communication points; arguments of `run`."""
    given = chosen(RunArguments, options, "run")
    record, execution = _take_execution(given, record, execution)
    coupling, system = take_coupling(given), opened(system, given)
    return _job(system.coupled(coupling) if coupling else system, scenario, record, execution, **given)


def _job(
    system: System,
    scenario: ScenarioSource,
    record: Record,
    execution: Execution,
    step: float | None = None,
    start: float | None = None,
    stop: float | None = None,
    parameters: Sequence[str | Path] = (),
    set: Mapping[str, Value | str] | None = None,
) -> tuple[Job, Grid]:
    """The job of a run of a system with its connections and coupling."""
    execution.check()
    if execution.isolated:
        start_process()
    system = replace(system, notes=system.notes + system.suggestion.notes(step is not None))
    system = with_sets(system, parameters).with_start(set or {})
    system = replace(system, notes=system.notes + built_notes(system))
    if isinstance(scenario, str | Path):
        scenario = find(scenario, SUFFIXES)
    trace, driving = _scenario(system, scenario)
    if driving:
        system = driving.released(system)
        system = replace(system, notes=system.notes + driving.overruled(system, set or {}))
    system = with_doubts(system, doubtful_starts(system))
    if driving and trace is not None:
        label = "scenario" if isinstance(scenario, Trace | Mapping) else str(scenario)
        if execution.progress and (doubt := doubtful_end(system, trace, label)):
            tell_once(f"warning: {doubt}")  # before a long run, not only on its card
        system = with_doubts(system, doubtful_columns(system, trace, driving.columns, label))
    coupling = system.coupling or Coupling()
    coupling.check(system.components)
    if coupling.adaptive is None:
        times = grid(system, trace, step, start, stop, record.step, execution.accuracy is not None)
        if driving and guarded(system, coupling):
            times = with_events(times, driving.table.corners())
    else:
        corners = driving.table.corners() if driving else ()
        times = free_grid(system, trace, step, start, stop, record.step, corners)
    ssv = [s for s in parameters if str(s).endswith(SSV)]
    files = [*ssv, *([scenario] if isinstance(scenario, str | Path | Location) else [])]
    return Job(system, driving, coupling, record, execution, provenance(system, files)), times


def simulate(job: Job, times: Grid, sink: TraceSink) -> RunEnd:
    """Run a job, in a process of its own or in this one; the rows go to `sink`."""
    with ProgressBar(times.stop - times.start, job.execution.progress) as bar:
        run_job = run_isolated if job.execution.isolated else Job.run
        return run_job(job, times, sink, lambda t: bar.update(t - times.start))


def finished(job: Job, times: Grid, outcome: RunEnd, sink: TraceSink, trace: Trace) -> Result:
    """The result of a complete run; raises RunFailed or Interrupted with the result of another one."""
    messages = sorted((m for log in outcome.logs for m in log.messages), key=lambda m: m.time)
    card = job.card(times, outcome, sink)
    if outcome.errors:
        nominals = {str(p): job.system.variable(p).nominal for p in job.system.ports("output")}
        card = replace(card, errors=relative_errors(outcome.errors, trace, nominals), errors_of_inputs=True)
    result = Result(
        job.system,
        trace,
        card,
        tuple(messages),
        outcome.complete,
        job.coupling,
        job.provenance,
        sink.errors,
    )
    if outcome.interrupted:
        raise Interrupted(result, str(outcome.problem or ""))
    if outcome.problem:
        cause = card.likely_cause()
        problem = Problem(f"{outcome.problem}; {cause}") if cause else outcome.problem
        raise RunFailed(problem, result, outcome.died) from outcome.problem
    return result


def _scenario(system: System, scenario: ScenarioSource) -> tuple[Trace | None, Scenario | None]:
    if scenario is None:
        return None, None
    if isinstance(scenario, str | Path | Location):
        trace = read_trace(scenario, jumps=True)
        return trace, drive(system, trace, str(scenario))
    trace = as_trace(scenario, "scenario", jumps=True)
    return trace, drive(system, trace)


def with_error_estimate(job: Job, times: Grid, result: Result) -> Result:
    """A complete run with error estimates on its card, or with a note if a further run fails.

    If the run itself has estimated its errors, there are no further runs.
    """
    if result.card.errors_of_inputs:
        return result

    def repeated(job: Job, times: Grid) -> Trace:
        sink = TraceInMemory()
        return finished(job, times, simulate(job, times, sink), sink, sink.trace).trace

    def with_note(text: str) -> Result:
        return replace(result, card=replace(result.card, notes=(*result.card.notes, text)))

    if times.free:
        return with_note(
            "no error estimate: two adaptive runs have common times only with a record step; "
            "set --record-step"
        )
    adaptive = job.coupling.adaptive is not None
    try:
        fine_job, fine_times = (job.stricter(), times) if adaptive else (job, times.finer())
        fine, coarse = repeated(fine_job, fine_times), None
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                coarse = repeated(job, times.coarser())
    except Problem as failed:
        setting = "a tenth of the tolerance" if adaptive else "half the step"
        return with_note(f"no error estimate, the run at {setting} failed: {failed}")
    except Interrupted as interrupted:
        raise Interrupted(result, str(interrupted)) from None
    nominals = {str(p): job.system.variable(p).nominal for p in job.system.ports("output")}
    outputs = result.trace.select(name for name in nominals if name in result.trace.signals)
    errors = compare(fine, outputs, coarse, nominals)
    notes = () if errors else ("no error estimate: no output changes",)
    card = replace(result.card, errors=errors, notes=(*result.card.notes, *notes))
    return replace(result, card=card)


class ProgressBar:
    """Shows on a terminal or in a notebook how much of `total` [s] is simulated, if it takes long.

    delay   wall time until it appears [s]
    """

    delay = 1.0

    def __init__(self, total: float, enabled: bool) -> None:
        self._total, self._enabled = total, enabled and overwrites(sys.stderr)
        self._began = time.perf_counter()
        self._line: Doing | None = None

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, type_: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._line is not None:
            self._line.end()

    def update(self, simulated: float) -> None:
        """Show that `simulated` [s] are simulated."""
        passed = time.perf_counter() - self._began
        if not self._enabled or (self._line is None and passed < self.delay):
            return
        share = simulated / self._total if self._total else 1.0
        bar = f"{'#' * round(30 * share):.<30}"
        left = f", {passed * (1 / share - 1):.0f} s left" if share else ""
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
    accept: Callable[[System, Grid, RowLayout], None] | None = None,
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
    given = chosen(RunArguments, options, "run")
    noted = {**given, "scenario": None if isinstance(scenario, Trace) else scenario}
    record, execution = _take_execution(given, None, Execution(progress=True))
    coupling, loaded, step = take_coupling(given), opened(require_system(system), given), given.get("step")
    if execution.accuracy is None and default_accuracy and chooses_freely(loaded, step, coupling):
        execution = replace(execution, accuracy=default_accuracy)
    search = accuracy_search(loaded, execution, {"step": step, **coupling})
    loaded = loaded.coupled(coupling) if coupling else loaded
    if record.step is None and (search or (loaded.coupling and loaded.coupling.adaptive is not None)):
        record = replace(record, step=None if every_point else RECORD_STEP)
    elif record.step is None:
        record = replace(record, step=record_interval(step_length(loaded, step)))
    make_folder(out.parent)
    while True:
        file = TraceFile(out)
        job, times = _trial(search, loaded, scenario, record, execution, given)
        file.accept = partial(_begins, times, partial(accept, job.system, times) if accept else None)
        result, summary = None, ""
        try:
            outcome = simulate(job, times, file)
            with DeferredInterrupts(second_at_once=False) as interrupts:
                result, summary = _published(job, times, outcome, file, noted, interrupts.check, search)
            if result is None:
                continue
            estimate = execution.error_estimate and not search
            return with_error_estimate(job, times, result) if estimate else result, summary
        except KeyboardInterrupt as interrupt:  # the library of the command line would drop its message
            file.close()
            if result:  # the file is complete
                print(result.card.text())
            raise Stopped(str(interrupt) or summary) from None
        except BaseException:
            file.close()
            raise


def _begins(times: Grid, accept: Callable[[RowLayout], None] | None, layout: RowLayout) -> None:
    """Say what a long run will take, before its first step."""
    if times.steps >= MANY_STEPS:
        rows = size_text(times.rows, len(layout.names))
        tell_once(f"note: {times.steps:.3g} steps of {times.step:g} s up to {times.stop:g} s, {rows}")
    if accept is not None:
        accept(layout)


def chooses_freely(system: System, step: float | None, coupling: Mapping[str, Any] | None) -> bool:
    """May a default accuracy choose the coupling, because neither the user nor the system does?"""
    suggestion = system.suggestion
    chosen = step is not None or coupling or suggestion.step or suggestion.coupling or suggestion.refusal
    return not chosen and estimates_errors(system)


def _published(
    job: Job,
    times: Grid,
    outcome: RunEnd,
    file: TraceFile,
    given: Mapping[str, Any],
    check: Callable[[], None],
    search: AccuracySearch | None,
) -> tuple[Result | None, str]:
    """Give the file of a complete run its name; raises RunFailed or Interrupted for another one.

    The result is None if the search needs another run.
    """
    try:
        result = finished(
            job, times, outcome, file, file.trace(file.path if outcome.complete else file.partial)
        )
    except (RunFailed, Interrupted) as ended:
        file.close()
        if search and isinstance(ended, RunFailed) and not ended.final and search.goes_on():
            return None, ""
        if file.partial.is_file():  # CSV; Parquet contains the units
            with suppress(OSError):  # the disk may be full
                text = metadata_text(ended.result, file.sha256, given, file.layout)
                metadata_file(file.partial).write_text(text, encoding="utf-8", newline="\n")
        end = f" up to t = {file.last:.6g} s" if file.rows else ""
        summary = _summary(ended.result.card, file, file.partial)
        print(f"{ended.result.card.text()}\n\nthe run ended early; the trace{end} is in {summary}")
        raise
    accurate = search.judge(result) if search else result
    if accurate is None:
        file.close()
        return None, ""
    result = accurate
    file.origin = metadata_text(result, "", given, file.layout)
    complete, digest = file.finish(check)
    file.publish(complete, {metadata_file(file.path): metadata_text(result, digest, given, file.layout)})
    return result, _summary(result.card, file, file.path)


def _summary(card: Card, file: TraceFile, name: Path) -> str:
    """A file with its number of signals and rows, and the record step."""
    has_interval = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
    interval = f", every {card.record_step:g} s" if has_interval else ""
    return f"{name}: {len(file.layout.names)} signals, {file.rows} rows{interval}"
