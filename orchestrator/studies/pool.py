"""A Dask cluster of this process: its workers are threads, and nothing listens on the network.

`distributed.LocalCluster` would open a page of the scheduler and one of each worker to the network, also
without a dashboard.

Where the runs take place: all cores of this machine, or a Dask cluster that is there already.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, Future, Scheduler, SpecCluster, Worker, as_completed
from distributed.client import ClosedClientError
from distributed.scheduler import KilledWorker

from orchestrator.base.errors import Problem
from orchestrator.studies.single_run import Row, Sample, failed
from orchestrator.studies.worker import Crew, Packet, digest, dumps, work


class _Private:
    """Without pages."""

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Open no port."""


class _Scheduler(_Private, Scheduler):  # type: ignore[misc]  # Dask has no types
    pass


class _Worker(_Private, Worker):  # type: ignore[misc]  # Dask has no types
    pass


def local(workers: int) -> SpecCluster:
    """A cluster of so many workers with one thread each, which look after processes of their own."""
    inside = {"host": None, "protocol": "inproc", "dashboard": False}
    worker = {"cls": _Worker, "options": {**inside, "nthreads": 1, "memory_limit": 0}}
    return SpecCluster(
        scheduler={"cls": _Scheduler, "options": {**inside, "port": 0}},
        workers=dict.fromkeys(range(workers), worker),
        worker=worker,
        silence_logs=False,
    )


PATIENCE = 10.0  # [s] to reach a scheduler, and for its first worker
LOST = 60.0  # [s] that a cluster may be without workers: time to start others
LOOK = 0.01  # [s] between two looks for a batch that has ended
KEPT = "what is finished is kept, the same command goes on"
LENGTH = 1.5  # [s] of a batch: long beside the 10 ms that Dask takes for it, little to lose by a kill
MOST, FIRST = 50, 2  # runs of a batch; of the first ones, before it is known how long a run takes
WAITING = 2  # batches per core: one at work, one that waits for it
# of batches, of what is asked of the scheduler, of a client that has given up
GONE = (CancelledError, OSError, ClosedClientError)
QUIET = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}


class _Client(Client):  # type: ignore[misc]  # Dask has no types
    """Leaves nothing behind where it cannot connect.

    Dask's own is then left half made, in a reference cycle, with a running loop. When the garbage collector
    finds it while another client starts its loop, its destructor waits for the lock that this start holds.
    """

    def __init__(self, address: Any, **settings: Any) -> None:
        try:
            super().__init__(address, **settings)
        except BaseException:
            self.close()  # by its status the destructor then has nothing to do
            self._loop_runner.stop()  # which close leaves out where Dask has closed the connection itself
            raise


@contextmanager
def client(workers: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """A connection to a cluster.

    workers     of a cluster of this machine alone, see `local`; default: one per core
    scheduler   address of a cluster that is there, such as tcp://host:8786
    """
    with dask.config.set(QUIET), _silence():
        if scheduler is None:
            with local(workers or available()) as cluster, _Client(cluster) as here:
                yield here
            return
        try:
            remote = _Client(scheduler, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            raise Problem(f"--scheduler {scheduler}: expected a Dask scheduler, got {_line(error)}") from None
        with remote:
            _wait(remote, scheduler)
            yield remote


def available() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def rows(
    connection: Client, packet: Packet, samples: Sequence[Sample], look: Callable[[], None] = lambda: None
) -> Generator[list[Row], None, None]:
    """Run samples, in batches as they are done: in any order, each sample once.

    look   called all the time while this waits; what it raises ends the runs
    """
    data = dumps(packet)
    crew = Crew(f"sweep-{digest(data)[:16]}", data)
    try:
        connection.register_plugin(crew, name=crew.name)
        yield from Batches(connection, crew.name, packet, list(samples), look).done()
    finally:
        with suppress(Exception):  # the cluster may be gone
            connection.unregister_worker_plugin(crew.name)


class Batches:
    """Samples on their way through a cluster."""

    def __init__(
        self,
        connection: Client,
        name: str,
        packet: Packet,
        samples: list[Sample],
        look: Callable[[], None],
    ) -> None:
        self._connection, self._name, self._packet, self._left = connection, name, packet, samples[::-1]
        self._look = look
        self._away: dict[Future, list[Sample]] = {}
        self._size, self._began = FIRST, time.perf_counter()
        self._suspects: list[Sample] = []

    def done(self) -> Iterator[list[Row]]:
        """The rows of each batch that is done."""
        queue = as_completed()
        try:
            self._fill(queue)
            while self._away:
                self._wait(queue)
                future = next(queue)
                found = self._found(future, self._away.pop(future))
                self._fill(queue)
                if found:
                    yield found
        except GONE:
            raise Problem(f"the Dask scheduler is gone; {KEPT}") from None
        finally:
            with suppress(Exception):  # the cluster may be gone
                self._connection.cancel(list(self._away), force=True)

    def _wait(self, queue: Any) -> None:
        """Until a batch has ended."""
        began = time.perf_counter()
        self._look()
        while not queue.has_ready():
            self._look()
            time.sleep(LOOK)
            if time.perf_counter() - began > LOST:
                if not self._connection.nthreads():
                    raise Problem(f"no worker is left in the Dask cluster; {KEPT}")
                began = time.perf_counter()

    def _fill(self, queue: Any) -> None:
        """Keep all cores busy, and no more than that in memory."""
        room = WAITING * max(sum(self._connection.nthreads().values()), 1)
        while len(self._away) < room and (self._left or self._suspects):
            batch = self._next()
            future = self._connection.submit(work, self._name, batch, pure=False, retries=0)
            self._away[future] = batch
            queue.add(future)

    def _next(self) -> list[Sample]:
        if self._suspects:
            return [self._suspects.pop()]
        return [self._left.pop() for _ in range(min(self._size, len(self._left)))]

    def _found(self, future: Future, batch: list[Sample]) -> list[Row]:
        """The rows of a batch; one whose worker died is split."""
        problem = future.exception()
        if problem is None:
            found: list[Row] = future.result()
            self._learn(found)
            return found
        if not isinstance(problem, KilledWorker):
            raise problem if isinstance(problem, Problem) else Problem(f"Dask: {_line(problem)}")
        if len(batch) > 1:
            self._suspects += batch
            return []
        return [failed(self._packet.study, batch[0].run, "the Dask worker died")]

    def _learn(self, found: list[Row]) -> None:
        """How many runs take as long as a batch should."""
        each = sum(r.wall for r in found) / len(found)
        self._size = max(1, min(MOST, round(LENGTH / each))) if each > 0 else self._size


def _wait(remote: Client, scheduler: str) -> None:
    try:
        remote.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise Problem(f"--scheduler {scheduler}: expected workers, got none in {PATIENCE:g} s") from None


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _silence() -> Iterator[None]:
    """What Dask remarks on its own work, or on a scheduler that is gone, is of no use beside a Problem."""
    # some of them have levels of their own
    known = [n for n in logging.root.manager.loggerDict if n.startswith("distributed.")]
    names = ("distributed", *known, "tornado", "asyncio")
    loggers: Mapping[str, int] = {n: logging.getLogger(n).level for n in names}
    for name in loggers:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in loggers.items():
            logging.getLogger(name).setLevel(level)
