"""On a Dask cluster that is there already: the same content, also when one of its processes dies."""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Iterator, Sequence

import dask
import psutil
import pytest
from distributed import Client, LocalCluster
from distributed.utils import LoopRunner
from kit import shards
from kit.mistakes import problem
from sweep.studies import GAIN, content, run, study

from orchestrator import Problem
from orchestrator.studies import pool
from orchestrator.studies.cases import Sample
from orchestrator.studies.parameter_study import sweep
from orchestrator.studies.single_run import RunOutcome

pytestmark = shards.faults

LONG = GAIN.replace("runs = 12", "runs = 120").replace("stop = 0.2", "stop = 20")  # many batches


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """The address of a scheduler with one worker in a process of its own, which is replaced when it dies."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as there,
    ):
        yield there.scheduler_address


class Killer:
    """Kills the worker, once, when the first batch is done."""

    def __init__(self, address: str) -> None:
        self._address, self.killed = address, 0

    def __call__(self, _total: int, _done: int, batch: Sequence[RunOutcome]) -> None:
        if batch and not self.killed:
            with Client(self._address) as client:
                self.killed = next(iter(client.run(os.getpid).values()))
            os.kill(self.killed, signal.SIGKILL)


def listening() -> set[object]:
    """Addresses at which this process listens: a server of another test may still be ending."""
    return {c.laddr for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN}


def test_no_port_is_opened_on_this_machine():
    """The workers of a local cluster are threads that listen on no port."""
    before = listening()
    with pool.client(1):
        assert listening() <= before


def test_a_worker_that_dies_costs_no_run(gain, one, address, tmp_path):
    """What it was at is run again elsewhere; the content is that of an undisturbed study, byte by byte."""
    file = study(tmp_path, LONG, gain)
    run(file, one, "here")
    killer = Killer(address)
    sweep(file, tmp_path / "there", scheduler=address, watch=killer)
    assert killer.killed
    assert content(tmp_path / "there") == content(tmp_path / "here")


def test_nothing_is_left_on_the_workers(gain, address, tmp_path):
    """The processes of a study end with it."""
    sweep(study(tmp_path, GAIN, gain), tmp_path / "out", scheduler=address)
    with Client(address) as client:
        children = client.run(lambda: [" ".join(p.cmdline()) for p in psutil.Process().children()])
    assert not [line for lines in children.values() for line in lines if "sweep.child" in line]


def test_schedulers_that_are_not_there_leave_nothing_that_can_hang(monkeypatch):
    """Two hundred in one process, and the garbage collector always runs while Dask's lock is held.

    A client that is left half made is closed by the collector then, and waits for that lock for ever.
    """
    start, collected = LoopRunner._start_unlocked, []

    def with_garbage(runner: LoopRunner) -> None:
        collected.append(gc.collect())
        start(runner)

    monkeypatch.setattr(LoopRunner, "_start_unlocked", with_garbage)
    monkeypatch.setattr(pool, "CONNECT_TIMEOUT", 0.02)
    threads = threading.active_count()
    gc.freeze()  # what is there already need not be looked at 200 times
    for n in range(200):
        url = ("nowhere", "foo://127.0.0.1:1", "tcp://127.0.0.1:1")[n % 3]
        expected = rf"^--scheduler {url}: expected a Dask scheduler, got [^\n]+$"
        with pytest.raises(Problem, match=expected), pool.client(scheduler=url):
            pass
    gc.unfreeze()
    assert len(collected) == 200
    assert threading.active_count() <= threads


@pytest.mark.parametrize("kept", [False, True])
def test_a_wrong_address_leaves_nothing_and_deletes_nothing(kept, gain, one, tmp_path, monkeypatch):
    """No folder where there was none, also none above it; with --fresh what is there stays, to be read."""
    monkeypatch.setattr(pool, "CONNECT_TIMEOUT", 0.5)
    file, out, url = study(tmp_path, GAIN, gain), tmp_path / "deep" / "out", "tcp://127.0.0.1:1"
    before = content(out) if kept and run(file, one, "deep/out") else {}
    line = problem(lambda: sweep(file, out, scheduler=url, fresh=kept))
    assert line.startswith(f"--scheduler {url}: expected a Dask scheduler")
    assert (tmp_path / "deep").exists() is kept
    assert content(out) == before
    assert bool(before) is kept
    if kept:  # a finished study needs no scheduler
        assert len(sweep(file, out, scheduler=url).table) == 12


class Deserted:
    """A connection to a cluster whose workers are gone."""

    def nthreads(self) -> dict[str, int]:
        return {}

    def submit(self, *_: object, **__: object) -> object:
        return object()

    def cancel(self, *_: object, **__: object) -> None:
        """Nobody is there."""


class Nothing(list):
    """A queue in which no batch ends."""

    add = list.append

    def has_ready(self) -> bool:
        return False


def test_a_cluster_that_is_lost_for_good_is_told(monkeypatch):
    """The command does not wait for ever, and says that it can go on."""
    monkeypatch.setattr(pool, "as_completed", Nothing)
    monkeypatch.setattr(pool, "WORKER_TIMEOUT", 0.0)
    batches = pool.Batches(Deserted(), "study", None, [(Sample(0, (), {}),)], lambda: None)
    expected = r"^the Dask cluster has no workers left; finished runs are stored; the"
    with pytest.raises(Problem, match=expected):
        next(batches.outcomes())
