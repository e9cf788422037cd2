"""The line at the foot of the page: how the machine does, and how well it keeps real time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from nicegui.element import Element

from orchestrator.live.setup import Frame
from orchestrator.view.reading import Reading

SPAN = 2.0  # s over which the factor is measured
GOOD, WATCH, BAD = "good", "watch", "bad"
TONES = {"running": GOOD, "failed": BAD, "starting": WATCH, "paused": WATCH, "ended": WATCH}
SHARE = 0.005  # of missed frames that is still good
MILLI = 1e3
FULL = 0.9  # share of the speed wanted that still counts as all of it
ENGAGED = 0.5  # of `engaged`, 0 to 1: from there on the controller moves the tip

Cell = tuple[str, str, str]  # name, text, tone


class Clock:
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


def limit(reading: Reading, frame: Frame) -> str:
    """Why the controller gives the tip less than the speed wanted; empty where it gives it, or is off.

    The use of speed or strokes acts above 1; else only the wait for the machine is left.
    """
    share, engaged, stroke, speed = (
        reading.value(frame, name) for name in ("reference_share", "engaged", "stroke_use", "speed_use")
    )
    if not (share < FULL and engaged > ENGAGED):  # what is not known is not a number
        return ""
    if max(stroke, speed) <= 1.0:
        return "waits for the machine"
    return "at the end of a stroke" if stroke > speed else "at a speed limit"


def cells(frame: Frame, factor: float | None, drives: bool, held: str = "") -> list[Cell]:
    """What the line shows; held: what limits the tip."""
    pulse = frame.pulse
    state = frame.state if drives or frame.state != "running" else "replaying"
    found: list[Cell] = [("", state, TONES.get(frame.state, WATCH))]
    found.append(("t", f"{frame.t:.1f} s" if frame.t == frame.t else "–", ""))  # noqa: RUF001
    found.append(("real time", "–" if factor is None else f"× {factor:.2f}", ""))  # noqa: RUF001
    if held:
        found.append(("tip", held, WATCH))
    if drives and pulse.frames:
        share = pulse.missed / pulse.frames
        middle, high, worst = (MILLI * value for value in pulse.latency)
        missed = f"{pulse.missed} of {pulse.frames} ({100 * share:.2f} %)"
        found += [
            ("missed", missed, GOOD if share < SHARE else BAD),
            ("latency", f"{middle:.1f} ms, 99 % {high:.1f}, worst {worst:.1f}", ""),
            ("load", f"{100 * pulse.load:.0f} %", ""),
        ]
    return [*found, ("", frame.message, BAD if frame.state == "failed" else "")] if frame.message else found


class Line(Element, component="state.js"):
    """The line on one page."""

    def show(self, frame: Frame, factor: float | None, drives: bool, held: str = "") -> None:
        """New texts."""
        self.run_method("show", cells(frame, factor, drives, held))
