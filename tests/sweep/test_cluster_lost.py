"""A Dask scheduler that is killed in the middle of a study: for real, all in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from distributed import Client
from kit import shards
from sweep.studies import GAIN, content, run, study

pytestmark = shards.faults

RUNS = 240
CONNECT_TIMEOUT = 600  # s; only bounds a failure, on a computer that does much else
LONG = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 20")
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


def _dask(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
    return subprocess.Popen(
        [*command, "--no-dashboard"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Its address and its process; one worker is with it."""
    file = tmp_path / "scheduler.json"
    with ExitStack() as ends:
        process = _dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        ends.callback(_end, process)
        while not (address := _address(file)):
            assert process.poll() is None
            time.sleep(0.05)
        worker = _dask("worker", address, "--nthreads", "1", "--no-nanny")
        ends.callback(_end, worker)
        with Client(address, timeout=CONNECT_TIMEOUT) as client:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
        yield address, process


def _address(file: Path) -> str:
    """Of the scheduler, when all of its file is written."""
    try:
        return json.loads(file.read_text())["address"]
    except (OSError, ValueError):
        return ""


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def test_a_scheduler_that_is_killed_is_told_in_one_line(gain, one, scheduler, tmp_path) -> None:
    """No log of Dask and no traceback, exit status 2; what was finished is kept, and the study goes on."""
    address, process = scheduler
    file, out = study(tmp_path, LONG, gain), tmp_path / "out"
    options = ["sweep", str(file), "--out", str(out), "--scheduler", address]
    sweep = subprocess.run(
        [sys.executable, "-c", COMMAND, str(process.pid), *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=CONNECT_TIMEOUT,
    )
    told, wrong = sweep.stdout, sweep.stderr
    *progress, last = wrong.splitlines()
    assert last == (
        "harvester: the connection to the Dask scheduler is lost; finished runs are stored; the "
        "same command continues the study"
    )
    assert all(f" of {RUNS} runs, " in line for line in progress), wrong
    assert (told, sweep.returncode) == ("", 2)
    _, fresh = run(file, one)
    assert 0 < len(fresh) < RUNS
    run(file, one, "undisturbed")
    assert content(out) == content(tmp_path / "undisturbed")
