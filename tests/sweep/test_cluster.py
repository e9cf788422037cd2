"""On a Dask cluster that is there already: the same content, also when one of its processes dies."""

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest
from distributed import Client, LocalCluster
from distributed.utils import LoopRunner, json_load_robust
from kit import shards
from kit.mistakes import problem
from kit.wait import LONG
from sweep.studies import GAIN, content, run, study

from orchestrator import Problem
from orchestrator.studies import cluster
from orchestrator.studies.parameter_study import sweep

pytestmark = shards.faults

RUNS = 240  # in many batches
MANY = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 20")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """The address of a scheduler with two workers in processes of their own, replaced when they die."""
    options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with LocalCluster(2, **options) as there:
        yield there.scheduler_address


def listening() -> set[object]:
    """Addresses at which this process listens: a server of another test may still be ending."""
    return {c.laddr for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN}


def test_no_port_is_opened_on_this_machine(file, tmp_path):
    """A study without a cluster listens on no port."""
    before, during = listening(), set()
    sweep(file, tmp_path / "out", watch=lambda *_: during.update(listening()))
    assert during <= before


def test_a_worker_that_dies_costs_no_run(gain, address, tmp_path):
    """One of two is killed: what it was at is run again elsewhere, and no sample is lost or there twice.

    The content is that of an undisturbed study, byte by byte.

        python -m pytest -m long tests/sweep/test_cluster.py -k dies
    """
    file = study(tmp_path, MANY, gain)
    run(file, "here")
    killed = []

    def kill(_total, _done, batch):
        """One worker, once, when the first batch is done."""
        if batch and not killed:
            with Client(address) as client:
                killed.extend(client.run(os.getpid).values())
            os.kill(killed[0], signal.SIGKILL)

    result = sweep(file, tmp_path / "there", scheduler=address, watch=kill)
    assert len(killed) == 2
    assert sorted(result.table["run"]) == list(range(RUNS))
    assert content(tmp_path / "there") == content(tmp_path / "here")


def test_nothing_is_left_on_the_workers(gain, address, tmp_path):
    """The processes of a study end with it."""
    with Client(address) as client:
        sweep(study(tmp_path, GAIN, gain), tmp_path / "out", client=client)
        children = client.run(lambda: [" ".join(p.cmdline()) for p in psutil.Process().children()])
    assert not [line for lines in children.values() for line in lines if "worker.main" in line]


def test_schedulers_that_are_not_there_leave_nothing_that_can_hang(monkeypatch):
    """Two hundred in one process, and the garbage collector always runs while Dask's lock is held.

    A client that is left half made is closed by the collector then, and waits for that lock for ever.
    """
    start, collected = LoopRunner._start_unlocked, []

    def with_garbage(runner: LoopRunner) -> None:
        collected.append(gc.collect())
        start(runner)

    monkeypatch.setattr(LoopRunner, "_start_unlocked", with_garbage)
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.02)
    threads = threading.active_count()
    gc.freeze()  # what is there already need not be looked at 200 times
    for n in range(200):
        url = ("nowhere", "foo://127.0.0.1:1", "tcp://127.0.0.1:1")[n % 3]
        expected = rf"^--scheduler {url}: expected a Dask scheduler, got [^\n]+$"
        with pytest.raises(Problem, match=expected), cluster.client(url):
            pass
    gc.unfreeze()
    assert len(collected) == 200
    assert threading.active_count() <= threads


@pytest.mark.parametrize("kept", [False, True])
def test_a_wrong_address_leaves_nothing_and_deletes_nothing(kept, gain, tmp_path, monkeypatch):
    """No folder where there was none, also none above it; with --fresh what is there stays, to be read."""
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    file, out, url = study(tmp_path, GAIN, gain), tmp_path / "deep" / "out", "tcp://127.0.0.1:1"
    before = content(out) if kept and run(file, "deep/out") else {}
    line = problem(lambda: sweep(file, out, scheduler=url, fresh=kept))
    assert line.startswith(f"--scheduler {url}: expected a Dask scheduler")
    assert (tmp_path / "deep").exists() is kept
    assert content(out) == before
    assert bool(before) is kept
    if kept:  # a finished study needs no scheduler
        assert len(sweep(file, out, scheduler=url).table) == 12


def test_a_cluster_that_is_lost_for_good_is_told(monkeypatch):
    """The command does not wait for ever, and says that it can go on."""
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 0.0)
    deserted = cluster.Places(Mock(**{"nthreads.return_value": {}}))
    problem(deserted, r"^the Dask cluster has no workers left; finished runs are stored; the")


# ---- a scheduler that is killed in the middle of a study: for real, all in processes of their own

# the command line, which kills the scheduler itself when its first batch is kept: in the middle, however slow
# or fast this computer is
COMMAND = """
import os, signal, sys
from orchestrator.__main__ import main
from orchestrator.studies.store import Store
scheduler, add = int(sys.argv.pop(1)), Store.add
def first(self, rows):
    add(self, rows)
    Store.add = add
    os.kill(scheduler, signal.SIGKILL)
Store.add = first
sys.exit(main())
"""


@contextmanager
def _dask(program: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask until the end of the block."""
    command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *arguments, "--no-dashboard"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Its address and its process; one worker is with it."""
    file = tmp_path / "scheduler.json"
    options = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    with _dask("scheduler", *options) as process:
        address = json_load_robust(file, timeout=LONG)["address"]
        with _dask("worker", address, "--nthreads", "1", "--no-nanny"):
            with Client(address, timeout=LONG) as client:
                client.wait_for_workers(1, timeout=LONG)
            yield address, process


def test_a_scheduler_that_is_killed_is_told_in_one_line(gain, scheduler, tmp_path) -> None:
    """No log of Dask and no traceback, exit status 2; what was finished is kept, and the study goes on."""
    address, process = scheduler
    file, out = study(tmp_path, MANY, gain), tmp_path / "out"
    options = ["sweep", str(file), "--out", str(out), "--scheduler", address]
    command = [sys.executable, "-c", COMMAND, str(process.pid), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *progress, last = done.stderr.splitlines()
    told = "the connection to the Dask scheduler is lost; finished runs are stored"
    assert last == f"harvester: {told}; the same command continues the study"
    assert all(f" of {RUNS} runs, " in line for line in progress), done.stderr
    assert (done.stdout, done.returncode) == ("", 2)
    _, fresh = run(file)
    assert 0 < len(fresh) < RUNS
    run(file, "undisturbed")
    assert content(out) == content(tmp_path / "undisturbed")
