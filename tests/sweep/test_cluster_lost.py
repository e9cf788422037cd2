"""A Dask scheduler that is killed in the middle of a study: for real, all in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from distributed import Client
from kit import shards
from kit.wait import LONG, until
from sweep.studies import GAIN, content, run, study

pytestmark = shards.faults

RUNS = 240
MANY = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 20")
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
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Its address and its process; one worker is with it."""
    file = tmp_path / "scheduler.json"
    options = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    with _dask("scheduler", *options) as process:
        assert until(lambda: process.poll() is not None or _address(file))
        with _dask("worker", address := _address(file), "--nthreads", "1", "--no-nanny"):
            with Client(address, timeout=LONG) as client:
                client.wait_for_workers(1, timeout=LONG)
            yield address, process


def _address(file: Path) -> str:
    """Of the scheduler, when all of its file is written."""
    try:
        return json.loads(file.read_text())["address"]
    except (OSError, ValueError):
        return ""


def test_a_scheduler_that_is_killed_is_told_in_one_line(gain, one, scheduler, tmp_path) -> None:
    """No log of Dask and no traceback, exit status 2; what was finished is kept, and the study goes on."""
    address, process = scheduler
    file, out = study(tmp_path, MANY, gain), tmp_path / "out"
    options = ["sweep", str(file), "--out", str(out), "--scheduler", address]
    command = [sys.executable, "-c", COMMAND, str(process.pid), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *progress, last = done.stderr.splitlines()
    assert last == (
        "harvester: the connection to the Dask scheduler is lost; finished runs are stored; the "
        "same command continues the study"
    )
    assert all(f" of {RUNS} runs, " in line for line in progress), done.stderr
    assert (done.stdout, done.returncode) == ("", 2)
    _, fresh = run(file, one)
    assert 0 < len(fresh) < RUNS
    run(file, one, "undisturbed")
    assert content(out) == content(tmp_path / "undisturbed")
