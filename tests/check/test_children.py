"""Child processes of the check end whatever the FMU does, and leave no processes or files."""

import signal
import tempfile
import time
from functools import partial
from pathlib import Path

import pytest
from kit import shards
from kit.needs import needs
from kit.wait import until
from zoo.command import command

from check.test_probes import apply, opened
from orchestrator.check import probe_process
from orchestrator.check.probe_process import ProbeLimits, use_probe_limits
from orchestrator.worker.calls import share_activity
from orchestrator.worker.process import MAX_STDERR, LimitExceeded, Worker, WorkerLimits

PATIENCE = 60.0  # s: for what takes less than a second, on a machine with other things to do
linux = needs("Linux", "looks into /proc")
bounded = pytest.mark.timeout(PATIENCE)  # a limit that is not enforced lets a test wait for ever


@linux
def test_an_fmu_that_eats_memory_is_stopped(oscillators, tmp_path):
    """The message contains the limit, and the last call into the FMU."""
    with use_probe_limits(ProbeLimits(call_time=PATIENCE, work_time=2.0, memory=2e8)):
        found = apply(oscillators.make(fault="eats"), tmp_path, "default")
    text = "co-simulation: uses more than 0.2 GB of memory, stopped in fmi2DoStep at t = 0.31 s"
    assert ("error", text) in [(f.severity, f.text) for f in found]


@pytest.fixture
def sleeper(monkeypatch):
    """A child that never ends by itself."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1] / "worker"))
    child = Worker("jobs:sleep", dict)
    yield child
    child.close()


@bounded
def test_an_fmu_that_prints_without_end_does_not_fill_the_disk(sleeper):
    """Only the beginning of the stderr of a child process is kept if it becomes very long."""
    errors = sleeper.folder / "errors"
    errors.write_bytes(bytes(MAX_STDERR + 1))
    until((sleeper.folder / "activity").exists)
    share_activity(sleeper.folder / "activity").call("fmi2DoStep")
    with pytest.raises(LimitExceeded, match=r"^hang: no return within 0.2 s in fmi2DoStep$") as exceeded:
        list(sleeper.messages(WorkerLimits(call_time=0.2)))
    assert not exceeded.value.timed_out
    assert errors.stat().st_size <= MAX_STDERR // 256


@bounded
def test_a_python_that_starts_slowly_is_no_hang(sleeper):
    """Before the first call only the time limit of the whole probe applies."""
    text = r"^not done within 0.3 s, stopped outside of the FMUs$"
    with pytest.raises(LimitExceeded, match=text) as exceeded:
        list(sleeper.messages(WorkerLimits(call_time=0.1, total_time=0.3)))
    assert exceeded.value.timed_out


def test_a_crash_leaves_no_copy_of_the_fmu(oscillators, tmp_path, monkeypatch):
    """The copy in another folder is removed, also if the FMU crashes the process that made it."""
    there = tmp_path / "temporary"
    there.mkdir()
    monkeypatch.setenv("TMPDIR", str(there))
    monkeypatch.setattr(tempfile, "tempdir", None)
    found = apply(oscillators.make(fault="place"), tmp_path / "fmu", "resources")
    assert any("abort in fmi2Instantiate" in f.text and "in a folder" in f.text for f in found), found
    assert list(there.iterdir()) == []


def test_a_defect_of_the_check_is_not_reported_as_a_fault_of_the_fmu(oscillators, tmp_path):
    """An exception in a task gives a warning that names a defect of the check."""
    subject = opened(oscillators.make(), tmp_path)
    task = "time_and_state:elsewhere"
    outcome = probe_process.run(subject.folder, subject.model, "CoSimulation", task, payload={})
    assert outcome.remarks == [
        ("warning", "the probe failed (a defect of this check): KeyError('initial_inputs')")
    ]
    assert outcome.failure == ""


def _hangs_in_a_step(there: Path) -> bool:
    """A child process is in the same call of fmi2DoStep as half a second ago."""

    def calls() -> set[bytes]:
        return {b.read_bytes() for b in there.glob("probe-*/activity")}

    before = calls()
    time.sleep(0.5)
    return any(b"fmi2DoStep" in call for call in before & calls())


@needs("POSIX", "sends POSIX signals")
@pytest.mark.parametrize(
    "number", ["SIGINT", *(pytest.param(other, marks=shards.faults) for other in ("SIGTERM", "SIGHUP"))]
)
def test_an_interrupted_check_leaves_nothing(oscillators, tmp_path, number):
    """Ctrl-C, SIGTERM and a closed terminal end the check while the FMU hangs, and leave no folder."""
    words = ["check", "--timeout", "1000", oscillators.make(fault="hang")]
    hangs = partial(_hangs_in_a_step, tmp_path / "temporary")
    ended = command(words, tmp_path, hangs, number=getattr(signal, number))
    # of a shell: 128 and the signal
    status = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}[number]
    assert (ended.status, ended.lines, ended.left) == (status, ["harvester: interrupted"], ())
