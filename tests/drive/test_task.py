"""The training task on trajectories whose scores are known in closed form, in a browser."""

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from kit import shards
from numpy.typing import NDArray
from view.standin import DESCRIPTION

from orchestrator.base.signals import bare_name
from orchestrator.data.trace import Trace
from orchestrator.drive.page import page_data
from orchestrator.drive.task import Exercise, Target

pytestmark = shards.browser
RULES = json.loads(json.dumps(page_data(DESCRIPTION, None)))["task"]
# an attempt: samples in columns by name, then the table, the phases and loads that were seen, and the file
RUN = """(() => { const task = new m.Attempts(a.rules); task.show(true); const seen = [];
  a.time.forEach((t, k) => {
    if (a.restarts.includes(k)) task.again();
    task.add(t, Object.fromEntries(Object.entries(a.columns).map(([n, v]) => [n, v[k]])));
    seen.push([task.phase, task.load]);
  });
  return { table: task.table, seen, status: task.status(), csv: task.table.length && task.csv() }; })()"""
Attempt = Callable[..., Any]
Array = NDArray[np.float64]
STEP, TIME = 0.01, np.arange(0, 10, 0.01)
RADIUS, ARC, HEIGHT = 4.0, 1.0, 1.5
T_SWING, T_REST, T_RISE = 4.0, 2.0, 3.0
END = RADIUS * math.cos(ARC), RADIUS * math.sin(ARC)
EXERCISE = Exercise("arc and lift", (Target("pick", (*END, 0.0)), Target("place", (*END, HEIGHT))))


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


def given(trace: Trace, exercise: Exercise = EXERCISE, restarts: tuple[int, ...] = ()) -> dict[str, Any]:
    """What the page is given of these samples."""
    finite = {n: [v if math.isfinite(v) else None for v in x.tolist()] for n, x in trace.signals.items()}
    columns = {bare_name(name): values for name, values in finite.items()}
    rules = RULES | {"exercises": [asdict(exercise)]}
    return {"rules": rules, "time": trace.time.tolist(), "columns": columns, "restarts": restarts}


@pytest.fixture
def attempt(script: Any) -> Attempt:
    """attempt(trace, exercise): what the page makes of these samples."""
    return lambda *samples, **more: script("task", RUN, given(*samples, **more))


def test_cycle(attempt: Attempt) -> None:
    """Times, path, energy and pressure of a cycle follow from its formulas."""
    result = attempt(cycle())
    (found,) = result["table"]
    assert found["finished"]
    # the clock starts when the chord to the first position is 0.05 m
    started = 1 + when(2 * math.asin(EXERCISE.start / 2 / RADIUS) / ARC, T_SWING)
    entered = 1 + when(1 - 2 * math.asin(EXERCISE.radius / 2 / RADIUS) / ARC, T_SWING)
    rise = 1 + T_SWING + T_REST
    slow = rise + slow_after(EXERCISE.slow / HEIGHT, T_RISE)
    # each instant is seen at the next sample: at most one step late, at both ends
    assert found["reach_time"] == pytest.approx(entered - started, abs=STEP)
    assert found["cycle_time"] == pytest.approx(slow + EXERCISE.hold - started, abs=2 * STEP)
    # what is left out: the start of 0.05 m; chords of the arc are shorter by less than 1e-6
    assert found["path_length"] == pytest.approx(RADIUS * ARC - EXERCISE.start + HEIGHT, abs=0.01)
    # 20 MPa times 2 litres, less what flowed before the clock: the same share as of the way, 1.25 %
    assert found["energy"] == pytest.approx(2e7 * 1e-3 * (2 - EXERCISE.start / RADIUS / ARC), rel=1e-3)
    assert found["peak_pressure"] == 8e6
    # boom and stick together count as two; both ends of a movement fall between two samples
    lift = T_RISE - 2 * (T_RISE - slow_after(0.02 / 0.4, T_RISE))
    assert found["simultaneous"] * found["cycle_time"] == pytest.approx(lift, abs=2 * STEP)
    swing = slow_after(0.02 / ARC, T_SWING) + 1 - started
    # the same, over 6 s
    assert found["functions"] == pytest.approx((swing + 2 * lift) / (swing + lift), abs=0.005)
    assert {phase for phase, _ in result["seen"]} == {"ready", "moving", "holding", "done"}
    assert result["csv"].startswith("attempt,exercise,finished,cycle_time")


def test_stem_is_held_between_its_two_places(attempt: Attempt) -> None:
    """From the pick to the place the head holds the stem, then nothing."""
    stem = replace(EXERCISE, targets=(replace(EXERCISE.targets[0], load=200.0), EXERCISE.targets[1]))
    loads = [load for _, load in attempt(cycle(), stem)["seen"]]
    assert [load for load, _ in itertools.groupby(loads)] == [0, 200, 0]


def test_restart_ends_an_attempt(attempt: Attempt) -> None:
    """The attempt is over, unfinished, and a new one begins; one that has not started is not kept."""
    whole = cycle()
    twice = {name: np.concatenate((v[:300], v)) for name, v in whole.signals.items()}
    trace = Trace(np.concatenate((whole.time[:300] - 3, whole.time)), twice)
    table = attempt(trace, restarts=(50, 300))["table"]
    assert [row["finished"] for row in table] == [False, True]


