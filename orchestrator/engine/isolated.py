"""Runs a job in a process of its own, so that an FMU that crashes or hangs ends only that process.

`main` runs in the child: it opens the FMUs, runs the engine, and sends rows, messages of the FMUs and the
outcome. `run_isolated` runs in the parent: it passes the rows to a sink, ends the child after an interrupt or
at a limit, and finds out which call into which FMU was in progress. The points since the last rows that were
sent, and the state of the simulation, are in files that the child maps into its memory and that survive the
child.

The process is started before the parent has read the system, and one idle process is kept for the next run;
`many` keeps more of them.
"""

from __future__ import annotations

import ctypes
import errno
import json
import mmap
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any

from orchestrator.worker.process import GARBLED, LimitExceeded, Pool, Worker, read_file

if TYPE_CHECKING:
    from pathlib import Path

    from orchestrator.data.trace_writer import Array, Points, RowLayout, TraceSink
    from orchestrator.engine.job import Job
    from orchestrator.engine.result import Event, RunEnd
    from orchestrator.fmi.messages import LogMessage
    from orchestrator.worker.main import Channel

POLL = 0.05  # [s] between two checks for interrupts and limits
STOP_TIME = 1.0  # [s] that a run has to end by itself after an interrupt
CLOSE_TIME = 10.0  # [s] that FMUs have to close when a run is complete
PROGRESS_TIME = 0.1  # [s] between two messages about the progress
MOST_OF_EVENTS = 100_000_000  # bytes that are read after a crash
MAX_MESSAGES = 1000  # of FMUs that are kept for a message after a crash
STOP = "stop"  # message to the child
TARGET = "orchestrator.engine.isolated:main"

# One of many runs uses one thread, because there is one on every core.
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")}

_numbers = count(1)  # of runs


@dataclass(frozen=True)
class RunTask:
    """Message to the child: a run to do.

    number         of the run
    directory      the working directory
    path           where modules are found
    keeps_errors   send estimated errors to the parent
    many           one of many runs of the same FMUs, side by side: one thread, and it does not matter if
                   their libraries keep threads for the next run
    """

    job: Job
    number: int
    directory: str
    path: list[str]
    keeps_errors: bool
    many: bool


# ---- the parent


def start_process() -> None:
    """Start a process for the next run, if none is idle."""
    _single.warm()


def processes() -> Pool:
    """Processes for many runs of the same FMUs, side by side."""
    return Pool(lambda: Worker(TARGET, _contents, "run", environment=ONE_THREAD))


def _contents() -> Mapping[str, Any]:
    """What the child may send."""
    from orchestrator.data.trace_writer import Array, Points, RowLayout
    from orchestrator.engine.result import RunEnd
    from orchestrator.fmi.messages import LogMessage

    errors = tuple[tuple[str, ...], Array, Array]
    types: dict[str, Any] = {
        "begin": RowLayout,
        "points": Points,
        "errors": errors,
        "message": LogMessage,
        "outcome": RunEnd,
    }
    return types | {"time": float, "closed": bool} | dict.fromkeys(("problem", "failed"), str)


_single = Pool(lambda: Worker(TARGET, _contents, "run"), kept=1)


def run_isolated(
    job: Job,
    sink: TraceSink,
    between: Callable[[float], bool] = lambda _: False,
    pool: Pool | None = None,
) -> RunEnd:
    """Run a job in a child process.

    between   called with the simulated time [s] all the while; returns True to end the run
    pool      that of many runs side by side, see `processes`

    Raises Problem if the run does not begin, KeyboardInterrupt if the user ends it before.
    """
    from orchestrator.base.interrupts import DeferredInterrupts

    outcome: RunEnd | None = None
    try:
        with DeferredInterrupts(second_at_once=False) as interrupts, (pool or _single).worker() as worker:
            supervision = _Supervision(worker, job, sink, many=pool is not None)
            outcome = supervision.outcome(interrupts.check, between)
    except KeyboardInterrupt:  # one that came when the run had ended, or before it has begun
        if outcome is None:
            raise
        outcome.interrupted = True
    return outcome


