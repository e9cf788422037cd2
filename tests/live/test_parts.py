"""The pieces of a live machine, each by itself and without any process."""

import gc
import math
import tracemalloc
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from kit.mistakes import problem

from orchestrator import Coupling, Trace, run
from orchestrator.engine.scenario import ScenarioTable
from orchestrator.realtime import deadlines
from orchestrator.realtime.deadlines import BINS, latency_bin, latency_quantile
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.realtime.shared_memory import Command, Memory, SharedState, attach, layout
from orchestrator.realtime.stepping import CommandWatchdog, FrameStepper, Ramp, RateLimiter
from orchestrator.ssp import load as loading

from .conftest import DETAILED

AXIS = Axis("u", 1.0, 1.0)
positive = st.floats(1e-6, 1e6)
anything = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.lists(st.tuples(positive, positive, st.floats(-1, 1)), min_size=1, max_size=3),
    st.lists(arrays(float, 3, elements=anything), max_size=20),
    st.floats(1e-4, 0.1),
)
def test_an_axis_is_never_beyond_its_limit_or_faster_than_its_rate(kinds, commands, frame):
    """Whatever is commanded, no numbers and infinite ones included."""
    axes = [Axis(f"a{i}", limit, rate, share * limit) for i, (limit, rate, share) in enumerate(kinds)]
    limits = RateLimiter(axes, frame)
    now = limits.rest.copy()
    for command in commands:
        new = limits.toward(now, command[: len(axes)])
        for axis, before, after in zip(axes, now, new, strict=True):
            assert abs(after) <= axis.limit
            rounding = 4 * np.spacing(axis.limit)  # of a sum and a difference of numbers below the limit
            assert abs(after - before) <= axis.rate * frame + rounding
        now = new


@given(positive, st.integers(1, 50), st.floats(-1, 1), st.floats(-1, 1))
def test_an_axis_arrives_at_what_is_possible(limit, frames, start, wanted):
    """In as many frames as its rate needs."""
    limits = RateLimiter([Axis("a", limit, rate=2 * limit / (frames * 0.01))], 0.01)
    now, target = np.array([start * limit]), np.array([wanted * limit])
    for _ in range(frames):
        now = limits.toward(now, target)
    assert abs(now[0] - target[0]) <= 4 * frames * np.spacing(limit)  # each move is rounded


def test_no_number_means_rest():
    """NaN is no limit; an axis that lingers stays 0.03 s after the last command, and obeys at once, also a
    command of its rest value."""
    limits = RateLimiter([Axis("a", 5, 1000, rest=1.0), Axis("b", 5, 1000)], 0.01)
    np.testing.assert_array_equal(limits.toward(np.array([3.0, 3.0]), np.array([np.nan, 4.0])), [1.0, 4.0])
    axes = [Axis("engaged", 1.0, 1000.0, rest_delay=0.03), Axis("velocity", 1.0, 1000.0)]
    limits = RateLimiter(axes, 0.01)
    now, seen, none = limits.rest.copy(), [], (np.nan, np.nan)
    for wanted in [none] + 2 * [(1, 1)] + 2 * [none] + [(1, 1)] + 5 * [none] + [(1, 1), (0, 0)]:
        now = limits.toward(now, np.array(wanted, dtype=float))
        seen.append((int(now[0]), int(now[1])))
    assert seen[:6] == [(0, 0), (1, 1), (1, 1), (1, 0), (1, 0), (1, 1)]
    assert seen[6:] == 3 * [(1, 0)] + 2 * [(0, 0)] + [(1, 1), (0, 0)]


def axis(**changed: float) -> dict[str, tuple[Axis, ...]]:
    """A setup with one axis that is wrong."""
    return {"axes": (replace(AXIS, **changed),)}


