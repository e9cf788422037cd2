"""`run`: co-simulates a system with the user's choices; `run_to_file`: the same for the command line.

Both run the job in a process of its own, see `isolated`, unless they are asked not to.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias, TypeVar, Unpack

from orchestrator.base.errors import Problem, Stopped
from orchestrator.base.files import make_folder, require_system, tell_once, write_whole
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.options import chosen, documented
from orchestrator.base.processes import size_text
from orchestrator.base.progress import Doing, overwrites
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import RowLayout, TraceFile, TraceInMemory, TraceSink
from orchestrator.engine.arguments import RunArguments
from orchestrator.engine.isolated import run_isolated, start_process
from orchestrator.engine.job import Job, Request, isolated, open_slave
from orchestrator.engine.options import RunOptions
from orchestrator.engine.refinement import with_error_estimate
from orchestrator.engine.result import (
    Card,
    Interrupted,
    Result,
    RunEnd,
    RunFailed,
    metadata_file,
    metadata_text,
    write_events,
)
from orchestrator.engine.scenario import ScenarioSource
from orchestrator.engine.time_grid import RECORD_STEP, Grid, record_interval, step_length
from orchestrator.engine.until import Until
from orchestrator.ssp.coupling import CouplingOptions
from orchestrator.ssp.dependencies import estimates_errors
from orchestrator.ssp.plausible import doubts_told
from orchestrator.ssp.system import System

FIRST_SHARE = 0.001  # of a run, from which on the time that it will take is estimated
MANY_STEPS = 10**7  # 20 s of the harvester's FMUs: from here on a run says in advance what it will take

Accept: TypeAlias = Callable[[System, Grid, RowLayout], None]

__all__ = ["Interrupted", "Result", "RunFailed", "open_slave", "run"]  # what a caller of `run` needs


@documented(RunArguments)
def run(
    system: System | str | Path, scenario: ScenarioSource = None, **options: Unpack[RunArguments]
) -> Result:
    """Co-simulate a system.

    system       a System, or the path of an .ssp, .ssd or .fmu file
    scenario     inputs over time: a .csv, .parquet or .mat file, a Trace, a pandas DataFrame, a structured
                 array, or a mapping such as {"time": [0, 1, 1.3], "boom_command": [0, 0, 5]}, whose values
                 may be functions of the time [s]; a column has the name of an input
                 of the system, of component.variable, or of all component inputs with this name; it replaces
                 the connection to its input

    Quantities may have a unit: stop=2.0 is stop="2000 ms". Values of `swap`, `set` and `factors` are
    mappings, such as set={"boom_stick.oil_density": "870 kg/m3"}. `master` may be a `Coupling`.

    Raises Problem for a mistake, RunFailed or Interrupted when a started run ends early.
    """
    return co_simulate(Request.of(system, scenario, chosen(RunOptions, options, "run")))


def co_simulate(request: Request) -> Result:
    """The result of a request, as of `run`."""
    return _co_simulated(request, lambda _: TraceInMemory())[0]


def attempt(
    system: System | str | Path, scenario: ScenarioSource = None, **options: Unpack[RunArguments]
) -> tuple[Result, str]:
    """The result of `run`, also if it ended early, and why it did; raises Problem if it did not begin."""
    try:
        return run(system, scenario, **options), ""
    except RunFailed as failed:
        return failed.result, str(failed)


Sink = TypeVar("Sink", bound=TraceSink)


def _co_simulated(
    request: Request,
    new_sink: Callable[[Job], Sink],
    keep: Callable[[Result, Sink, Callable[[], None]], None] = lambda *_: None,
) -> tuple[Result, Sink]:
    """The result of the run that is asked for, or of the last of those of a search, and its sink.

    new_sink   makes the sink of a run
    keep       called with the result, its sink, and a function that raises KeyboardInterrupt if the user has
               interrupted meanwhile
    """
    search, options = None, request.options
    if options.accuracy is not None:
        from orchestrator.engine.accuracy import AccuracySearch  # not every run needs it

        search = AccuracySearch(request)
    if isolated(options):
        start_process()
    while True:
        job = (search.request if search else request).job()
        if search and (alone := search.sources_alone(job)):
            looks = TraceInMemory()
            search.heed(simulate(alone, looks), looks)
            job = search.request.job()
        if search and search.runs and options.progress:
            tell_once(f"note: {search.cost(job.times.stop - job.times.start)}")
        sink = new_sink(job)
        try:
            end = simulate(job, sink)
            with DeferredInterrupts(second_at_once=False) as interrupts:
                result = job.result(end, sink)
                if search and not search.accepts(result):
                    search.choose_stricter(result)
                    continue
                result = search.noted(result) if search else result
                keep(result, sink, interrupts.check)
                if end.closing and end.interrupted:
                    raise Interrupted(result, end.closing)
                if end.closing:
                    raise RunFailed(Problem(end.closing), result, end.died)
        except RunFailed as failed:
            if not (search and not failed.final and not failed.result.complete and search.goes_on()):
                raise
            continue
        finally:
            sink.close()
        estimate = options.error_estimate and not search
        return with_error_estimate(job, result, _in_memory) if estimate else result, sink


def simulate(job: Job, sink: TraceSink) -> RunEnd:
    """Run a job, in a process of its own or in this one; the rows go to `sink`."""
    until = Until(job.until, sink) if job.until is not None else None
    job = replace(job, until=None)  # functions stay in this process
    times = job.times
    with (
        ProgressBar(times.stop - times.start, bool(job.options.progress)) as bar,
        doubts_told(job.system),
    ):

        def between(t: float) -> bool:
            bar.update(t - times.start)
            return until is not None and until.reached is not None

        if isolated(job.options):
            end = run_isolated(job, until or sink, between)
        else:
            from orchestrator.engine.simulation_loop import (
                run_job,  # a process that only supervises needs it not
            )

            end = run_job(job, until or sink, between)
        return until.ended(end) if until else end


def _in_memory(job: Job) -> Result:
    """The result of a job, whose rows are in memory."""
    sink = TraceInMemory()
    return job.result(simulate(job, sink), sink)


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
    options: RunOptions | None = None,
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
    given = options or RunOptions()
    request = Request.of(require_system(system), scenario, replace(given, progress=True))
    loaded, step, choices = request.system, given.step, given.coupling
    parts = given.accuracy is not None or given.save_state is not None or given.resume is not None
    if default_accuracy and not parts and chooses_freely(loaded, step, choices):
        request = request.with_options(replace(request.options, accuracy=default_accuracy))
    if given.record_step is None:
        coupled = loaded.coupled(choices)
        adaptive = coupled.coupling is not None and coupled.coupling.adaptive is not None
        if request.options.accuracy or adaptive:
            interval = None if every_point else RECORD_STEP
        else:
            interval = record_interval(step_length(coupled, step))
        request = request.with_options(replace(request.options, record_step=interval))
    make_folder(out.parent)
    output = _Output(out, given, None if isinstance(scenario, Trace) else scenario, accept)
    try:
        return _co_simulated(request, output.begun, output.keep)[0], output.line
    except RunFailed as failed:
        output.explain(failed, failed.result)
        raise
    except KeyboardInterrupt as interrupt:  # the library of the command line would drop its message
        stopped = Stopped(str(interrupt) or output.line)
        output.explain(stopped, getattr(interrupt, "result", None))
        raise stopped from None


class _Output:
    """A file with the rows of a run, and its metadata; line: about the complete file."""

    def __init__(self, path: Path, given: RunOptions, scenario: Path | None, accept: Accept) -> None:
        self._path, self._given, self._scenario, self._accept = path, given, scenario, accept
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
        file.origin = metadata_text(result, "", self._given, file.layout, self._scenario)
        complete, digest = file.finish(check)
        metadata = metadata_text(result, digest, self._given, file.layout, self._scenario)
        file.publish(complete, {metadata_file(file.path): metadata})
        write_events(result.card, file.path)
        self._complete, self.line = result, self._summary(result.card, file.path)

    def explain(self, error: Exception, result: Result | None) -> None:
        """Add to an error what is kept of a run with this result; a part of a run gets its metadata."""
        if self._complete:
            error.add_note(f"{self._complete.card.text()}\n\n{self.line}")
        elif result and not result.complete:
            file = self._file
            if file.partial.is_file():
                with suppress(OSError, Problem):  # the disk may be full
                    text = metadata_text(result, file.sha256, self._given, file.layout, self._scenario)
                    write_whole(metadata_file(file.partial), text)
            end = f" up to t = {file.last:.6g} s" if file.rows else ""
            summary = self._summary(result.card, file.partial)
            error.add_note(f"{result.card.text()}\n\nthe run ended early; the trace{end} is in {summary}")

    def _summary(self, card: Card, name: Path) -> str:
        """A file with its number of signals and rows, and the record step."""
        has_interval = card.record_step > card.step or (card.adaptive is not None and card.record_step > 0)
        interval = f", every {card.record_step:g} s" if has_interval else ""
        return f"{name}: {len(self._file.layout.names)} signals, {self._file.rows} rows{interval}"


def chooses_freely(system: System, step: float | None, coupling: CouplingOptions) -> bool:
    """May a default accuracy choose the coupling, because neither the user nor the system does?"""
    suggestion = system.suggestion
    if step is not None or coupling.names or suggestion.step or suggestion.coupling or suggestion.refusal:
        return False
    return estimates_errors(system)
