"""Training task: signals, exercises, progress and score of a run.

The machine declares its signals and exercises (`Task`). The speed of the tip is the norm of its velocities
and of the turning speed times the distance from the vertical axis.

Progress: ready -> moving -> holding -> moving -> ... -> done. The clock starts when the tip has moved by
`start` from its first position. A target is done when the tip has been within `radius` of it and slower than
`slow` for `hold` without interruption. From then to the next one the machine carries the load of the target.

Score, from the start of the clock to its end or to the last sample:

    cycle time        s   first movement to the last target done
    reach time        s   first movement until the first target is entered
    path length       m   path of the tip, sum of the distances between samples; "crane tip distance" of
                          Polowy and Rutkowski, Forests 15:1277, 2024
    simultaneous      1   fraction of time with two or more functions moving (faster than MOVING)
    functions         1   mean number of moving functions while any moves; Polowy and Rutkowski 2024 give
                          1.8 at the end of a training on a simulator, by their definition and of more
                          functions
    energy            J   integral of supply pressure times supply flow
    peak pressure     Pa  largest pressure of the lines
    smoothness        1   spectral arc length of the speed of the tip

Definitions without a source are our own. Integrals use the trapezoidal rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.toml import Rule
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace

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
class Task:
    """A training task, as `[task]` of the view description declares it. Names are signals of any component.

    tip          forward, left, up [m]
    velocities   of the tip, outwards and upwards [m/s]
    turning      speed about the vertical axis [rad/s]
    speeds       of the functions [rad/s]
    pressures    of the lines [Pa]
    supply       pressure [Pa] and flow [m3/s]; the flow of the component whose name it begins with, else the
                 sum over all components
    load         input with the mass that the machine is to hold [kg]
    """

    tip: Annotated[tuple[str, ...], Rule("three signals", lambda value: len(value) == 3)]
    velocities: tuple[str, ...]
    turning: str
    speeds: tuple[str, ...]
    exercises: Annotated[tuple[Exercise, ...], Rule("a list that is not empty", bool)]
    pressures: tuple[str, ...] = ()
    supply: Annotated[tuple[str, ...], Rule("pressure and flow", lambda value: len(value) == 2)] = ("", "")
    load: str = ""

    @property
    def needed(self) -> tuple[str, ...]:
        """Signals without which there is no score."""
        return tuple(dict.fromkeys((*self.tip, *self.speeds, *self.velocities, self.turning)))

    @property
    def units(self) -> dict[str, str]:
        """Signal -> its unit."""
        pressure, flow = self.supply
        units = dict.fromkeys(self.tip, "m") | dict.fromkeys(self.velocities, "m/s")
        units |= dict.fromkeys((*self.speeds, self.turning), "rad/s")
        return units | dict.fromkeys((pressure, *self.pressures), "Pa") | {flow: "m3/s"}

    def exercise(self, name: str) -> Exercise | None:
        """The exercise of this name."""
        return next((exercise for exercise in self.exercises if exercise.name == name), None)


NO_TASK = Task((), (), "", (), (Exercise("", ()),))  # of a machine that declares none


@dataclass(frozen=True)
class Samples:
    """Samples of a part of a run.

    time       (n,) [s]
    tip        (n, 3) [m]: forward, left, up
    speed      (n,) speed of the tip [m/s]
    functions  (n, k) speeds of the functions [rad/s]
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


def of_trace(trace: Trace, task: Task) -> Samples:
    """All samples of a run."""
    for name in trace.signals:
        expected = task.units.get(_variable(name))
        if expected and (unit := trace.units.get(name, expected)) != expected:
            raise Problem(f"task: {name}: expected {expected}, found {unit}")
    return of_values(trace.time, trace.signals, task)


def of_values(time: Array, values: Mapping[str, Array], task: Task) -> Samples:
    """Samples from the values of some signals, by name."""
    if task is NO_TASK:
        raise Problem("task: this machine declares none")
    first = {_variable(name): name for name in reversed(list(values))}
    if missing := [variable for variable in task.needed if variable not in first]:
        expected = ", ".join(task.needed)
        raise Problem(f"task: expected a run with {expected}, found none of {', '.join(missing)}")
    columns = {variable: np.asarray(values[name], float) for variable, name in first.items()}
    tip = np.stack([columns[name] for name in task.tip], axis=1)
    across = columns[task.turning] * np.hypot(tip[:, 0], tip[:, 1])
    lines = [columns[name] for name in task.pressures if name in columns]
    speed = np.linalg.norm([*(columns[name] for name in task.velocities), across], axis=0)
    functions = np.stack([columns[name] for name in task.speeds], axis=1)
    pressure = np.max(lines, axis=0) if lines else np.empty(0)
    power = _power(values, columns, *task.supply)
    return Samples(np.asarray(time, float), tip, speed, functions, power, pressure)


