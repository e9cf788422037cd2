"""Runs of a study as tasks of Dask, on the cores of this machine or on an existing cluster.

On this machine the workers of the cluster are threads of this process, and nothing listens on the network.
`distributed.LocalCluster` would serve a page of the scheduler and of each worker, also without a dashboard.
"""

from __future__ import annotations

import logging
import pickle
import tempfile
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
from orchestrator.base.processes import available_cores
from orchestrator.studies.cases import Unit
from orchestrator.studies.payload import Payload, digest
from orchestrator.studies.processes import ProcessPool, run_batch
from orchestrator.studies.single_run import RunOutcome, failed
from orchestrator.studies.study import Study

CONNECT_TIMEOUT = 10.0  # [s], for the scheduler and for its first worker
WORKER_TIMEOUT = 60.0  # [s] without workers after which the study ends; others can be started until then
POLL_INTERVAL = 0.01  # [s]
CONTINUE = "finished runs are stored; the same command continues the study"
BATCH_TIME = 1.5  # [s]: long compared with the 10 ms that Dask needs per batch, short to lose by a kill
MOST_RUNS, FIRST_RUNS = 50, 2  # of a batch; of the first batches, before the duration of a run is known
BATCHES_PER_CORE = 2  # one that runs, one that waits
# Errors of futures, of calls to the scheduler, and of a client that has given up.
CONNECTION_ERRORS = (CancelledError, OSError, ClosedClientError)
NO_MEMORY_LIMITS = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}


