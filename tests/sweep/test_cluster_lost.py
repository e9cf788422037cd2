"""A Dask scheduler that is killed in the middle of a study: for real, all in processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sweep.studies import GAIN, content, run, study

RUNS = 240
LONG = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 20")
# the command line, but for the time that it gives a scheduler to come back
COMMAND = """
import sys
from orchestrator.__main__ import main
from orchestrator.sweep import cluster
cluster.PATIENCE = 2.0
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
    process = _dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    while not file.exists():
        assert process.poll() is None
        time.sleep(0.05)
    worker = _dask("worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-nanny")
    yield json.loads(file.read_text())["address"], process
    for one in (worker, process):
        one.kill()
        one.wait()


def test_a_scheduler_that_is_killed_is_told_in_one_line(gain, one, scheduler, tmp_path) -> None:
    """No log of Dask and no traceback, exit status 2; what was finished is kept, and the study goes on."""
    address, process = scheduler
    file, out = study(tmp_path, LONG, gain), tmp_path / "out"
    command = [sys.executable, "-c", COMMAND, "sweep", str(file), "--out", str(out), "--scheduler", address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sweep:
        while not list(out.glob("parts/runs-*.parquet")):
            assert sweep.poll() is None, sweep.communicate()
            time.sleep(0.02)
        os.kill(process.pid, signal.SIGKILL)
        told, wrong = sweep.communicate(timeout=60)
    *progress, last = wrong.splitlines()
    assert last == "harvester: the Dask scheduler is gone; what is finished is kept, the same command goes on"
    assert all(f" of {RUNS} runs, " in line for line in progress), wrong
    assert (told, sweep.returncode) == ("", 2)
    _, fresh = run(file, one)
    assert 0 < len(fresh) < RUNS
    run(file, one, "undisturbed")
    assert content(out) == content(tmp_path / "undisturbed")
