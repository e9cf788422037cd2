"""The gauges: what is shown of a machine, in the units that people read.

The line at the foot of the page: how the machine does, and how well it keeps real time.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui.element import Element

from orchestrator.realtime.setup import Frame
from orchestrator.view.scene.canvas import SCALE, colour
from orchestrator.view.signals import FULL as FULL_of_reading
from orchestrator.view.signals import SignalIndex

MEGA, LITRES, DEGREES, TURNS = 1e-6, 6e4, 180 / math.pi, 30 / math.pi  # to MPa, L/min, degrees, rpm

TORN = -5e4  # Pa, over the atmosphere: shown as -0.1 MPa; from there the oil is torn, a void is in it


@dataclass(frozen=True)
class Gauge:
    """One line: a signal by its bare name, its text and unit, the factor to that unit, the ends of its bar.

    pressure   its bar has the colour of the pressure
    """

    name: str
    text: str
    unit: str
    factor: float
    low: float
    high: float
    digits: int = 1
    pressure: bool = False


def _pressure(name: str, text: str) -> Gauge:
    return Gauge(name, text, "MPa", MEGA, 0.0, FULL_of_reading * MEGA, 1, pressure=True)


GROUPS: Sequence[tuple[str, Sequence[Gauge]]] = (
    (
        "Pressure",
        (
            _pressure("supply_pressure", "Supply"),
            _pressure("boom_head_pressure", "Boom, head side"),
            _pressure("boom_rod_pressure", "Boom, rod side"),
            _pressure("stick_head_pressure", "Stick, head side"),
            _pressure("stick_rod_pressure", "Stick, rod side"),
            _pressure("swing_pressure_a", "Swing, port A"),
            _pressure("swing_pressure_b", "Swing, port B"),
        ),
    ),
    (
        "Motion",
        (
            Gauge("swing_angle", "Swing angle", "°", DEGREES, -180, 180, 0),
            Gauge("boom_angle", "Boom angle", "°", DEGREES, -90, 90, 0),
            Gauge("stick_angle", "Stick angle", "°", DEGREES, -180, 180, 0),
            Gauge("swing_speed", "Swing speed", "°/s", DEGREES, -60, 60, 0),
            Gauge("tip_radial_velocity", "Tip outwards", "m/s", 1, -2, 2, 2),
            Gauge("tip_vertical_velocity", "Tip upwards", "m/s", 1, -2, 2, 2),
            Gauge("tip_radius", "Tip, reach", "m", 1, 0, 7, 2),
            Gauge("tip_height", "Tip, height", "m", 1, -2, 6, 2),
            Gauge("head_side_angle", "Head, sideways", "°", DEGREES, -60, 60, 0),
            Gauge("tip_error", "Tip off its path", "mm", 1e3, 0, 60, 0),
        ),
    ),
    (
        "Power",
        (
            Gauge("hydraulic_power", "Hydraulics", "kW", 1e-3, 0, 100, 0),
            Gauge("supply_flow", "Flow", "L/min", LITRES, 0, 300, 0),
            Gauge("engine_speed", "Engine", "rpm", TURNS, 0, 3000, 0),
            Gauge("engine_torque", "Engine torque", "N.m", 1, 0, 700, 0),
            Gauge("pump_1_stroke", "Pump 1, stroke", "%", 100, 0, 100, 0),
            Gauge("pump_2_stroke", "Pump 2, stroke", "%", 100, 0, 100, 0),
        ),
    ),
)


def known(index: SignalIndex) -> list[tuple[str, list[Gauge]]]:
    """The gauges for which the machine has signals, by group."""
    groups = [(title, [g for g in gauges if index.knows(g.name)]) for title, gauges in GROUPS]
    return [(title, gauges) for title, gauges in groups if gauges]


class Gauges(Element, component="gauges.js"):
    """Bars and numbers of one page."""

    def __init__(self) -> None:
        super().__init__()
        self._gauges: list[Gauge] = []
        self._props.update({"groups": [], "scale": list(SCALE), "full": FULL_of_reading * MEGA})

    def fit(self, index: SignalIndex) -> None:
        """Show what this machine has."""
        groups = known(index)
        self._gauges = [g for _, gauges in groups for g in gauges]
        self._props["groups"] = [{"title": t, "gauges": [_spec(g) for g in gauges]} for t, gauges in groups]
        self.update()

    def show(self, frame: Frame, index: SignalIndex) -> None:
        """New numbers."""
        self.run_method("show", [figure(g, index.value(frame, g.name)) for g in self._gauges])


def figure(gauge: Gauge, value: float) -> list[Any]:
    """Text, begin and end of the bar as shares of its length, colour, and a word in the place of the unit
    where something is wrong; a dash where nothing is known."""
    zero = _share(gauge, 0.0)
    if not math.isfinite(value):
        return ["–", zero, zero, "", ""]  # noqa: RUF001
    shown = value * gauge.factor
    ends = sorted((zero, _share(gauge, shown)))
    text = f"{shown:.{gauge.digits}f}".replace("-", "\N{MINUS SIGN}") if round(shown, gauge.digits) else "0"
    word = "torn" if gauge.pressure and value < TORN else ""
    return [
        text,
        *(round(e, 3) for e in ends),
        colour(value, FULL_of_reading) if gauge.pressure else "",
        word,
    ]


def _share(gauge: Gauge, shown: float) -> float:
    return min(1.0, max(0.0, (shown - gauge.low) / (gauge.high - gauge.low)))


def _spec(gauge: Gauge) -> dict[str, Any]:
    return {"text": gauge.text, "unit": gauge.unit, "zero": round(_share(gauge, 0.0), 3)}


SPAN = 2.0  # s over which the factor is measured
GOOD, WATCH, BAD = "good", "watch", "bad"
TONES = {"running": GOOD, "failed": BAD, "starting": WATCH, "paused": WATCH, "ended": WATCH}
SHARE = 0.005  # of missed frames that is still good
MILLI = 1e3
FULL = 0.9  # share of the speed wanted that still counts as all of it
ENGAGED = 0.5  # of `engaged`, 0 to 1: from there on the controller moves the tip

Cell = tuple[str, str, str]  # name, text, tone


class RealTimeFactor:
    """How fast simulated time goes by, measured over the last two seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen = deque[tuple[float, float]]()

    def look(self, frame: Frame) -> None:
        """At a frame; whatever is not running begins anew."""
        now = self._clock()
        if frame.state != "running" or (self._seen and frame.t < self._seen[-1][1]):
            self._seen.clear()
        if frame.state == "running":
            self._seen.append((now, frame.t))
        while self._seen and now - self._seen[0][0] > SPAN:
            self._seen.popleft()

    @property
    def factor(self) -> float | None:
        """Simulated over real time; nothing if that cannot be told yet."""
        if len(self._seen) < 2 or self._seen[-1][0] - self._seen[0][0] < SPAN / 4:
            return None
        (begin, t), (end, u) = self._seen[0], self._seen[-1]
        return (u - t) / (end - begin)


