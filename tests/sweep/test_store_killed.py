"""A study that is killed or interrupted: what was finished is kept, the content is the same in the end."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from kit import shards
from kit.wait import until
from sweep.studies import GAIN, content, run, study

pytestmark = shards.faults

RUNS = 120
LONG = GAIN.replace("runs = 12", f"runs = {RUNS}").replace("stop = 0.2", "stop = 40")  # some seconds in all


@pytest.fixture(scope="module")
def long(gain, tmp_path_factory):
    """The file of a study of some seconds, and its results without a kill, by two workers."""
    file = study(tmp_path_factory.mktemp("long"), LONG, gain)
    _, runs = run(file, "undisturbed", workers=2)
    assert runs == list(range(RUNS))
    return file, content(file.parent / "undisturbed")


def command(file: Path, out: Path, **environment: str) -> subprocess.Popen[str]:
    """The command line in a process group of its own, as a terminal starts it."""
    arguments = ["sweep", str(file), "--out", str(out), "--no-report"]
    # a process that was started in the background would ignore Ctrl-C: its handler is set again
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    begin += f"import sys; sys.argv[1:] = {arguments!r}; from orchestrator.__main__ import script; script()"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    environ = os.environ | environment
    return subprocess.Popen([sys.executable, "-c", begin], start_new_session=True, env=environ, **pipes)


def reached(process: subprocess.Popen[str], folder: Path, pattern: str) -> None:
    """Wait until a command that runs has made such a file."""
    assert until(lambda: process.poll() is not None or list(folder.glob(pattern)))
    assert process.poll() is None, process.communicate()


def stopped(
    file: Path, out: Path, stop: Callable[[int], object]
) -> tuple[subprocess.Popen[str], list[psutil.Process], str, str]:
    """The command after it was stopped in the middle, its children, and what it said.

    Where much else is done a signal may come after the last run: then all is done once more.
    """
    for _ in range(10):
        process = command(file, out)
        reached(process, out, "parts/batch-*.parquet")
        children = psutil.Process(process.pid).children()
        stop(process.pid)
        told, wrong = process.communicate()
        if not (out / "runs.parquet").exists() and len(kept(out)) < RUNS:
            return process, children, told, wrong
        shutil.rmtree(out)
    pytest.fail("ten times the study was over before it was stopped")


def kept(out: Path) -> set[int]:
    """The runs that are finished."""
    return {n for f in out.glob("parts/batch-*.parquet") for n in pq.read_table(f)["run"].to_pylist()}


def test_killed_and_started_again_the_content_is_the_same(long):
    """Byte by byte, with another number of workers; the runs that were kept do not take place again."""
    file, undisturbed = long
    out = file.parent / "killed"
    _, children, *_ = stopped(file, out, lambda pid: os.kill(pid, signal.SIGKILL))
    assert children
    assert psutil.wait_procs(children, timeout=60)[1] == []  # they see that nobody asks them any more
    there = kept(out)
    assert 0 < len(there) < RUNS
    assert not (out / "runs.parquet").exists()
    _, runs = run(file, "killed")
    assert runs == sorted(set(range(RUNS)) - there)
    assert content(out) == undisturbed


def test_an_interrupt_keeps_what_is_finished(long):
    """One line, the exit status of an interrupt, and what was finished is there."""
    file, _ = long
    out = file.parent / "interrupted"
    # as the terminal does, to all processes of the command
    process, _, told, wrong = stopped(file, out, lambda group: os.killpg(group, signal.SIGINT))
    assert process.returncode == 130, wrong
    assert told == ""
    *progress, last = wrong.splitlines()
    assert last == (
        f"harvester: interrupted; {len(kept(out))} of {RUNS} runs are stored in {out};"
        " the same command continues the study"
    )
    assert all(f" of {RUNS} runs, " in line for line in progress)


def test_an_interrupt_while_the_processes_start(long, tmp_path):
    """It is an interrupt, no process that could not be started."""
    file, _ = long
    out = file.parent / "early"
    for _ in range(10):
        process = command(file, out, TMPDIR=str(tmp_path))
        reached(process, tmp_path, "sweep-*/errors")
        os.killpg(process.pid, signal.SIGINT)
        _, wrong = process.communicate()
        if not kept(out) and not (out / "runs.parquet").exists():
            break
        shutil.rmtree(out)  # where much else is done the signal may come after the first runs
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
    assert process.returncode == 130, wrong
    assert wrong.splitlines()[-1].startswith(f"harvester: interrupted; 0 of {RUNS} runs are stored")
