"""What the page shows beside the picture, as its scripts compute it in a browser."""

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from kit import shards
from kit.mistakes import entry, table
from numpy.typing import NDArray
from view.standin import DESCRIPTION

from orchestrator.base.signals import bare_name
from orchestrator.data.trace import Trace
from orchestrator.drive.drawing import SCALE, UNKNOWN
from orchestrator.drive.page import libraries, page_data
from orchestrator.drive.task import Exercise, Target
from orchestrator.drive.view_description import CAVITATION

pytestmark = shards.browser
DATA = json.loads(json.dumps(page_data(DESCRIPTION, None)))
GAUGES = {line["name"]: line for group in DATA["gauges"] for line in group["lines"]}
NOW = {"state": "running", "time": 1.0, "factor": 1.0, "values": {}, "drives": True, "message": ""}


def test_figures(script: Any) -> None:
    """Numbers come in the units that people read, bars begin at zero, what is not known is a dash."""

    def figure(name: str, value: float) -> Any:
        asked = [GAUGES[name], None if math.isnan(value) else value, CAVITATION]
        return script("panels", "m.figure(a[0], a[1] ?? NaN, a[2])", asked)

    supply = figure("supply_pressure", 20.68e6)
    assert (supply["text"], supply["begin"], round(supply["end"], 3)) == ("207", 0.0, 0.827)
    swing = figure("swing_speed", math.radians(-30))
    assert swing["text"] == "\N{MINUS SIGN}30"
    assert (swing["begin"], swing["end"]) == pytest.approx((0.25, 0.5))
    assert figure("tip_radius", math.nan)["text"] == "\N{EN DASH}"
    assert figure("boom_rod_pressure", -1e5)["warning"] == "cavitates"
    assert figure("boom_rod_pressure", -1e3)["warning"] == "", "the sound of a pressure at rest is no void"
    assert figure("tip_radial_velocity", -1e-4)["text"] == "0.00", "no minus sign at rest"


def test_a_bar_without_ends_grows(script: Any) -> None:
    """It includes all values so far, from zero until one is negative; three digits count."""
    run = "a.reduce((ends, value) => m.grown(ends, value ?? NaN), { low: 0, high: 0.001, digits: 1 })"
    for values, expected in (
        ([1482, 3], (0, 2000, 0)),
        ([0.004, None], (0, 0.005, 5)),
        ([-104.1], (-200, 200, 0)),
        ([30, -1], (-50, 50, 1)),
        ([1000], (0, 1000, 0)),
    ):
        found = script("panels", run, values)
        assert (found["low"], found["high"], found["digits"]) == pytest.approx(expected)


COLOURS = {"-1e5": SCALE[0], "9e7": SCALE[-1], "NaN": UNKNOWN, "Infinity": UNKNOWN}


@pytest.mark.parametrize(("pressure", "expected"), COLOURS.items())
def test_colours_at_the_ends(script: Any, pressure: str, expected: str) -> None:
    """What is beyond the scale has the colour of its end, what is no number is grey."""
    assert script("panels", f"m.colour(a, {pressure})", DATA) == expected


def test_clock(script: Any) -> None:
    """The factor is simulated over real time, and nothing is told right after a pause."""
    begun = "(() => { let now = 0; const p = new m.Pace(() => now);"
    begun += " for (let k = 0; k < 20; k++) { now = 100 * k; p.look(0.05 * k, true); }"
    assert script("panels", f"{begun} return p.factor; }})()") == pytest.approx(0.5)
    assert script("panels", f"{begun} p.look(0.95, false); return p.factor; }})()") is None
    assert script("panels", f"{begun} p.look(9, true, 'jumped'); return p.factor; }})()") is None


def test_cells(script: Any) -> None:
    """Missed deadlines and latency are told of a live machine, the reason of a failure in any case."""
    timing = {"frames": 1000, "missed": 10, "latency": [4e-4, 1e-3, 2e-2], "load": 0.05}
    live = {name: text for name, text, _ in script("panels", "m.cells(a)", NOW | {"timing": timing})}
    assert live["missed"] == "10 of 1000 (1.00 %)"
    assert live["latency"] == "0.4 ms, 99 % 1.0, worst 20.0"
    replayed = script("panels", "m.cells(a)", NOW | {"timing": timing, "drives": False})
    assert replayed[0][1] == "replaying"
    assert "missed" not in [name for name, *_ in replayed]
    failed = script("panels", "m.cells(a)", NOW | {"state": "failed", "message": "it broke"})
    assert failed[-1][1:] == ["it broke", "bad"]


