"""From one session of a live machine to the next: restarts, other machines, what is kept and written."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from kit.wait import until

from orchestrator.realtime import machine
from orchestrator.realtime.setup import Axis, Setup

from .conftest import u


def test_restart_with_another_setup(opened, drift, fmus):
    """Other machine, other axes, other signals; numbers go on, time begins again, old commands are gone."""
    station = opened(drift)
    station.command({"u": 1.0})
    assert until(lambda: u(station) == 1.0)
    old = station.latest().number
    axes = (Axis("gain.u", 5.0, 100.0, rest=-1.0),)
    gain = Setup(str(fmus["gain"]), axes, ("gain.y",), set={"gain.factor": 3})
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