class _WithoutPages:
    """Mixin of a Dask server that serves no HTTP pages."""

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Open no port."""


class _Scheduler(_WithoutPages, Scheduler):  # type: ignore[misc]  # Dask has no types
    pass


class _Worker(_WithoutPages, Worker):  # type: ignore[misc]  # Dask has no types
    pass


def local(workers: int) -> SpecCluster:
    """A cluster with this number of workers in this process, with one thread each."""
    options = {"host": None, "protocol": "inproc", "dashboard": False}
    worker = {"cls": _Worker, "options": {**options, "nthreads": 1, "memory_limit": 0}}
    return SpecCluster(
        scheduler={"cls": _Scheduler, "options": {**options, "port": 0}},
        workers=dict.fromkeys(range(workers), worker),
        worker=worker,
        silence_logs=False,
    )


class _Client(Client):  # type: ignore[misc]  # Dask has no types
    """A Dask client that is closed if it cannot connect.

    Otherwise it stays half initialised, in a reference cycle, with a running event loop. If the garbage
    collector deletes it while another client starts its loop, its destructor waits for that start.
    """

    def __init__(self, address: Any, **settings: Any) -> None:
        try:
            super().__init__(address, **settings)
        except BaseException:
            self.close()  # sets the status with which the destructor does nothing
            self._loop_runner.stop()  # close() does not if Dask has closed the connection before
            raise


@contextmanager
def client(workers: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """A connection to a cluster.

    workers     number of workers of a cluster in this process; default: one per core
    scheduler   address of an existing cluster, such as tcp://host:8786
    """
    with dask.config.set(NO_MEMORY_LIMITS), _silence():
        if scheduler is None:
            with (
                tempfile.TemporaryDirectory(prefix="sweep-") as folder,
                dask.config.set({"temporary-directory": folder}),
                local(workers or available_cores()) as cluster,
                _Client(cluster) as connection,
            ):
                yield connection
            return
        try:
            remote = _Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, ValueError, TimeoutError) as error:
            raise Problem(f"--scheduler {scheduler}: expected a Dask scheduler, got {_line(error)}") from None
        with remote:
            try:
                remote.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
            except TimeoutError:
                expected = f"expected workers, got none within {CONNECT_TIMEOUT:g} s"
                raise Problem(f"--scheduler {scheduler}: {expected}") from None
            yield remote


def outcomes(
    connection: Client, payload: Payload, units: Sequence[Unit], poll: Callable[[], None] = lambda: None
) -> Generator[list[RunOutcome], None, None]:
    """Run samples; yields the outcomes of each finished batch, in any order, each sample once.

    units   samples that are run together

    poll  called repeatedly while batches run; an exception that it raises ends the runs
    """
    data = pickle.dumps(payload, protocol=pickle.HIGHEST_PROTOCOL)
    pool = ProcessPool(f"sweep-{digest(data)[:16]}", data)
    try:
        connection.register_plugin(pool, name=pool.name)
        yield from Batches(connection, pool.name, payload.study, units, poll).outcomes()
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
        units: Sequence[Unit],
        poll: Callable[[], None],
    ) -> None:
        self._connection, self._name, self._study, self._poll = connection, name, study, poll
        self._waiting = list(units)[::-1]
        self._retried: list[Unit] = []  # samples of batches whose worker died; they are run one by one
        self._running: dict[Future, list[Unit]] = {}
        self._size = FIRST_RUNS

    def outcomes(self) -> Iterator[list[RunOutcome]]:
        """The outcomes of each finished batch."""
        queue = as_completed()
        try:
            self._fill(queue)
            while self._running:
                self._wait(queue)
                future = next(queue)
                batch = self._result(future, self._running.pop(future))
                self._fill(queue)
                if batch:
                    yield batch
        except CONNECTION_ERRORS:
            raise Problem(f"the connection to the Dask scheduler is lost; {CONTINUE}") from None
        finally:
            with suppress(Exception):  # the cluster may be gone
                self._connection.cancel(list(self._running), force=True)

    def _wait(self, queue: Any) -> None:
        """Wait for a batch."""
        began = time.perf_counter()
        self._poll()
        while not queue.has_ready():
            self._poll()
            time.sleep(POLL_INTERVAL)
            if time.perf_counter() - began > WORKER_TIMEOUT:
                if not self._connection.nthreads():
                    raise Problem(f"the Dask cluster has no workers left; {CONTINUE}")
                began = time.perf_counter()

    def _fill(self, queue: Any) -> None:
        """Submit as many batches as keep all cores busy, and no more."""
        most = BATCHES_PER_CORE * max(sum(self._connection.nthreads().values()), 1)
        while len(self._running) < most and (self._waiting or self._retried):
            source, size = (self._retried, 1) if self._retried else (self._waiting, self._size)
            batch = [source.pop() for _ in range(min(size, len(source)))]
            future = self._connection.submit(run_batch, self._name, batch, pure=False, retries=0)
            self._running[future] = batch
            queue.add(future)

    def _result(self, future: Future, batch: list[Unit]) -> list[RunOutcome]:
        """The outcomes of a batch; empty if its worker died and the samples are run one by one."""
        error = future.exception()
        if error is None:
            outcomes: list[RunOutcome] = future.result()
            mean_wall = sum(r.wall for r in outcomes) / len(batch)
            if mean_wall > 0:
                self._size = max(1, min(MOST_RUNS, round(BATCH_TIME / mean_wall)))
            return outcomes
        if not isinstance(error, KilledWorker):
            raise error if isinstance(error, Problem) else Problem(f"Dask: {_line(error)}")
        samples = [sample for unit in batch for sample in unit]
        if len(samples) > 1:
            self._retried += [(sample,) for sample in samples]
            return []
        return [failed(self._study, samples[0].run, "the Dask worker died")]


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _silence() -> Iterator[None]:
    """Silence the log of Dask: a Problem reports what the user needs."""
    # Some of these loggers have their own level.
    children = [n for n in logging.root.manager.loggerDict if n.startswith("distributed.")]
    names = ("distributed", *children, "tornado", "asyncio")
    loggers = {n: logging.getLogger(n).level for n in names}
    for name in loggers:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in loggers.items():
            logging.getLogger(name).setLevel(level)
