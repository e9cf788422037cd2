"""Paths of the tip over time: straight segments in space, as inputs of the controller.

Each segment begins and ends at rest and changes its acceleration at a constant jerk, because a jump of the
acceleration would require a jump of the oil pressures. Paths are predefined (PATHS) or given by waypoints on
the command line.

`python -m fmus.controller.paths` writes line.csv and square.csv to data/scenarios.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem, nested
from fmus.controller.arm import Arm
from fmus.controller.model import CONTROLLER
from fmus.parameters import values
from orchestrator.base.errors import Problem
from orchestrator.base.files import write_columns
from orchestrator.base.numerals import finite

Array = NDArray[np.float64]


def experiment_inputs(time: Array) -> dict[str, Array]:
    """Inputs of the reference experiment at `time` [s]: engaged by velocity, later along a path."""
    sine = np.round(np.sin(np.pi * time), 3)  # few digits, because the samples are written to a file
    first, second = (time >= 2) & (time < 4), (time >= 6) & (time < 7.5)
    samples = {
        "engaged": first | second,
        "follow": second,
        "radial_velocity": 0.3 * sine,
        "vertical_velocity": 0.2 * sine,
        "swing_velocity": 0.1 * sine,
        "path_radius": 4.5 + 0.1 * sine,
        "path_height": 0.2 * sine,
        "path_angle": 0.4 + 0.05 * sine,
    }
    return {n: np.round(values.astype(np.float64), 6) for n, values in samples.items()}


Point = tuple[float, float, float]  # x forward, y to the left, z up, from the foot of the column [m]
SAMPLE_RATE = 200.0  # Hz
SMALLEST_RADIUS = 0.1  # m; the swing angle jumps at the swing axis
COLUMNS = (
    *("radial_velocity", "vertical_velocity", "swing_velocity"),
    *("path_radius", "path_height", "path_angle", "follow", "engaged"),
)


@dataclass(frozen=True)
class Route:
    """Waypoints of a path and the limits of its motion.

    points         waypoints [m]
    speed          largest speed [m/s]
    acceleration   largest acceleration [m/s2]
    rise           time from zero to the largest acceleration [s]
    wait           rest before the first segment and at each waypoint [s]
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
    """Radius [m], height [m] and swing angle [rad] of the first waypoint."""
    x, y, z = path.points[0]
    return math.hypot(x, y), z, math.atan2(y, x)


def segment_profile(length: float, path: Route) -> tuple[float, Array, Array, Array]:
    """One segment from rest to rest: duration [s]; starts [s], durations [s] and jerks [m/s3] of its phases.

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


def highest_speed(path: Route) -> float:
    """Highest speed [m/s] on any segment of the path."""
    return max(min(path.speed, _reachable(math.dist(a, b), path)) for a, b in pairwise(path.points))


def segment_motion(time: Array, length: float, path: Route) -> tuple[Array, Array]:
    """Distance [m] and speed [m/s] at `time` [s] after the start of a segment."""
    duration, starts, phases, jerks = segment_profile(length, path)
    t = np.clip(time, 0.0, duration)
    distance, speed = np.zeros_like(t), np.zeros_like(t)
    s = v = a = 0.0
    for begin, phase, jerk in zip(starts, phases, jerks, strict=False):
        h = t - begin
        inside = h >= 0
        distance = np.where(inside, s + v * h + a * h**2 / 2 + jerk * h**3 / 6, distance)
        speed = np.where(inside, v + a * h + jerk * h**2 / 2, speed)
        s, v, a = (
            s + v * phase + a * phase**2 / 2 + jerk * phase**3 / 6,
            v + a * phase + jerk * phase**2 / 2,
            a + jerk * phase,
        )
    finished = time >= duration
    return np.where(finished, length, distance), np.where(finished, 0.0, speed)


def sample(path: Route) -> tuple[Array, Array, Array]:
    """Time (n,) [s] at 200 Hz, points (n, 3) [m] and velocities (n, 3) [m/s] in space, rests included."""
    segments: list[tuple[float, Point, Point, float]] = []
    clock = path.wait
    for a, b in pairwise(path.points):
        length = math.dist(a, b)
        if length == 0:
            raise Problem(f"path: two waypoints in a row at {a}, expected different ones")
        segments.append((clock, a, b, length))
        clock += math.ceil(segment_profile(length, path)[0] * SAMPLE_RATE) / SAMPLE_RATE + path.wait
    time = np.arange(round(clock * SAMPLE_RATE) + 1) / SAMPLE_RATE
    points, velocities = np.tile(path.points[0], (time.size, 1)), np.zeros((time.size, 3))
    for begin, a, b, length in segments:
        distance, speed = segment_motion(time - begin, length, path)
        direction = (np.array(b) - a) / length
        after = time >= begin
        points[after] = (np.array(a) + distance[:, None] * direction)[after]
        velocities[after] = (speed[:, None] * direction)[after]
    return time, points, velocities


def controller_inputs(points: Array, velocities: Array) -> Array:
    """The controller's inputs (n, 8) in the order of COLUMNS, engaged and following from the start."""
    x, y, z = points.T
    radius, angle = np.hypot(x, y), np.unwrap(np.arctan2(y, x))
    if (smallest := float(radius.min())) < SMALLEST_RADIUS:
        raise Problem(f"path: {smallest:.2g} m from the swing axis, expected at least {SMALLEST_RADIUS:g} m")
    out, left = np.cos(angle), np.sin(angle)
    radial = velocities[:, 0] * out + velocities[:, 1] * left
    swing = (velocities[:, 1] * out - velocities[:, 0] * left) / radius
    ones = np.ones_like(radius)
    return np.column_stack([radial, velocities[:, 2], swing, radius, z, angle, ones, ones])


