"""A study that is killed or interrupted: what was finished is kept, the content is the same in the end."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from kit import shards
from kit.wait import until
from sweep.studies import GAIN, content, run, study

from orchestrator.studies import store

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


def stopped(file, out, stop, begun="parts/batch-*.parquet", most=RUNS):
    """The command line, which is stopped when it has made such a file: status, children, and what it said.

    It has a process group of its own, as a terminal starts it. Where much else is done a signal may come when
    `most` runs are kept or all are done: then all is done once more.
    """
    arguments = ["sweep", str(file), "--out", str(out), "--no-report"]
    # a process that was started in the background would ignore Ctrl-C: its handler is set again
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    begin += f"import sys; sys.argv[1:] = {arguments!r}; from orchestrator.__main__ import script; script()"
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    for _ in range(10):
        out.mkdir()
        options["env"] = os.environ | {"TMPDIR": str(out)}
        process = subprocess.Popen([sys.executable, "-c", begin], **options)
        assert until(lambda p=process: p.poll() is not None or list(out.glob(begun)))
        assert process.poll() is None, process.communicate()
        children = psutil.Process(process.pid).children()
        stop(process.pid)
        told, wrong = process.communicate()
        if not store.finished(out) and len(kept(out)) < most:
            return process.returncode, children, told, wrong
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
    assert not store.finished(out)
    _, runs = run(file, "killed")
    assert runs == sorted(set(range(RUNS)) - there)
    assert content(out) == undisturbed


def interrupt(group: int) -> None:
    """As the terminal does, of all processes of the command."""
    os.killpg(group, signal.SIGINT)


def test_an_interrupt_keeps_what_is_finished(long):
    """One line and the exit status of an interrupt; the same command runs the others to the same content."""
    file, undisturbed = long
    out = file.parent / "interrupted"
    status, _, told, wrong = stopped(file, out, interrupt)
    assert (status, told) == (130, ""), wrong
    *progress, last = wrong.splitlines()
    told = f"{len(kept(out))} of {RUNS} runs are stored in {out}"
    assert last == f"harvester: interrupted; {told}; the same command continues the study"
    assert all(f" of {RUNS} runs, " in line for line in progress)
    run(file, "interrupted")
    assert content(out) == undisturbed


def test_an_interrupt_while_the_processes_start(long):
    """It is an interrupt, no process that could not be started."""
    file, _ = long
    status, *_, wrong = stopped(file, file.parent / "early", interrupt, "run-*/errors", 1)
    assert status == 130, wrong
    assert wrong.splitlines()[-1].startswith(f"harvester: interrupted; 0 of {RUNS} runs are stored")
