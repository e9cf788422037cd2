"""`harvester track`: every machine follows every path, with the controller's feedback and without.

The tracking error is the distance of the tip from the commanded point:

    e(t) = |tip(t) - path(t)|        both in space, at the same instant

A scenario contains the path. The position of the tip is computed from outputs of the machine (radius, height,
angle), not from what the controller reports. `TrackedMachine` has the names.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fmus.machine.feasible import Mechanics, exceeded
from fmus.machine.sway import remaining, shaped, shaper, together
from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder, write_columns, write_whole
from orchestrator.base.signals import rms
from orchestrator.base.text import TextTable
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace, read_trace
from orchestrator.engine.run import attempt
from orchestrator.fmi.description import Value
from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import legend, new_figure, png, style_axes
from orchestrator.results.report import Report
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.plausible import doubtful_starts, refuse_long
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System
from orchestrator.ssp.write import parameter_set

RECORD_STEP = 5e-3  # [s], sampling interval of the paths
SAME_VALUE = 1e-9  # relative difference up to which two parameter values are equal
TURN = 1.0  # [s]; no machine turns once in this time
FAR = 0.1  # [m]: a larger error is reported with its cause; usual errors are ten times smaller
MM = 1e3
WITH, WITHOUT = "-", (0, (3, 1.5))
RISING = 0.05  # height over length above which a path rises
STRAIGHT = 1e-3  # width over length, seen from above, below which a path is in one upright plane
LEAST_ERROR = 0.1  # [mm], lower end of the error axis
HEAD = ("path", "machine", "feedback", "largest [mm]", "at [s]", "RMS [mm]", "last [mm]", "times as large")

Start = Callable[[Mapping[str, float]], Mapping[str, float]]
Starts = Mapping[str, Value | str]  # start values by name


# ---- one run


@dataclass(frozen=True)
class Limit:
    """A limit of the controller: above its threshold it acts, if its use lasts so long [s]."""

    cause: str
    threshold: float
    lasting: float = 0.0
    decisive: bool = False


# Use of a limit of the controller -> the limit. The first one that acts and is decisive, else the one that is
# exceeded most, is the cause of an error. A load-sensing pump raises its pressure within a few tenths of a
# second after a valve has opened, so that use counts if it lasts; then the machine waits, and the path asks
# for more speed.
LIMITS = {
    "controller.pressure_use": Limit("the supply pressure does not carry the load", 1.0, 1.0, decisive=True),
    "controller.stroke_use": Limit("the path leads beyond the end of a stroke", 1.0),
    "controller.speed_use": Limit("the path requires more speed than an actuator has", 1.0),
    "controller.wait_use": Limit("the machine does not follow", 0.5),
}


@dataclass(frozen=True)
class TrackedMachine:
    """Names of a machine that follows paths; the defaults are those of the harvester.

    example      file of such a machine
    alone        a variant, as COMPONENT=VARIANT, for a message
    tip          radius [m], height [m] and angle [rad]: signals of the machine
    path         the same: columns of a scenario
    velocity     columns that a scenario may lack: the derivatives of the path
    engaged      columns that a scenario may lack: 1
    radius       what this radius is, for a figure
    follower     component whose parameters determine the start of a path
    controller   component that may assume other parameters than the machine has
    feedback     input: 1 if the controller uses measurements, else 0
    copied       end of the names of parameters of the components that the controller gets
    """

    example: str = "build/harvester_control.ssp"
    alone: str = "swing=lumped"
    tip: tuple[str, ...] = ("manipulator.tip_radius", "manipulator.tip_height", "manipulator.swing_angle")
    path: tuple[str, ...] = ("path_radius", "path_height", "path_angle")
    velocity: tuple[str, ...] = ("radial_velocity", "vertical_velocity", "swing_velocity")
    engaged: tuple[str, ...] = ("engaged", "follow")
    radius: str = "radius from the swing axis"
    follower: str = "manipulator"
    controller: str = "controller"
    feedback: str = "controller.feedback"
    copied: str = "_section_flow"


HARVESTER = TrackedMachine()


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
    final      further outputs at the end {name: value}
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
    final: Mapping[str, float] = field(default_factory=dict)

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
    start: Starts,
    yes: bool = False,
    also: Sequence[str] = (),
) -> PathRun:
    """Run a system along the path of a scenario; a Problem names machine and path.

    also   further outputs, of which the run has the last values
    """
    scenario = read_trace(path)
    points(scenario, names.path, str(path))  # a file without a path is reported before anything runs
    scenario = unwrapped(scenario, names.path[-1])
    driven, values = completed(scenario, names), {**start, names.feedback: float(feedback)}
    limits = {name: limit for name, limit in LIMITS.items() if system.has(name)}
    try:
        recorded = [*names.tip, *limits, *also]
        result, failure = attempt(
            system, driven, record=recorded, record_step=RECORD_STEP, set=values, yes=yes
        )
    except Problem as problem:
        raise Problem(f"machine {machine}, path {path.stem}: {problem}") from None
    trace = result.trace
    commanded = points(scenario.at(trace.time), names.path, str(path))
    tip = points(trace, names.tip, names.follower)
    uses = {name: _lasting(trace[name], round(limit.lasting / RECORD_STEP)) for name, limit in limits.items()}
    final = {n: float(trace[n][-1]) for n in also}
    return PathRun(path.stem, machine, feedback, trace.time, commanded, tip, failure, uses, limits, final)


def _lasting(use: Array, count: int) -> Array:
    """The least of the last `count` samples at each instant; 0 before there are so many."""
    if count < 2:
        return use
    least = np.zeros_like(use)
    if use.size >= count:
        least[count - 1 :] = np.lib.stride_tricks.sliding_window_view(use, count).min(axis=1)
    return least


def unwrapped(scenario: Trace, name: str) -> Trace:
    """The scenario with an angle that goes on where it jumps by a turn in less than `TURN`, as of arctan2."""
    angle = scenario[name]
    turns = np.round(np.diff(angle, prepend=angle[:1]) / math.tau)
    turns[np.diff(scenario.time, prepend=-math.inf) > TURN] = 0
    return replace(scenario, signals={**scenario.signals, name: angle - math.tau * np.cumsum(turns)})


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


# ---- all runs


def track(
    system: Path,
    names: TrackedMachine,
    mechanics: Mechanics,
    paths: Sequence[tuple[Path, Start]],
    machines: Mapping[str, Mapping[str, str]],
    out: Path,
    feedback: Sequence[bool],
    limit: float | None,
    given: Starts,
    report: Callable[[str], object],
    yes: bool = False,
    sets: Sequence[str | Path] = (),
    sway: float | None = None,
    learned: Path | None = None,
) -> bool:
    """Run every machine along every path; report a table, write tracking.png and tracking.json.

    mechanics what is known of all machines; what a path asks beyond it is reported before the first run
    paths     scenarios, each with a function from parameter values of its follower to start values for the
              first point of the path; the function raises a Problem if that point is out of reach
    machines  name -> variants {component: variant}
    limit     largest allowed error with feedback [m]
    given     start values of all runs
    yes       as of `run`
    report    called with notes before the first run, and with the table and the files after the last
    sets      parameter sets, as `parameters` of `run`
    sway      period of the head [s] for which the paths are shaped (`sway.shaped`); 0: that of the machines
    learned   file (.ssv) for what the controller of one machine has learned; each path begins with what it
              learned on the one before

    Returns True if all runs came to the end, within the limit.
    """
    loaded = load(system)
    if not loaded.has(names.feedback):
        example = f"a machine with the controller, such as {names.example}"
        raise Problem(f"{system}: expected {example}, got no variable {names.feedback}")
    for path, _ in () if yes else paths:  # before anything is computed: that takes as long as the path
        refuse_long(loaded, read_trace(path), f"path {path.stem}: scenario")
    make_folder(out)
    systems = swapped_systems(loaded, names, machines, given, sets)
    also = _learned_outputs(systems, names, mechanics, learned) if learned else []
    if sway is not None:
        paths = list(_shaped(paths, names, systems, mechanics, sway, out, report))
    # All start values are computed first: a point out of reach is reported before anything runs.
    tasks = [
        (path, name, {**start(machine.components[names.follower].real_parameters()), **given})
        for path, start in paths
        for name, machine in systems.items()
    ]
    for note in dict.fromkeys(n for machine in systems.values() for n in differences(machine, names)):
        report(f"note: {note}")
    for doubts in dict.fromkeys(filter(None, (d for m in systems.values() for d in doubtful_starts(m)))):
        report(f"warning: {doubts}")
    for line in [*dict.fromkeys(x for t in tasks for x in _exceeded(systems, names, mechanics, *t))]:
        report(f"warning: {line}")
    runs, kept = list[PathRun](), dict[str, float]()
    for (path, name, at), on in itertools.product(tasks, feedback):
        runs.append(follow(systems[name], names, path, name, on, {**at, **kept}, yes, also))
        if learned and on:
            kept = mechanics.learned(systems[name].components[names.controller], runs[-1].final)
    if learned:
        (machine,) = systems.values()
        of = machine.components[names.controller].interface.variables
        values = {n: (of[n.partition(".")[2]], x) for n, x in kept.items()}
        write_whole(learned, parameter_set("learned", values))
        report(f"{learned}: {len(kept)} values that the controller has learned")
    figure, json = out / "tracking.png", out / "tracking.json"
    report(text(runs))
    write_whole(figure, png(draw(runs, names.radius)))
    beyond = [] if limit is None else [r for r in runs if r.feedback and not r.largest <= limit]
    failed = bool(beyond) or any(r.failure for r in runs)
    worst = max((r for r in runs if r.feedback), key=lambda r: r.largest)
    told = [f"{r.path}, {r.machine}: {r.failure}" for r in runs if r.failure]
    told = told or [f"largest error: {MM * worst.largest:.1f} mm, {worst.path}, {worst.machine}"]
    passed = False if failed else None if limit is None else True
    found = Report("Tracking", told[0], [], {"runs": [as_dict(r) for r in runs]}, passed)
    write_whole(json, found.json() + "\n")
    report(f"{figure} {json}")
    for r in beyond:
        got = f"got {MM * r.largest:.1f} mm"
        report(f"{r.path}, {r.machine}: expected at most {MM * (limit or 0):g} mm, {got}")
    return not failed


def _shaped(
    paths: Sequence[tuple[Path, Start]],
    names: TrackedMachine,
    systems: Mapping[str, System],
    mechanics: Mechanics,
    period: float,
    out: Path,
    report: Callable[[str], object],
) -> Iterator[tuple[Path, Start]]:
    """The paths, shaped for the heads of all machines; they are written to a folder."""
    every = [mode for m in systems.values() for mode in mechanics.sway(m.components[names.follower])]
    modes = together(every)
    if period:
        modes = [(period, min(modes, key=lambda m: abs(m[0] - period), default=(0.0, 0.0))[1])]
    if not modes:
        swinging = "a machine whose head swings, or --sway-period"
        raise Problem(f"--shape-sway: expected {swinging}, got {', '.join(systems)}")
    heads = " and ".join(f"a period of {t:.2f} s, damping ratio {z:.2f}" for t, z in modes)
    rest = dict.fromkeys(f"{100 * remaining(*shaper(modes), m):.1f} % with {m[0]:.2f} s" for m in every)
    told = f"; sway that is left: {', '.join(rest)}" if rest else ""
    for path, start in paths:
        scenario = read_trace(path)
        points(scenario, names.path, str(path))
        scenario = unwrapped(scenario, names.path[-1])
        made = shaped(scenario, names.path, names.velocity, modes)
        rows = np.column_stack([made.time, *made.signals.values()])
        write_columns(file := out / f"{path.stem}_shaped.csv", ("time", *made.signals), rows, 10)
        seconds = " s become ".join(f"{np.ptp(t.time):.1f}" for t in (scenario, made))
        report(f"note: {path.stem} is shaped for a head with {heads}: {seconds} s, {file}{told}")
        yield file, start


def _exceeded(
    systems: Mapping[str, System],
    names: TrackedMachine,
    mechanics: Mechanics,
    path: Path,
    machine: str,
    at: Starts,
) -> Iterator[str]:
    """What a path asks of a machine beyond its limits; none of one that is not followed all the time."""
    scenario = completed(unwrapped(read_trace(path), names.path[-1]), names)
    if min(scenario[n].min() for n in names.engaged) < 1:
        return
    columns, parts = np.array([scenario[n] for n in names.path]), (names.follower, names.controller)
    try:
        for line in exceeded(systems[machine].with_start(at), mechanics, parts, scenario.time, columns):
            yield f"{path.stem}, {machine}: {line}"
    except Problem as problem:
        raise Problem(f"machine {machine}, path {path.stem}: {problem}") from None


def _learned_outputs(
    systems: Mapping[str, System], names: TrackedMachine, mechanics: Mechanics, file: Path
) -> list[str]:
    """Outputs with what the controller has learned; a Problem if it learns nothing, or on two machines."""
    if len(systems) > 1:
        raise Problem(f"--learned {file}: expected one machine, such as with --swap {names.alone}")
    (machine,) = systems.values()
    if not float(machine.components[names.controller].value("learning")) > 0:
        raise Problem(f"--learned {file}: expected --set {names.controller}.learning=1, got 0")
    return mechanics.learned_outputs(names.controller)


def swapped_systems(
    system: System,
    names: TrackedMachine,
    machines: Mapping[str, Mapping[str, str]],
    start: Starts,
    sets: Sequence[str | Path] = (),
) -> dict[str, System]:
    """Every machine {name: variants} with these start values; all machines must have these variables."""
    systems = {name: with_sets(with_swaps(system, variants), sets) for name, variants in machines.items()}
    for variable in start:
        having = [name for name, machine in systems.items() if machine.has(variable)]
        lacking = [name for name in systems if name not in having]
        if having and lacking:
            component = variable.partition(".")[0]
            swaps = [f"--swap {component}={v}" for n in having if (v := machines[n].get(component))]
            raise Problem(
                f"--set {variable}: the {' and '.join(lacking)} machine has no such variable, only the"
                f" {' and '.join(having)} one; to run one machine alone:"
                f" {[*swaps, f'--swap {names.alone}'][0]}, for example"
            )
    copied = {name: copied_parameters(machine, names) for name, machine in systems.items()}
    return {name: machine.with_start({**copied[name], **start}) for name, machine in systems.items()}


def copied_parameters(system: System, names: TrackedMachine) -> dict[str, float]:
    """Parameters of the controller that it gets from this machine."""
    others = (c for part, c in system.components.items() if part != names.controller)
    values = {name: value for part in others for name, value in part.real_parameters().items()}
    copied = {f"{names.controller}.{n}": v for n, v in values.items() if n.endswith(names.copied)}
    return {name: value for name, value in copied.items() if system.has(name)}


def differences(system: System, names: TrackedMachine) -> list[str]:
    """One note for each parameter that controller and machine have in the same unit, with different values.

    A parameter of the machine has the same name in the controller, or `component_name` if several components
    have a parameter of that name. If one value is 0, the note contains the description of the parameter,
    since 0 can mean that the FMU derives the value from other parameters.
    """
    if names.controller not in system.components:
        return []
    controller, notes = system.components[names.controller], []
    assumed = controller.real_parameters()
    for part, component in system.components.items():
        for name, value in {} if part == names.controller else component.real_parameters().items():
            assumed_name = f"{part}_{name}" if f"{part}_{name}" in assumed else name
            other = assumed.get(assumed_name)
            if other is None or math.isclose(other, value, rel_tol=SAME_VALUE):
                continue
            variable = component.interface.variables[name]
            unit = variable.unit
            if controller.interface.variables[assumed_name].unit == unit:
                suffix = f" {unit.name}" if unit and unit.name != "1" else ""
                meaning = f" ({variable.description})" if 0 in (value, other) else ""
                notes.append(
                    f"{names.controller}.{assumed_name} is {other:.6g}{suffix}, {part}.{name} is"
                    f" {value:.6g}{suffix}{meaning}: the controller assumes another machine"
                )
    return notes


def rows(runs: Sequence[PathRun]) -> list[tuple[str, ...]]:
    """One row for each run; the last cell is its largest error over that of the same run with feedback."""
    with_feedback = {(r.path, r.machine): r.largest for r in reversed(runs) if r.feedback}
    cells = []
    for r in runs:
        numbers = [f"{x:.1f}" for x in (MM * r.largest, r.time_of_largest, MM * r.rms, MM * r.last)]
        closed = None if r.feedback else with_feedback.get((r.path, r.machine))
        ratio = "" if closed is None else f"{r.largest / closed:.1f}"
        cells.append((r.path, r.machine, "yes" if r.feedback else "no", *numbers, ratio))
    return cells


def text(runs: Sequence[PathRun]) -> str:
    """The table, and below it the runs that failed or have a large error."""
    columns = len(HEAD) - all(r.feedback for r in runs)  # the last one compares with the run with feedback
    cells = [row[:columns] for row in rows(runs)]
    table = TextTable(HEAD[:columns], cells, left=range(3)).lines()
    failed, far = list[str](), list[str]()
    for r in runs:
        if r.failure:
            failed.append(f"{r.path}, {r.machine}: ended early at {r.time[-1]:.3g} s: {r.failure}")
        elif r.feedback and r.largest > FAR:
            away = f"the tip is up to {r.largest:.2f} m away, {r.last:.2f} m at the end{r.cause}"
            far.append(f"{r.path}, {r.machine}: {away}")
    return "\n".join([*table, *failed, *far])


def as_dict(r: PathRun) -> dict[str, Any]:
    """A run for tracking.json."""
    return {
        "path": r.path,
        "machine": r.machine,
        "feedback": r.feedback,
        "highest speed asked for [m/s]": r.speed,
        "duration [s]": float(r.time[-1]),
        "largest error [m]": r.largest,
        "largest outwards, sideways, upwards [m]": np.abs(r.components).max(axis=0).tolist(),
        "time of the largest error [s]": r.time_of_largest,
        "RMS error [m]": r.rms,
        "error at the end [m]": r.last,
        "largest uses of limits": {name: float(use.max()) for name, use in r.uses.items()},
        "failure": r.failure,
    }


def draw(runs: Sequence[PathRun], radius: str) -> Figure:
    """One row per path: from above, from the side, and error over time. radius: as of `TrackedMachine`."""
    paths = list(dict.fromkeys(r.path for r in runs))
    machines = list(dict.fromkeys(r.machine for r in runs))
    figure = new_figure(14, 3.7 * len(paths) + 0.5, w_pad=0.08, h_pad=0.08)
    axes = figure.subplots(len(paths), 3, squeeze=False, width_ratios=(1, 1, 1.4))
    for (left, middle, right), path in zip(axes, paths, strict=True):
        on_path = [r for r in runs if r.path == path]
        title = f"{path}, up to {on_path[0].speed:.2g} m/s"
        left.set_title(title, loc="left", fontsize=10, color=PALETTE.ink)
        style_axes(left, "to the right [m]", "forward [m]", size=10)
        _draw_view(left, on_path, machines, top_view)
        side, axis_label = side_view(on_path[0].commanded, radius)
        style_axes(middle, axis_label, "height [m]", size=10)
        _draw_view(middle, on_path, machines, side)
        _draw_errors(right, on_path, machines)
    axes[-1][2].set_xlabel("time [s]", color=PALETTE.ink)
    _legend(figure, runs, machines)
    return figure


def top_view(points: Array) -> Array:
    """Points (n, 3) from above, the machine at the bottom: to the right and forward [m], shape (2, n)."""
    return np.stack([-points[:, 1], points[:, 0]])


def side_view(commanded: Array, radius: str) -> tuple[Callable[[Array], Array], str]:
    """The side view of a path (n, 3), a function from points (n, 3) to shape (2, n) [m], and its axis label.

    A path that rises in one upright plane is projected on that plane, so its lengths are true. Any other
    path is drawn in the plane of the arm, which turns.
    """
    horizontal = commanded[:, :2] - commanded[0, :2]
    along = horizontal[np.argmax(np.hypot(*horizontal.T))]
    length = float(np.hypot(*along))
    across = np.abs(horizontal @ [along[1], -along[0]]).max()
    if np.ptp(commanded[:, 2]) > RISING * length > 0 and across < STRAIGHT * length**2:
        origin, direction = commanded[0, :2], along / length
        return lambda p: np.stack([(p[:, :2] - origin) @ direction, p[:, 2]]), "along the ground [m]"
    return lambda p: np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]]), f"{radius} [m]"


def _draw_view(
    axes: Axes, runs: Sequence[PathRun], machines: Sequence[str], view: Callable[[Array], Array]
) -> None:
    """Draw path and tips in one view; both axes have the same scale."""
    axes.plot(*view(runs[0].commanded), color=PALETTE.faint, linewidth=4, alpha=0.5)
    for r in runs:
        axes.plot(*view(r.tip), **_style(r, machines))
    axes.set_aspect("equal", adjustable="datalim")


def _draw_errors(axes: Axes, runs: Sequence[PathRun], machines: Sequence[str]) -> None:
    """Draw the errors over time on a logarithmic scale, as feedback reduces them tenfold and more."""
    style_axes(axes, y="distance to the commanded point [mm]", size=10)
    for r in runs:
        axes.semilogy(r.time, np.maximum(MM * r.error, LEAST_ERROR / 10), **_style(r, machines))
    axes.set_ylim(LEAST_ERROR, None)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")


def _style(run: PathRun, machines: Sequence[str]) -> dict[str, Any]:
    colour = PALETTE.colour(machines.index(run.machine))
    return {"color": colour, "linewidth": 1.3, "linestyle": WITH if run.feedback else WITHOUT}


def _legend(figure: Figure, runs: Sequence[PathRun], machines: Sequence[str]) -> None:
    handles = [Line2D([], [], label="path", color=PALETTE.faint, linewidth=4, alpha=0.5)]
    handles += [
        Line2D([], [], label=name, color=PALETTE.colour(k), linewidth=1.3) for k, name in enumerate(machines)
    ]
    if any(not r.feedback for r in runs):
        handles.append(Line2D([], [], label="without feedback", color=PALETTE.ink, linestyle=WITHOUT))
    legend(figure, handles=handles, loc="outside upper center", ncols=5, fontsize=10)
