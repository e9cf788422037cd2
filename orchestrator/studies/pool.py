"""Where the runs of a study take place: on the cores of this machine, or on a Dask cluster that exists.

On this machine it is a Dask cluster whose workers are threads of this process, and nothing listens on the
network. `distributed.LocalCluster` would open a page of the scheduler and one of each worker to the network,
also without a dashboard.
"""

from __future__ import annotations

import logging
import os
import pickle
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, Future, Scheduler, SpecCluster, Worker, as_completed
from distributed.client import ClosedClientError
from distributed.scheduler import KilledWorker

from orchestrator.base.errors import Problem
from orchestrator.studies.design import Sample
from orchestrator.studies.processes import Payload, ProcessPool, digest, run_batch
from orchestrator.studies.single_run import RunOutcome, failed
from orchestrator.studies.study import Study

PATIENCE = 10.0  # [s] to reach a scheduler, and for its first worker
LOST = 60.0  # [s] that a cluster may be without workers: time to start others
POLL = 0.01  # [s] between two looks for a batch that has ended
KEPT = "what is finished is kept, the same command goes on"
LENGTH = 1.5  # [s] of a batch: long compared with Dask's 10 ms for it, little to lose by a kill
MOST, FIRST = 50, 2  # runs of a batch; of the first ones, before it is known how long a run takes
WAITING = 2  # batches per core: one that runs, one that waits
# of batches, of what is asked of the scheduler, of a client that has given up
GONE = (CancelledError, OSError, ClosedClientError)
QUIET = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}


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


class _Client(Client):  # type: ignore[misc]  # Dask has no types
    """A client that leaves nothing behind where it cannot connect.

    Dask's own is then left half initialised, in a reference cycle, with a running loop. When the garbage
    collector finds it while another client starts its loop, its destructor waits for the lock of that start.
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
            try:
                remote.wait_for_workers(1, timeout=PATIENCE)
            except TimeoutError:
                expected = f"expected workers, got none in {PATIENCE:g} s"
                raise Problem(f"--scheduler {scheduler}: {expected}") from None
            yield remote


def available() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def outcomes(
    connection: Client, payload: Payload, samples: Sequence[Sample], poll: Callable[[], None] = lambda: None
) -> Generator[list[RunOutcome], None, None]:
    """Run samples, in batches as they are done: in any order, each sample once.

    poll  called all the time while this waits; an exception that it raises ends the runs
    """
    data = pickle.dumps(payload, protocol=pickle.HIGHEST_PROTOCOL)
    pool = ProcessPool(f"sweep-{digest(data)[:16]}", data)
    try:
        connection.register_plugin(pool, name=pool.name)
        yield from Batches(connection, pool.name, payload.study, samples, poll).done()
    finally:
        with suppress(Exception):  # the cluster may be gone
            connection.unregister_worker_plugin(pool.name)


class Batches:
    """The samples of a study as tasks of a cluster."""

    def __init__(
        self,
        connection: Client,
        name: str,
        study: Study,
        samples: Sequence[Sample],
        poll: Callable[[], None],
    ) -> None:
        self._connection, self._name, self._study, self._poll = connection, name, study, poll
        self._waiting = list(samples)[::-1]
        self._retried: list[Sample] = []  # of batches whose worker died: one by one
        self._running: dict[Future, list[Sample]] = {}
        self._size = FIRST

    def done(self) -> Iterator[list[RunOutcome]]:
        """The outcomes of each batch that is done."""
        queue = as_completed()
        try:
            self._fill(queue)
            while self._running:
                self._wait(queue)
                future = next(queue)
                found = self._outcomes(future, self._running.pop(future))
                self._fill(queue)
                if found:
                    yield found
        except GONE:
            raise Problem(f"the Dask scheduler is gone; {KEPT}") from None
        finally:
            with suppress(Exception):  # the cluster may be gone
                self._connection.cancel(list(self._running), force=True)

    def _wait(self, queue: Any) -> None:
        """Until a batch is done."""
        began = time.perf_counter()
        self._poll()
        while not queue.has_ready():
            self._poll()
            time.sleep(POLL)
            if time.perf_counter() - began > LOST:
                if not self._connection.nthreads():
                    raise Problem(f"no worker is left in the Dask cluster; {KEPT}")
                began = time.perf_counter()

    def _fill(self, queue: Any) -> None:
        """Keep all cores busy, and no more than that in memory."""
        most = WAITING * max(sum(self._connection.nthreads().values()), 1)
        while len(self._running) < most and (self._waiting or self._retried):
            source, size = (self._retried, 1) if self._retried else (self._waiting, self._size)
            batch = [source.pop() for _ in range(min(size, len(source)))]
            future = self._connection.submit(run_batch, self._name, batch, pure=False, retries=0)
            self._running[future] = batch
            queue.add(future)

    def _outcomes(self, future: Future, batch: list[Sample]) -> list[RunOutcome]:
        """Those of a batch; one whose worker died is split."""
        error = future.exception()
        if error is None:
            found: list[RunOutcome] = future.result()
            each = sum(r.wall for r in found) / len(found)
            if each > 0:
                self._size = max(1, min(MOST, round(LENGTH / each)))
            return found
        if not isinstance(error, KilledWorker):
            raise error if isinstance(error, Problem) else Problem(f"Dask: {_line(error)}")
        if len(batch) > 1:
            self._retried += batch
            return []
        return [failed(self._study, batch[0].run, "the Dask worker died")]


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _silence() -> Iterator[None]:
    """What Dask logs about its own work, or about a scheduler that is gone, is useless next to a Problem."""
    # some of them have levels of their own
    known = [n for n in logging.root.manager.loggerDict if n.startswith("distributed.")]
    names = ("distributed", *known, "tornado", "asyncio")
    loggers = {n: logging.getLogger(n).level for n in names}
    for name in loggers:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in loggers.items():
            logging.getLogger(name).setLevel(level)
