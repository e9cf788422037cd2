"""The training task on trajectories whose scores are known in closed form."""

import functools
import itertools
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from view.standin import DESCRIPTION, StandIn

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.drive import score as scores
from orchestrator.drive.score import Exercise, Progress, Target, of_trace, score
from orchestrator.view.training import Training

Array = NDArray[np.float64]
STEP = 0.01
RADIUS, ARC, HEIGHT = 4.0, 1.0, 1.5
T_SWING, T_REST, T_RISE = 4.0, 2.0, 3.0
END = RADIUS * math.cos(ARC), RADIUS * math.sin(ARC)
EXERCISE = Exercise("arc and lift", (Target("pick", (*END, 0.0)), Target("place", (*END, HEIGHT))))
TASK = replace(DESCRIPTION.task, exercises=(EXERCISE,))


def blend(t: Array, start: float, duration: float) -> tuple[Array, Array]:
    """From 0 to 1 as half a cosine, and its rate."""
    phase = np.clip((t - start) / duration, 0, 1) * math.pi
    return (1 - np.cos(phase)) / 2, np.sin(phase) * math.pi / (2 * duration)


def cycle() -> Trace:
    """Swing over an arc, rest, rise by a height (boom and stick together), rest."""
    time = np.arange(0, 12, STEP)
    swung, swing_rate = blend(time, 1.0, T_SWING)
    risen, rise_rate = blend(time, 1.0 + T_SWING + T_REST, T_RISE)
    values = {
        "tip_x": RADIUS * np.cos(ARC * swung),
        "tip_y": RADIUS * np.sin(ARC * swung),
        "tip_height": HEIGHT * risen,
        "tip_radial_velocity": 0 * time,
        "tip_vertical_velocity": HEIGHT * rise_rate,
        "swing_speed": ARC * swing_rate,
        "boom_speed": 0.4 * rise_rate,
        "stick_speed": -0.4 * rise_rate,
        "swing_pressure_a": 1e6 + 5e6 * swing_rate,
        "boom_head_pressure": 8e6 + 0 * time,
        "supply_pressure": 2e7 + 0 * time,
        "supply_flow": 1e-3 * (swing_rate + rise_rate),
    }
    return Trace(time, {f"machine.{name}": value for name, value in values.items()})


def when(share: float, duration: float) -> float:
    """When half a cosine has done this share of its way."""
    return duration * math.acos(1 - 2 * share) / math.pi


def slow_after(rate: float, duration: float) -> float:
    """When the rate of half a cosine has fallen to this."""
    return duration * (1 - math.asin(rate * 2 * duration / math.pi) / math.pi)


def scored(trace: Trace) -> scores.Score:
    """The score of an attempt that took place."""
    found = score(trace, TASK)
    assert found is not None
    return found


def test_cycle() -> None:
    """Times, path, energy and pressure of a cycle follow from its formulas."""
    found = scored(cycle())
    assert found.finished
    # the clock starts when the chord to the first position is 0.05 m
    started = 1 + when(2 * math.asin(EXERCISE.start / 2 / RADIUS) / ARC, T_SWING)
    entered = 1 + when(1 - 2 * math.asin(EXERCISE.radius / 2 / RADIUS) / ARC, T_SWING)
    rise = 1 + T_SWING + T_REST
    slow = rise + slow_after(EXERCISE.slow / HEIGHT, T_RISE)
    # each instant is seen at the next sample: at most one step late, at both ends
    assert found.reach_time == pytest.approx(entered - started, abs=STEP)
    assert found.cycle_time == pytest.approx(slow + EXERCISE.hold - started, abs=2 * STEP)
    # what is left out: the start of 0.05 m; chords of the arc are shorter by less than 1e-6
    assert found.path_length == pytest.approx(RADIUS * ARC - EXERCISE.start + HEIGHT, abs=0.01)
    # 20 MPa times 2 litres, less what flowed before the clock: the same share as of the way, 1.25 %
    assert found.energy == pytest.approx(2e7 * 1e-3 * (2 - EXERCISE.start / RADIUS / ARC), rel=1e-3)
    assert found.peak_pressure == 8e6


def test_shares_of_functions() -> None:
    """Boom and stick together count as two; a share is the time that both are fast over the whole time."""
    found = scored(cycle())
    lift = T_RISE - 2 * (T_RISE - slow_after(0.02 / 0.4, T_RISE))
    # both ends of a movement fall between two samples
    assert found.simultaneous == pytest.approx(lift / found.cycle_time, abs=2 * STEP / found.cycle_time)
    swing = slow_after(0.02 / ARC, T_SWING)
    started = when(2 * math.asin(EXERCISE.start / 2 / RADIUS) / ARC, T_SWING)
    mean = (swing - started + 2 * lift) / (swing - started + lift)
    # the same, over 6 s
    assert found.functions == pytest.approx(mean, abs=0.005)


