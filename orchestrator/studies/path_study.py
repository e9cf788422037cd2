"""`harvester track`: every machine follows every path, with the controller's feedback and without."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import make_folder
from orchestrator.base.html_page import write_json
from orchestrator.base.plotting import png
from orchestrator.ssp.load import load
from orchestrator.studies.path_figure import draw
from orchestrator.studies.path_following import (
    FEEDBACK,
    MANIPULATOR,
    MM,
    assembled,
    data,
    differences,
    follow,
    text,
)

Start = Callable[[Mapping[str, float]], Mapping[str, float]]


def track(
    system: Path,
    paths: Sequence[tuple[Path, Start]],
    machines: Mapping[str, Mapping[str, str]],
    out: Path,
    feedback: Sequence[bool] = (True, False),
    limit: float | None = None,
    **options: Any,
) -> bool:
    """Run every machine along every path; print a table, write tracking.png and tracking.json.

    paths     scenarios, each with a function from the numbers of the arm to the start values that put the tip
              at the beginning of the path; it raises a Problem where the arm cannot reach that point
    machines  name -> variants {component: variant}
    limit     on the error with feedback [m]
    options   of `run`

    Returns True if all runs came to the end, within the limit.
    """
    if not system.exists():
        raise Problem(f"{system}: no such file; make it with: harvester build")
    whole = load(system)
    if not whole.has(FEEDBACK):
        example = "a machine with the controller, such as build/harvester_control.ssp"
        raise Problem(f"{system}: has no {FEEDBACK}, expected {example}")
    make_folder(out)
    given = options.pop("set", {})
    systems = assembled(whole, machines, given)
    # all start values first: a point out of reach is reported before anything runs
    tasks = [
        (path, name, {**start(machine.components[MANIPULATOR].numbers()), **given})
        for path, start in paths
        for name, machine in systems.items()
    ]
    for note in dict.fromkeys(n for machine in systems.values() for n in differences(machine)):
        print(f"note: {note}")
    runs = [
        follow(systems[name], path, name, on, set=start, **options)
        for path, name, start in tasks
        for on in feedback
    ]
    figure, numbers = out / "tracking.png", out / "tracking.json"
    print(text(runs))
    figure.write_bytes(png(draw(runs)))
    write_json(numbers, data(runs))
    print(figure, numbers)
    beyond = [] if limit is None else [r for r in runs if r.feedback and not r.largest <= limit]
    for r in beyond:
        print(f"{r.path}, {r.machine}: {MM * r.largest:.1f} mm, expected at most {MM * (limit or 0):g} mm")
    return not beyond and not any(r.failure for r in runs)
