"""The command `harvester track`: rides along paths, with feedback and without, as one table and a picture."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import folder
from orchestrator.fmi.description import Value
from orchestrator.results.figures import png
from orchestrator.ssp.load import load
from orchestrator.ssp.system import System
from orchestrator.studies.path_figure import draw
from orchestrator.studies.path_following import (
    MANIPULATOR,
    MM,
    SWITCH,
    Ride,
    assembled,
    data,
    differences,
    ride,
    text,
)

MAKE, EXAMPLE = "harvester build", "build/harvester_control.ssp"


@dataclass(frozen=True)
class Course:
    """A scenario with a path, and how to get to its beginning.

    start   start values that put the tip there, from the numbers of the arm {name: value}; refuses what the
            arm cannot reach
    """

    scenario: Path
    start: Callable[[Mapping[str, float]], Mapping[str, float]]


def track(
    system: Path,
    courses: Sequence[Course],
    machines: Mapping[str, Mapping[str, str]],
    out: Path,
    feedback: Sequence[bool] = (True, False),
    limit: float | None = None,
    **options: Any,
) -> bool:
    """Run every machine {name: swaps} along every course; True if all ended, within the limit [m].

    The limit is for rides with feedback. Writes tracking.png and tracking.json; `options` go to `run`.
    """
    if not system.exists():
        raise Problem(f"{system}: no such file; make it with: {MAKE}")
    whole = load(system)
    if not whole.has(SWITCH):
        raise Problem(f"{system}: has no {SWITCH}, expected a machine with the controller, such as {EXAMPLE}")
    folder(out)
    given = options.pop("set", {})
    found = assembled(whole, machines, given)
    starts = {
        (course, name): {**course.start(machine.components[MANIPULATOR].numbers()), **given}
        for course in courses
        for name, machine in found.items()
    }
    for note in dict.fromkeys(n for machine in found.values() for n in differences(machine)):
        print(f"note: {note}")
    rides = [
        _ride(found[name], course, name, on, start, options)
        for (course, name), start in starts.items()
        for on in feedback
    ]
    print(text(rides))
    print(*_write(rides, out))
    missed = [] if limit is None else [r for r in rides if r.feedback and not r.largest <= limit]
    for r in missed:
        print(f"{r.path}, {r.machine}: {MM * r.largest:.1f} mm, expected at most {MM * (limit or 0):g} mm")
    return not missed and not any(r.failure for r in rides)


def _ride(
    system: System,
    course: Course,
    machine: str,
    feedback: bool,
    start: Mapping[str, Value | str],
    options: Mapping[str, Any],
) -> Ride:
    """A ride; what goes wrong with one machine is told with its name."""
    try:
        return ride(system, course.scenario, machine, feedback, set=start, **options)
    except Problem as problem:
        raise Problem(f"machine {machine}, path {course.scenario.stem}: {problem}") from None


def _write(rides: Iterable[Ride], out: Path) -> tuple[Path, Path]:
    found, picture, numbers = list(rides), out / "tracking.png", out / "tracking.json"
    picture.write_bytes(png(draw(found)))
    told = json.dumps(data(found), indent=1, ensure_ascii=False)
    numbers.write_text(told + "\n", encoding="utf-8", newline="\n")
    return picture, numbers
