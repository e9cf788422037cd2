"""Many runs, several at a time: `many` hands out tasks, `Runs` has the processes and the groups of lanes.

`batch` and the studies go through both. On a cluster `cluster` hands out the tasks, and each worker has
`Runs`.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from orchestrator.base.errors import LimitReached, Problem
from orchestrator.base.extras import require
from orchestrator.base.files import Location, temporary_folder, write_whole, zip_bytes
from orchestrator.base.interrupts import POLL_INTERVAL, DeferredInterrupts
from orchestrator.data.table import Array
from orchestrator.data.trace_writer import TraceInMemory
from orchestrator.engine.c_library import library
from orchestrator.engine.isolated import processes, run_isolated
from orchestrator.engine.job import ENDS_EARLY, Job
from orchestrator.engine.result import BondEnergy, Interrupted, Result, RunFailed
from orchestrator.lanes.compiled import LANES
from orchestrator.lanes.group import Ended, Group, Lanes, Status
from orchestrator.ssp.system import Port, System

if TYPE_CHECKING:
    from distributed import Client

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")
Given = TypeVar("Given", contravariant=True)
Found = TypeVar("Found", covariant=True)
BY_USER = Ended(Status.INTERRUPTED, "by the user")


class ClusterLost(Problem):
    """The scheduler of a cluster cannot be reached any more, or it has no workers; what is done is kept."""


class Runner(Protocol[Given, Found]):
    """Runs that are open here. Pickled, they are opened anew where they are unpickled.

    compiled   some run in lanes, which a compiler makes
    """

    @property
    def compiled(self) -> bool: ...

    def run(self, task: Given, /) -> Found: ...

    def lost(self, task: Given, reason: str, /) -> Found:
        """The outcome of a task that cannot be run."""

    def stop(self) -> None:
        """End the tasks that run."""

    def close(self) -> None: ...


@contextmanager
def connected(scheduler: str | None) -> Iterator[Client | None]:
    """A connection to the Dask cluster of a scheduler, such as tcp://host:8786; None without one."""
    if scheduler is None:
        yield None
        return
    require("cluster", "--scheduler", "distributed")
    from orchestrator.lanes import cluster

    with cluster.client(scheduler) as client:
        yield client


def compiles(where: int | Client) -> bool:
    """Can the runs be in lanes there, as far as that depends on the workers of a cluster?"""
    if isinstance(where, int):
        return True
    from orchestrator.lanes import cluster

    return cluster.compiles(where)


def many(
    runs: Runner[Task, Outcome],
    tasks: Sequence[Task],
    keep: Callable[[list[Outcome]], object],
    where: int | Client,
    interval: float = 0.0,
) -> None:
    """Run tasks, several at once; the first exception, or an interrupt, ends all.

    keep       called with new outcomes, at intervals [s] and before an exception is raised
    where      a number of threads, with one more task ready for each, or the client of a Dask cluster
    interval   between two calls of `keep` [s]
    """
    if not isinstance(where, int):
        from orchestrator.lanes import cluster

        return cluster.many(runs, tasks, keep, where, interval)
    waiting, running, threads = deque(tasks), set[Future[Outcome]](), max(1, min(where, len(tasks)))
    found, kept = list[Outcome](), -interval
    with DeferredInterrupts() as interrupts, ThreadPoolExecutor(threads) as executor:
        try:
            while waiting or running:
                for _ in range(min(2 * threads - len(running), len(waiting))):
                    running.add(executor.submit(runs.run, waiting.popleft()))
                ended = wait(running, POLL_INTERVAL, FIRST_COMPLETED).done
                running -= ended
                for future in sorted(ended, key=_has_failed):  # an outcome is kept before an exception
                    found.append(future.result())
                if found and time.monotonic() - kept >= interval:
                    new, found, kept = found, [], time.monotonic()
                    keep(new)
                interrupts.check()
        except BaseException:
            runs.stop()
            for future in running:
                future.cancel()
            raise
        finally:
            if found:
                keep(found)
    return None


def _has_failed(future: Future[Any]) -> bool:
    return future.exception() is not None


def archives_of(systems: Iterable[System]) -> dict[Location, bytes]:
    """The FMUs of systems as bytes; those of an unpacked FMU, which is packed, do not depend on the time."""

    def archive(source: Location) -> bytes:
        if not source.is_folder:
            return source.read()
        return zip_bytes({name: source.member(name).read() for name in source.names()})

    sources = dict.fromkeys(c.source for s in systems for c in s.components.values() if c.source)
    return {source: archive(source) for source in sources}