MISTAKES = {
    "frame: expected a positive time, got 0 s": {"frame": 0.0},
    "timeout: expected a positive time, got nan s": {"timeout": math.nan},
    "axis u: expected once, got twice": {"axes": (AXIS, AXIS)},
    "signal a.b: expected once, got twice": {"signals": ("a.b", "a.b")},
    "axis u: expected a positive limit, got -1": axis(limit=-1.0),
    "axis u: expected a positive rate, got inf": axis(rate=math.inf),
    "axis u: expected a rest value of at most 1 in magnitude, got 2": axis(rest=2.0),
    "axis u: expected a rest delay of 0 s or more, got -1 s": axis(rest_delay=-1.0),
    "axis u: expected a rest delay of 0 s or more, got inf s": axis(rest_delay=math.inf),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_a_wrong_setup_is_told_in_one_line(message):
    """Before any process is started."""
    wrong = replace(Setup("a.fmu", (AXIS,), ("a.b",)), **MISTAKES[message])
    assert problem(wrong.check) == message


def test_the_watchdog_lets_go_of_old_commands():
    """A command holds for the timeout after it was seen; the same one seen again is no younger."""
    watchdog = CommandWatchdog(np.array([7.0]), timeout=0.25, serial=3)
    old, new = (Command(True, 1.0, serial, np.array([float(serial)])) for serial in (3, 4))
    assert watchdog.commanded(old, 10.0) == 7.0  # of the session before
    assert watchdog.commanded(new, 10.1) == 4.0
    assert watchdog.commanded(new, 10.35) == 4.0
    assert watchdog.commanded(new, 10.36) == 7.0
    assert watchdog.commanded(new._replace(serial=5), 10.4) == 4.0


@pytest.fixture
def shared():
    """Two views of the same memory."""
    memory = Memory(layout(2, 3, 10).itemsize)
    other = attach(memory.address)
    return SharedState(memory.map, 2, 3, 10), SharedState(other, 2, 3, 10)


def test_commands_and_frames_arrive_in_another_mapping(shared):
    """What one side writes the other one reads, to the last bit."""
    parent, child = shared
    parent.write_command(Command(True, 0.1, 12, np.array([math.pi, -1e300])))
    command = child.read_command()
    assert command[:3] == (True, 0.1, 12)
    np.testing.assert_array_equal(command.values, [math.pi, -1e300])
    child.write_frame(13, 0.125, np.array([1.0, 2.0]), np.array([3.0, np.nan, 5.0]))
    number, t, axes, values = parent.frames[3].item()
    assert (number, t, *axes) == (13, 0.125, 1, 2)
    np.testing.assert_array_equal(values, [3, np.nan, 5])
    child.set_state("failed", "gauge \u00fc")
    assert (parent.status().state, parent.status().text) == ("failed", "gauge \u00fc")


def test_half_an_order_is_none(shared):
    """Neither one that is being written nor one whose numbers do not fit together."""
    parent, child = shared
    parent.write_command(Command(True, 1.0, 1, np.array([1.0, 2.0])))
    parent._command["sequence"] += 1
    assert child.read_command() is None
    parent._command["sequence"] += 1
    assert child.read_command() is not None
    parent._command["content"]["values"][1] = 3.0
    assert child.read_command() is None


def test_a_writer_that_died_locks_nobody_out(shared):
    """A status whose sequence number stays odd is read as it is."""
    parent, child = shared
    child.set_state("running", "on")
    child._status["sequence"] += 1
    assert parent.status().state == "running"


@given(st.lists(st.floats(1e-6, 50.0), min_size=1, max_size=50), st.floats(0.01, 1.0))
def test_quantiles_of_latencies(latencies, share):
    """At least the share lies below, but for half a bin, which is 1 %."""
    bins = np.zeros(BINS, np.int64)
    for latency in latencies:
        bins[latency_bin(latency)] += 1
    found = latency_quantile(bins, share)
    exact = sorted(latencies)[max(math.ceil(share * len(latencies) - 1e-9) - 1, 0)]
    assert abs(found / exact - 1) < 0.011  # half a bin, and the rounding of its number
    assert latency_quantile(np.zeros(BINS, np.int64), share) == 0.0


@given(st.lists(arrays(float, 2, elements=st.floats(-10, 10)), min_size=1, max_size=5))
def test_a_ramp_is_the_scenario_with_a_row_per_frame(values):
    """Bit for bit at any time of a frame, at its ends too."""
    rows = [np.zeros(2), *values]
    times = 0.25 + 0.01 * np.arange(len(rows))
    table = ScenarioTable(times, np.array(rows))
    ramp = Ramp(times[0], times[1], rows[0])
    for begin, end, value in zip(times, times[1:], values, strict=False):
        ramp.aim(begin, end, value)
        for t in (begin, begin + 0.3 * (end - begin), end):
            np.testing.assert_array_equal(ramp.at(t), table.at(t))
            np.testing.assert_array_equal(ramp.sample(t), table.sample(t))


def _frames(clock, works, length=0.01):
    """Latencies of frames that take so long, and the deadlines."""
    kept, latencies = deadlines.DeadlineClock(), []
    kept.begin(length)
    for work in works:
        kept.wait()
        clock.now += work
        latencies.append(clock.now - kept.due)
        kept.done(length)
    return latencies, kept


def test_deadlines_do_not_drift(clock):
    """Nothing slips in a thousand frames or a short halt; what is missing of frames twice as long does."""
    latencies, kept = _frames(clock, np.random.default_rng(1).uniform(0, 0.009, 1000))
    assert kept.due == pytest.approx(100.0 + 1001 * 0.01, abs=1e-9)  # rounding of a thousand sums
    assert max(latencies) < 0.0091
    assert kept.slipped == 0.0
    latencies, kept = _frames(clock, [0.001] * 5 + [0.08] + [0.001] * 30)
    assert kept.slipped == 0.0
    assert latencies[-1] == pytest.approx(0.001, abs=1e-9)  # rounding of sums
    latencies, kept = _frames(clock, [0.02] * 1000)
    assert max(latencies) < deadlines.BEHIND + 0.05
    # what is left to others, and the end
    assert kept.slipped == pytest.approx(1000 * (0.02 - 0.01), rel=0.05)


# ---- The loop in frames beside `run`: the same bits; mistakes; memory

COMMANDS = tuple(Axis(f"{name}_command", 10.0, 100.0) for name in ("swing", "boom", "stick"))
SHOWN = ("manipulator.swing_angle", "manipulator.stick_angle", "swing.swing_pressure_a")
SHOWN += ("boom_stick.boom_head_pressure", "boom_stick.boom_command")


def played(setup: Setup, frames: int, wanted) -> Trace:
    """A live run; wanted: values of the axes by number of the frame."""
    with closing(FrameStepper(setup)) as live:
        rows = [(live.t, live.axes.copy(), live.values.copy())]
        for n in range(frames):
            live.advance(wanted(n))
            rows.append((live.t, live.axes.copy(), live.values.copy()))
    times, axes, values = (np.array(column) for column in zip(*rows, strict=True))
    table = {axis.name: axes[:, i] for i, axis in enumerate(setup.axes)}
    return Trace(times, table | {name: values[:, i] for i, name in enumerate(setup.signals)})


def same_as_run(setup: Setup, live: Trace, system=None) -> None:
    """`run` with what drove the live machine as its scenario gives the same numbers."""
    scenario = live.select([axis.name for axis in setup.axes])
    as_set = {"swap": setup.swap, "set": setup.set, "step": setup.step}
    result = run(system or setup.system, scenario, **as_set, record=setup.signals, record_step=setup.frame)
    assert result.complete
    np.testing.assert_array_equal(result.trace.time, live.time)
    for name in setup.signals:
        np.testing.assert_array_equal(result.trace[name], live[name], err_msg=name)


def random_walk(seed: int, size: int, limit: float = 6.0):
    """Commands that change in each frame, or jump."""
    rng = np.random.default_rng(seed)
    rows = np.clip(np.cumsum(rng.normal(0, 0.5, (1000, size)), axis=0), -limit, limit)
    rows[400:] = rng.uniform(-limit, limit, (600, size))
    return rows.__getitem__


@pytest.mark.parametrize("swap", [{}, DETAILED], ids=["lumped", "detailed"])
def test_the_machine_is_the_one_of_run(fmu_dir, swap):
    """Half a second of random commands, to the last bit, with a pose that is set."""
    pose = {"manipulator.initial_boom_angle": 0.3}
    setup = Setup(str(fmu_dir / "harvester.ssp"), COMMANDS, SHOWN, swap, set=pose)
    live = played(setup, 50, random_walk(1, 3))
    assert np.ptp(live["manipulator.swing_angle"]) > 1e-3
    same_as_run(setup, live)


MASTERS = {
    "jacobi": Coupling("jacobi"),
    "third order": Coupling("gauss-seidel", 3),
    "hermite": Coupling("hermite"),  # with a guard that divides steps
    "interface-jacobian": Coupling("interface-jacobian"),
    "adaptive": Coupling("hermite", adaptive=1e-4),
}


@pytest.mark.parametrize("label", MASTERS)
def test_masters_that_a_system_suggests(system, monkeypatch, label):
    """A quarter of a second under each of them, steps of their own choice included."""
    suggested = system.coupled(MASTERS[label])
    monkeypatch.setattr(loading, "load", lambda _: suggested)
    setup = Setup("suggested", COMMANDS, SHOWN, step=2e-3)
    live = played(setup, 25, random_walk(2, 3))
    same_as_run(setup, live, suggested)


def test_inputs_that_are_no_reals(fmus):
    """Whole numbers and truth values are held, as in a scenario."""
    limits = {"real": 5, "int": 7, "bool": 1}
    axes = tuple(Axis(f"types.{kind}_in", limit, 1000.0) for kind, limit in limits.items())
    outs = ("types.real_out", "types.int_out", "types.bool_out", "types.real_in")
    setup = Setup(str(fmus["types"]), axes, outs)
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.normal(size=40), rng.integers(-7, 8, 40), rng.integers(0, 2, 40)])
    live = played(setup, 40, rows.__getitem__)
    assert len(np.unique(live["types.int_out"])) > 5
    same_as_run(setup, live)


