"""Many runs on a cluster of Dask: what `many` does with a `distributed.Client`.

A worker that joins is first compared with this installation. It then gets the contents that it lacks, such as
FMUs, each once by its SHA-256, and a plugin that opens the runs at its first task. Tasks and outcomes travel
in batches of about 1.5 s of work, so that the scheduler has few messages. The scheduler needs only Dask: it
unpickles tasks, so these are calls of `pickle.loads`.
"""

from __future__ import annotations

import asyncio
import logging
import math
import pickle
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import Any
from uuid import uuid4

from distributed import Client, Reschedule, WorkerPlugin, as_completed, get_worker
from distributed.client import ClosedClientError
from distributed.core import Status
from distributed.scheduler import KilledWorker

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_whole
from orchestrator.base.interrupts import POLL_INTERVAL, DeferredInterrupts
from orchestrator.base.text import grouped
from orchestrator.lanes.many import ClusterLost, Outcome, Runner, Task

CONNECT_TIMEOUT = 10.0  # [s], for the scheduler and for its first worker
WORKER_TIMEOUT = 60.0  # [s] without workers after which all ends; others can be started until then
ASK_INTERVAL = 1.0  # [s] between two questions for the workers
BATCH_TIME = 1.5  # [s] of work in a batch: long beside the milliseconds of its messages, short to lose
PACE = 0.005  # [s] of work for each batch that is outstanding, of which the scheduler manages 200 per second
OUTSTANDING = 2  # batches for each thread of a worker: one that runs and one that waits
LARGE = 2**16  # bytes; contents above it travel by their hash
CODE = (".py", ".c", ".h", ".cpp")
# errors of calls to the scheduler, of futures, and of a client that has given up
CONNECTION_ERRORS = (OSError, CancelledError, ClosedClientError)


class _Client(Client):  # type: ignore[misc]  # Dask has no types
    """A client that is closed if it cannot connect.

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
    """A connection to the cluster of a scheduler, such as tcp://host:8786; Dask's settings of TLS apply."""
    with _silence():
        try:
            remote = _Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise Problem(f"--scheduler {scheduler}: expected a Dask scheduler, got {_line(error)}") from None
        with remote:
            try:
                remote.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
            except TimeoutError:
                expected = f"expected workers, got none within {CONNECT_TIMEOUT:g} s"
                raise Problem(f"--scheduler {scheduler}: {expected}") from None
            yield remote


@contextmanager
def _silence() -> Iterator[None]:
    """Silence the log of Dask: a Problem reports what the user needs."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in (*names, "asyncio")}
    for name in levels:  # some have levels of their own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def _line(error: object) -> str:
    return " ".join(str(error).split()) or type(error).__name__


# ---- on a worker


@cache
def installation() -> tuple[str, str, str, str]:
    """Versions of the package and of Python, a hash of the code, the compiler's version; empty: none."""
    root, code = Path(__file__).parents[2], sha256()
    files = [f for package in ("fmus", "orchestrator") for f in (root / package).rglob("*")]
    for file in sorted(f for f in files if f.suffix in CODE):
        code.update(file.relative_to(root).as_posix().encode())
        code.update(file.read_bytes().replace(b"\r\n", b"\n"))
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return _version("harvester-cosim"), python, code.hexdigest()[:12], _version("ziglang")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _folder(worker: Any) -> Path:
    """Where a worker keeps contents; Dask removes the folder when the worker ends."""
    return Path(worker.local_directory) / "harvester-cosim"


