"""Training task: signals, exercises, progress and score of a run.

Signals, by the names of the variables in any component:

    tip in space         tip_x, tip_y, tip_height [m]                            needed
    speed of functions   swing_speed, boom_speed, stick_speed [rad/s]            needed
    speed of the tip     |(tip_radial_velocity, tip_vertical_velocity, swing_speed r)| [m/s],
                         r^2 = x^2 + y^2                                         needed
    supply               supply_pressure [Pa], supply_flow [m3/s]: of the component `supply` if there is one,
                         else the sum over all components
    pressures            of the six lines [Pa]

Progress: ready -> moving -> holding -> moving -> ... -> done. The clock starts when the tip has moved by
`start` from its first position. A target is done when the tip has been within `radius` of it and slower than
`slow` for `hold` without interruption. The exercise is our own: a stem has to be reached, gripped while the
head does not move, and put down at another place. In between a machine with the input `payload_mass` [kg]
carries it.

Score, from the start of the clock to its end or to the last sample:

    cycle time        s   first movement to the last target done
    reach time        s   first movement until the first target is entered
    path length       m   path of the tip, sum of the distances between samples; "crane tip distance" of
                          Polowy and Rutkowski, Forests 15:1277, 2024
    simultaneous      1   fraction of time with two or more of swing, boom and stick moving (faster than
                          MOVING)
    functions         1   mean number of moving functions while any moves; Polowy and Rutkowski 2024 give
                          1.8 at the end of a training on a simulator, by their definition and of more
                          functions
    energy            J   integral of supply pressure times supply flow
    peak pressure     Pa  largest pressure of the lines of the three drives
    smoothness        1   spectral arc length of the speed of the tip

Definitions without a source are our own. Integrals use the trapezoidal rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace

TIP = ("tip_x", "tip_y", "tip_height")
SPEEDS = ("swing_speed", "boom_speed", "stick_speed")
VELOCITIES = ("tip_radial_velocity", "tip_vertical_velocity")
PRESSURE, FLOW = "supply_pressure", "supply_flow"
ENDS = ("boom_head", "boom_rod", "stick_head", "stick_rod")
LINES = ("swing_pressure_a", "swing_pressure_b", *(f"{end}_pressure" for end in ENDS))
NEEDED = (*TIP, *SPEEDS, *VELOCITIES)
UNITS = dict.fromkeys(TIP, "m") | dict.fromkeys(SPEEDS, "rad/s") | dict.fromkeys(VELOCITIES, "m/s")
UNITS |= dict.fromkeys((PRESSURE, *LINES), "Pa") | {FLOW: "m3/s"}


@dataclass(frozen=True)
class Samples:
    """Samples of a part of a run.

    time       (n,) [s]
    tip        (n, 3) [m]: forward, left, up
    speed      (n,) speed of the tip [m/s]
    functions  (n, 3) speeds of swing, boom and stick [rad/s]
    power      (n,) hydraulic power from the supply [W]; empty if not recorded
    pressure   (n,) largest pressure of the lines [Pa]; empty if none is recorded
    """

    time: Array
    tip: Array
    speed: Array
    functions: Array
    power: Array
    pressure: Array

    def __getitem__(self, part: slice) -> Samples:
        return Samples(*(values[part] for values in vars(self).values()))

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """The samples of parts that follow each other."""
        return Samples(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))

    @property
    def tips(self) -> list[Point]:
        """The positions of the tip."""
        return [(x, y, z) for x, y, z in self.tip.tolist()]


def of_trace(trace: Trace) -> Samples:
    """All samples of a run."""
    for name in trace.signals:
        expected = UNITS.get(_variable(name))
        if expected and (unit := trace.units.get(name, expected)) != expected:
            raise Problem(f"task: {name}: expected {expected}, found {unit}")
    return of_values(trace.time, trace.signals)


def of_values(time: Array, values: Mapping[str, Array]) -> Samples:
    """Samples from the values of some signals, by name."""
    first = {_variable(name): name for name in reversed(list(values))}
    missing = [variable for variable in NEEDED if variable not in first]
    if missing:
        expected = ", ".join(NEEDED)
        raise Problem(f"task: expected a run with {expected}, found none of {', '.join(missing)}")
    columns = {variable: np.asarray(values[name], float) for variable, name in first.items()}
    tip = np.stack([columns[name] for name in TIP], axis=1)
    across = columns["swing_speed"] * np.hypot(tip[:, 0], tip[:, 1])
    lines = [columns[name] for name in LINES if name in columns]
    speed = np.linalg.norm([*(columns[name] for name in VELOCITIES), across], axis=0)
    functions = np.stack([columns[name] for name in SPEEDS], axis=1)
    pressure = np.max(lines, axis=0) if lines else np.empty(0)
    return Samples(np.asarray(time, float), tip, speed, functions, _power(values, columns), pressure)


def _power(values: Mapping[str, Array], columns: Mapping[str, Array]) -> Array:
    flows = [name for name in values if _variable(name) == FLOW]
    # the flow of a supply component is already the sum over the drives
    total = [name for name in flows if name.split(".")[-2:-1] == ["supply"]] or flows
    if not total or PRESSURE not in columns:
        return np.empty(0)
    flow: Array = np.sum([values[name] for name in total], axis=0)
    return columns[PRESSURE] * flow


def _variable(name: str) -> str:
    return name.rpartition(".")[2]


Point = tuple[float, float, float]


@dataclass(frozen=True)
class Target:
    """A position in space [m]: forward, left, up from the foot of the column.

    load   mass that the head holds from there on [kg]
    """

    name: str
    at: Point
    load: float = 0.0


@dataclass(frozen=True)
class Exercise:
    """Targets in order, and the tolerances: radius, start [m], slow [m/s], hold [s]."""

    name: str
    targets: tuple[Target, ...]
    radius: float = 0.3
    slow: float = 0.15
    hold: float = 1.0
    start: float = 0.05


@dataclass(frozen=True)
class Progress:
    """Progress of an attempt. Times are those of the samples [s].

    origin    first position of the tip
    started   time when the clock started, None before
    inside    time since which the tip is in the target and slow, None if it is not
    reached   for each target, the time of its first entry
    done      for each target, the time when it was done
    now       time of the last sample
    """

    origin: Point | None = None
    started: float | None = None
    inside: float | None = None
    reached: tuple[float, ...] = ()
    done: tuple[float, ...] = ()
    now: float = 0.0


LONGEST = 600.0  # s; a longer attempt is given up, to limit memory
LOAD = "payload_mass"  # input with the mass that the head is to hold
STEM = 200.0  # kg
EXERCISES: Mapping[str, Exercise] = {
    name: Exercise(name, (Target("pick", (2.25, y, 0.3), STEM), Target("place", (3.4, to, 1.0))))
    for name, y, to in (("stem on the left", 3.9, -1.2), ("stem on the right", -3.9, 1.2))
}


def rules() -> dict[str, Any]:
    """The task as data for a page that scores by itself (task.js)."""
    signals = {"needed": NEEDED, "tip": TIP, "speeds": SPEEDS, "velocities": VELOCITIES}
    signals |= {"lines": LINES, "supply": (PRESSURE, FLOW)}
    exercises = [asdict(exercise) for exercise in EXERCISES.values()]
    return {"exercises": exercises, "load": LOAD, "moving": MOVING, "longest": LONGEST, **signals}


def distance(exercise: Exercise, progress: Progress, tip: Point) -> float:
    """Distance of the tip from the next target [m]; 0 when all are done."""
    left = exercise.targets[len(progress.done) :]
    return math.dist(tip, left[0].at) if left else 0.0


def way(tip: Point, at: Point) -> Point:
    """Vector from the tip to a position in crane coordinates: outwards [m], up [m], to the left [rad]."""
    turn = math.atan2(at[1], at[0]) - math.atan2(tip[1], tip[0])
    out = math.hypot(at[0], at[1]) - math.hypot(tip[0], tip[1])
    return out, at[2] - tip[2], math.remainder(turn, 2 * math.pi)


def load(exercise: Exercise, progress: Progress) -> float:
    """Mass that the head holds after the targets that are done [kg]."""
    return exercise.targets[len(progress.done) - 1].load if progress.done else 0.0


def clock(progress: Progress) -> float | None:
    """Time since the start [s], until all targets are done; None before the start."""
    return None if progress.started is None else progress.now - progress.started


def phase(exercise: Exercise, progress: Progress) -> str:
    """`ready`, `moving`, `holding` or `done`."""
    if len(progress.done) == len(exercise.targets):
        return "done"
    if progress.inside is not None:
        return "holding"
    return "ready" if progress.started is None else "moving"


def advance(exercise: Exercise, progress: Progress, time: float, tip: Point, speed: float) -> Progress:
    """Progress after one more sample."""
    if phase(exercise, progress) == "done":
        return progress
    updated = replace(progress, origin=progress.origin or tip, now=time)
    if updated.origin is not None and updated.started is None:
        if math.dist(tip, updated.origin) <= exercise.start:
            return updated
        updated = replace(updated, started=time)
    # with this comparison, NaN is never in a target
    if not distance(exercise, updated, tip) <= exercise.radius:
        return replace(updated, inside=None)
    if len(updated.reached) == len(updated.done):
        updated = replace(updated, reached=(*updated.reached, time))
    if not speed <= exercise.slow:
        return replace(updated, inside=None)
    since = time if updated.inside is None else updated.inside
    # tolerance for rounding: the time of a frame is a multiple of the step
    if time - since >= exercise.hold - 1e-9:
        return replace(updated, inside=None, done=(*updated.done, time))
    return replace(updated, inside=since)


def follow(exercise: Exercise, progress: Progress, samples: Samples) -> Progress:
    """Progress after more samples."""
    for time, tip, speed in zip(samples.time.tolist(), samples.tips, samples.speed.tolist(), strict=True):
        progress = advance(exercise, progress, time, tip, speed)
    return progress


HIGHEST = 10.0  # Hz; upper limit of the frequency
SMALLEST = 0.05  # smallest amplitude relative to that at zero frequency
RATE = 50.0  # Hz; sampling rate for the spectrum
PADDING = 4  # zero padding by this power of two, for a smooth arc


def spectral_arc_length(time: Array, speed: Array) -> float | None:
    """Spectral arc length [1] of a speed over time; None without motion or with too few samples.

    S = - int_0^w sqrt((1 / w)^2 + (dV / dw)^2) dw,   V(f) = |FFT v(f)| / |FFT v(0)|

    w is the largest frequency up to 10 Hz at which V is at least 0.05. A single bell-shaped movement has -1.4
    to -1.6; each further start and stop makes the value more negative. The value does not depend on the
    amplitude of the movement, and hardly on its duration. Balasubramanian, Melendez-Calderon, Roby-Brami,
    Burdet, J. NeuroEng. Rehabil. 12:112, 2015.
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


MOVING = 0.02  # rad/s; a tenth of an ordinary speed, far above the leakage of a closed valve
DEFAULT = EXERCISES["stem on the left"]


@dataclass(frozen=True)
class Score:
    """Score of one attempt; None for figures whose signals are not recorded."""

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
    """Score of a run; None if the tip never moved."""
    samples = of_trace(trace)
    return judge(samples, exercise, follow(exercise, Progress(), samples))


def judge(samples: Samples, exercise: Exercise, progress: Progress) -> Score | None:
    """Score of samples with this progress; None if the clock has not started."""
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
    """Mean over time; 0 for fewer than two samples."""
    if len(time) < 2:
        return 0.0
    return float(np.trapezoid(values.astype(float), time) / (time[-1] - time[0]))
