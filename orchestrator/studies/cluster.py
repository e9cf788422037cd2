"""Runs of a study as tasks of Dask, on an existing cluster.

Each Dask worker keeps as many child processes as it has threads.
"""

from __future__ import annotations

import logging
import pickle
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from typing import Any

from distributed import Client, Future, WorkerPlugin, as_completed, get_worker
from distributed.client import ClosedClientError
from distributed.scheduler import KilledWorker

from orchestrator.base.errors import Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.studies.cases import Unit
from orchestrator.studies.processes import Payload, RunProcesses, digest
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


class _Client(Client):  # type: ignore[misc]  # Dask has no types
    """A Dask client that is closed if it cannot connect.

    Otherwise it stays half initialised, in a reference cycle, with a running event loop. If the garbage
    collector deletes it while another client starts its loop, its destructor waits for that start.
    """

    def __init__(self, address: Any, **settings: object) -> None:
        try:
            super().__init__(address, **settings)
        except BaseException:
            self.close()  # sets the status with which the destructor does nothing
            self._loop_runner.stop()  # close() does not if Dask has closed the connection before
            raise


@contextmanager
def client(scheduler: str) -> Iterator[Client]:
    """A connection to the cluster of a scheduler, such as tcp://host:8786."""
    with _silence():
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


class RunPlugin(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """Plugin of a Dask worker with its child processes."""

    def __init__(self, name: str, data: bytes) -> None:
        """name: name of the plugin in this cluster; data: pickled payload."""
        self.name, self._data = name, data

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """Read the study; called on the Dask worker."""
        self._processes = RunProcesses(pickle.loads(self._data))

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End all processes, including those that run a sample."""
        self._processes.stop()
        self._processes.close()

    def run(self, batch: Sequence[Unit]) -> list[RunOutcome]:
        """Run samples; if a sample ends its process, the next one runs in another process."""
        return [outcome for unit in batch for outcome in self._processes.run(unit)]


def run_batch(name: str, batch: Sequence[Unit]) -> list[RunOutcome]:
    """The Dask task: run samples in the processes of this Dask worker."""
    plugin = get_worker().plugins.get(name)
    if not isinstance(plugin, RunPlugin):
        raise Problem(f"worker {get_worker().address}: expected the plugin {name}, got none")
    return plugin.run(batch)


def run_units(
    connection: Client, payload: Payload, units: Sequence[Unit], store: Callable[[list[RunOutcome]], None]
) -> None:
    """Run samples; `store` gets the outcomes of each finished batch, in any order, each sample once."""
    data = pickle.dumps(payload, protocol=pickle.HIGHEST_PROTOCOL)
    plugin = RunPlugin(f"sweep-{digest(data)[:16]}", data)
    with DeferredInterrupts() as interrupts:  # Dask's callbacks would swallow a KeyboardInterrupt
        try:
            connection.register_plugin(plugin, name=plugin.name)
            batches = Batches(connection, plugin.name, payload.study, units, interrupts.check)
            with closing(batches.outcomes()) as outcomes:
                for batch in outcomes:
                    store(batch)
        finally:
            with suppress(Exception):  # the cluster may be gone
                connection.unregister_worker_plugin(plugin.name)


class Batches:
    """The samples of a study as tasks of a cluster."""

    def __init__(
        self, connection: Client, name: str, study: Study, units: Sequence[Unit], poll: Callable[[], None]
    ) -> None:
        self._connection, self._name, self._study, self._poll = connection, name, study, poll
        self._waiting = list(units)[::-1]
        self._retried: list[Unit] = []  # samples of batches whose worker died; they are run one by one
        self._running: dict[Future, list[Unit]] = {}
        self._size = FIRST_RUNS

    def outcomes(self) -> Generator[list[RunOutcome], None, None]:
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
