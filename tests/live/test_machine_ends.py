"""However the process of a machine ends: it is told, leaves nothing behind, and another can be started."""

import gc
import os
import signal
import subprocess
import sys
import threading
import warnings
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from kit import shards
from kit.mistakes import problem
from kit.wait import runs, until

from orchestrator.realtime import machine
from orchestrator.realtime.machine import RealTimeMachine
from orchestrator.realtime.setup import Axis, Setup

from .conftest import posix, u


def test_a_failed_fmu_is_told_and_a_restart_works(opened, failing, drift):
    """One line; what was seen until then stays; neither the page nor the machine is lost."""
    station = opened(failing, playing=False)  # or it might have failed before anybody has seen it start
    station.play()
    assert until(lambda: station.latest().state == "failed")
    frame = station.latest()
    assert frame.message.startswith("fails: the step failed at t = 0.195 s")
    assert "\n" not in frame.message
    assert frame.t == pytest.approx(0.19)
    assert len(station.trace().time) == 20
    station.command({"u": 1.0})
    station.restart(replace(failing, set={}))
    assert station.ready().state != "failed"
    station.restart(replace(failing, signals=("fails.z",)))
    assert station.ready().message.startswith("unknown variable 'fails.z'; did you mean fails.y")
    station.restart(drift)
    assert until(lambda: station.latest().state == "running")


@pytest.mark.usefixtures("opened")
def test_a_wrong_setup_is_told_at_the_start(drift):
    """And nothing is left running."""
    unknown, wrong = replace(drift, signals=("drift.z",)), replace(drift, axes=(Axis("u", -1.0, 1.0),))
    problem(lambda: RealTimeMachine(unknown), r"^unknown variable 'drift\.z'; did you mean drift\.y")
    problem(lambda: RealTimeMachine(wrong), "^axis u: expected a positive limit, got -1$")
    told = r"^speed: expected a factor from 0\.1 to 10, got 0$"
    problem(lambda: RealTimeMachine(drift, speed=0.0), told)


@posix
def test_a_process_that_dies_is_told_and_a_restart_works(opened, drift):
    """As when an FMU crashes."""
    station = opened(drift)
    assert until(lambda: station.latest().timing.frames > 3)
    os.kill(station.pid, signal.SIGKILL)
    assert until(lambda: station.latest().state == "failed")
    message = station.latest().message
    assert message.startswith("the process of the machine ended: killed by the system (out of memory?) ")
    assert message.endswith((f"outside of the FMUs: {drift.system}", f"of drift ({drift.system})"))
    assert len(station.trace().time) > 3
    station.restart()
    assert station.ready().state != "failed"


def test_a_process_that_does_not_start_is_ended(opened, drift, monkeypatch):
    """It stays failed, and a restart works."""
    station = opened(drift)
    with monkeypatch.context() as patch:
        patch.setattr(machine, "START_TIMEOUT", 0.0)
        station.restart(drift)
        assert until(lambda: station.latest().state == "failed")
    assert station.latest().message.startswith("the machine has not started within 0 s")
    assert not runs(station.pid)
    station.restart(drift)
    assert until(lambda: station.latest().state == "running")


@shards.faults
@posix
def test_a_process_that_hangs_is_told(opened, drift, monkeypatch):
    """As when an FMU does not return; it may come back, and it can be ended."""
    station = opened(drift)
    assert until(lambda: station.latest().state == "running")
    os.kill(station.pid, signal.SIGSTOP)
    monkeypatch.setattr(machine, "SILENT", 0.5)
    assert until(lambda: station.latest().state == "failed")
    assert station.latest().message.startswith("the machine has not answered for ")
    os.kill(station.pid, signal.SIGCONT)
    assert until(lambda: station.latest().state == "running")
    os.kill(station.pid, signal.SIGSTOP)
    station.close()
    assert not runs(station.pid)


PARENT = """
import sys
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.realtime.machine import RealTimeMachine
station = RealTimeMachine(Setup(sys.argv[1], (Axis("u", 2.0, 10.0),), ("drift.y",), timeout=60.0))
station.command({"u": 1.0})
print(station.pid, flush=True)
if sys.argv[2] == "wait":
    sys.stdin.read()
elif sys.argv[2] == "raise":
    raise SystemExit(3)
"""


@posix
@pytest.mark.parametrize("how", shards.few(["kill"], ["kill", "raise", "return"], shards.faults))
def test_it_does_not_outlive_its_parent(drift, tmp_path, how):
    """Killed, ended by an error, or at its end without a close: no process and no file stays."""
    shared = set(os.listdir("/dev/shm")) if sys.platform == "linux" else set()
    command = [sys.executable, "-c", PARENT, drift.system, "wait" if how == "kill" else how]
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(machine.__file__).parents[2])}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as parent:
        child = int(parent.stdout.readline())
        if how == "kill":
            assert runs(child)
            assert list(tmp_path.glob("live-*"))
            parent.kill()
    assert until(lambda: not runs(child))
    assert until(lambda: not list(tmp_path.glob("live-*")))
    assert parent.returncode == {"kill": -signal.SIGKILL, "raise": 3, "return": 0}[how]
    if sys.platform == "linux":
        assert not [name for name in set(os.listdir("/dev/shm")) - shared if "harvester" in name]


