"""Runs of a study as tasks of Dask, on an existing cluster: its client is an executor of `many`.

Each Dask worker keeps as many child processes as it has threads.
"""

from __future__ import annotations

import logging
import math
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from distributed import Client, WorkerPlugin, get_worker
from distributed.client import ClosedClientError
from distributed.scheduler import KilledWorker

from orchestrator.base.errors import Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.lanes.many import many
from orchestrator.studies.cases import Unit
from orchestrator.studies.runs import STORE_TIME, Payload, RunOutcome, StudyRuns, digest, failed

CONNECT_TIMEOUT = 10.0  # [s], for the scheduler and for its first worker
WORKER_TIMEOUT = 60.0  # [s] without workers after which the study ends; others can be started until then
CONTINUE = "finished runs are stored; the same command continues the study"
PLACES_PER_CORE = 2  # for a sample that runs and one that waits
ASK_INTERVAL = 1.0  # [s] between two questions for the workers
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
    """Plugin of a Dask worker, with the runs of a study there."""

    def __init__(self, name: str, data: bytes) -> None:
        """name: name of the plugin in this cluster; data: pickled payload."""
        self.name, self._data = name, data

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """Read the study; called on the Dask worker."""
        self.runs = StudyRuns(pickle.loads(self._data))

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End all processes, including those that run a sample."""
        self.runs.stop()
        self.runs.close()


def run_unit(name: str, unit: Unit) -> list[RunOutcome]:
    """The Dask task: run samples on this Dask worker."""
    plugin = get_worker().plugins.get(name)
    if not isinstance(plugin, RunPlugin):
        raise Problem(f"worker {get_worker().address}: expected the plugin {name}, got none")
    return plugin.runs.run(unit)


def run_units(
    connection: Client,
    payload: Payload,
    units: Sequence[Unit],
    keep: Callable[[list[list[RunOutcome]]], object],
) -> None:
    """Run samples; `keep` gets their outcomes now and then, in any order, each sample once."""
    data = pickle.dumps(payload, protocol=pickle.HIGHEST_PROTOCOL)
    plugin = RunPlugin(f"sweep-{digest(data)[:16]}", data)

    def ended(unit: Unit, error: Exception) -> list[RunOutcome]:
        if isinstance(error, KilledWorker):  # after Dask has tried others
            return [failed(payload.study, sample.run, "the Dask worker died") for sample in unit]
        raise error if isinstance(error, (Problem, *CONNECTION_ERRORS)) else Problem(f"Dask: {_line(error)}")

    executor = connection.get_executor(pure=False)
    try:
        with DeferredInterrupts():  # Dask's callbacks would swallow a KeyboardInterrupt
            connection.register_plugin(plugin, name=plugin.name)
        run = partial(run_unit, plugin.name)
        stop, places = partial(executor.shutdown, wait=False), Places(connection)
        many(run, units, keep, stop, executor, places, ended, STORE_TIME)
    except CONNECTION_ERRORS:
        raise Problem(f"the connection to the Dask scheduler is lost; {CONTINUE}") from None
    finally:
        with suppress(Exception):  # the cluster may be gone
            connection.unregister_worker_plugin(plugin.name)


class Places:
    """How many samples are on the cluster at once; raises a Problem if it has lost its workers for long."""

    def __init__(self, connection: Client) -> None:
        self._connection, self._count = connection, 0
        self._asked, self._alive = -math.inf, time.monotonic()

    def __call__(self) -> int:
        now = time.monotonic()
        if now - self._asked > ASK_INTERVAL:
            self._asked, self._count = now, sum(self._connection.nthreads().values())
            self._alive = now if self._count else self._alive
        if now - self._alive > WORKER_TIMEOUT:
            raise Problem(f"the Dask cluster has no workers left; {CONTINUE}")
        return PLACES_PER_CORE * max(self._count, 1)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _silence() -> Iterator[None]:
    """Silence the log of Dask: a Problem reports what the user needs."""
    # Some of these loggers have their own level.
    children = [n for n in logging.root.manager.loggerDict if n.startswith(("distributed.", "tornado."))]
    names = ("distributed", *children, "tornado", "asyncio")
    loggers = {n: logging.getLogger(n).level for n in names}
    for name in loggers:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in loggers.items():
            logging.getLogger(name).setLevel(level)