@table(__file__, "limits", "values, told")
def test_what_holds_the_tip(script: Any, values: tuple[float, ...], told: str) -> None:
    """The limit that is used most has a cell of its own while the controller is on, else the wait has."""
    named = dict(zip(("engaged", "reference_share", "stroke_use", "speed_use"), values, strict=True))
    cells = script("panels", "m.cells(a)", NOW | {"values": named, "slowed": DATA["slowed"]})
    shown = {name: text for name, text, _ in cells}
    assert shown.get("tip", "") == told
    assert script("panels", "m.limit(a, {})", DATA["slowed"]) == "", "no controller"


@pytest.mark.parametrize(("force", "told"), [(0.0, ""), (999.0, ""), (-2e3, "at an end"), (None, "")])
def test_an_end_of_stroke_is_told(script: Any, force: float | None, told: str) -> None:
    """Beside the gauge, above the value that it states, of either sign; not without the signal."""
    gauge = GAUGES["tip_radius"] | {"told": [{"name": "stop_force", "above": 1e3, "text": "at an end"}]}
    asked = [gauge, CAVITATION, {"stop_force": force}]
    assert script("panels", "m.figure(a[0], 3, a[1], a[2])", asked)["warning"] == told
    assert script("panels", "m.notices(a[0].told, a[2])", asked) == ([told] if told else [])


@pytest.mark.parametrize(
    ("unit", "shown", "end"), [("bar", "207", 250), ("MPa", "20.7", 25), ("psi", "3000", 3600)]
)
def test_pressures_in_another_unit(script: Any, unit: str, shown: str, end: float) -> None:
    """Gauges, charts and sliders show the same pressure, 3000 psi by the pound's definition; others stay."""
    turned = script("panels", "m.inPressure(a[0], a[1])", [DATA, unit])
    lines = {line["name"]: line for group in turned["gauges"] for line in group["lines"]}
    found = script(
        "panels", "m.figure(a[0], a[1], a[2])", [lines["supply_pressure"], 3000 * 6894.757, CAVITATION]
    )
    assert (found["text"], lines["supply_pressure"]["unit"]) == (shown, unit)
    assert found["end"] == pytest.approx(0.8274, abs=1e-4), "3000 psi of 250 bar"
    assert lines["swing_speed"] == GAUGES["swing_speed"]
    chart = next(chart for chart in turned["charts"] if chart["pressure"])
    assert (chart["ends"][0], chart["unit"]) == (end, unit)
    slider = next(one for one in turned["sliders"] if one["name"] == "supply_pressure")
    assert slider["high"] / slider["factor"] == pytest.approx(25e6)


def test_history(script: Any) -> None:
    """A spike of one frame stays in sight for the window, and is gone after it; a restart begins anew."""
    make = "const h = new m.History([{ curves: [{ name: 'a' }] }]); "
    make += "const add = (k, v) => h.add(0.01 * k, { a: v });"
    spike = f"{make} for (let k = 0; k < 1000; k++) add(k, k === 137 ? 9 : 0.5);"
    peak = "return [Math.max(...h.curves(0).columns.a), h.curves(0).time.length];"
    later = "for (let k = 1000; k < 3100; k++) add(k, 0.5);"
    again = "for (let k = 0; k < 50; k++) add(k, 0.1);"
    assert script("charts", f"(() => {{ {spike} {peak} }})()") == [9, 100]
    highest, count = script("charts", f"(() => {{ {spike} {later} {peak} }})()")
    assert highest == 0.5
    assert count <= 2 * (20 / 0.2 + 1)
    assert script("charts", f"(() => {{ {spike} {again} {peak} }})()")[0] == 0.1
    put = f"{make} h.put(3, [5], [-1]); h.put(3, [5], [-2]);"
    grown = script("charts", f"(() => {{ {put} return h.curves(1).columns.a; }})()")
    assert grown == [5, -2], "a bin that has grown"