def test_without_axes_and_without_signals(fmus):
    """A machine that is only watched, and one that is only driven."""
    setup = Setup(str(fmus["source"]), (), ("source.y",))
    live = played(setup, 10, lambda _: np.zeros(0))
    # one FMU without inputs: its output is the sine itself at the communication points
    np.testing.assert_allclose(live["source.y"], np.sin(live.time), atol=1e-12)
    unseen = Setup(str(fmus["drift"]), (Axis("u", 1, 1),), ())
    assert played(unseen, 3, lambda _: np.ones(1)).time[-1] == pytest.approx(0.03)


WRONG_SETUPS = {
    "axes: column 'w' is not an input of the system; inputs: u, u_rate": {"axes": (Axis("w", 1, 1),)},
    "unknown variable 'drift.z'; did you mean drift.y, drift.u, drift.u_rate?": {"signals": ("drift.z",)},
    "frame: expected a multiple of the step 0.003 s, got 0.01 s": {"step": 3e-3},
    "step: expected a positive time, got -1 s": {"step": -1.0},
    "step: expected at least 9.09e-15 s, got 1e-300 s": {"step": 1e-300},
    "step: expected at least 9.09e-15 s, got 9.99989e-321 s": {"step": 1e-320},
    "none.fmu: no such file": {"system": "none.fmu"},
    "fault u: expected an input that nobody drives here": {"fault": {"u": "1@1s"}},
}