class _Supervision:
    """One run in a child process, seen from the parent."""

    def __init__(self, worker: Worker, job: Job, sink: TraceSink, many: bool) -> None:
        self._worker, self._times, self._sink, self._t = worker, job.times, sink, job.times.start
        self._limits, self._limited_from = job.worker_limits, job.command_began
        worker.fmus = job.system.fmus
        self._outputs = {str(port) for port in job.system.ports("output")}
        self._layout: RowLayout | None = None
        self._outcome: RunEnd | None = None
        self._messages: deque[LogMessage] = deque(maxlen=MAX_MESSAGES)
        self._number = next(_numbers)
        task = RunTask(job, self._number, os.getcwd(), [*sys.path], sink.keeps_errors, many)
        worker.put(task)
        self._kill_at, self._began = float("inf"), time.perf_counter()
        self._interrupted = self._killed = self._stopping = False
        self._limit: LimitExceeded | None = None

    def outcome(self, check: Callable[[], None], between: Callable[[float], bool]) -> RunEnd:
        """Wait for the end of the run; both functions may raise KeyboardInterrupt to interrupt it."""
        while True:
            try:
                name, content = self._worker.get(POLL)
            except TimeoutError:
                name = ""
            except EOFError:
                return self._ended_by_fmu()
            if name == "closed" and self._outcome is not None:
                self._worker.reusable = content
                return self._complete(self._outcome)
            if name:
                self._receive(name, content)
            ends = False
            try:
                check()
                ends = between(self._t)
                if not self._killed:
                    self._worker.check_limits(self._limits, self._limited_from)
            except KeyboardInterrupt:
                if self._interrupted:
                    self._kill()
                ends = self._interrupted = True
            except LimitExceeded as limit:
                self._limit = limit
                self._kill()
            if ends and not self._stopping:
                self._stopping = True
                self._worker.put(STOP)
                self._kill_at = min(self._kill_at, time.monotonic() + STOP_TIME)
            if time.monotonic() > self._kill_at:
                self._kill()

    def _kill(self) -> None:
        self._killed = True
        self._worker.kill()

    def _receive(self, name: str, content: Any) -> None:
        """Handle one message of the child, whose types are right; its values may not be."""
        from orchestrator.base.errors import Problem, one_line

        self._limited_from = min(self._limited_from, time.monotonic())
        if name == "points" and self._follow(content):
            self._sink.append_points(*content)
        elif name == "errors" and self._are_errors(*content):
            self._sink.append_errors(*content)
        elif name == "time":
            self._t = content
        elif name == "begin" and self._layout is None and content.consistent:
            self._layout = content
            self._sink.begin(self._layout, self._times.rows + 1)
        elif name == "message":
            self._messages.append(replace(content, text=one_line(content.text)))
        elif name == "outcome" and content.errors.keys() <= self._outputs:
            self._outcome, self._kill_at = content, min(self._kill_at, time.monotonic() + CLOSE_TIME)
        elif name == "problem" and not self._state().steps:
            raise Problem(content)
        elif name in ("problem", "failed"):
            self._worker.stop(f"the process failed ({one_line(content)})")
        else:
            self._worker.stop(GARBLED)

    def _follow(self, points: Points) -> bool:
        """Do points have the form of the layout, and times that increase after those of the last ones?"""
        layout, (t, reals, integers) = self._layout, points
        if layout is None or t.ndim != 1:
            return False
        shapes = (len(t), layout.reals), (len(t), layout.integers)
        increasing = (t[1:] > t[:-1]).all() and not (len(t) and t[0] <= self._sink.last)
        too_many = not self._times.free and self._sink.rows + len(t) > self._times.rows + 2
        return (reals.shape, integers.shape) == shapes and bool(increasing) and not too_many

    def _are_errors(self, outputs: Sequence[str], times: Array, errors: Array) -> bool:
        """Are these estimated errors of outputs?"""
        known = self._layout is not None and self._outputs.issuperset(outputs)
        return known and times.ndim == 1 and errors.shape == (len(times), len(outputs))

    def _complete(self, outcome: RunEnd) -> RunEnd:
        """The outcome of a run that ended by itself."""
        if self._interrupted:  # which must not be lost, also if it came too late
            outcome.interrupted = True
        if printed := self._worker.printed:
            more = f" and {len(printed) - 1} more lines" if len(printed) > 1 else ""
            outcome.notes += (f"the FMUs printed: {printed[0]}{more}",)
        return outcome

    def _ended_by_fmu(self) -> RunEnd:
        """The outcome of a run whose process ended: by a call into an FMU, by an interrupt, or at a limit."""
        from orchestrator.base.errors import LimitReached, Problem
        from orchestrator.base.text import grouped
        from orchestrator.engine.result import RunEnd
        from orchestrator.fmi.messages import Log

        limit, interrupted = self._limit, self._interrupted and self._killed and not self._limit
        message = self._cause()
        if self._layout is None and interrupted:
            raise KeyboardInterrupt(message)
        if self._outcome and self._outcome.complete:
            closing = f"the run is complete; then {message}"
            return replace(self._outcome, closing=closing, died=True, interrupted=interrupted)
        first = f"{self._outcome.problem}; then " if self._outcome and self._outcome.problem else ""
        message = f"{first}{message}"  # many FMUs crash when they are freed
        problem = Problem(message)
        if limit is not None:
            problem = LimitReached(message, "time_limit" if limit.timed_out else "memory_limit")
        if self._layout is None:
            raise problem
        outcome = self._outcome or RunEnd(self._times.start)
        if self._outcome is None:
            self._rescue(outcome, self._layout)
            by_component = grouped(self._messages, lambda message: message.component)
            outcome.events = tuple(self._kept_events())
            outcome.logs = tuple(Log(name, messages=texts) for name, texts in by_component.items())
        outcome.interrupted, outcome.died, outcome.problem = interrupted, True, problem
        return outcome

    def _cause(self) -> str:
        """The FMU, what happened, and in which call, in one line."""
        where = self._worker.where
        if self._killed and self._limit is None:  # a run that did not end when it was asked to
            return where if self._stopping else f"no end within {CLOSE_TIME:g} s {where}"
        cause = str(self._limit or self._worker.cause)
        process = (
            "" if where.startswith("in ") or cause.startswith("the process") else "the process of the run: "
        )
        return f"{process}{cause} {where}{self._last_words()}"

    def _last_words(self) -> str:
        """The last messages that FMUs logged or printed."""
        logged = [f"; {m.component} says: {m.text}" for m in [*self._messages][-2:]]
        printed = [f"; printed: {line}" for line in self._worker.printed[-1:]]
        return "".join([*logged, *printed])

    def _state(self) -> Any:
        """The state of the simulation as the child has left it; all zero if there is none."""
        from orchestrator.engine.c_library import engine_h

        size = ctypes.sizeof(structure := engine_h().Simulation)
        content = read_file(self._worker.folder / f"simulation-{self._number}", size)
        return structure.from_buffer_copy(content if len(content) == size else bytes(size))

    def _kept_events(self) -> Iterator[Event]:
        """The events that the child has stored, until a line that an FMU or its end has damaged."""
        from orchestrator.engine.result import Event

        stored = read_file(self._worker.folder / f"events-{self._number}", MOST_OF_EVENTS)
        with suppress(ValueError, TypeError):
            for line in stored.splitlines():
                time, causes = json.loads(line)
                yield Event(float(time), tuple(map(str, causes)))

    def _rescue(self, outcome: RunEnd, layout: RowLayout) -> None:
        """Complete an outcome and the rows by what the files of the child contain."""
        import numpy as np

        from orchestrator.engine.recorder import BLOCK, PointBlock, recorded_rows

        sink, state, size = self._sink, self._state(), PointBlock.size(layout)
        content = read_file(self._worker.folder / f"rows-{self._number}", size)
        if not state.step or len(content) < size:  # there is none, or an FMU has cut or removed it
            return
        block = PointBlock(layout, content)
        filled = block.finite_rows(min(max(state.recorder.filled, 0), BLOCK))
        rows = recorded_rows(state.recorder.collected, filled, layout.every)
        rows = np.union1d(rows, np.arange(filled)[-1:])  # and the latest point of the block
        rows = rows[~(block.time[rows] <= sink.last)]  # those that were not sent; NaN without any row
        lost = sink.rows < -(-state.recorder.collected // layout.every)  # with a message that was cut off
        if not lost and self._follow(points := block.points(rows)):
            sink.append_points(*points)
        outcome.wall = time.perf_counter() - self._began
        outcome.t, outcome.steps, outcome.passes = state.t, state.steps, state.all_passes
        outcome.repeated, outcome.lengths = state.repeated, (state.shortest, state.longest)


# ---- the child


def main(channel: Channel) -> None:
    """Run what the parent asks for, one job after the other."""
    import traceback

    from orchestrator.base.errors import Problem
    from orchestrator.engine import simulation_loop  # noqa: F401  imported while the parent reads the system
    from orchestrator.engine.c_library import library
    from orchestrator.worker.main import left_behind

    with suppress(Problem):  # the run reports it
        library()
    while True:
        task = channel.get()
        if task == STOP:  # of a run that has ended meanwhile
            continue
        try:
            before = left_behind(channel, threads=not task.many)
            _run(channel, task)
            if os.name == "posix":  # what FMUs printed may wait in the buffer of the C library
                ctypes.CDLL(None).fflush(None)
            channel.put("closed", left_behind(channel, threads=not task.many) == before)
        except Problem as problem:
            channel.put("problem", problem)
        except (OSError, MemoryError) as error:  # an FMU may have changed the limits of this process
            channel.put("failed", repr(error))
        except EOFError:  # the parent, or an FMU, has closed the connection
            raise
        except Exception:  # a mistake of ours, or the work of an FMU: the parent cannot tell
            channel.put("failed", traceback.format_exc())
        os.chdir(channel.folder)  # the user's folder may be removed


class KeptFile:
    """A file that stays open between its lines, as to open it takes longer than an instant.

    An FMU may close it, also to put another one in its place: then it is opened again.

    descriptor   of the file; -1 before its first line
    """

    def __init__(self, path: Path) -> None:
        self._path, self.descriptor, self._opened = path, -1, os.stat_result((0,) * 10)

    def append(self, text: str) -> None:
        """Append lines, which are lost if the file cannot be written."""
        with suppress(OSError):
            if not self._is_open():
                self.descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
                self._opened = os.fstat(self.descriptor)
            os.write(self.descriptor, text.encode())

    def close(self) -> None:
        """Close the file, if it is still open."""
        if self._is_open():
            os.close(self.descriptor)

    def _is_open(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self.descriptor), self._opened)
        except OSError:
            return False


