"""The gauges of a machine, and the line at the foot of the page: state, real-time factor, latency."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from nicegui.element import Element

from orchestrator.base.units import parse
from orchestrator.realtime.setup import Frame
from orchestrator.view.scene.canvas import SCALE, colour
from orchestrator.view.view_description import Gauge, GaugeGroup, SignalIndex, ViewDescription

CAVITATION = -5e4  # Pa, over the atmosphere: shown as -0.1 MPa; from there the oil cavitates


class Gauges(Element, component="gauges.js"):
    """Bars and numbers of one page."""

    def __init__(self) -> None:
        super().__init__()
        self._gauges: list[Gauge] = []
        self._props.update({"groups": [], "scale": list(SCALE), "full": 0.0})
        self._full = 0.0

    def fit(self, index: SignalIndex, description: ViewDescription) -> None:
        """Show what this machine has."""
        kept = [
            GaugeGroup(g.title, tuple(x for x in g.lines if index.knows(x.name))) for g in description.gauges
        ]
        self._gauges, self._full = [line for group in kept for line in group.lines], description.full_pressure
        groups = [{"title": g.title, "gauges": [_spec(x) for x in g.lines]} for g in kept if g.lines]
        self._props.update({"groups": groups, "full": self._full / parse("MPa").factor})
        self.update()

    def show(self, frame: Frame, index: SignalIndex) -> None:
        """New numbers."""
        self.run_method("show", [figure(g, index.value(frame, g.name), self._full) for g in self._gauges])


def figure(gauge: Gauge, value: float, full: float) -> list[Any]:
    """Text, begin and end of the bar as shares of its length, colour, and a word in the place of the unit
    where something is wrong; a dash where nothing is known. full: end of the scale of colours [Pa]."""
    zero = _share(gauge, 0.0)
    if not math.isfinite(value):
        return ["–", zero, zero, "", ""]  # noqa: RUF001
    shown = value * gauge.factor
    ends = sorted((zero, _share(gauge, shown)))
    text = f"{shown:.{gauge.digits}f}".replace("-", "\N{MINUS SIGN}") if round(shown, gauge.digits) else "0"
    word = "cavitates" if gauge.is_pressure and value < CAVITATION else ""
    return [
        text,
        *(round(e, 3) for e in ends),
        colour(value, full) if gauge.is_pressure else "",
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