def write(folder: Path, paths: Mapping[str, Route] = PATHS) -> list[Path]:
    """Write each path as a scenario `name.csv`."""
    written: list[Path] = []
    for name, path in paths.items():
        time, points, velocities = sample(path)
        rows = np.column_stack([time, controller_inputs(points, velocities)])
        written.append(folder / f"{name}.csv")
        write_columns(written[-1], ("time", *COLUMNS), rows, 10)
    return written


def write_route(texts: Sequence[str], speed: float, folder: Path) -> tuple[Path, float]:
    """Write route.csv, the scenario through the points 'x,y,z' [m] at a speed [m/s].

    Returns the file and the highest speed [m/s], which is below `speed` if all segments are short.
    """
    points = tuple(_point(text) for text in texts)
    if len(points) < 2:
        raise Problem(f"--through {texts[0]}: expected two points or more, got one")
    if not speed > 0:
        raise Problem(f"--speed {speed:g}: expected more than 0 m/s")
    folder.mkdir(parents=True, exist_ok=True)
    path = Route(points, speed=speed)
    return write(folder, {"route": path})[0], highest_speed(path)


def _point(text: str) -> Point:
    try:
        x, y, z = map(finite, text.split(","))
    except ValueError:
        raise Problem(f"--through {text}: expected x,y,z in metres, such as 3.6,-2,1") from None
    return x, y, z


def route_start_angles(
    texts: Sequence[str], given: Mapping[str, float], controller: Subsystem = CONTROLLER
) -> dict[str, float]:
    """`start_angles` for the first of the points 'x,y,z' [m]; raises Problem if one is out of reach."""
    first, *others = [(f"--through {text}", start(Route((_point(text),)))) for text in texts]
    for label, tip in others:
        start_angles(label, tip, given, controller, ends=False)
    return start_angles(*first, given, controller)


def start_angles(
    label: str,
    tip: tuple[float, float, float],
    given: Mapping[str, float],
    controller: Subsystem = CONTROLLER,
    ends: bool = True,
) -> dict[str, float]:
    """Start values of the manipulator with the tip at a place, by `component.variable`.

    label        first words of the message if the arm cannot reach the position
    tip          (radius, height, angle) [m, m, rad]
    given        parameters of the manipulator that replace those of the controller
    controller   of the machine
    ends         whether the strokes have to reach there, or the links alone
    """
    arm: Arm = controller.model.arm
    v, names = values(controller), [a.coordinate[0] for a in arm.axes]
    p = nested(controller.parameters, {n: given.get(n, x) for n, x in v.p.items()})
    try:
        found = arm.pose(tip, [given.get(f"initial_{n}", v.u[n]) for n in names], p, ends)
    except Problem as error:
        raise Problem(f"{label}: {error}") from None
    return {f"manipulator.initial_{n}": x for n, x in zip(names, found, strict=True)}


if __name__ == "__main__":
    for file in write(Path(*(sys.argv[1:] or ["data/scenarios"]))):
        print(file)