@functools.cache
def in_one_piece() -> tuple[Any, Progress]:
    """The samples of the cycle, and the progress at their end."""
    samples = of_trace(cycle(), TASK)
    return samples, Progress(EXERCISE).follow(samples)


@given(st.lists(st.integers(1, 1198), unique=True, max_size=8))
def test_in_pieces(cuts: list[int]) -> None:
    """Progress does not depend on how the samples are cut into pieces."""
    samples, whole = in_one_piece()
    progress = Progress(EXERCISE)
    for part in np.split(np.arange(len(samples.time)), sorted(cuts)):
        progress = progress.follow(samples[slice(part[0], part[-1] + 1)])
    assert progress == whole


def machine(trace: Trace) -> StandIn:
    """A machine that did this, frame by frame."""
    names = tuple(trace.signals)
    rows = np.stack([trace[name] for name in names], axis=1).tolist()
    return StandIn(signals=names, frames=list(zip(trace.time.tolist(), rows, strict=True)))


def test_online_is_offline(tmp_path: Path) -> None:
    """Frames as they come give the same score as the file afterwards."""
    trace = cycle()
    live = machine(trace)
    frames, live.frames = live.frames, []
    training = Training(live, lambda: TASK)
    seen = set()
    for n in range(0, len(frames), 37):
        live.frames = frames[: n + 37]
        training.update()
        seen.add(training.status()["phase"])
    assert seen == {"ready", "moving", "holding", "done"}
    assert training.table == [{"attempt": 1, "exercise": EXERCISE.name, **asdict(score(trace, TASK))}]
    assert training.status()["time"] == training.table[0]["cycle_time"]
    text = training.write(tmp_path / "build" / "training.csv").read_text()
    assert text.count("\n") == 2
    assert text.startswith("attempt,exercise,finished,cycle_time")


def test_counts_only_what_is_shown() -> None:
    """What the machine did before the task was opened belongs to no attempt."""
    live = machine(cycle())
    live.number = len(live.frames) - 101
    training = Training(live, lambda: TASK)
    training.open()
    training.update()
    assert training.table == []
    assert training.status()["phase"] == "ready"


def test_stem_is_held_between_its_two_places() -> None:
    """From the pick to the place the head holds the stem, then nothing; before, and while no page shows the
    task, it is left alone."""
    stem = Exercise("stem", (replace(EXERCISE.targets[0], load=200.0), EXERCISE.targets[1]))
    task = replace(TASK, exercises=(stem,))
    live = machine(cycle())
    frames, live.frames = live.frames, []
    training = Training(live, lambda: task)
    training.open()
    held = set()
    for n in range(0, len(frames), 37):
        live.frames = frames[: n + 37]
        training.update()
        mass = training.loads().get("payload_mass")
        held.add((training.status()["phase"], mass))
        assert (mass or 0.0) == training.status()["load"]
    assert {mass for state, mass in held if state == "moving"} == {None, 200.0}
    assert {mass for state, mass in held if state == "done"} == {0.0}
    live.frames = frames[:700]
    again = Training(live, lambda: task)
    again.open()
    again.update()
    assert again.loads() == {"payload_mass": 200.0}
    again.close()
    assert again.loads() == {}


def test_way() -> None:
    """Where to go is told as the hands do it: the way round is the shorter one."""
    assert scores.way((3.0, 0.0, 1.0), (0.0, 4.0, 0.5)) == pytest.approx((1.0, -0.5, math.pi / 2))
    behind, beyond = (-4.0, 0.1, 0.0), (-4.0, -0.1, 0.0)
    assert scores.way(behind, beyond)[2] == pytest.approx(2 * math.atan(0.1 / 4))


def test_restart_ends_an_attempt() -> None:
    """When the time of the machine goes back, the attempt is over, unfinished, and a new one begins."""
    live = machine(cycle())
    first = live.frames[:300]
    live.frames = first + live.frames
    training = Training(live, lambda: TASK)
    training.update()
    assert [attempt["finished"] for attempt in training.table] == [False, True]
    training.again()
    assert len(training.table) == 2
    assert training.status()["phase"] == "ready"


LINE = Exercise("line", (Target("end", (1.0, 0.0, 0.0)),))


