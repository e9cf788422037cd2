"""A result file with the interface of a live machine."""

import numpy as np
import pytest

from orchestrator import Problem, Trace, write_trace
from orchestrator.realtime.replay import Replay


@pytest.fixture
def file(tmp_path):
    """x = 2 t, sampled at 200 Hz from 1 to 3 s, and y = -t."""
    t = 1.0 + 0.005 * np.arange(401)
    trace = Trace(t, {"a.x": 2 * t, "a.y": -t}, {"a.x": "m"})
    return write_trace(trace, tmp_path / "run.parquet")


def test_it_goes_at_the_speed_that_is_asked_for(clock, file):
    """What is shown follows from the clock, through changes of speed and pauses."""
    shown = Replay(file)
    assert (shown.drives, tuple(shown.signals), dict(shown.units)) == (False, ("a.x", "a.y"), {"a.x": "m"})
    clock.now += 0.505
    assert shown.latest().t == pytest.approx(1.5)
    shown.speed(2.0)
    clock.now += 0.25
    assert shown.latest().t == pytest.approx(2.0)
    shown.pause()
    clock.now += 100.0
    frame = shown.latest()
    assert (frame.t, frame.state) == (pytest.approx(2.0), "paused")
    np.testing.assert_allclose(frame.values, [4.0, -2.0], rtol=1e-12)  # linear, so but for rounding
    shown.play()
    clock.now += 10.0
    frame = shown.latest()
    assert (frame.t, frame.state) == (pytest.approx(3.0), "ended")


def test_frames_are_numbered_and_none_is_left_out(clock, file):
    """`since` gives each frame once, through jumps, and numbers never go back."""
    shown, seen, last = Replay(file), [], 0
    for jump in (None, 2.5, 1.2, None):
        for _ in range(5):
            clock.now += 0.033
            numbers, times, axes, values = shown.since(last)
            assert axes.shape == (len(numbers), 0)
            assert values.shape == (len(numbers), 2)
            np.testing.assert_allclose(values[:, 0], 2 * times, rtol=1e-12)  # linear, so but for rounding
            seen += list(numbers)
            last = shown.latest().number
            assert not len(numbers) or numbers[-1] == last
        if jump:
            shown.seek(jump)
            assert shown.latest().t == pytest.approx(jump)
    assert seen == list(range(1, last + 1))


@pytest.mark.usefixtures("clock")
def test_restart_and_its_limits(file):
    """From the beginning at once, in the state it was in; there is nothing to drive and nothing to set up."""
    shown = Replay(file, signals=["a.y"], playing=False)
    shown.seek(1e9)
    assert shown.latest().state == "ended"
    shown.restart()
    frame = shown.latest()
    assert (frame.t, frame.state, list(frame.values)) == (1.0, "paused", [-1.0])
    shown.command({})
    with pytest.raises(Problem, match=r"unknown axis 'boom': a replay takes no commands"):
        shown.command({"boom": 1.0})
    with pytest.raises(Problem, match=r"speed: expected a factor from 0\.1 to 10, got 11"):
        shown.speed(11)
    with pytest.raises(Problem, match=r"replay: expected a finite time, got nan s"):
        shown.seek(float("nan"))
    with pytest.raises(Problem, match=r"no signal a\.z in the run"):
        Replay(file, signals=["a.z"])
    assert list(shown.trace().signals) == ["a.y"]
    shown.close()