def test_priority_can_be_declined(opened, drift, monkeypatch):
    """By an environment variable; the notes say how the process is scheduled."""
    monkeypatch.setenv("HARVESTER_PRIORITY", "ordinary")
    assert opened(drift).notes[-1] == "ordinary scheduling, as HARVESTER_PRIORITY asks for"


def test_closing(opened, drift):
    """Closing may be repeated; frames stay readable, the state is "ended", and a restart is refused."""
    station = opened(drift)
    assert until(lambda: station.latest().timing.frames > 3)
    station.close()
    station.close()
    assert not runs(station.pid)
    frame = station.latest()
    assert (frame.state, frame.message) == ("ended", "")
    assert len(station.trace().time) == frame.timing.frames + 1
    station.command({"u": 1.0})
    problem(station.restart, "the machine is closed")


def test_one_that_is_forgotten_ends(drift):
    """Without a close, when nobody holds it any more."""
    station = RealTimeMachine(drift)
    pid = station.pid
    with warnings.catch_warnings(action="error"):
        del station
        gc.collect()
    assert until(lambda: not runs(pid))


# ---- From one session of a live machine to the next: restarts, other machines, what is kept and written


def test_restart_with_another_setup(opened, drift, fmus):
    """Other machine, axes and signals; numbers go on, time begins again, old commands are gone."""
    station = opened(drift)
    station.command({"u": 1.0})
    assert until(lambda: u(station) == 1.0)
    old = station.latest().number
    axes = (Axis("gain.u", 5.0, 100.0, rest=-1.0),)
    gain = Setup(str(fmus["gain"]), axes, ("gain.y",), set=MappingProxyType({"gain.factor": 3}))
    station.restart(gain)
    waiting = station.latest()
    if waiting.state == "starting":
        assert waiting.number > old
        assert np.isnan([waiting.t, *waiting.axes, *waiting.values]).all()
    assert until(lambda: station.latest().timing.frames > 3)
    frame = station.latest()
    assert (station.axes, station.signals, station.units["gain.u"]) == (("gain.u",), ("gain.y",), "m")
    assert (list(frame.axes), list(frame.values)) == ([-1.0], [-3.0])
    numbers, times, _, values = station.since(old)
    assert times[0] == 0.0
    assert numbers[0] > old
    assert (values == -3.0).all()
    station.restart()
    assert station.ready().number > frame.number


def test_numbers_never_go_back(opened, drift):
    """Whoever looks all the time, through restarts at full speed."""
    station, seen, over = opened(drift, speed=10.0), [0], threading.Event()

    def look() -> None:
        while not over.is_set():
            seen.append(station.latest().number)

    looking = threading.Thread(target=look)
    looking.start()
    for _ in range(2):
        number = station.latest().number
        assert until(lambda number=number: station.latest().number > number + 20)
        station.restart()
        station.ready()
    over.set()
    looking.join()
    assert (np.diff(seen) >= 0).all()


def test_the_machine_in_another_fidelity(opened, fmu_dir):
    """The whole machine: lumped, then detailed in another pose, without being closed."""
    axes = (Axis("swing_command", 10.0, 100.0),)
    first = Setup(str(fmu_dir / "harvester.ssp"), axes, ("manipulator.boom_angle",))
    station = opened(first)
    station.command({"swing_command": 3.0})
    assert until(lambda: station.latest().timing.frames > 5)
    other = replace(first, swap={"swing": "detailed"}, set={"manipulator.initial_boom_angle": 0.5})
    station.restart(other)
    frame = station.ready()
    assert frame.state != "failed", frame.message
    assert station.setup == other
    assert station.trace()["manipulator.boom_angle"][0] == pytest.approx(0.5)
    assert any("swing is swapped: swing_detailed" in note for note in station.notes)


def test_old_frames_make_room(opened, drift, monkeypatch):
    """The newest frames of a long session are kept in order; a note reports the number of dropped ones."""
    monkeypatch.setattr(machine, "KEPT", 0.4)  # 40 frames
    station = opened(drift, speed=10.0)
    assert until(lambda: station.latest().timing.frames > 200)
    station.close()
    numbers, times, _, _ = station.since(-1)
    assert 25 <= len(numbers) <= 40
    assert (np.diff(numbers) == 1).all()
    assert numbers[-1] == station.latest().number
    np.testing.assert_allclose(times, 0.01 * (numbers - 1), rtol=1e-9)  # rounding of times
    assert f"the first {numbers[0] - 1} frames are no longer in memory" in station.notes