def at(progress: Progress, time: float, x: float, speed: float = 0.0) -> Progress:
    """One more sample on a line, with the target at 1 m."""
    return progress.advance(time, (x, 0.0, 0.0), speed)


def test_hold_without_a_break() -> None:
    """Too fast, or out of the target for a moment, and the hold begins again."""
    progress = at(at(Progress(LINE), 0, 0), 1, 0.9)
    assert progress.inside == 1
    assert at(progress, 1.9, 0.9).done == ()
    assert at(progress, 2.0, 0.9).done == (2.0,)
    for broken in (at(progress, 1.5, 0.6), at(progress, 1.5, 0.9, 0.2), at(progress, 1.5, math.nan)):
        assert broken.inside is None
        assert at(broken, 2.0, 0.9).done == ()
    assert at(progress, 1.5, 0.9, math.nan).inside is None


def test_nothing_moves() -> None:
    """A machine that stands has no score, also inside a target."""
    time = np.arange(0, 5, STEP)
    still = Trace(time, {name: np.full_like(time, value[-1]) for name, value in cycle().signals.items()})
    assert score(still, TASK) is None
    assert Progress(EXERCISE).follow(of_trace(still, TASK)).phase == "ready"


def test_supply_is_not_counted_twice() -> None:
    """Flows of drives add up; where a component `supply` tells the sum, it alone counts."""
    trace = cycle()
    flow = trace["machine.supply_flow"]
    apart = {name: value for name, value in trace.signals.items() if not name.endswith("supply_flow")}
    two = Trace(trace.time, {**apart, "a.supply_flow": 0.25 * flow, "b.supply_flow": 0.75 * flow})
    three = Trace(trace.time, {**two.signals, "supply.supply_flow": flow})
    for other in (two, three):
        # the same sum in another order
        assert scored(other).energy == pytest.approx(scored(trace).energy, rel=1e-12)


def test_what_lacks() -> None:
    """Without a supply or pressures those figures are left out; a tip or unit that lacks is one line."""
    trace = cycle()
    bare = [n for n in trace.signals if not n.endswith(("pressure", "flow", "pressure_a"))]
    found = scored(trace.select(bare))
    assert (found.energy, found.peak_pressure) == (None, None)
    with pytest.raises(Problem, match="found none of tip_x"):
        score(trace.select([n for n in trace.signals if not n.endswith("tip_x")]), TASK)
    with pytest.raises(Problem, match=r"machine\.tip_x: expected m, found mm"):
        score(Trace(trace.time, trace.signals, {"machine.tip_x": "mm"}), TASK)
    live = StandIn(signals=("a.b",), frames=[(0.0, [1.0])])
    training = Training(live, lambda: TASK)
    training.update()
    assert "found none of" in training.status()["problem"]


TIME = np.arange(0, 10, 0.01)


def bells(*centres: float, width: float = 0.5) -> Array:
    """Speeds of bell-shaped movements."""
    return np.sum([np.exp(-(((TIME - c) / width) ** 2)) for c in centres], axis=0)


@given(st.floats(1e-3, 1e3))
def test_size_does_not_matter(size: float) -> None:
    """A larger movement of the same form is as smooth."""
    usual = scores.spectral_arc_length(TIME, bells(5))
    # rounding only
    assert scores.spectral_arc_length(TIME, size * bells(5)) == pytest.approx(usual, rel=1e-9)


def test_bell_by_hand() -> None:
    """The spectrum of exp(-(t/w)^2) is exp(-(pi f w)^2): its arc down to 0.05, by quadrature."""
    end = np.sqrt(np.log(20)) / (np.pi * 0.5)
    f = np.linspace(0, end, 100_001)
    arc = np.sum(np.hypot(np.diff(f) / end, np.diff(np.exp(-((np.pi * f * 0.5) ** 2)))))
    # the end of the arc lies on a line of the padded spectrum: up to 1/109 of its width beside it
    assert scores.spectral_arc_length(TIME, bells(5)) == pytest.approx(-arc, rel=0.01)


def test_more_stops_are_less_smooth() -> None:
    """Each further start and stop makes it more negative; no movement and no time have no smoothness."""
    values = [scores.spectral_arc_length(TIME, bells(*np.arange(1, n + 1) * 1.5)) for n in range(1, 6)]
    assert all(a > b for a, b in itertools.pairwise(values))
    assert scores.spectral_arc_length(TIME, 0 * TIME) is None
    assert scores.spectral_arc_length(TIME[:3], TIME[:3]) is None