@pytest.mark.parametrize("message", WRONG_SETUPS)
def test_mistakes_are_told_in_one_line(drift, message):
    """Names and times that do not fit."""
    assert problem(lambda: FrameStepper(replace(drift, **WRONG_SETUPS[message]))) == message


def test_an_input_takes_a_value_at_a_time(drift):
    """Behind the axes, within a frame: no motion before, and then as if an axis had been moved."""
    axis = Axis("u", 2.0, 1e3)
    with (
        closing(FrameStepper(replace(drift, axes=(), fault={"u": "1@0.04s"}))) as given,
        closing(FrameStepper(replace(drift, axes=(axis,)))) as moved,
    ):
        for k in range(8):
            given.advance(np.array([]))
            moved.advance(np.array([0.0 if k < 4 else 1.0]))
            assert given.values == pytest.approx(moved.values, rel=1e-9)
        assert given.values[0] != 0


def test_a_long_session_needs_no_more_memory(drift):
    """Of Python's memory nothing is left of two thousand frames."""
    live, wanted = FrameStepper(drift), np.ones(1)
    for _ in range(300):  # more points than the recorder holds
        live.advance(wanted)
    gc.collect()
    tracemalloc.start()
    for _ in range(2000):
        live.advance(wanted)
    gc.collect()
    # other threads of the test process allocate too
    ours = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, "*/orchestrator/*")])
    tracemalloc.stop()
    live.close()
    left = sum(line.size for line in ours.statistics("filename"))
    assert left < 2000  # one byte per frame: a few numbers that are the latest ones
