"""The machine in a process of its own obeys, and rests when nobody commands.

No test measures time: it waits until something holds, and commands live for a minute unless their age is
meant.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from kit.mistakes import problem
from kit.wait import until

from orchestrator import run
from orchestrator.realtime.setup import Axis
from orchestrator.realtime.shared_memory import Command

from .conftest import u


def test_it_does_what_it_is_told_and_run_does_the_same(opened, drift):
    """`run` with the axes of a session as the scenario gives the same bits; the session's trace has units."""
    station = opened(drift)
    assert (station.axes, station.signals) == (("u",), ("drift.y", "drift.u"))
    assert station.units == {"u": "m", "drift.u": "m"}
    for value in (1.0, -0.5, 2.0):
        station.command({"u": value})
        assert until(lambda value=value: u(station) == value)
    station.speed(10.0)
    station.command({})
    assert until(lambda: u(station) == 0.0)
    station.close()
    trace = station.trace()
    assert dict(trace.units) == {"u": "m", "drift.u": "m"}
    assert trace["drift.y"][-1] > 0
    again = run(drift.system, trace.select(["u"]), record=drift.signals, record_step=drift.frame).trace
    for name in drift.signals:
        np.testing.assert_array_equal(again[name], trace[name])


def test_what_is_no_number_is_refused(opened, drift):
    """One line, and the machine keeps what it was told before."""
    station = opened(drift)
    station.command({"u": 1.0})
    for wrong in (math.nan, math.inf, -math.inf, "fast", None, 10**400, [1.0]):
        told = r"^axis u: expected a finite number, got [^\n]{1,40}$"
        problem(lambda wrong=wrong: station.command({"u": wrong}), told)
        problem(lambda: station.command({"v": 1.0}), r"^unknown axis 'v'(; did you mean u\?)?$")
    number = station.latest().number
    assert until(lambda: u(station) == 1.0 and station.latest().number > number + 20)  # none is on its way


def test_no_number_in_the_memory_itself_does_not_move_it(opened, drift):
    """Past the border: NaN is rest, infinity is the limit."""
    station = opened(drift)
    for serial, (written, meant) in enumerate([(1.0, 1.0), (math.nan, 0.0), (math.inf, 2.0)], start=100):
        station._process.shared.write_command(Command(True, 1.0, serial, np.array([written])))
        assert until(lambda meant=meant: u(station) == meant)
    assert np.isfinite(station.trace()["drift.y"]).all()


def test_an_axis_that_lingers_does_so_without_anybody(opened, drift):
    """The watchdog of the process itself lets it outlast the other one by its 0.3 s."""
    axes = (Axis("u", 2.0, 1e3, rest_delay=0.3), Axis("u_rate", 2.0, 1e3))
    station = opened(replace(drift, axes=axes, timeout=0.3))
    station.command({"u": 1.0, "u_rate": 1.0})

    def rested():
        """Both came and went, in one and the same trace: it goes on between two readings."""
        seen = station.trace()
        return seen["u"].any() and seen["u"][-1] == 0.0

    assert until(rested)
    trace = station.trace()
    alone = (trace["u"] == 1.0) & (trace["u_rate"] == 0.0)
    assert np.count_nonzero(alone) == 30


def test_a_pause_keeps_the_state(opened, drift):
    """No frame is added while it stands, and the next one follows the last one."""
    station = opened(drift)
    station.command({"u": 1.0})
    assert until(lambda: u(station) == 1.0)
    station.pause()
    assert until(lambda: station.latest().state == "paused")
    frame, shared = station.latest(), station._process.shared
    beat = shared.status().heartbeat
    assert until(lambda: shared.status().heartbeat > beat + 5)
    still = station.latest()
    assert (still.number, still.t, still.state) == (frame.number, frame.t, "paused")
    station.play()
    assert until(lambda: station.latest().number > frame.number)
    numbers, times, axes, _ = station.since(frame.number - 1)
    assert numbers[0] == frame.number
    assert (np.diff(numbers) == 1).all()
    np.testing.assert_allclose(np.diff(times), 0.01, rtol=1e-9)  # rounding of times
    assert axes[0, 0] == frame.axes[0]


def test_it_may_begin_paused(opened, drift):
    """Nothing moves before it is told to."""
    station = opened(drift, playing=False, speed=5.0)
    frame = station.latest()
    assert (frame.state, frame.t, frame.number) == ("paused", 0.0, 1)
    station.restart()
    assert station.ready().state == "paused"
    station.play()
    assert until(lambda: station.latest().t > 0)


def test_two_at_once(opened, drift):
    """Neither hears what the other one is told."""
    one, two = opened(drift), opened(drift)
    one.command({"u": 1.0})
    two.command({"u": -1.0})
    assert until(lambda: u(one) == 1.0 and u(two) == -1.0)
    one.close()
    number = two.latest().number
    assert until(lambda: two.latest().number > number + 5)


def test_commands_from_many_threads(opened, drift):
    """Each is whole: the axis is on its way to one of them, and the machine goes on."""
    station = opened(drift)

    def send(value: float) -> None:
        for _ in range(300):
            station.command({"u": value})

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(send, (0.0, 0.1, 0.2, 0.3)))
    station.command({"u": 0.5})
    assert until(lambda: u(station) == 0.5)
    # one that halts for long has failed until it goes on
    assert until(lambda: station.latest().state == "running")


def test_the_timing_counts_every_frame(opened, drift):
    """Frames, latencies in order, a load; how good they are is a matter of the benchmark."""
    station = opened(drift, speed=10.0)
    assert until(lambda: station.latest().timing.frames > 100)
    station.close()
    timing = station.latest().timing
    assert timing.frames == station.latest().number - 1
    assert 0 <= timing.missed <= timing.frames
    assert 0 < timing.latency[0] <= timing.latency[1] <= timing.latency[2]
    assert timing.load > 0
