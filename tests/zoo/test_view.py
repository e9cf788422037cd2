"""A live machine of an FMU with a fault: one line on the page and the terminal, its frames are kept."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from kit import shards
from kit.wait import LONG, runs, until

from orchestrator import Problem
from orchestrator.data.trace import read_trace
from orchestrator.realtime import machine as realtime
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Axis, Setup
from zoo.command import command
from zoo.faulty import BEGIN, CASES, FAULTS, HANGS, MEMORY, Faulty, faulty

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="faults and signals of POSIX")
SILENT, STARTED = 1.0, 4.0  # [s] instead of 5 and 60, to wait less
SELECTED = [(fault, "step") for fault in FAULTS if fault not in ("exit_7", "overflow")]
SELECTED += [("spin", "instantiate"), ("exit_0", "initialise"), ("exit_0", "free"), ("sleep", "free")]
QUIET = ("--no-open", "--port", "0")
QUICK = [("segfault", "step"), ("spin", "step"), ("exit_0", "initialise")]
HANGING = [("spin", "instantiate"), ("sleep", "step")]


def _timeouts(fault: str) -> tuple[float, float]:
    """Timeouts [s] of a step and of the start; long for a leak, which takes its time on a loaded machine."""
    return (LONG, LONG) if fault == "leak" else (SILENT, STARTED)


def _check(fmu: Faulty, message: str) -> None:
    """One line with the FMU and what has happened."""
    cause = ""
    if fmu.fault in HANGS or (fmu.fault, fmu.phase) == ("leak", "free"):  # nobody looks at the memory then
        hangs = {"step": "not answered for 1 s", "free": f"did not end within {realtime.END_TIMEOUT:g} s"}
        cause = hangs.get(fmu.phase, f"not started within {STARTED:g} s")
    fmu.assert_told(message, fmu.fmu.stem, cause)


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Limits that are reached soon; no file is left at the end."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    monkeypatch.setattr(realtime, "MEMORY", 1e9 * MEMORY)
    yield
    assert list(temporary.iterdir()) == []


@pytest.mark.usefixtures("limits")
@pytest.mark.parametrize(("fault", "phase"), shards.few(QUICK, SELECTED, shards.faults))
def test_a_fault_fails_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, phase: str
) -> None:
    """Frames until then stay; the process and what it started are gone after the close."""
    fmu = faulty(tmp_path, fault, phase)
    silent, started = _timeouts(fault)
    monkeypatch.setattr(realtime, "SILENT", silent)
    monkeypatch.setattr(realtime, "START_TIMEOUT", started)
    try:
        machine = RealTimeMachine(Setup(str(fmu.fmu), (Axis("u", 2.0, 10.0),), ("lag.y",)))
    except Problem as problem:
        assert phase in ("instantiate", "initialise")
        _check(fmu, str(problem))
        return
    if phase == "step":
        assert until(fmu.committed.exists)
        until(lambda: machine.latest().state == "failed", 0.5 if fmu.harmless else 2 * silent + 10)
        assert (machine.latest().state == "failed") != fmu.harmless
        # the frame that ends at 0.5 s is the last; without a fault the machine goes on
        assert (machine.trace().time[-1] > BEGIN + 0.05) == fmu.harmless
        assert machine.trace().time[-1] > BEGIN - 0.011
    machine.close()
    frame = machine.latest()
    assert frame.state == ("ended" if fmu.harmless else "failed")
    if not fmu.harmless:
        _check(fmu, frame.message)
    assert not runs(machine.pid)
    assert until(lambda: not runs(int(fmu.committed.read_text())))


ABORT = [("abort", "step", 3)]


@pytest.mark.parametrize(("fault", "phase", "major"), shards.few(ABORT, CASES, shards.faults))
def test_the_terminal_tells_the_fault(tmp_path: Path, fault: str, phase: str, major: int) -> None:
    """In one line, also while an FMU hangs; Ctrl-C ends the command and leaves nothing."""
    fmu = faulty(tmp_path, fault, phase, major)

    def begun() -> bool:
        """The fault was committed and its line is there, or it is committed at the end."""
        if phase == "free" or fmu.harmless:
            return (tmp_path / "stdout").stat().st_size > 0
        return "session-" in (tmp_path / "stderr").read_text("utf-8")

    limits = "m.MEMORY, m.SILENT, m.START_TIMEOUT = {}, {}, {}".format(1e9 * MEMORY, *_timeouts(fault))
    setup = f"import orchestrator.realtime.machine as m; {limits}"
    ended = command(["view", fmu.fmu, *QUIET, "--results", "results"], tmp_path, begun, setup)
    assert ended.left == ()
    if "harvester: interrupted" not in ended.err:  # failed before its page was there
        assert ended.status == 2
        assert phase in ("instantiate", "initialise")
        _check(fmu, "\n".join(ended.lines))
        return
    assert ended.status == 130
    assert len(ended.lines) == 2 - fmu.harmless
    if not fmu.harmless:
        _check(fmu, ended.lines[0])
        file = tmp_path / ended.lines[0].rpartition(" is in ")[2]
        # frames of 10 ms up to 0.5 s, and the first
        assert len(read_trace(file).time) >= (51 if phase == "step" else 1)


@pytest.mark.parametrize(("fault", "phase"), shards.few(HANGING[:1], HANGING, shards.faults))
def test_an_interrupt_is_obeyed_while_an_fmu_hangs(tmp_path: Path, fault: str, phase: str) -> None:
    """Before the page is there, and after."""
    fmu = faulty(tmp_path, fault, phase)
    ended = command(["view", fmu.fmu, *QUIET], tmp_path, fmu.committed.exists)
    assert (ended.status, ended.lines[-1]) == (130, "harvester: interrupted")
    assert ended.left == ()
