"""The training task as a function of a run: signals, exercises, progress, score.

Read by the names that the parts give their variables, in any component:

    tip in space         tip_x, tip_y, tip_height [m]                            needed
    speed of functions   swing_speed, boom_speed, stick_speed [rad/s]            needed
    speed of the tip     |(tip_radial_velocity, tip_vertical_velocity, swing_speed r)| [m/s],
                         r^2 = x^2 + y^2                                         needed
    supply               supply_pressure [Pa], supply_flow [m3/s]: of the component `supply` if there is one,
                         else the flows of all components together
    pressures            of the six lines [Pa]

How far it is: ready -> moving -> holding -> moving -> ... -> done. The clock starts when the tip has left its
first position by `start`. A target is done when the tip has been within `radius` of it and slower than `slow`
for `hold` without a break. Order and form are ours: a stem has to be reached, gripped while the head stands
still, and put down elsewhere.

How well it was done, from the start of the clock to its end or to the last sample:

    cycle time        s   first movement to the last target done
    reach time        s   first movement until the first target is entered
    path length       m   of the tip, sum of the distances between samples; "crane tip distance" of Polowy and
                          Rutkowski, Forests 15:1277, 2024
    simultaneous      1   share of time with two or more of swing, boom and stick moving (faster than MOVING)
    functions         1   mean number of them that move while any does; Polowy and Rutkowski 2024 give 1.8 at
                          the end of a training on a simulator, by their definition and of more functions
    energy            J   integral of supply pressure times supply flow: what the drives take
    peak pressure     Pa  of the lines of the three drives
    smoothness        1   spectral arc length of the speed of the tip

Where no source is named the definition is ours. Integrals are by the trapezoidal rule.
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


HIGHEST = 10.0  # Hz
SMALLEST = 0.05  # of the spectrum at zero frequency
RATE = 50.0  # Hz, of the samples that the spectrum is taken from
PADDING = 4  # powers of two beyond the length, so that the arc has no corners


def spectral_arc_length(time: Array, speed: Array) -> float | None:
    """Spectral arc length [1] of a speed over time; None where nothing moves or there is too little.

    S = - int_0^w sqrt((1 / w)^2 + (dV / dw)^2) dw,   V(f) = |FFT v(f)| / |FFT v(0)|

    up to w: at most 10 Hz, and where V stays below 0.05. One bell-shaped movement has about -1.4 to -1.6;
    each further start and stop makes it more negative. It depends neither on the size of the movement nor,
    closely, on its duration. Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J. NeuroEng. Rehabil.
    12:112, 2015.
    """
    if len(time) < 2 or time[-1] - time[0] < 5 / RATE:
        return None
    even = np.interp(np.arange(time[0], time[-1], 1 / RATE), time, speed)
    size = 2 ** (int(np.ceil(np.log2(len(even)))) + PADDING)
    spectrum = np.abs(np.fft.rfft(even, size))
    if not spectrum[0] > 0:
        return None
    heights = (spectrum / spectrum[0])[np.fft.rfftfreq(size, 1 / RATE) <= HIGHEST]
    last = int(np.flatnonzero(heights >= SMALLEST)[-1])
    if last == 0:
        return None
    return float(-np.sum(np.hypot(1 / last, np.diff(heights[: last + 1]))))


MOVING = 0.02  # rad/s; ours: a tenth of an ordinary speed, far above what a closed valve lets through
DEFAULT = EXERCISES["stem on the left"]


@dataclass(frozen=True)
class Score:
    """Figures of one attempt; None where the run does not hold what is needed."""

    finished: bool
    cycle_time: float
    reach_time: float | None
    path_length: float
    simultaneous: float
    functions: float
    energy: float | None
    peak_pressure: float | None
    smoothness: float | None


def score(trace: Trace, exercise: Exercise = DEFAULT) -> Score | None:
    """The score of any run with a tip in it; None if the tip never moved."""
    samples = of_trace(trace)
    return judge(samples, exercise, follow(exercise, Progress(), samples))


def judge(samples: Samples, exercise: Exercise, progress: Progress) -> Score | None:
    """The score of samples whose progress is known; None if the clock has not started."""
    if progress.started is None:
        return None
    finished = phase(exercise, progress) == "done"
    end = progress.done[-1] if finished else progress.now
    part = samples[slice(*np.searchsorted(samples.time, (progress.started, np.nextafter(end, np.inf))))]
    moving = np.sum(np.abs(part.functions) > MOVING, axis=1)
    return Score(
        finished=finished,
        cycle_time=end - progress.started,
        reach_time=progress.reached[0] - progress.started if progress.reached else None,
        path_length=float(np.sum(np.linalg.norm(np.diff(part.tip, axis=0), axis=1))),
        simultaneous=_mean(moving >= 2, part.time),
        functions=_mean(moving, part.time) / (_mean(moving >= 1, part.time) or 1.0),
        energy=float(np.trapezoid(part.power, part.time)) if len(part.power) else None,
        peak_pressure=float(part.pressure.max()) if len(part.pressure) else None,
        smoothness=spectral_arc_length(part.time, part.speed),
    )


def _mean(values: NDArray[np.generic], time: Array) -> float:
    """Mean over time; 0 where there is no time."""
    if len(time) < 2:
        return 0.0
    return float(np.trapezoid(values.astype(float), time) / (time[-1] - time[0]))
