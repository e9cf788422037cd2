"""How far the tip of the boom is from the path that it is to follow: runs, errors, and their table.

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

The path is that of a scenario. The tip is the end of the stick, from radius, height and swing angle of the
manipulator: the machine's own motion, whatever its controller states.
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
from orchestrator.base.text import TextTable
from orchestrator.data.trace import Trace, read
from orchestrator.engine.result import RunFailed
from orchestrator.engine.run import run
from orchestrator.fmi.description import Value
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System

Array = NDArray[np.float64]

PATH = ("path_radius", "path_height", "path_angle")
VELOCITY = ("radial_velocity", "vertical_velocity", "swing_velocity")
MANIPULATOR, CONTROLLER = "manipulator", "controller"  # components
TIP = tuple(f"{MANIPULATOR}.{name}" for name in ("tip_radius", "tip_height", "swing_angle"))
FEEDBACK = f"{CONTROLLER}.feedback"  # 1: the controller uses measurements, 0: it does not
# how far each limit of the controller is used; above its threshold the limit acts
STROKE, SPEED, WAIT = (f"{CONTROLLER}.{name}_use" for name in ("stroke", "speed", "wait"))
THRESHOLDS = {STROKE: 1.0, SPEED: 1.0, WAIT: 0.5}
CAUSES = {
    STROKE: "the path leads beyond the end of a stroke",
    SPEED: "the path asks for more speed than an actuator has",
    WAIT: "the machine does not follow",
}
RECORD_STEP = 5e-3  # [s], as the paths are sampled
DERIVED = "; 0: "  # in the description of a number that follows from others if it is 0
SAME = 1e-9  # relative difference of two numbers that are meant to be equal
LOST = 0.1  # [m] ten times what is usual on a path that can be followed
MM = 1e3
HEAD = ("path", "machine", "feedback", "largest [mm]", "at [s]", "RMS [mm]", "last [mm]", "times as large")


@dataclass(frozen=True)
class PathRun:
    """One machine on one path.

    feedback  whether the controller used measurements
    time      shape (n,) [s]
    wanted    points of the path, shape (n, 3): x forward, y to the left, z up [m]
    tip       points of the tip, likewise
    failure   why the run ended early; empty if it did not
    uses      use of each limit of the controller {name: shape (n,)}
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
        """Distance of the tip from its point on the path at each instant [m], shape (n,)."""
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
        """Root mean square of the error over the equally spaced samples [m]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def last(self) -> float:
        """The error at the end, where the tip is at rest [m]."""
        return float(self.error[-1])

    @property
    def speed(self) -> float:
        """The highest speed of the path [m/s]."""
        moved = np.linalg.norm(np.diff(self.wanted, axis=0), axis=1)
        return float((moved / np.diff(self.time)).max(initial=0.0))

    @property
    def cause(self) -> str:
        """The limit of the controller that is exceeded most, and since when; empty if it reports none."""
        if not self.uses:
            return ""
        relative = {name: use / THRESHOLDS.get(name, 1.0) for name, use in self.uses.items()}
        most = max(relative, key=lambda name: float(relative[name].max()))
        if not relative[most].max() > 1:
            return ": no limit of the controller acts"
        since = float(self.time[int((relative[most] > 1).argmax())])
        return f": {CAUSES[most]}, from {since:.1f} s on ({most} is up to {self.uses[most].max():.3g})"


def follow(system: System, path: Path, machine: str, feedback: bool, **options: Any) -> PathRun:
    """Run a system along the path of a scenario; `options` go to `run`, a Problem names machine and path."""
    scenario = read(path)
    points(scenario, PATH, str(path))  # a file without a path is reported before anything runs
    options["set"] = {**options.get("set", {}), FEEDBACK: float(feedback)}
    failure, uses = "", [name for name in CAUSES if system.has(name)]
    try:
        trace = run(
            system, completed(scenario), record=[*TIP, *uses], record_step=RECORD_STEP, **options
        ).trace
    except RunFailed as failed:
        trace, failure = failed.result.trace, str(failed)
    except Problem as problem:
        raise Problem(f"machine {machine}, path {path.stem}: {problem}") from None
    wanted, tip = points(scenario.at(trace.time), PATH, str(path)), points(trace, TIP, MANIPULATOR)
    return PathRun(
        path.stem, machine, feedback, trace.time, wanted, tip, failure, {name: trace[name] for name in uses}
    )


def completed(scenario: Trace) -> Trace:
    """The scenario with what a plain table of points leaves out: engaged, following, velocities as slopes."""
    own = {"engaged": np.ones_like(scenario.time), "follow": np.ones_like(scenario.time)}
    for place, velocity in zip(PATH, VELOCITY, strict=True):
        own[velocity] = np.gradient(scenario[place], scenario.time)
    return replace(scenario, signals=own | dict(scenario.signals))


def points(trace: Trace, names: Sequence[str], where: str) -> Array:
    """Radius, height and angle of these names as x, y, z, shape (n, 3) [m]."""
    if missing := [n for n in names if n not in trace.signals]:
        raise Problem(f"{where}: expected {', '.join(names)}, got no {', '.join(missing)}")
    radius, height, angle = (trace[n] for n in names)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def beginning(path: Path) -> tuple[float, float, float]:
    """Radius [m], height [m] and angle [rad] where the path of a scenario begins."""
    scenario = read(path)
    points(scenario, PATH, str(path))
    radius, height, angle = (float(scenario[name][0]) for name in PATH)
    return radius, height, angle


def assembled(
    system: System, machines: Mapping[str, Mapping[str, str]], given: Mapping[str, Value | str]
) -> dict[str, System]:
    """Every machine {name: variants} with the start values that are given; each must have all of them."""
    swapped = {name: with_swaps(system, swap) for name, swap in machines.items()}
    for value in given:
        having = [name for name, machine in swapped.items() if machine.has(value)]
        lacking = [name for name in swapped if name not in having]
        if having and lacking:
            part = value.partition(".")[0]
            swaps = [f"--swap {part}={variant}" for n in having if (variant := machines[n].get(part))]
            raise Problem(
                f"--set {value}: the {' and '.join(lacking)} machine has no such variable, only the"
                f" {' and '.join(having)} one; to run one machine alone:"
                f" {[*swaps, '--swap swing=lumped'][0]}, for example"
            )
    return {name: machine.with_start(given) for name, machine in swapped.items()}


def differences(system: System) -> list[str]:
    """One note for each number that controller and machine have in the same unit, with different values.

    The controller names a number as its part does, or `part_name` where several parts have that name. A
    number that the part derives from others, because it is 0, is not compared.
    """
    if CONTROLLER not in system.components:
        return []
    controller, notes = system.components[CONTROLLER], []
    own = controller.numbers()
    for part, component in system.components.items():
        for name, value in {} if part == CONTROLLER else component.numbers().items():
            known = f"{part}_{name}" if f"{part}_{name}" in own else name
            if known not in own or abs(own[known] - value) <= SAME * max(abs(own[known]), abs(value)):
                continue
            variable = component.interface.variables[name]
            unit, derived = variable.unit, value == 0 and DERIVED in variable.description
            if controller.interface.variables[known].unit == unit and not derived:
                suffix = f" {unit.name}" if unit and unit.name != "1" else ""
                notes.append(
                    f"{CONTROLLER}.{known} is {own[known]:.6g}{suffix}, {part}.{name} {value:.6g}{suffix}:"
                    " the controller believes another machine"
                )
    return notes


def rows(runs: Sequence[PathRun]) -> list[tuple[str, ...]]:
    """One row for each run; the last cell is its largest error over that of the same run with feedback."""
    closed = {(r.path, r.machine): r.largest for r in reversed(runs) if r.feedback}
    return [
        (
            *(r.path, r.machine, "yes" if r.feedback else "no"),
            *(f"{MM * r.largest:.1f}", f"{r.when:.1f}", f"{MM * r.rms:.1f}", f"{MM * r.last:.1f}"),
            "" if r.feedback or (r.path, r.machine) not in closed
            else f"{r.largest / closed[r.path, r.machine]:.1f}",
        )
        for r in runs
    ]  # fmt: skip


def text(runs: Sequence[PathRun]) -> str:
    """The table, and below it the runs that failed or went far off."""
    columns = len(HEAD) - all(r.feedback for r in runs)  # the last one compares with the run with feedback
    cells = [row[:columns] for row in rows(runs)]
    table = TextTable(HEAD[:columns], cells, left=range(3)).lines()
    failed = [
        f"{r.path}, {r.machine}: ended early at {r.time[-1]:.3g} s: {r.failure}" for r in runs if r.failure
    ]
    lost = [
        f"{r.path}, {r.machine}: the tip is up to {r.largest:.2f} m away, {r.last:.2f} m at the end{r.cause}"
        for r in runs
        if r.feedback and not r.failure and r.largest > LOST
    ]
    return "\n".join([*table, *failed, *lost])


def data(runs: Sequence[PathRun]) -> list[dict[str, Any]]:
    """All numbers, for JSON."""
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
        for r in runs
    ]
