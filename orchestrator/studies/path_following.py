"""One run along a path, and how far the tip was from it.

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

The path is that of the scenario. The tip is the end of the stick, from radius, height and swing angle of the
manipulator: the machine's own motion, whatever its controller says about it.

The machines of a comparison with what the user sets, and where one is not what its controller assumes.

Why a tip is far from its path, by what its controller tells about its limits.

The rides as a table for people and as numbers for programs.
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
from orchestrator.data.trace import Trace, read
from orchestrator.engine.result import RunFailed
from orchestrator.engine.run import run
from orchestrator.fmi.description import Value
from orchestrator.ssp.system import System

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


CONTROLLER = "controller"
ALONE = "--swap swing=lumped"
CLOSE = 1e-9  # relative: more digits than anybody writes


def assembled(
    system: System, machines: Mapping[str, Mapping[str, str]], given: Mapping[str, Value | str]
) -> dict[str, System]:
    """Every machine {name: swaps} with its start values; a name that only others have is told as such."""
    swapped = {name: system.swapped(swap) for name, swap in machines.items()}
    for value in given:
        having = [name for name, machine in swapped.items() if machine.has(value)]
        lacking = [name for name in swapped if name not in having]
        if having and lacking:
            part = value.partition(".")[0]
            swaps = [f"--swap {part}={variant}" for n in having if (variant := machines[n].get(part))]
            raise Problem(
                f"--set {value}: the {' and '.join(lacking)} machine has no such variable, only the"
                f" {' and '.join(having)} one; to run one machine alone: {[*swaps, ALONE][0]}, for example"
            )
    return {name: machine.with_start(given) for name, machine in swapped.items()}


def differences(system: System) -> list[str]:
    """One note for each number that the controller has as well, in the same unit, but with another value.

    The controller names a number as its part does, or `part_name` where parts have one of the same name.
    """
    if CONTROLLER not in system.components:
        return []
    controller = system.components[CONTROLLER]
    own, found = controller.numbers(), []
    for part, component in system.components.items():
        for name, value in {} if part == CONTROLLER else component.numbers().items():
            known = f"{part}_{name}" if f"{part}_{name}" in own else name
            if known not in own or abs(own[known] - value) <= CLOSE * max(abs(own[known]), abs(value)):
                continue
            unit = component.interface.variables[name].unit
            if controller.interface.variables[known].unit == unit:
                here = f" {unit.name}" if unit and unit.name != "1" else ""
                found.append(
                    f"{CONTROLLER}.{known} is {own[known]:.6g}{here}, {part}.{name} {value:.6g}{here}:"
                    " the controller believes another machine"
                )
    return found


WAIT = "controller.wait_use"
CAUSES = {
    "controller.stroke_use": "the path leads beyond the end of a stroke",
    "controller.speed_use": "the path asks for more speed than an actuator has",
    WAIT: "the machine does not follow",
}
ACTS = {WAIT: 0.5}  # above it the controller waits; the other limits act above 1


def cause(ride: Ride) -> str:
    """The limit that is exceeded most, and since when; empty where the controller tells of none."""
    if not ride.uses:
        return ""
    over: Mapping[str, Array] = {name: use / ACTS.get(name, 1.0) for name, use in ride.uses.items()}
    most = max(over, key=lambda name: float(over[name].max()))
    if not over[most].max() > 1:
        return ": no limit of the controller acts"
    began = float(ride.time[int((over[most] > 1).argmax())])
    return f": {CAUSES[most]}, from {began:.1f} s on ({most} is up to {ride.uses[most].max():.3g})"


HEAD = ("path", "machine", "feedback", "largest [mm]", "at [s]", "RMS [mm]", "last [mm]", "times as large")
NAMES = 3  # columns of words
MM = 1e3
LOST = 0.1  # m: ten times what is usual on a path that can be followed


def rows(rides: Sequence[Ride]) -> list[tuple[str, ...]]:
    """One row for each ride; the last cell is its largest error over that with feedback."""
    found: list[tuple[str, ...]] = []
    for ride in rides:
        errors = ride.largest, ride.rms, ride.last
        largest, rms, last = (f"{MM * x:.1f}" for x in errors)
        other = twin(ride, rides)
        times = "" if ride.feedback or other is None else f"{ride.largest / other.largest:.1f}"
        words = ride.path, ride.machine, "yes" if ride.feedback else "no"
        found.append((*words, largest, f"{ride.when:.1f}", rms, last, times))
    return found


def twin(ride: Ride, rides: Sequence[Ride]) -> Ride | None:
    """The same ride with feedback turned the other way."""
    same = (r for r in rides if (r.path, r.machine) == (ride.path, ride.machine))
    return next((r for r in same if r.feedback != ride.feedback), None)


def text(rides: Sequence[Ride]) -> str:
    """The table, with what failed or went far off below it."""
    lines = [HEAD, *rows(rides)]
    if all(r.feedback for r in rides):  # nothing to compare with
        lines = [line[:-1] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = ["  ".join(map(_cell, range(len(line)), line, widths)).rstrip() for line in lines]
    early = [r for r in rides if r.failure]
    failed = [f"{r.path}, {r.machine}: ended early at {r.time[-1]:.3g} s: {r.failure}" for r in early]
    lost = [r for r in rides if r.feedback and not r.failure and r.largest > LOST]
    away = [
        f"{r.path}, {r.machine}: the tip is up to {r.largest:.2f} m away, {r.last:.2f} m at the end{cause(r)}"
        for r in lost
    ]
    return "\n".join([*table, *failed, *away])


def _cell(place: int, content: str, width: int) -> str:
    return content.ljust(width) if place < NAMES else content.rjust(width)


def data(rides: Sequence[Ride]) -> list[dict[str, Any]]:
    """All numbers."""
    return [
        {
            "path": r.path,
            "machine": r.machine,
            "feedback": r.feedback,
            "highest speed asked for [m/s]": r.speed,
            "duration [s]": float(r.time[-1]),
            "largest error [m]": r.largest,
            "largest outwards, sideways, upwards [m]": np.abs(r.parts).max(axis=0).tolist(),
            "time of the largest error [s]": r.when,
            "RMS error [m]": r.rms,
            "error at the end [m]": r.last,
            "largest uses of limits": {name: float(use.max()) for name, use in r.uses.items()},
            "failure": r.failure,
        }
        for r in rides
    ]