def line(*samples: tuple[float, float, float]) -> Trace:
    """A tip on a line, from time [s], position [m] and speed [m/s]."""
    time, x, speed = np.array(samples).T
    still = dict.fromkeys((*RULES["needed"], "tip_y", "tip_height"), 0 * time)
    return Trace(time, still | {"tip_x": x, "tip_radial_velocity": speed})


def test_hold_without_a_break(attempt: Attempt) -> None:
    """Too fast, out of the target or unknown for a moment, and the hold begins again."""
    exercise, nan = Exercise("line", (Target("end", (1.0, 0.0, 0.0)),)), math.nan
    begin = (0.0, 0.0, 0.0), (1.0, 0.9, 0.0)
    assert attempt(line(*begin, (1.9, 0.9, 0)), exercise)["seen"][-1][0] == "holding"
    assert attempt(line(*begin, (2.0, 0.9, 0)), exercise)["seen"][-1][0] == "done"
    for broken in ((1.5, 0.6, 0), (1.5, 0.9, 0.2), (1.5, nan, 0), (1.5, 0.9, nan)):
        phases = [phase for phase, _ in attempt(line(*begin, broken, (2.0, 0.9, 0)), exercise)["seen"]]
        assert phases == ["ready", "holding", "moving", "holding"]


def test_nothing_moves(attempt: Attempt) -> None:
    """A machine that stands has no score, also inside a target."""
    still = {name: np.full_like(values, values[-1]) for name, values in cycle().signals.items()}
    result = attempt(Trace(cycle().time, still))
    assert (result["table"], result["seen"][-1][0]) == ([], "ready")


def test_a_replay_is_scored_as_it_was_driven(attempt: Attempt, script: Any) -> None:
    """The times of its pictures are those of the run here, so the samples are the same."""
    trace = cycle()
    run = """(() => {
      const replay = new m.Recording({ time: a.time, columns: a.columns, ghost: {} }, a.rules);
      replay.task.show(true); replay.show(a.time[0]);
      for (const t of a.time.slice(1)) replay.show(t);
      return replay.task.table; })()"""
    assert script("recording", run, given(trace)) == attempt(trace)["table"]


def test_what_lacks(attempt: Attempt) -> None:
    """Without a supply or pressures those figures are left out."""
    trace = cycle()
    bare = [n for n in trace.signals if not n.endswith(("pressure", "flow", "pressure_a"))]
    (found,) = attempt(trace.select(bare))["table"]
    assert (found["energy"], found["peak_pressure"]) == (None, None)


def bells(*centres: float, width: float = 0.5) -> Array:
    """Speeds of bell-shaped movements."""
    return np.sum([np.exp(-(((TIME - c) / width) ** 2)) for c in centres], axis=0)


def test_smoothness(script: Any) -> None:
    """A bell by hand; the size of a movement does not matter, and each further stop makes it less smooth."""

    def smoothness(values: Array, time: Array = TIME) -> Any:
        return script("task", "m.smoothness(...a)", [time.tolist(), values.tolist()])

    # the spectrum of exp(-(t/w)^2) is exp(-(pi f w)^2): its arc down to 0.05, by quadrature
    end = np.sqrt(np.log(20)) / (np.pi * 0.5)
    f = np.linspace(0, end, 100_001)
    arc = np.sum(np.hypot(np.diff(f) / end, np.diff(np.exp(-((np.pi * f * 0.5) ** 2)))))
    # the end of the arc lies on a line of the padded spectrum: up to 1/109 of its width beside it
    assert smoothness(bells(5)) == pytest.approx(-arc, rel=0.01)
    # rounding only
    assert smoothness(1e3 * bells(5)) == pytest.approx(smoothness(bells(5)), rel=1e-9)
    # an independent transform: numpy's of the same samples
    for n in (1, 3):
        assert smoothness(bells(*np.arange(1, n + 1) * 1.5)) == pytest.approx(by_numpy(n), rel=1e-9)
    values = [smoothness(bells(*np.arange(1, n + 1) * 1.5)) for n in range(1, 6)]
    assert all(a > b for a, b in itertools.pairwise(values))
    assert smoothness(0 * TIME) is None
    assert smoothness(TIME[:3], TIME[:3]) is None


def by_numpy(count: int) -> float:
    """The spectral arc length of so many bells: 50 Hz, padded by 2^4, down to 0.05, up to 10 Hz."""
    even = bells(*np.arange(1, count + 1) * 1.5)[:-1:2]
    size = 2 ** (math.ceil(math.log2(len(even))) + 4)
    spectrum = np.abs(np.fft.rfft(even, size))[: int(10 * size / 50) + 1]
    heights = spectrum / spectrum[0]
    last = np.flatnonzero(heights >= 0.05)[-1]
    return -float(np.sum(np.hypot(1 / last, np.diff(heights[: last + 1]))))
