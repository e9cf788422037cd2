"""Paths of the tip over time: straight segments in space, as inputs of the controller.

Each segment begins and ends at rest and changes its acceleration at a constant jerk: a jump of acceleration
would ask the oil for a jump of pressure. There are paths for experiments with the controller alone, and those
that a user gives on the command line, from point to point.

`python -m fmus.controller.paths` writes line.csv and square.csv to data/scenarios.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.controller.geometry import joints
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values
from orchestrator.base.errors import Problem
from orchestrator.base.files import write_columns

Array = NDArray[np.float64]


def spells(time: Array) -> dict[str, Array]:
    """Inputs by name over time [s]: engaged twice, the second time along a path, else at the levers."""
    half = np.round(np.sin(np.pi * time), 3)  # few digits: they go into a file
    first, second = (time >= 2) & (time < 4), (time >= 6) & (time < 7.5)
    wanted = {
        "engaged": first | second,
        "follow": second,
        "radial_velocity": 0.3 * half,
        "vertical_velocity": 0.2 * half,
        "swing_velocity": 0.1 * half,
        "path_radius": 4.5 + 0.1 * half,
        "path_height": 0.2 * half,
        "path_angle": 0.4 + 0.05 * half,
    }
    return {n: np.round(samples.astype(np.float64), 6) for n, samples in wanted.items()}


Point = tuple[float, float, float]  # x forward, y to the left, z up, from the foot of the column [m]
RATE = 200.0  # samples per second
NEAREST = 0.1  # m, to the swing axis, where the swing angle would jump
COLUMNS = (
    *("radial_velocity", "vertical_velocity", "swing_velocity"),
    *("path_radius", "path_height", "path_angle", "follow", "engaged"),
)


@dataclass(frozen=True)
class Route:
    """Waypoints [m] and how they are passed: speed [m/s], acceleration [m/s2], time to reach it [s].

    wait   rest before the first segment and at each waypoint [s]
    """

    points: tuple[Point, ...]
    speed: float = 0.5
    acceleration: float = 0.5
    rise: float = 0.4
    wait: float = 0.5


PATHS: Mapping[str, Route] = {
    # 4 m across in front of the machine and back, at constant height
    "line": Route(((3.6, -2.0, 1.0), (3.6, 2.0, 1.0), (3.6, -2.0, 1.0)), wait=1.0),
    # upright, 1 m by 1 m, at 45 degrees to the arm, so that all three functions work on its level sides
    "square": Route(
        tuple(
            (3.7 + math.sqrt(0.5) * a, -0.35 + math.sqrt(0.5) * a, 0.5 + b)
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
        ),
        wait=1.0,
    ),
}


def start(path: Route) -> Point:
    """Radius [m], height [m] and swing angle [rad] of the first point."""
    x, y, z = path.points[0]
    return math.hypot(x, y), z, math.atan2(y, x)


def travel(length: float, path: Route) -> tuple[float, Array, Array, Array]:
    """One segment from rest to rest: duration [s], corners [s], phases [s], jerks in them [m/s3].

    Seven phases of constant jerk, acceleration or speed; the speed of a short segment is lower.
    """
    j = path.acceleration / path.rise
    speed = min(path.speed, _reachable(length, path))
    top = min(path.acceleration, math.sqrt(speed * j))
    rise = top / j
    hold = speed / top - rise
    cruise = length / speed - speed / top - rise
    phases = np.array([rise, hold, rise, max(0.0, cruise), rise, hold, rise])
    jerks = j * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    return float(phases.sum()), np.concatenate([[0.0], np.cumsum(phases)]), phases, jerks


def _reachable(length: float, path: Route) -> float:
    """Largest speed [m/s] on a segment of this length from rest to rest."""
    j = path.acceleration / path.rise
    without_hold = (length / 2 * math.sqrt(j)) ** (2 / 3)  # 2 v sqrt(v/j) = length
    if without_hold <= path.acceleration**2 / j:
        return float(without_hold)
    a, r = path.acceleration, path.rise
    return a * (-r + math.sqrt(r**2 + 4 * length / a)) / 2  # v (v/a + r) = length


def fastest(path: Route) -> float:
    """Highest speed [m/s] on any of its segments."""
    return max(min(path.speed, _reachable(math.dist(a, b), path)) for a, b in pairwise(path.points))


def moved(time: Array, length: float, path: Route) -> tuple[Array, Array]:
    """Way [m] and speed [m/s] at `time` [s] after the start of a segment."""
    duration, corners, phases, jerks = travel(length, path)
    t = np.clip(time, 0.0, duration)
    way, speed = np.zeros_like(t), np.zeros_like(t)
    s = v = a = 0.0
    for begin, phase, jerk in zip(corners, phases, jerks, strict=False):
        h = t - begin
        inside = h >= 0
        way = np.where(inside, s + v * h + a * h**2 / 2 + jerk * h**3 / 6, way)
        speed = np.where(inside, v + a * h + jerk * h**2 / 2, speed)
        s, v, a = (
            s + v * phase + a * phase**2 / 2 + jerk * phase**3 / 6,
            v + a * phase + jerk * phase**2 / 2,
            a + jerk * phase,
        )
    ended = time >= duration
    return np.where(ended, length, way), np.where(ended, 0.0, speed)


def sample(path: Route) -> tuple[Array, Array, Array]:
    """Time (n,) [s] at 200 Hz, points (n, 3) [m] and velocities (n, 3) [m/s] in space, rests included."""
    pieces: list[tuple[float, Point, Point, float]] = []
    clock = path.wait
    for a, b in pairwise(path.points):
        length = math.dist(a, b)
        if length == 0:
            raise Problem(f"path: two waypoints at {a}, expected a distance")
        pieces.append((clock, a, b, length))
        clock += math.ceil(travel(length, path)[0] * RATE) / RATE + path.wait
    time = np.arange(round(clock * RATE) + 1) / RATE
    points, velocities = np.tile(path.points[0], (time.size, 1)), np.zeros((time.size, 3))
    for begin, a, b, length in pieces:
        way, speed = moved(time - begin, length, path)
        ahead = (np.array(b) - a) / length
        now = time >= begin
        points[now] = (np.array(a) + way[:, None] * ahead)[now]
        velocities[now] = (speed[:, None] * ahead)[now]
    return time, points, velocities


def inputs(points: Array, velocities: Array) -> Array:
    """The controller's inputs (n, 8) in the order of COLUMNS, engaged and following from the start."""
    x, y, z = points.T
    radius, angle = np.hypot(x, y), np.unwrap(np.arctan2(y, x))
    if (least := float(radius.min())) < NEAREST:
        raise Problem(f"path: comes to {least:.2g} m from the swing axis, expected at least {NEAREST:g} m")
    out, left = np.cos(angle), np.sin(angle)
    radial = velocities[:, 0] * out + velocities[:, 1] * left
    turning = (velocities[:, 1] * out - velocities[:, 0] * left) / radius
    on = np.ones_like(radius)
    return np.column_stack([radial, velocities[:, 2], turning, radius, z, angle, on, on])