def limit(index: SignalIndex, frame: Frame) -> str:
    """Why the controller gives the tip less than the speed wanted; empty where it gives it, or is off.

    The use of speed or strokes acts above 1; else only the wait for the machine is left.
    """
    share, engaged, stroke, speed = (
        index.value(frame, name) for name in ("reference_share", "engaged", "stroke_use", "speed_use")
    )
    if not (share < FULL and engaged > ENGAGED):  # what is not known is not a number
        return ""
    if max(stroke, speed) <= 1.0:
        return "waits for the machine"
    return "at the end of a stroke" if stroke > speed else "at a speed limit"


def cells(frame: Frame, factor: float | None, drives: bool, held: str = "") -> list[Cell]:
    """What the line shows; held: what limits the tip."""
    timing = frame.timing
    state = frame.state if drives or frame.state != "running" else "replaying"
    found: list[Cell] = [("", state, TONES.get(frame.state, WATCH))]
    found.append(("t", f"{frame.t:.1f} s" if frame.t == frame.t else "–", ""))  # noqa: RUF001
    found.append(("real time", "–" if factor is None else f"× {factor:.2f}", ""))  # noqa: RUF001
    if held:
        found.append(("tip", held, WATCH))
    if drives and timing.frames:
        share = timing.missed / timing.frames
        middle, high, worst = (MILLI * value for value in timing.latency)
        missed = f"{timing.missed} of {timing.frames} ({100 * share:.2f} %)"
        found += [
            ("missed", missed, GOOD if share < SHARE else BAD),
            ("latency", f"{middle:.1f} ms, 99 % {high:.1f}, worst {worst:.1f}", ""),
            ("load", f"{100 * timing.load:.0f} %", ""),
        ]
    return [*found, ("", frame.message, BAD if frame.state == "failed" else "")] if frame.message else found


class StatusLine(Element, component="state.js"):
    """The line on one page."""

    def show(self, frame: Frame, factor: float | None, drives: bool, held: str = "") -> None:
        """New texts."""
        self.run_method("show", cells(frame, factor, drives, held))