class Runs:
    """Runs in any number of threads: each in a process of its own, or several in the lanes of a core.

    systems   with copies of their FMUs, which nobody changes meanwhile; archives: see `archives_of`
    """

    def __init__(self, systems: Sequence[System], archives: Mapping[Location, bytes] | None = None) -> None:
        library()  # raises the Problem of all runs if there is no engine
        self._pool, self._stopped = processes(), False
        self._idle, self._busy = defaultdict[Lanes, list[Group]](list), list[Group]()
        archives = archives_of(systems) if archives is None else archives
        with ExitStack() as stack:
            folder = stack.enter_context(temporary_folder("many-", "the FMUs"))
            self._copies = {source: folder / f"{n:06}.fmu" for n, source in enumerate(archives)}
            for source, copy in self._copies.items():
                write_whole(copy, archives[source])
            self.systems = [self.copied(s) for s in systems]
            stack.callback(self._pool.close)
            self._ends = stack.pop_all()

    def copied(self, system: System) -> System:
        """A system of the same FMUs, with the copies."""
        components = system.components.items()
        copies = {source: Location(copy) for source, copy in self._copies.items()}
        sources = {n: copies.get(c.source, c.source) if c.source else None for n, c in components}
        return replace(system, components={n: replace(c, source=sources[n]) for n, c in components})

    def stop(self) -> None:
        """End all runs as soon as possible."""
        self._stopped = True
        for group in [*self._busy]:
            group.stop()

    def close(self) -> None:
        """End all processes, and remove the FMUs; no run takes place any more."""
        with DeferredInterrupts():
            self._ends.close()

    def alone(self, job: Job) -> tuple[Result | None, Ended | None]:
        """The result of a run, None if it did not begin, and why it ended early or is not reliable."""
        if time.monotonic() >= job.deadline:
            return None, Ended(Status.FAILED, f"not begun within {job.options.time_limit:g} s")
        sink = TraceInMemory()
        try:
            end = run_isolated(job, sink, self._between, self._pool)
            result = job.result(end, sink)
        except RunFailed as failed:
            return failed.result, self._failed(failed, failed.__cause__)
        except Problem as problem:
            return None, self._failed(problem, problem)
        except KeyboardInterrupt as interrupt:
            return interrupt.result if isinstance(interrupt, Interrupted) else None, BY_USER
        if end.closing:
            return result, BY_USER if end.interrupted else self._failed(Problem(end.closing), None)
        notes, unreliable = result.card.notes, result.card.unreliable
        early = [note.removeprefix(ENDS_EARLY) for note in notes if note.startswith(ENDS_EARLY)]
        if early:
            return result, Ended(Status.EARLY, " ".join(early[0].split()))
        return result, Ended(Status.NOT_RELIABLE, "; ".join(unreliable)) if unreliable else None

    def _failed(self, problem: Problem, cause: BaseException | None) -> Ended:
        """The end of a run by a problem, with the names of the original FMUs."""
        reason = " ".join(str(problem).split())
        for source, copy in self._copies.items():
            reason = reason.replace(str(copy), str(source))
        return Ended(Status.FAILED, reason, cause.limit if isinstance(cause, LimitReached) else "")

    def _between(self, _: float) -> bool:
        if self._stopped:
            raise KeyboardInterrupt
        return False

    def together(
        self,
        lanes: Lanes,
        values: Mapping[Port, Array],
        rows: Sequence[Array],
        first: int,
        count: int,
        job: Job,
    ) -> list[tuple[list[BondEnergy], Ended | None]]:
        """A group of machines from `first` on: their energies, and why they ended early or are not reliable.

        values, rows   of all machines, as of `Group.run`; count: their number
        """
        idle = self._idle[lanes]
        group = idle.pop() if idle else Group(lanes)
        self._busy.append(group)
        if self._stopped:
            group.stop()
        within = job.options.time_limit
        left = min(within, job.deadline - time.monotonic(), threading.TIMEOUT_MAX)
        limit = threading.Timer(left, group.stop)
        limit.start()
        try:
            ended = group.run(first, values, rows, count)
        finally:
            limit.cancel()
            self._busy.remove(group)
        machines = range(first, min(first + LANES, count))
        if group.struct.stop:  # which is for good
            late = Ended(Status.FAILED, f"not done within {within:g} s")
            why = BY_USER if self._stopped else late
            for i in machines:
                failed = i in ended and ended[i].status == Status.FAILED
                if not failed and any(np.isnan(row[i, -1]) for row in rows):
                    ended[i] = why
        else:
            idle.append(group)
        return [(group.energies(i - first), ended.get(i)) for i in machines]
