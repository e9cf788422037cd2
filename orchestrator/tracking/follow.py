"""One run along a path, and how far the tip was from it.

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

The path is that of the scenario. The tip is the end of the stick, from radius, height and swing angle of the
manipulator: the machine's own motion, whatever its controller says about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace, read
from orchestrator.runs.simulation import RunFailed, run
from orchestrator.system.system import System

Array = NDArray[np.float64]
PATH = ("path_radius", "path_height", "path_angle")
VELOCITY = ("radial_velocity", "vertical_velocity", "swing_velocity")
MANIPULATOR = "manipulator"  # the component
TIP = tuple(f"{MANIPULATOR}.{name}" for name in ("tip_radius", "tip_height", "swing_angle"))
SWITCH = "controller.feedback"  # 1 where the controller looks at the machine, 0 where it does not
USES = tuple(f"controller.{name}_use" for name in ("stroke", "speed", "wait"))  # of limits
RECORD = 5e-3  # s, as the paths are sampled


@dataclass(frozen=True)
class Ride:
    """A run along a path.

    machine   name of the machine; `feedback`: did its controller look at the machine?
    time      shape (n,) [s]
    wanted    places of the path, shape (n, 3): x forward, y to the left, z up [m]; `tip`: those of the tip
    failure   why the run ended early; empty when it came to the end
    uses      what the controller tells about its limits {name: shape (n,)}
    """

    path: str
    machine: str
    feedback: bool
    time: Array
    wanted: Array
    tip: Array
    failure: str = ""
    uses: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def error(self) -> Array:
        """Distance of the tip from its place on the path at each instant [m], shape (n,)."""
        return np.asarray(np.linalg.norm(self.tip - self.wanted, axis=1))

    @property
    def parts(self) -> Array:
        """Tip less path [m], shape (n, 3): outwards, to the left, upwards, seen from the column."""
        away, angle = self.tip - self.wanted, np.arctan2(self.wanted[:, 1], self.wanted[:, 0])
        cos, sin = np.cos(angle), np.sin(angle)
        left = away[:, 1] * cos - away[:, 0] * sin
        return np.column_stack([away[:, 0] * cos + away[:, 1] * sin, left, away[:, 2]])

    @property
    def largest(self) -> float:
        """The largest error [m]."""
        return float(self.error.max())

    @property
    def when(self) -> float:
        """The time of the largest error [s]."""
        return float(self.time[int(np.argmax(self.error))])

    @property
    def rms(self) -> float:
        """Root of the mean square of the error over the points recorded, which are equally far apart [m]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def last(self) -> float:
        """The error where it comes to rest [m]."""
        return float(self.error[-1])

    @property
    def speed(self) -> float:
        """The highest speed that the path asks for [m/s]."""
        moved = np.linalg.norm(np.diff(self.wanted, axis=0), axis=1)
        return float((moved / np.diff(self.time)).max(initial=0.0))


def ride(
    system: System,
    path: Path,
    machine: str,
    feedback: bool,
    **options: Any,
) -> Ride:
    """Run a system along the path of a scenario, with the controller's feedback or without.

    options   of `run`
    """
    scenario = read(path)
    places(scenario, PATH, str(path))  # a file without a path is told before anything runs
    given = {**options.pop("set", {}), SWITCH: float(feedback)}
    failure, uses = "", [name for name in USES if system.has(name)]
    record = [*TIP, *uses]
    try:
        trace = run(
            system, completed(scenario), set=given, record=record, record_step=RECORD, **options
        ).trace
    except RunFailed as failed:
        trace, failure = failed.result.trace, str(failed)
    wanted = places(scenario.at(trace.time), PATH, str(path))
    tip, told = places(trace, TIP, MANIPULATOR), {name: trace[name] for name in uses}
    return Ride(path.stem, machine, feedback, trace.time, wanted, tip, failure, told)


def completed(scenario: Trace) -> Trace:
    """With what a plain table of places leaves out: engaged, following, the velocities as slopes."""
    own = {"engaged": np.ones_like(scenario.time), "follow": np.ones_like(scenario.time)}
    for place, velocity in zip(PATH, VELOCITY, strict=True):
        own[velocity] = np.gradient(scenario[place], scenario.time)
    return replace(scenario, signals=own | dict(scenario.signals))


def places(trace: Trace, names: Sequence[str], where: str) -> Array:
    """Radius, height and angle of these names as x, y, z, shape (n, 3) [m]."""
    if missing := [n for n in names if n not in trace.signals]:
        raise Problem(f"{where}: expected {', '.join(names)}, got no {', '.join(missing)}")
    radius, height, angle = (trace[n] for n in names)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def first(path: Path) -> tuple[float, float, float]:
    """Radius [m], height [m] and angle [rad] where the path of a scenario begins."""
    scenario = read(path)
    places(scenario, PATH, str(path))
    radius, height, angle = (float(scenario[name][0]) for name in PATH)
    return radius, height, angle