def test_a_rise_has_no_stairs(script: Any) -> None:
    """A value that only rises is drawn as it is, whatever the bins."""
    run = """(() => { const h = new m.History([{ curves: [{ name: 'a' }] }], a);
      for (let k = 0; k < 1000; k++) h.add(0.01 * k, { a: 0.01 * k });
      return h.curves(10); })()"""
    for width in (0.1, 0.2):
        found = script("charts", run, width)
        assert found["columns"]["a"] == pytest.approx([10 + t for t in found["time"]], abs=1e-9)  # rounding


def test_charts_tell_seconds_and_end(script: Any) -> None:
    """Each label below the curves has its unit; charts that are closed are destroyed and look no more."""
    draw = """(async () => { (0, eval)(a.uplot); const drawn = [], ended = [];
      CanvasRenderingContext2D.prototype.fillText = (text) => drawn.push(text);
      const place = document.body.appendChild(document.createElement("div"));
      const charts = new m.Charts(place, a.charts.slice(0, 1), new Set([a.name]));
      charts.show({ time: [-1, 0], columns: { [a.name]: [0, 1e6] } });
      await new Promise((done) => setTimeout(done, 100));
      const [one] = charts.charts;
      one.plot.hooks.destroy = [() => ended.push("plot")];
      one.observer.disconnect = () => ended.push("observer");
      charts.close(); place.remove();
      return { drawn, ended: ended.sort() }; })()"""
    given = {"uplot": libraries()["uplot"], "charts": DATA["charts"], "name": "boom_head_pressure"}
    found = script("charts", draw, given)
    assert set(found["drawn"]) >= {"\N{MINUS SIGN}20 s", "\N{MINUS SIGN}10 s", "0 s"}
    assert found["ended"] == ["observer", "plot"]


def test_words_of_the_task(script: Any) -> None:
    """Where to go is told as the hands do it: the way round is the shorter one; what is done has no ring."""
    assert script("task", "m.directions(a)", [1.0, -0.5, math.pi / 2]) == "out 1.00 m, down 0.50 m, left 90°"
    angle = script("task", "m.way(...a)", [[-4.0, 0.1, 0.0], [-4.0, -0.1, 0.0]])[2]
    assert angle == pytest.approx(2 * math.atan(0.1 / 4))
    status = {"exercise": "stem on the left", "radius": 0.3}
    for done, strong in ((0, [True, False]), (1, [True]), (2, [])):
        rings = script("task", "m.rings(...a)", [DATA["task"], status | {"done": done}])
        assert [ring["strong"] for ring in rings] == strong


# ---- The training task on trajectories whose scores are known in closed form, in a browser

RULES = json.loads(json.dumps(page_data(DESCRIPTION, None)))["task"]
# an attempt: samples in columns by name, then the table, the phases and loads that were seen, and the file
RUN = entry(__file__, "run")
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


def test_no_motion_and_no_supply(attempt: Attempt) -> None:
    """A machine that stands has no score, also in a target; without a supply some figures are left out."""
    still = {name: np.full_like(values, values[-1]) for name, values in cycle().signals.items()}
    result = attempt(Trace(cycle().time, still))
    assert (result["table"], result["seen"][-1][0]) == ([], "ready")
    trace = cycle()
    bare = [n for n in trace.signals if not n.endswith(("pressure", "flow", "pressure_a"))]
    (found,) = attempt(trace.select(bare))["table"]
    assert (found["energy"], found["peak_pressure"]) == (None, None)


def test_a_replay_is_scored_as_it_was_driven(attempt: Attempt, script: Any) -> None:
    """The times of its pictures are those of the run here, so the samples are the same."""
    trace = cycle()
    run = """(() => {
      const replay = new m.Recording({ time: a.time, columns: a.columns, ghost: {} }, a.rules);
      replay.task.show(true); replay.show(a.time[0]);
      for (const t of a.time.slice(1)) replay.show(t);
      return replay.task.table; })()"""
    assert script("recording", run, given(trace)) == attempt(trace)["table"]


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
