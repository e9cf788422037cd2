"""Setup of a machine in real time, and its frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array


@dataclass(frozen=True)
class Axis:
    """An input that takes commands while the machine runs.

    name        as for a column of a scenario: an input of the system, `component.variable`, or the name of a
                variable
    limit       largest magnitude, in the unit of the FMU; commands are clipped
    rate        largest change per second, in that unit, also towards rest
    rest        value without a command
    rest_delay  time for which an axis without a command keeps its value before it goes to rest [s of
                simulated time]; longer for one that others need to stop, such as `engaged` of a controller
    """

    name: str
    limit: float
    rate: float
    rest: float = 0.0
    rest_delay: float = 0.0

    def check(self) -> None:
        """Raise `Problem` for a limit, rate, rest or rest delay without sense."""
        for name, value in (("limit", self.limit), ("rate", self.rate)):
            if not (isfinite(value) and value > 0):
                raise Problem(f"axis {self.name}: expected a positive {name}, got {value:g}")
        if not (isfinite(self.rest_delay) and self.rest_delay >= 0):
            got = f"got {self.rest_delay:g} s"
            raise Problem(f"axis {self.name}: expected a rest delay of 0 s or more, {got}")
        if not abs(self.rest) <= self.limit:
            expected = f"expected a rest value of at most {self.limit:g} in magnitude"
            raise Problem(f"axis {self.name}: {expected}, got {self.rest:g}")


@dataclass(frozen=True)
class Setup:
    """Declaration of a machine in real time; can be pickled.

    system       path of an .ssp or .fmu file
    axes         inputs that take commands
    signals      recorded signals, `component.variable`
    swap, parameters, set, fault   as for `run`
    step         communication step [s]; default: the suggestion of the system
    frame        time between two readings of the command, and the deadline [s]
    timeout      age at which a command expires and the axes go to rest [s]
    """

    system: str
    axes: tuple[Axis, ...]
    signals: tuple[str, ...]
    swap: Mapping[str, str] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    set: Mapping[str, float | str] = field(default_factory=dict)
    fault: Mapping[str, float | str] = field(default_factory=dict)
    step: float | None = None
    frame: float = 0.01
    timeout: float = 0.25

    def check(self) -> None:
        """Raise `Problem` for values that are wrong for any machine."""
        for name, value in (("frame", self.frame), ("timeout", self.timeout)):
            if not (isfinite(value) and value > 0):
                raise Problem(f"{name}: expected a positive time, got {value:g} s")
        for noun, names in (("axis", [a.name for a in self.axes]), ("signal", list(self.signals))):
            if twice := [n for i, n in enumerate(names) if n in names[:i]]:
                raise Problem(f"{noun} {twice[0]}: expected once, got twice")
        for axis in self.axes:
            axis.check()


@dataclass(frozen=True)
class Task:
    """Message that starts the process of a machine.

    address   address of the shared memory
    rows      number of frames in the shared memory
    first     number of the first frame
    serial    number of the last command that is not for this process
    """

    setup: Setup
    address: str
    rows: int
    first: int
    serial: int


@dataclass(frozen=True)
class Timing:
    """Statistics of the deadlines since the last start or restart.

    frames     number of frames
    missed     number of frames that were ready more than one frame after they were due
    latency    time from the deadline of a frame until it can be read: median, 99 %, largest [s]
    load       computing time relative to the length of the frame, mean over the last second
    """

    frames: int = 0
    missed: int = 0
    latency: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 0.0


class State(StrEnum):
    """What a machine does, in the order of its memory, which is zero at first."""

    STARTING = "starting"
    RUNNING = "running"
    PAUSED = "paused"
    ENDED = "ended"
    FAILED = "failed"


@dataclass(frozen=True)
class Frame:
    """Values and state of the machine at one instant.

    number     counts up; equal numbers are the same frame
    t          simulated time [s]
    axes       values of the axes after limits, shape (axes,)
    values     values of the signals, shape (signals,)
    message    reason of a failure, or why the motion is not reliable, else empty
    """

    number: int
    t: float
    axes: Array
    values: Array
    state: State
    message: str
    timing: Timing
