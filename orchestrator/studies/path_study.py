"""`harvester track`: every machine follows every path, with the controller's feedback and without."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder
from orchestrator.base.text import TextTable
from orchestrator.fmi.description import Value
from orchestrator.pages.html_page import write_json
from orchestrator.pages.plotting import png
from orchestrator.ssp.load import load
from orchestrator.ssp.plausible import doubtful_starts
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System
from orchestrator.studies.path_figure import draw
from orchestrator.studies.path_following import PathRun, TrackedMachine, follow

SAME_VALUE = 1e-9  # relative difference up to which two parameter values are equal
FAR = 0.1  # [m]: a larger error is reported with its cause; usual errors are ten times smaller
MM = 1e3
HEAD = ("path", "machine", "feedback", "largest [mm]", "at [s]", "RMS [mm]", "last [mm]", "times as large")

Start = Callable[[Mapping[str, float]], Mapping[str, float]]


def track(
    system: Path,
    names: TrackedMachine,
    paths: Sequence[tuple[Path, Start]],
    machines: Mapping[str, Mapping[str, str]],
    out: Path,
    feedback: Sequence[bool] = (True, False),
    limit: float | None = None,
    given: Mapping[str, Value | str] = MappingProxyType({}),
) -> bool:
    """Run every machine along every path; print a table, write tracking.png and tracking.json.

    paths     scenarios, each with a function from parameter values of its follower to start values for the
              first point of the path; the function raises a Problem if that point is out of reach
    machines  name -> variants {component: variant}
    limit     largest allowed error with feedback [m]
    given     start values of all runs

    Returns True if all runs came to the end, within the limit.
    """
    loaded = load(system)
    if not loaded.has(names.feedback):
        example = f"a machine with the controller, such as {names.example}"
        raise Problem(f"{system}: expected {example}, got no variable {names.feedback}")
    make_folder(out)
    systems = swapped_systems(loaded, names, machines, given)
    # All start values are computed first: a point out of reach is reported before anything runs.
    tasks = [
        (path, name, {**start(machine.components[names.follower].real_parameters()), **given})
        for path, start in paths
        for name, machine in systems.items()
    ]
    for note in dict.fromkeys(n for machine in systems.values() for n in differences(machine, names)):
        print(f"note: {note}")
    for doubts in dict.fromkeys(filter(None, (d for m in systems.values() for d in doubtful_starts(m)))):
        print(f"warning: {doubts}")
    runs = [
        follow(systems[name], names, path, name, on, start) for path, name, start in tasks for on in feedback
    ]
    figure, json = out / "tracking.png", out / "tracking.json"
    print(text(runs))
    figure.write_bytes(png(draw(runs)))
    write_json(json, [as_dict(r) for r in runs])
    print(figure, json)
    beyond = [] if limit is None else [r for r in runs if r.feedback and not r.largest <= limit]
    for r in beyond:
        print(
            f"{r.path}, {r.machine}: expected at most {MM * (limit or 0):g} mm, got {MM * r.largest:.1f} mm"
        )
    return not beyond and not any(r.failure for r in runs)


def swapped_systems(
    system: System,
    names: TrackedMachine,
    machines: Mapping[str, Mapping[str, str]],
    start: Mapping[str, Value | str],
) -> dict[str, System]:
    """Every machine {name: variants} with these start values; all machines must have these variables."""
    systems = {name: with_swaps(system, variants) for name, variants in machines.items()}
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
    return {
        name: machine.with_start({**copied_parameters(machine, names), **start})
        for name, machine in systems.items()
    }


def copied_parameters(system: System, names: TrackedMachine) -> dict[str, float]:
    """Parameters of the controller that it gets from this machine."""
    return {
        f"{names.controller}.{name}": value
        for part, component in system.components.items()
        for name, value in ({} if part == names.controller else component.real_parameters()).items()
        if name.endswith(names.copied) and system.has(f"{names.controller}.{name}")
    }


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
            if assumed_name not in assumed or _equal(assumed[assumed_name], value):
                continue
            variable = component.interface.variables[name]
            unit = variable.unit
            a, b = f"{names.controller}.{assumed_name}", f"{part}.{name}"
            if controller.interface.variables[assumed_name].unit == unit:
                suffix = f" {unit.name}" if unit and unit.name != "1" else ""
                meaning = f" ({variable.description})" if 0 in (value, assumed[assumed_name]) else ""
                notes.append(
                    f"{a} is {assumed[assumed_name]:.6g}{suffix}, {b} is {value:.6g}{suffix}{meaning}:"
                    " the controller assumes another machine"
                )
    return notes


def _equal(a: float, b: float) -> bool:
    return abs(a - b) <= SAME_VALUE * max(abs(a), abs(b))


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
    failed = [
        f"{r.path}, {r.machine}: ended early at {r.time[-1]:.3g} s: {r.failure}" for r in runs if r.failure
    ]
    far = [
        f"{r.path}, {r.machine}: the tip is up to {r.largest:.2f} m away, {r.last:.2f} m at the end{r.cause}"
        for r in runs
        if r.feedback and not r.failure and r.largest > FAR
    ]
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
