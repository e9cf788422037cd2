"""The gauges, and the status line at the foot of the page: state, real-time factor, latency."""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from nicegui.element import Element

from orchestrator.base.units import parse_unit
from orchestrator.realtime.setup import Frame
from orchestrator.scene.drawing import SCALE, colour
from orchestrator.scene.view_description import CAVITATION, Gauge, GaugeGroup, ViewDescription
from orchestrator.view.session import SignalIndex


class Gauges(Element, component="gauges.js"):
    """The gauges of one page: bars and values."""

    def __init__(self) -> None:
        super().__init__()
        self._gauges: list[Gauge] = []
        self._props.update({"groups": [], "scale": list(SCALE), "full": 0.0})
        self._full = 0.0

    def fit(self, index: SignalIndex, description: ViewDescription) -> None:
        """Show the gauges whose signals this machine has."""
        kept = [
            GaugeGroup(g.title, tuple(x for x in g.lines if index.contains(x.name)))
            for g in description.gauges
        ]
        self._gauges, self._full = [line for group in kept for line in group.lines], description.full_pressure
        groups = [{"title": g.title, "gauges": [_spec(x) for x in g.lines]} for g in kept if g.lines]
        self._props.update({"groups": groups, "full": self._full / parse_unit("MPa").factor})
        self.update()

    def show(self, frame: Frame, index: SignalIndex) -> None:
        """Update the values."""
        self.run_method("show", [figure(g, index.value(frame, g.name), self._full) for g in self._gauges])


def figure(gauge: Gauge, value: float, full: float) -> list[Any]:
    """Value as text, begin and end of the bar as fractions of its length, colour, and a warning or empty.

    A dash stands for a value that is not finite. full: end of the colour scale [Pa].
    """
    zero = _fraction(gauge, 0.0)
    if not math.isfinite(value):
        return ["–", zero, zero, "", ""]  # noqa: RUF001
    shown = value * gauge.factor
    ends = sorted((zero, _fraction(gauge, shown)))
    text = f"{shown:.{gauge.digits}f}".replace("-", "\N{MINUS SIGN}") if round(shown, gauge.digits) else "0"
    warning = "cavitates" if gauge.is_pressure and value < CAVITATION else ""
    return [text, *(round(e, 3) for e in ends), colour(value, full) if gauge.is_pressure else "", warning]


def _fraction(gauge: Gauge, shown: float) -> float:
    return min(1.0, max(0.0, (shown - gauge.low) / (gauge.high - gauge.low)))


def _spec(gauge: Gauge) -> dict[str, Any]:
    return {"text": gauge.text, "unit": gauge.unit, "zero": round(_fraction(gauge, 0.0), 3)}


SPAN = 2.0  # s; time over which the real-time factor is measured
GOOD, WATCH, BAD = "good", "watch", "bad"
TONES = {"running": GOOD, "failed": BAD, "starting": WATCH, "paused": WATCH, "ended": WATCH}
MISSED = 0.005  # fraction of missed frames that is still good
MILLI = 1e3
FULL = 0.9  # fraction of the commanded speed that counts as full speed
ENGAGED = 0.5  # value of `engaged`, 0 to 1, above which the controller moves the tip

Cell = tuple[str, str, str]  # name, text, tone


class RealTimeFactor:
    """Simulated time over real time, measured over the last two seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen = deque[tuple[float, float]]()

    def look(self, frame: Frame) -> None:
        """Add a frame. The measurement starts again when the machine does not run."""
        now = self._clock()
        if frame.state != "running" or (self._seen and frame.t < self._seen[-1][1]):
            self._seen.clear()
        if frame.state == "running":
            self._seen.append((now, frame.t))
        while self._seen and now - self._seen[0][0] > SPAN:
            self._seen.popleft()

    @property
    def factor(self) -> float | None:
        """Simulated over real time; None before enough frames."""
        if len(self._seen) < 2 or self._seen[-1][0] - self._seen[0][0] < SPAN / 4:
            return None
        (begin, t), (end, u) = self._seen[0], self._seen[-1]
        return (u - t) / (end - begin)


def tip_limit(index: SignalIndex, frame: Frame) -> str:
    """Reason why the controller moves the tip slower than commanded; empty if it does not, or is off.

    `stroke_use` and `speed_use` limit the speed above 1. Below that, the controller waits for the machine.
    """
    share, engaged, stroke, speed = (
        index.value(frame, name) for name in ("reference_share", "engaged", "stroke_use", "speed_use")
    )
    if not (share < FULL and engaged > ENGAGED):  # False if a value is NaN
        return ""
    if max(stroke, speed) <= 1.0:
        return "waits for the machine"
    return "at the end of a stroke" if stroke > speed else "at a speed limit"


def cells(frame: Frame, factor: float | None, drives: bool, limited: str = "") -> list[Cell]:
    """Cells of the status line. limited: limit of the tip's speed, see `tip_limit`."""
    timing = frame.timing
    state = frame.state if drives or frame.state != "running" else "replaying"
    line: list[Cell] = [("", state, TONES.get(frame.state, WATCH))]
    line.append(("t", f"{frame.t:.1f} s" if frame.t == frame.t else "–", ""))  # noqa: RUF001
    line.append(("real time", "–" if factor is None else f"× {factor:.2f}", ""))  # noqa: RUF001
    if limited:
        line.append(("tip", limited, WATCH))
    if drives and timing.frames:
        fraction = timing.missed / timing.frames
        median, p99, worst = (MILLI * value for value in timing.latency)
        missed = f"{timing.missed} of {timing.frames} ({100 * fraction:.2f} %)"
        line += [
            ("missed", missed, GOOD if fraction < MISSED else BAD),
            ("latency", f"{median:.1f} ms, 99 % {p99:.1f}, worst {worst:.1f}", ""),
            ("load", f"{100 * timing.load:.0f} %", ""),
        ]
    return [*line, ("", frame.message, BAD if frame.state == "failed" else "")] if frame.message else line


class StatusLine(Element, component="state.js"):
    """The status line of one page."""

    def show(self, frame: Frame, factor: float | None, drives: bool, limited: str = "") -> None:
        """Update the cells."""
        self.run_method("show", cells(frame, factor, drives, limited))