def introduce(digests: Sequence[str], dask_worker: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The installation of a worker, and the contents that it lacks."""
    return installation(), tuple(d for d in digests if not (_folder(dask_worker) / d).exists())


async def enter(name: str, runs: bytes, contents: Mapping[str, bytes], dask_worker: Any) -> str:
    """Give contents and pickled runs to a worker; returns why that failed."""
    try:
        for digest, content in contents.items():
            write_whole(_folder(dask_worker) / digest, content)
        await dask_worker.plugin_add(RunsPlugin(runs), name=name)
    except Exception as error:
        return _line(error)
    return ""


async def leave(name: str, dask_worker: Any) -> None:
    """End the runs on a worker."""
    if name in dask_worker.plugins:
        await dask_worker.plugin_remove(name)


class RunsPlugin(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """The runs on a worker, in its process: opened at the first task, ended with the worker."""

    def __init__(self, data: bytes) -> None:
        self._data, self._lock, self.ended = data, threading.Lock(), False
        self._runs: Any = None

    def setup(self, worker: Any) -> None:
        """Called by Dask."""
        self._contents = _folder(worker)

    def opened(self) -> Runner[Any, Any]:
        """The runs."""
        with self._lock:
            self._runs = self._runs or _Unpickler(self._data, self._contents).load()
            runs: Runner[Any, Any] = self._runs
            return runs

    async def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End all runs; called by Dask."""
        self.ended = True
        await asyncio.to_thread(self._end)

    def _end(self) -> None:
        with self._lock:
            if self._runs:
                self._runs.stop()
                self._runs.close()


def work(name: str, tasks: Sequence[Any]) -> bytes | None:
    """Run a batch on this worker, when it has entered: pickled outcomes, seconds, and an error.

    None if it does not enter. It waits here, because a new task would not know how often it was repeated.
    """
    worker, found, error = get_worker(), list[Any](), ""
    end = time.monotonic() + WORKER_TIMEOUT
    while (plugin := worker.plugins.get(name)) is None:
        if worker.status != Status.running:
            raise Reschedule
        if time.monotonic() > end:
            return None
        time.sleep(POLL_INTERVAL)
    began = time.perf_counter()
    try:
        runs = plugin.opened()
        began = time.perf_counter()
        for task in tasks:
            found += [] if plugin.ended else [runs.run(task)]
    except Exception as failure:
        kind = "" if isinstance(failure, Problem) else f"{type(failure).__name__}: "
        error = f"worker {worker.address}: {kind}{_line(failure)}"
    if plugin.ended:  # the worker leaves, so these outcomes may be those of interrupted runs
        raise Reschedule
    return pickle.dumps((found, time.perf_counter() - began, error))


# ---- what travels


class _Call:
    """A call that takes place where it is unpickled."""

    def __init__(self, *call: Any) -> None:
        self._call = call

    def __reduce__(self) -> tuple[Any, ...]:
        function, *arguments = self._call
        return function, tuple(arguments)


class _Pickler(pickle.Pickler):
    """Leaves large contents out, by their SHA-256."""

    def __init__(self) -> None:
        self.file, self.contents = BytesIO(), dict[str, bytes]()
        super().__init__(self.file, pickle.HIGHEST_PROTOCOL)

    def persistent_id(self, thing: Any) -> str | None:
        """The hash of a large content."""
        if type(thing) is not bytes or len(thing) < LARGE:
            return None
        digest = sha256(thing).hexdigest()
        self.contents[digest] = thing
        return digest


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: bytes, folder: Path) -> None:
        super().__init__(BytesIO(data))
        self._folder = folder

    def persistent_load(self, digest: str) -> bytes:
        return (self._folder / digest).read_bytes()


class Packing:
    """How many tasks make a batch: about BATCH_TIME of work, on large clusters more; one at first.

    In the end batches are equal shares of what is left.
    """

    def __init__(self) -> None:
        self._time = math.inf  # of a task [s]

    def size(self, waiting: int, places: int) -> int:
        """For a number of waiting tasks, and of batches that can be outstanding."""
        work = max(BATCH_TIME, PACE * places)
        return max(1, min(int(work / self._time), math.ceil(waiting / places)))

    def measured(self, tasks: int, seconds: float) -> None:
        """Learn from a batch that is done; the last ones count most."""
        mean = max(seconds / max(tasks, 1), 1e-9)
        self._time = mean if self._time == math.inf else (self._time + mean) / 2


# ---- here


class Workers:
    """The workers of a cluster that have the runs."""

    def __init__(self, connection: Client, runs: Runner[Any, Any]) -> None:
        pickler = _Pickler()
        pickler.dump(runs)
        self._runs, self._contents = pickler.file.getvalue(), pickler.contents
        # without the compiler, if nothing is compiled
        self._expected = installation()[: 4 if runs.compiled else 3]
        self.name = f"harvester-cosim-{uuid4().hex}"  # another client may run the same
        self._connection, self._entered = connection, set[str]()
        self._asked, self._alive, self._threads = -math.inf, time.monotonic(), 0

    def threads(self, at_once: bool = False) -> int:
        """Threads of all workers that have entered; new ones enter. Asks now and then, or at once.

        Raises Problem for a worker at the beginning with another installation; later ones are sent away.
        """
        now = time.monotonic()
        if now - self._asked > ASK_INTERVAL or at_once:
            there, self._asked = self._connection.nthreads(), now
            if new := [address for address in there if address not in self._entered]:
                self._enter(new)
            self._entered &= {*there}
            self._threads = sum(there[address] for address in self._entered)
            self._alive = now if self._threads else self._alive
        if now - self._alive > WORKER_TIMEOUT:
            raise ClusterLost("the Dask cluster has no workers left")
        return self._threads

    def _enter(self, new: Sequence[str]) -> None:
        connection, wrong, lacking = self._connection, list[str](), dict[str, Any]()
        introduced = connection.run(introduce, [*self._contents], workers=new, on_error="return")
        for address, answer in introduced.items():
            found = answer if isinstance(answer, Exception) else answer[0][: len(self._expected)]
            if found == self._expected:
                lacking[address] = answer[1]
            elif not isinstance(answer, OSError):  # with that, it has left
                self._refuse(address, _told(self._expected), _told(found), wrong)
        for digests, addresses in grouped(lacking, lambda address: lacking[address]).items():
            contents = {digest: self._contents[digest] for digest in digests}
            arguments = self.name, self._runs, contents
            entered = connection.run(enter, *arguments, workers=addresses, on_error="return")
            for address, failure in entered.items():
                if failure == "":
                    self._entered.add(address)
                elif not isinstance(failure, OSError):
                    self._refuse(address, "room for the FMUs", _line(failure), wrong)
        if wrong:
            connection.retire_workers(workers=wrong)

    def leave(self, running: Sequence[Any]) -> None:
        """End the runs on all workers, also those of these futures."""
        if self._connection.status == "running":
            with suppress(Exception):  # the cluster may be gone
                self._connection.cancel(running, force=True)
                self._connection.run(leave, self.name, on_error="ignore")

    def _refuse(self, address: str, expected: str, found: str, wrong: list[str]) -> None:
        line = f"worker {address}: expected {expected}, found {found}"
        if not self._entered:
            raise Problem(line)
        logging.getLogger(__name__).warning("%s; it is sent away", line)
        wrong.append(address)


