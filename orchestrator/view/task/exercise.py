"""What a training task reads of a run: by the names that the parts give their variables, in any component.

tip in space         tip_x, tip_y, tip_height [m]                            needed
speed of functions   swing_speed, boom_speed, stick_speed [rad/s]            needed
speed of the tip     |(tip_radial_velocity, tip_vertical_velocity, swing_speed r)| [m/s],
                     r^2 = x^2 + y^2                                         needed
supply               supply_pressure [Pa], supply_flow [m3/s]: of the component `supply` if there is one,
                     else the flows of all components together
pressures            of the six lines [Pa]

What has to be done, and how far it is: a function from one sample to the next.

    ready -> moving -> holding -> moving -> ... -> done

The clock starts when the tip has left its first position by `start`. A target is done when the tip has been
within `radius` of it and slower than `slow` for `hold` without a break. Order and form are ours: a stem has
to be reached, gripped while the head stands still, and put down elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace

Array = NDArray[np.float64]

TIP = ("tip_x", "tip_y", "tip_height")
SPEEDS = ("swing_speed", "boom_speed", "stick_speed")
VELOCITIES = ("tip_radial_velocity", "tip_vertical_velocity")
PRESSURE, FLOW = "supply_pressure", "supply_flow"
LINES = (
    "swing_pressure_a",
    "swing_pressure_b",
    *(f"{axis}_{side}_pressure" for axis in ("boom", "stick") for side in ("head", "rod")),
)
NEEDED = (*TIP, *SPEEDS, *VELOCITIES)
WANTED = (*NEEDED, PRESSURE, FLOW, *LINES)
UNITS = {
    **dict.fromkeys(TIP, "m"),
    **dict.fromkeys(SPEEDS, "rad/s"),
    **dict.fromkeys(VELOCITIES, "m/s"),
    **dict.fromkeys((PRESSURE, *LINES), "Pa"),
    FLOW: "m3/s",
}


@dataclass(frozen=True)
class Samples:
    """A stretch of a run.

    time       (n,) [s]
    tip        (n, 3) [m]: forward, left, up
    speed      (n,) of the tip [m/s]
    functions  (n, 3) speeds of swing, boom and stick [rad/s]
    power      (n,) hydraulic power from the supply [W]; empty if the run does not hold it
    pressure   (n,) the largest of the lines [Pa]; empty if the run holds none
    """

    time: Array
    tip: Array
    speed: Array
    functions: Array
    power: Array
    pressure: Array

    def __getitem__(self, part: slice) -> Samples:
        return Samples(*(getattr(self, name)[part] for name in self.__dataclass_fields__))


def wanted(signals: Sequence[str]) -> tuple[str, ...]:
    """Those of the signals that a task reads."""
    return tuple(name for name in signals if _tail(name) in WANTED)


def of_trace(trace: Trace) -> Samples:
    """All samples of a run."""
    names = wanted(list(trace.signals))
    for name in names:
        unit = trace.units.get(name, UNITS[_tail(name)])
        if unit != UNITS[_tail(name)]:
            raise Problem(f"task: {name}: expected {UNITS[_tail(name)]}, found {unit}")
    return of_values(trace.time, {name: trace[name] for name in names})


def of_values(time: Array, values: Mapping[str, Array]) -> Samples:
    """Samples from the values of some signals, by name."""
    first = {_tail(name): name for name in reversed(list(values))}
    lacking = [tail for tail in NEEDED if tail not in first]
    if lacking:
        expected = ", ".join(NEEDED)
        raise Problem(f"task: expected a run with {expected}, found none of {', '.join(lacking)}")
    found = {tail: np.asarray(values[name], float) for tail, name in first.items()}
    tip = np.stack([found[name] for name in TIP], axis=1)
    lines = [found[name] for name in LINES if name in found]
    return Samples(
        time=np.asarray(time, float),
        tip=tip,
        speed=_speed(tip, found),
        functions=np.stack([found[name] for name in SPEEDS], axis=1),
        power=_power(values, found),
        pressure=np.max(lines, axis=0) if lines else np.empty(0),
    )


def _speed(tip: Array, found: Mapping[str, Array]) -> Array:
    across = found["swing_speed"] * np.hypot(tip[:, 0], tip[:, 1])
    speed: Array = np.linalg.norm([*(found[name] for name in VELOCITIES), across], axis=0)
    return speed


def _power(values: Mapping[str, Array], found: Mapping[str, Array]) -> Array:
    flows = [name for name in values if _tail(name) == FLOW]
    # a supply of its own already adds up what the drives take
    total = [name for name in flows if name.split(".")[-2:-1] == ["supply"]] or flows
    if not total or PRESSURE not in found:
        return np.empty(0)
    flow: Array = np.sum([values[name] for name in total], axis=0)
    return found[PRESSURE] * flow


def _tail(name: str) -> str:
    return name.rpartition(".")[2]


Point = tuple[float, float, float]


@dataclass(frozen=True)
class Target:
    """A place in space [m]: forward, left, up from the foot of the column."""

    name: str
    at: Point


@dataclass(frozen=True)
class Exercise:
    """Targets in their order; lengths [m], speed [m/s], time [s]."""

    name: str
    targets: tuple[Target, ...]
    radius: float = 0.3
    slow: float = 0.15
    hold: float = 1.0
    start: float = 0.05


@dataclass(frozen=True)
class Progress:
    """Where an attempt stands after some samples.

    origin    the first position of the tip
    started   when the clock started, None before
    inside    since when the tip is in the target and slow, None if it is not
    reached   when each target was entered first
    done      when each target was done
    now       time of the last sample
    """

    origin: Point | None = None
    started: float | None = None
    inside: float | None = None
    reached: tuple[float, ...] = ()
    done: tuple[float, ...] = ()
    now: float = 0.0


EXERCISES: Mapping[str, Exercise] = {
    "stem on the left": Exercise(
        "stem on the left", (Target("pick", (2.25, 3.9, 0.3)), Target("place", (3.4, -1.2, 1.0)))
    ),
    "stem on the right": Exercise(
        "stem on the right", (Target("pick", (2.25, -3.9, 0.3)), Target("place", (3.4, 1.2, 1.0)))
    ),
}


def distance(exercise: Exercise, progress: Progress, tip: Point) -> float:
    """How far the tip is from the target that is next [m]; 0 when all are done."""
    left = exercise.targets[len(progress.done) :]
    return math.dist(tip, left[0].at) if left else 0.0


def way(tip: Point, at: Point) -> Point:
    """From the tip to a place as a driver moves: outwards [m], up [m], to the left [rad]."""
    turn = math.atan2(at[1], at[0]) - math.atan2(tip[1], tip[0])
    out = math.hypot(at[0], at[1]) - math.hypot(tip[0], tip[1])
    return out, at[2] - tip[2], math.remainder(turn, 2 * math.pi)


def clock(progress: Progress) -> float | None:
    """Time since the start [s], which stands when all is done; None before."""
    return None if progress.started is None else progress.now - progress.started


def phase(exercise: Exercise, progress: Progress) -> str:
    """`ready`, `moving`, `holding` or `done`."""
    if len(progress.done) == len(exercise.targets):
        return "done"
    if progress.inside is not None:
        return "holding"
    return "ready" if progress.started is None else "moving"


def advance(exercise: Exercise, progress: Progress, time: float, tip: Point, speed: float) -> Progress:
    """The progress after one more sample."""
    if phase(exercise, progress) == "done":
        return progress
    found = replace(progress, origin=progress.origin or tip, now=time)
    if found.origin is not None and found.started is None:
        if math.dist(tip, found.origin) <= exercise.start:
            return found
        found = replace(found, started=time)
    # asked this way round, what is not a number is never in a target
    if not distance(exercise, found, tip) <= exercise.radius:
        return replace(found, inside=None)
    if len(found.reached) == len(found.done):
        found = replace(found, reached=(*found.reached, time))
    if not speed <= exercise.slow:
        return replace(found, inside=None)
    since = time if found.inside is None else found.inside
    # frames are whole multiples of a step: a hold may end a rounding error before its time
    if time - since >= exercise.hold - 1e-9:
        return replace(found, inside=None, done=(*found.done, time))
    return replace(found, inside=since)


def follow(exercise: Exercise, progress: Progress, samples: Samples) -> Progress:
    """The progress after some more samples."""
    tips: Sequence[Point] = [(x, y, z) for x, y, z in samples.tip.tolist()]
    for time, tip, speed in zip(samples.time.tolist(), tips, samples.speed.tolist(), strict=True):
        progress = advance(exercise, progress, time, tip, speed)
    return progress
