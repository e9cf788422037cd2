"""What runs in real time and what is known of it: setup, frames, and the interface that a page drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """An input that is driven while the machine runs.

    name        as a column of a scenario: an input of the system, `component.variable`, or a bare name
    limit       largest magnitude, in the unit of the FMU; what is beyond is cut off
    rate        largest change per second in that unit, also towards rest
    rest        what it goes to when nobody commands
    rest_delay  how long it stays where it is before it goes to rest [s of simulated time]: what brakes the
                others, such as a controller that is engaged, has to stay longer than they
    """

    name: str
    limit: float
    rate: float
    rest: float = 0.0
    rest_delay: float = 0.0

    def check(self) -> None:
        """Refuse an axis that cannot move, that rests beyond its limit, or never."""
        for name, value in (("limit", self.limit), ("rate", self.rate)):
            if not (isfinite(value) and value > 0):
                raise Problem(f"axis {self.name}: expected a positive {name}, got {value:g}")
        if not (isfinite(self.rest_delay) and self.rest_delay >= 0):
            raise Problem(
                f"axis {self.name}: expected a rest delay of 0 s or more, got {self.rest_delay:g} s"
            )
        if not abs(self.rest) <= self.limit:
            raise Problem(f"axis {self.name}: expected a rest within {self.limit:g}, got {self.rest:g}")


@dataclass(frozen=True)
class Setup:
    """A machine that can be sent to another process.

    system       path of an .ssp or .fmu file
    axes         what is driven
    signals      what is shown, `component.variable`
    swap, parameters, set   as of `run`
    step         communication step [s]; default: what the system suggests
    frame        interval between two looks at the commands [s]: the deadline
    timeout     commands that are older than this go to rest [s]
    """

    system: str
    axes: tuple[Axis, ...]
    signals: tuple[str, ...]
    swap: Mapping[str, str] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    set: Mapping[str, float | str] = field(default_factory=dict)
    step: float | None = None
    frame: float = 0.01
    timeout: float = 0.25

    def check(self) -> None:
        """Refuse a setup that is wrong for any machine."""
        for name, value in (("frame", self.frame), ("timeout", self.timeout)):
            if not (isfinite(value) and value > 0):
                raise Problem(f"{name}: expected a positive time, got {value:g} s")
        for what, names in (("axis", [a.name for a in self.axes]), ("signal", list(self.signals))):
            if twice := [n for i, n in enumerate(names) if n in names[:i]]:
                raise Problem(f"{what} {twice[0]}: expected it once, got it twice")
        for axis in self.axes:
            axis.check()


@dataclass(frozen=True)
class Task:
    """What the process of a machine gets through its pipe.

    address   of the shared memory
    rows      frames that it holds
    first     number of the first frame
    serial    of the last command that is not for this process
    """

    setup: Setup
    address: str
    rows: int
    first: int
    serial: int


@dataclass(frozen=True)
class Timing:
    """How well real time is held, since the last start or restart.

    frames     how many there were
    missed     those that were ready later than one frame after they were due
    latency    from the due time of a frame to the moment its values can be read: median, 99 %, worst [s]
    load       computing time per frame, share of the frame: mean over the last second
    """

    frames: int = 0
    missed: int = 0
    latency: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 0.0


@dataclass(frozen=True)
class Frame:
    """What is known of the machine at one instant.

    number     counts up; equal numbers are the same frame
    t          simulated time [s]
    axes       the values that drive the machine now, shape (axes,)
    values     of the signals, shape (signals,)
    state      "starting", "running", "paused", "ended" (a replay at its end), "failed"
    message    why it failed, else empty
    """

    number: int
    t: float
    axes: Array
    values: Array
    state: str
    message: str
    timing: Timing


class Machine(Protocol):
    """What a page shows and drives: simulated (`machine.RealTimeMachine`) or a replay (`replay.Replay`).

    axes, signals, units   names and units of what `Frame` holds
    drives     it takes commands
    command    new values by axis; what is not named goes to rest; Problem if one is not finite; they expire
    since      the frames after this number: numbers (n,), times (n,), axes (n, axes), values (n, signals);
               of long ago only what is still in memory
    trace      the whole session, with the axes among the signals
    restart    from the beginning, perhaps with another setup
    """

    @property
    def axes(self) -> Sequence[str]: ...
    @property
    def signals(self) -> Sequence[str]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def drives(self) -> bool: ...

    def command(self, values: Mapping[str, float]) -> None: ...
    def play(self) -> None: ...
    def pause(self) -> None: ...
    def speed(self, factor: float) -> None: ...
    def restart(self, setup: Setup | None = None) -> None: ...
    def latest(self) -> Frame: ...
    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]: ...
    def trace(self) -> Trace: ...
    def close(self) -> None: ...