def _told(installed: Sequence[str] | Exception) -> str:
    if isinstance(installed, Exception):
        return _line(installed)
    names = ("harvester-cosim", "Python", "code", "ziglang")
    return ", ".join(f"{n} {value or 'not installed'}" for n, value in zip(names, installed, strict=False))


def compiles(connection: Client) -> bool:
    """Have all workers that are there a compiler?"""
    with _connected():
        found = connection.run(installation, on_error="return").values()
    return all(isinstance(answer, tuple) and answer[3] for answer in found)


@contextmanager
def _connected() -> Iterator[None]:
    try:
        yield
    except CONNECTION_ERRORS as error:
        raise _problem(error) from None


def _problem(error: object) -> Problem:
    """What an error of a call to the scheduler, or of a future, is for the user."""
    if isinstance(error, CONNECTION_ERRORS):
        return ClusterLost("the connection to the Dask scheduler is lost")
    return Problem(f"Dask: {_line(error)}")


def many(
    runs: Runner[Task, Outcome],
    tasks: Sequence[Task],
    keep: Callable[[list[Outcome]], object],
    connection: Client,
    interval: float,
) -> None:
    """`many` of `lanes.many`, on a cluster.

    Dask repeats the batches of a worker that dies, up to three times, also those that only waited there. The
    tasks of batches that it gives up are the last ones: each runs while nothing else does, and if Dask gives
    it up again, its outcome says so.
    """
    waiting, running, again = deque(tasks), dict[Any, Sequence[Task]](), list[Sequence[Task]]()
    found, kept, packing, failure, at_once = list[Outcome](), -interval, Packing(), "", False
    suspects, alone = list[Task](), False
    ended = as_completed(loop=connection.loop, with_results=True, raise_errors=False)
    with DeferredInterrupts() as interrupts:  # Dask's callbacks would swallow a KeyboardInterrupt
        workers = Workers(connection, runs)
        try:
            while waiting or again or running or suspects:
                with _connected():
                    places, at_once = OUTSTANDING * workers.threads(at_once), False
                    if not (waiting or again or running):
                        again, alone = [[suspects.pop()]], True
                    while (waiting or again) and len(running) < places:
                        size = 0 if again else min(packing.size(len(waiting), places), len(waiting))
                        batch = again.pop() if again else [waiting.popleft() for _ in range(size)]
                        call = pickle.dumps(_Call(work, workers.name, batch))
                        future = connection.submit(pickle.loads, call, pure=False)
                        running[future] = batch
                        ended.add(future)
                time.sleep(POLL_INTERVAL)
                for future, result in ended.next_batch(block=False):
                    batch = running.pop(future)
                    error = result[1] if future.status == "error" else result
                    if isinstance(result, bytes):
                        outcomes, seconds, wrong = pickle.loads(result)
                        packing.measured(len(batch), seconds)
                        found, failure = found + outcomes, failure or wrong
                    elif result is None or isinstance(error, (ImportError, AttributeError)):
                        again, at_once = [*again, batch], True  # of a worker that has not entered
                    elif isinstance(error, KilledWorker) and not alone:
                        suspects += batch
                    elif isinstance(error, KilledWorker):
                        reason = f"the Dask worker died {error.allowed_failures + 1} times"
                        found.append(runs.lost(batch[0], reason))
                    else:
                        raise _problem(error)
                if found and time.monotonic() - kept >= interval:
                    new, found, kept = found, [], time.monotonic()
                    keep(new)
                if failure:
                    raise Problem(failure)
                interrupts.check()
        finally:
            if found:
                keep(found)
            workers.leave([*running])
