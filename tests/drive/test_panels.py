"""What the page shows beside the picture, as its scripts compute it in a browser."""

import json
import math
from typing import Any

import pytest
from kit import shards
from kit.mistakes import table
from view.standin import DESCRIPTION

from orchestrator.drive.drawing import SCALE, UNKNOWN
from orchestrator.drive.page import libraries, page_data
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
    assert (supply["text"], supply["begin"], round(supply["end"], 3)) == ("20.7", 0.0, 0.827)
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


@pytest.mark.parametrize(("force", "shown"), [(0.0, []), (999.0, []), (-2e3, ["at an end"]), (None, [])])
def test_an_end_of_stroke_is_noticed(script: Any, force: float | None, shown: list[str]) -> None:
    """Above the value of the notice, of either sign; not without the signal."""
    both = (("stop_force", 1e3, "at an end"), ("x", 0.0, "x"))
    described = [dict(zip(("name", "above", "text"), one, strict=True)) for one in both]
    assert script("panels", "m.notices(a[0], { stop_force: a[1] ?? NaN })", [described, force]) == shown


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


def test_the_axis_of_time_is_in_seconds(script: Any) -> None:
    """Each label that a chart draws below its curves has its unit."""
    draw = """(async () => { (0, eval)(a.uplot); const drawn = [];
      CanvasRenderingContext2D.prototype.fillText = (text) => drawn.push(text);
      const place = document.body.appendChild(document.createElement("div"));
      const charts = new m.Charts(place, a.charts.slice(0, 1), new Set([a.name]));
      charts.show({ time: [-1, 0], columns: { [a.name]: [0, 1e6] } });
      await new Promise((done) => setTimeout(done, 100)); place.remove();
      return [...new Set(drawn)]; })()"""
    given = {"uplot": libraries()["uplot"], "charts": DATA["charts"], "name": "boom_head_pressure"}
    labels = set(script("charts", draw, given))
    assert labels >= {"\N{MINUS SIGN}20 s", "\N{MINUS SIGN}10 s", "0 s"}


def test_charts_end(script: Any) -> None:
    """Charts that are closed are destroyed, and look at their size no more."""
    draw = """(() => { (0, eval)(a.uplot); const ended = [];
      const place = document.body.appendChild(document.createElement("div"));
      const charts = new m.Charts(place, a.charts.slice(0, 1), new Set([a.name]));
      const [one] = charts.charts;
      one.plot.hooks.destroy = [() => ended.push("plot")];
      one.observer.disconnect = () => ended.push("observer");
      charts.close(); place.remove();
      return ended.sort(); })()"""
    given = {"uplot": libraries()["uplot"], "charts": DATA["charts"], "name": "boom_head_pressure"}
    assert script("charts", draw, given) == ["observer", "plot"]


def test_words_of_the_task(script: Any) -> None:
    """Where to go is told as the hands do it: the way round is the shorter one; what is done has no ring."""
    assert script("task", "m.directions(a)", [1.0, -0.5, math.pi / 2]) == "out 1.00 m, down 0.50 m, left 90°"
    angle = script("task", "m.way(...a)", [[-4.0, 0.1, 0.0], [-4.0, -0.1, 0.0]])[2]
    assert angle == pytest.approx(2 * math.atan(0.1 / 4))
    status = {"exercise": "stem on the left", "radius": 0.3}
    for done, strong in ((0, [True, False]), (1, [True]), (2, [])):
        rings = script("task", "m.rings(...a)", [DATA["task"], status | {"done": done}])
        assert [ring["strong"] for ring in rings] == strong