def _power(values: Mapping[str, Array], columns: Mapping[str, Array], pressure: str, flow: str) -> Array:
    flows = [name for name in values if _variable(name) == flow]
    # the flow of a supply component is already the sum over the drives
    total = [name for name in flows if flow.startswith(f"{_component(name)}_")] or flows
    if not total or pressure not in columns:
        return np.empty(0)
    power: Array = columns[pressure] * np.sum([values[name] for name in total], axis=0)
    return power


def _component(name: str) -> str:
    return name.rpartition(".")[0].rpartition(".")[2]


def _variable(name: str) -> str:
    return name.rpartition(".")[2]


@dataclass(frozen=True)
class Progress:
    """Progress of an attempt at an exercise. Times are those of the samples [s].

    origin    first position of the tip
    started   time when the clock started, None before
    inside    time since which the tip is in the target and slow, None if it is not
    reached   for each target, the time of its first entry
    done      for each target, the time when it was done
    now       time of the last sample
    """

    exercise: Exercise
    origin: Point | None = None
    started: float | None = None
    inside: float | None = None
    reached: tuple[float, ...] = ()
    done: tuple[float, ...] = ()
    now: float = 0.0

    @property
    def target(self) -> Target | None:
        """The next target; None when all are done."""
        return next(iter(self.exercise.targets[len(self.done) :]), None)

    @property
    def load(self) -> float:
        """Mass that the head holds after the targets that are done [kg]."""
        return self.exercise.targets[len(self.done) - 1].load if self.done else 0.0

    @property
    def clock(self) -> float | None:
        """Time since the start [s], until all targets are done; None before the start."""
        return None if self.started is None else self.now - self.started

    @property
    def phase(self) -> str:
        """`ready`, `moving`, `holding` or `done`."""
        if self.target is None:
            return "done"
        if self.inside is not None:
            return "holding"
        return "ready" if self.started is None else "moving"

    def advance(self, time: float, tip: Point, speed: float) -> Progress:
        """Progress after one more sample."""
        if (target := self.target) is None:
            return self
        exercise, origin = self.exercise, self.origin or tip
        updated = replace(self, origin=origin, now=time)
        if updated.started is None:
            if math.dist(tip, origin) <= exercise.start:
                return updated
            updated = replace(updated, started=time)
        # with this comparison, NaN is never in a target
        if not math.dist(tip, target.at) <= exercise.radius:
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

    def follow(self, samples: Samples) -> Progress:
        """Progress after more samples."""
        progress = self
        for time, tip, speed in zip(samples.time.tolist(), samples.tips, samples.speed.tolist(), strict=True):
            progress = progress.advance(time, tip, speed)
        return progress


LONGEST = 600.0  # s; a longer attempt is given up, to limit memory


def rules(task: Task) -> dict[str, Any]:
    """The task as data for a page that scores by itself (task.js)."""
    return asdict(task) | {"needed": task.needed, "moving": MOVING, "longest": LONGEST}


def way(tip: Point, at: Point) -> Point:
    """Vector from the tip to a position: outwards [m], up [m], to the left [rad]."""
    turn = math.atan2(at[1], at[0]) - math.atan2(tip[1], tip[0])
    out = math.hypot(at[0], at[1]) - math.hypot(tip[0], tip[1])
    return out, at[2] - tip[2], math.remainder(turn, 2 * math.pi)


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


def score(trace: Trace, task: Task, exercise: Exercise | None = None) -> Score | None:
    """Score of a run; None if the tip never moved. Default: the first exercise of the task."""
    samples = of_trace(trace, task)
    return judge(samples, Progress(exercise or task.exercises[0]).follow(samples))


def judge(samples: Samples, progress: Progress) -> Score | None:
    """Score of samples with this progress; None if the clock has not started."""
    if progress.started is None:
        return None
    finished = progress.phase == "done"
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
