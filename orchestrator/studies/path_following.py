"""Tracking error of one machine on one path: the distance of the tip from the commanded point.

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

A scenario contains the path. The position of the tip is computed from outputs of the machine (radius, height,
angle), not from what the controller reports. A file of the machine has the names (`TrackedMachine`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.data.deviation import rms
from orchestrator.data.trace import Trace, read_trace
from orchestrator.engine.result import RunFailed
from orchestrator.engine.run import run
from orchestrator.fmi.description import Value
from orchestrator.ssp.system import System

Array = NDArray[np.float64]

RECORD_STEP = 5e-3  # [s], sampling interval of the paths


@dataclass(frozen=True)
class Limit:
    """A limit of the controller: above its threshold it acts, if its use lasts so long [s]."""

    cause: str
    threshold: float
    lasting: float = 0.0
    decisive: bool = False


@dataclass(frozen=True)
class TrackedMachine:
    """Names of a machine that follows paths, in a TOML file of the machine, such as tracking.toml.

    example      file of such a machine
    follower     component whose parameters determine the start of a path
    controller   component that may assume other parameters than the machine has
    alone        a variant, as COMPONENT=VARIANT, for a message
    path, tip    radius [m], height [m] and angle [rad]: columns of a scenario, and signals of the machine
    velocity     columns that a scenario may lack: the derivatives of the path
    engaged      columns that a scenario may lack: 1
    feedback     input: 1 if the controller uses measurements, else 0
    copied       end of the names of parameters of the components that the controller gets
    limits       signal with the use of a limit -> limit
    """

    example: str
    follower: str
    controller: str
    alone: str
    path: tuple[str, ...]
    velocity: tuple[str, ...]
    engaged: tuple[str, ...]
    tip: tuple[str, ...]
    feedback: str
    copied: str
    limits: Mapping[str, Limit]


def read_machine(file: Path) -> TrackedMachine:
    """Read the names of a machine."""
    return toml.read_dataclass(TrackedMachine, toml.read(file, file.read_bytes()))


@dataclass(frozen=True)
class PathRun:
    """One machine on one path.

    feedback   whether the controller used measurements
    time       shape (n,) [s]
    commanded  points of the path, shape (n, 3): x forward, y to the left, z up [m]
    tip        points of the tip, likewise
    failure    why the run ended early; empty if it did not
    uses       use of each limit of the controller {name: shape (n,)}
    limits     these limits
    """

    path: str
    machine: str
    feedback: bool
    time: Array
    commanded: Array
    tip: Array
    failure: str = ""
    uses: Mapping[str, Array] = field(default_factory=dict)
    limits: Mapping[str, Limit] = field(default_factory=dict)

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
        relative = {name: use / self.limits[name].threshold for name, use in self.uses.items()}
        largest = {name: float(use.max()) for name, use in relative.items()}
        decisive = [name for name in largest if self.limits[name].decisive and largest[name] > 1]
        worst = decisive[0] if decisive else max(largest, key=largest.__getitem__)
        if not largest[worst] > 1:
            return ": no limit of the controller acts"
        since, most = float(self.time[int((relative[worst] > 1).argmax())]), self.uses[worst].max()
        return f": {self.limits[worst].cause}, from {since:.1f} s on ({worst} is up to {most:.3g})"


def follow(
    system: System,
    names: TrackedMachine,
    path: Path,
    machine: str,
    feedback: bool,
    start: Mapping[str, Value | str],
) -> PathRun:
    """Run a system along the path of a scenario; a Problem names machine and path."""
    scenario = read_trace(path)
    points(scenario, names.path, str(path))  # a file without a path is reported before anything runs
    driven, values = completed(scenario, names), {**start, names.feedback: float(feedback)}
    failure, limits = "", {name: limit for name, limit in names.limits.items() if system.has(name)}
    try:
        trace = run(system, driven, record=[*names.tip, *limits], record_step=RECORD_STEP, set=values).trace
    except RunFailed as failed:
        trace, failure = failed.result.trace, str(failed)
    except Problem as problem:
        raise Problem(f"machine {machine}, path {path.stem}: {problem}") from None
    commanded = points(scenario.at(trace.time), names.path, str(path))
    tip = points(trace, names.tip, names.follower)
    uses = {name: _lasting(trace[name], round(limit.lasting / RECORD_STEP)) for name, limit in limits.items()}
    return PathRun(path.stem, machine, feedback, trace.time, commanded, tip, failure, uses, limits)


def _lasting(use: Array, count: int) -> Array:
    """The least of the last `count` samples at each instant; 0 before there are so many."""
    if count < 2:
        return use
    least = np.zeros_like(use)
    if use.size >= count:
        least[count - 1 :] = np.lib.stride_tricks.sliding_window_view(use, count).min(axis=1)
    return least


def completed(scenario: Trace, names: TrackedMachine) -> Trace:
    """The scenario with the inputs that a plain table of points lacks.

    The controller is engaged and follows; velocities are the derivatives of the points.
    """
    added = {name: np.ones_like(scenario.time) for name in names.engaged}
    for position, velocity in zip(names.path, names.velocity, strict=True):
        added[velocity] = np.gradient(scenario[position], scenario.time)
    return replace(scenario, signals=added | dict(scenario.signals))


def points(trace: Trace, names: Sequence[str], where: str) -> Array:
    """Signals with radius, height and angle as x, y, z, shape (n, 3) [m]."""
    if missing := [n for n in names if n not in trace.signals]:
        raise Problem(f"{where}: expected {', '.join(names)}, got no {', '.join(missing)}")
    radius, height, angle = (trace[n] for n in names)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def first_point(path: Path, columns: Sequence[str]) -> tuple[float, float, float]:
    """Radius [m], height [m] and angle [rad] of the first point of the path of a scenario."""
    scenario = read_trace(path)
    points(scenario, columns, str(path))
    radius, height, angle = (float(scenario[name][0]) for name in columns)
    return radius, height, angle
