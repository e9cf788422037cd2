"""Tracking error of one machine on one path: the distance of the tip from the commanded point.

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

A scenario contains the path. The tip is the end of the stick. Its position is computed from outputs of the
manipulator (radius, height, swing angle), not from what the controller reports.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.deviation import rms
from orchestrator.data.trace import Trace, read_trace
from orchestrator.engine.result import RunFailed
from orchestrator.engine.run import run
from orchestrator.ssp.system import System

Array = NDArray[np.float64]

PATH = ("path_radius", "path_height", "path_angle")
VELOCITY = ("radial_velocity", "vertical_velocity", "swing_velocity")
MANIPULATOR, CONTROLLER = "manipulator", "controller"  # components
TIP = tuple(f"{MANIPULATOR}.{name}" for name in ("tip_radius", "tip_height", "swing_angle"))
FEEDBACK = f"{CONTROLLER}.feedback"  # 1: the controller uses measurements, 0: it does not
# Use of each limit of the controller; above its threshold the limit acts.
PRESSURE, STROKE, SPEED, WAIT = (f"{CONTROLLER}.{n}_use" for n in ("pressure", "stroke", "speed", "wait"))
THRESHOLDS = {STROKE: 1.0, SPEED: 1.0, WAIT: 0.5}
CAUSES = {
    PRESSURE: "the supply pressure does not carry the load",
    STROKE: "the path leads beyond the end of a stroke",
    SPEED: "the path requires more speed than an actuator has",
    WAIT: "the machine does not follow",
}
RECORD_STEP = 5e-3  # [s], sampling interval of the paths
PUMP_TIME = 1.0  # [s]; a load-sensing pump raises its pressure within a few tenths after a valve has opened


@dataclass(frozen=True)
class PathRun:
    """One machine on one path.

    feedback   whether the controller used measurements
    time       shape (n,) [s]
    commanded  points of the path, shape (n, 3): x forward, y to the left, z up [m]
    tip        points of the tip, likewise
    failure    why the run ended early; empty if it did not
    uses       use of each limit of the controller {name: shape (n,)}
    """

    path: str
    machine: str
    feedback: bool
    time: Array
    commanded: Array
    tip: Array
    failure: str = ""
    uses: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def error(self) -> Array:
        """Distance of the tip from its point on the path at each instant [m], shape (n,)."""
        return np.asarray(np.linalg.norm(self.tip - self.commanded, axis=1))

    @property
    def components(self) -> Array:
        """Tip minus path [m], shape (n, 3): outwards, to the left, upwards, seen from the column."""
        error, angle = self.tip - self.commanded, np.arctan2(self.commanded[:, 1], self.commanded[:, 0])
        cos, sin = np.cos(angle), np.sin(angle)
        left = error[:, 1] * cos - error[:, 0] * sin
        return np.column_stack([error[:, 0] * cos + error[:, 1] * sin, left, error[:, 2]])

    @property
    def largest(self) -> float:
        """The largest error [m]."""
        return float(self.error.max())

    @property
    def time_of_largest(self) -> float:
        """Time of the largest error [s]."""
        return float(self.time[int(np.argmax(self.error))])

    @property
    def rms(self) -> float:
        """Root mean square of the error over the equally spaced samples [m]."""
        return rms(self.error)

    @property
    def last(self) -> float:
        """The error at the end, where the tip is at rest [m]."""
        return float(self.error[-1])

    @property
    def speed(self) -> float:
        """The highest speed of the path [m/s]."""
        distances = np.linalg.norm(np.diff(self.commanded, axis=0), axis=1)
        return float((distances / np.diff(self.time)).max(initial=0.0))

    @property
    def cause(self) -> str:
        """The limit that is exceeded most, and since when, as text; empty if the controller reports none."""
        if not self.uses:
            return ""
        relative = {name: use / THRESHOLDS.get(name, 1.0) for name, use in self.uses.items()}
        worst = max(relative, key=lambda name: float(relative[name].max()))
        if PRESSURE in relative and relative[PRESSURE].max() > 1:
            worst = PRESSURE  # then the machine waits, and the path demands more speed
        if not relative[worst].max() > 1:
            return ": no limit of the controller acts"
        since = float(self.time[int((relative[worst] > 1).argmax())])
        return f": {CAUSES[worst]}, from {since:.1f} s on ({worst} is up to {self.uses[worst].max():.3g})"


def follow(system: System, path: Path, machine: str, feedback: bool, **options: Any) -> PathRun:
    """Run a system along the path of a scenario; `options` go to `run`, a Problem names machine and path."""
    scenario = read_trace(path)
    points(scenario, PATH, str(path))  # a file without a path is reported before anything runs
    options["set"] = {**options.get("set", {}), FEEDBACK: float(feedback)}
    failure, limits = "", [name for name in CAUSES if system.has(name)]
    try:
        trace = run(
            system, completed(scenario), record=[*TIP, *limits], record_step=RECORD_STEP, **options
        ).trace
    except RunFailed as failed:
        trace, failure = failed.result.trace, str(failed)
    except Problem as problem:
        raise Problem(f"machine {machine}, path {path.stem}: {problem}") from None
    commanded, tip = points(scenario.at(trace.time), PATH, str(path)), points(trace, TIP, MANIPULATOR)
    uses = {name: trace[name] for name in limits}
    if PRESSURE in uses:
        uses[PRESSURE] = _lasting(uses[PRESSURE], round(PUMP_TIME / RECORD_STEP))
    return PathRun(path.stem, machine, feedback, trace.time, commanded, tip, failure, uses)


def _lasting(use: Array, count: int) -> Array:
    """The least of the last `count` samples at each instant; 0 before there are so many."""
    least = np.zeros_like(use)
    if use.size >= count:
        least[count - 1 :] = np.lib.stride_tricks.sliding_window_view(use, count).min(axis=1)
    return least


def completed(scenario: Trace) -> Trace:
    """The scenario with the inputs that a plain table of points lacks.

    The controller is engaged and follows; velocities are the derivatives of the points.
    """
    added = {"engaged": np.ones_like(scenario.time), "follow": np.ones_like(scenario.time)}
    for position, velocity in zip(PATH, VELOCITY, strict=True):
        added[velocity] = np.gradient(scenario[position], scenario.time)
    return replace(scenario, signals=added | dict(scenario.signals))


def points(trace: Trace, names: Sequence[str], where: str) -> Array:
    """Signals with radius, height and angle as x, y, z, shape (n, 3) [m]."""
    if missing := [n for n in names if n not in trace.signals]:
        raise Problem(f"{where}: expected {', '.join(names)}, got no {', '.join(missing)}")
    radius, height, angle = (trace[n] for n in names)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def first_point(path: Path) -> tuple[float, float, float]:
    """Radius [m], height [m] and angle [rad] of the first point of the path of a scenario."""
    scenario = read_trace(path)
    points(scenario, PATH, str(path))
    radius, height, angle = (float(scenario[name][0]) for name in PATH)
    return radius, height, angle