def _run(channel: Channel, task: RunTask) -> None:
    from orchestrator.base.errors import Problem
    from orchestrator.data.trace_writer import TraceSink
    from orchestrator.engine.job import open_slave
    from orchestrator.engine.simulation_loop import run_job
    from orchestrator.fmi.calls import Slave
    from orchestrator.ssp.system import Component

    channel.put("time", task.job.times.start)
    os.chdir(task.directory)
    sys.path += [folder for folder in task.path if folder not in sys.path]  # an FMU may be made of Python
    reported = 0.0
    for earlier in channel.folder.glob("events-*"):
        with suppress(OSError):  # an FMU has removed it
            earlier.unlink()

    class Sender(TraceSink):
        """Sends points to the parent."""

        def begin(self, layout: RowLayout, rows: int = 0) -> None:
            super().begin(layout, rows)
            channel.put("begin", layout)

        def append_points(self, *points: Any) -> None:
            channel.put("points", points)

        def append_events(self, events: Any) -> None:
            kept.append("".join(json.dumps((event.time, event.causes)) + "\n" for event in events))

        def append_errors(self, *errors: Any) -> None:
            if task.keeps_errors:
                channel.put("errors", errors)

    def open_fmu(component: Component) -> Slave:
        slave = open_slave(component)
        slave.log.on_message = lambda message: channel.put("message", message)
        return slave

    def between(t: float) -> bool:
        nonlocal reported
        if time.monotonic() - reported > PROGRESS_TIME:
            reported = time.monotonic()
            channel.put("time", t)
        return channel.waiting and channel.get() == STOP

    def allocate(name: str, size: int) -> mmap.mmap:
        for earlier in channel.folder.glob(f"{name}-*"):
            with suppress(OSError):  # Windows locks files in use
                earlier.unlink()
        try:
            with (channel.folder / f"{name}-{task.number}").open("w+b") as file:
                file.write(bytes(size))  # a full disk is an error now, not a signal later
                file.flush()
                return channel.keep(mmap.mmap(file.fileno(), size))
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.EFBIG):  # limits that an FMU has set
                raise
            reason = error.strerror or str(error)
            raise Problem(f"{channel.folder}: a temporary file cannot be written: {reason}") from None

    job = replace(task.job, options=replace(task.job.options, open=open_fmu))
    cores = 1 if task.many else None
    with closing(KeptFile(channel.folder / f"events-{task.number}")) as kept:
        run_job(job, Sender(), between, lambda outcome: channel.put("outcome", outcome), allocate, cores)