def write(folder: Path, paths: Mapping[str, Route] = PATHS) -> list[Path]:
    """Write each path as a scenario `name.csv`."""
    written: list[Path] = []
    for name, path in paths.items():
        time, points, velocities = sample(path)
        rows = np.column_stack([time, inputs(points, velocities)])
        written.append(folder / f"{name}.csv")
        write_columns(written[-1], ("time", *COLUMNS), rows, 10)
    return written


def main(arguments: Sequence[str]) -> None:
    """Write the scenarios to the folder named, by default data/scenarios."""
    for path in write(Path(arguments[0] if arguments else "data/scenarios")):
        print(path)


if __name__ == "__main__":
    main(sys.argv[1:])


def route(texts: Sequence[str], speed: float, folder: Path) -> tuple[Path, float]:
    """Write route.csv, the scenario through the points 'x,y,z' [m] at a speed [m/s].

    Returns its path and the highest speed [m/s], which is lower where the way is short.
    """
    points = tuple(_point(text) for text in texts)
    if len(points) < 2:
        raise Problem(f"--through {texts[0]}: expected two points or more, got one")
    if not speed > 0:
        raise Problem(f"--speed {speed:g}: expected more than 0 m/s")
    folder.mkdir(parents=True, exist_ok=True)
    path = Route(points, speed=speed)
    return write(folder, {"route": path})[0], fastest(path)


def _point(text: str) -> Point:
    try:
        x, y, z = (float(number) for number in text.split(","))
    except ValueError:
        raise Problem(f"--through {text}: expected x,y,z in metres, such as 3.6,-2,1") from None
    return x, y, z


def through(texts: Sequence[str], arm: Mapping[str, float]) -> dict[str, float]:
    """The start angles of `course` at the first of the points 'x,y,z' [m], all of which the arm reaches."""
    each = [course(f"--through {text}", start(Route((_point(text),))), arm) for text in texts]
    return each[0]


def course(label: str, place: Point, arm: Mapping[str, float]) -> dict[str, float]:
    """Start angles [rad] that put the tip to a place, by `component.variable`.

    place (radius, height, angle) [m, m, rad]
    arm   lengths and pivots of the machine, by the names of the manipulator; the usual ones where it has none
    """
    radius, height, angle = place
    try:
        boom, stick = joints(radius, height, {**values(MANIPULATOR).p, **arm})
    except Problem as error:
        raise Problem(f"{label}: {error}") from None
    angles = {"swing": angle, "boom": boom, "stick": stick}
    return {f"manipulator.initial_{joint}_angle": value for joint, value in angles.items()}
