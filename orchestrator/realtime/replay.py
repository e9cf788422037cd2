"""Replay of a result file in real time, with the interface of a live machine."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, read_trace
from orchestrator.realtime.deadlines import speed_factor
from orchestrator.realtime.setup import Frame, Setup, Timing

FRAME = 0.01  # [s]


class Replay:
    """A trace as a machine without commands; implements `setup.Machine`.

    Nothing runs in the background: the position follows from the clock at each call. The frames are
    `frame` [s] apart, interpolated between the samples of the file.
    """

    drives = False
    axes: Sequence[str] = ()

    def __init__(
        self,
        file: str | Path | Trace,
        signals: Sequence[str] | None = None,
        playing: bool = True,
        speed: float = 1.0,
        frame: float = FRAME,
    ) -> None:
        """file: a .csv, .parquet or .mat trace; signals: default: all."""
        whole = file if isinstance(file, Trace) else read_trace(file)
        self._trace = whole if signals is None else whole.select(signals)
        if not len(whole.time):
            raise Problem("replay: expected a trace with samples, got an empty one")
        self.signals: Sequence[str] = tuple(self._trace.signals)
        self.units: Mapping[str, str] = dict(self._trace.units)
        self.begin, self.end = float(whole.time[0]), float(whole.time[-1])
        self._frame, self._last = frame, int((self.end - self.begin) / frame + 1e-6)
        self._speed, self._playing = speed_factor(speed), playing
        self._first, self._origin = 1, 0  # number and position of the first frame since the last jump
        self._at, self._since = 0.0, time.monotonic()  # position at this time, in frames

    # ---- driving

    def command(self, values: Mapping[str, float]) -> None:
        """Raises `Problem` for any name: there are no axes."""
        for name in values:
            raise Problem(f"unknown axis {name!r}: a replay takes no commands")

    def play(self) -> None:
        """Continue."""
        self._hold()
        self._playing = True

    def pause(self) -> None:
        """Stop at the current position."""
        self._hold()
        self._playing = False

    def speed(self, factor: float) -> None:
        """Set the speed relative to real time, 0.1 to 10."""
        factor = speed_factor(factor)
        self._hold()
        self._speed = factor

    def restart(self, setup: Setup | None = None) -> None:
        """Go to the first frame."""
        if setup is not None:
            raise Problem("a replay has no setup: expected None, got one")
        self.seek(self.begin)

    def seek(self, t: float) -> None:
        """Go to the frame at time t [s], limited to the time span of the file."""
        if not np.isfinite(t):
            raise Problem(f"replay: expected a finite time, got {t:g} s")
        self._first = self._number() + 1
        position = round((min(max(t, self.begin), self.end) - self.begin) / self._frame)
        self._origin = min(position, self._last)
        self._at, self._since = float(self._origin), time.monotonic()

    def close(self) -> None:
        """Nothing is open."""

    # ---- watching

    def latest(self) -> Frame:
        """The current frame."""
        position = self._position()
        times, values = self._values(np.array([position]))
        state = "ended" if position == self._last else "running" if self._playing else "paused"
        number = self._first + position - self._origin
        return Frame(number, float(times[0]), np.zeros(0), values[0], state, "", Timing())

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """The frames after this number since the last jump."""
        last = self._number()
        numbers = np.arange(min(max(number + 1, self._first), last + 1), last + 1)
        times, values = self._values(numbers - self._first + self._origin)
        return numbers, times, np.zeros((len(numbers), 0)), values

    def before(self, seconds: float) -> tuple[Array, Array, Array]:
        """Times (n,), axes (n, 0), values (n, signals) of the frames in these last seconds of the file."""
        last = self._position()
        times, values = self._values(np.arange(max(0, last - round(seconds / self._frame)), last + 1))
        return times, np.zeros((len(times), 0)), values

    def trace(self) -> Trace:
        """The whole file."""
        return self._trace

    # ---- inside

    def _passed(self) -> float:
        """Current position in frames, with fraction."""
        elapsed = (time.monotonic() - self._since) * self._speed / self._frame if self._playing else 0.0
        return min(self._at + elapsed, float(self._last))

    def _position(self) -> int:
        return int(self._passed())

    def _number(self) -> int:
        return self._first + self._position() - self._origin

    def _hold(self) -> None:
        """Restart the clock at the current position."""
        self._at, self._since = self._passed(), time.monotonic()

    def _values(self, positions: NDArray[np.int64]) -> tuple[Array, Array]:
        """Times (n,) and values (n, signals) of the frames at these positions."""
        times = np.minimum(self.begin + positions * self._frame, self.end)
        columns = [np.interp(times, self._trace.time, v) for v in self._trace.signals.values()]
        return times, np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
