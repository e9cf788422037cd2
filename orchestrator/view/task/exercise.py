"""What has to be done, and how far it is: a function from one sample to the next.

    ready -> moving -> holding -> moving -> ... -> done

The clock starts when the tip has left its first position by `start`. A target is done when the tip has been
within `radius` of it and slower than `slow` for `hold` without a break. Order and form are ours: a stem has
to be reached, gripped while the head stands still, and put down elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from orchestrator.view.task.samples import Samples

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
