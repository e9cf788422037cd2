"""`harvester track`: move the tip along paths, and measure the tracking error."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.options import Kind, Swaps, Values
from orchestrator.cli.options import BUILD, Folder, System, command, system_file, tell_built

PATHS = ("line", "square")


@command
def track(
    system: System = None,
    path: Annotated[list[str] | None, Kind("NAME")] = None,
    through: Annotated[list[str] | None, Kind("X,Y,Z")] = None,
    speed: Annotated[float, Kind("V")] = 0.5,
    swap: Swaps = None,
    set_: Values = None,
    compare: bool = True,
    limit: Annotated[float | None, Kind("MM")] = None,
    out: Folder = BUILD,
) -> bool:
    """Move the tip along paths and measure the tracking error, with and without the controller's feedback.

    Runs the machine as built and the detailed one; with --swap only the machine with these variants. A
    variable of --set must exist in each machine, so --set supply.pressure_setting=15e6 needs
    --swap supply=ideal.

    system    The machine with its controller (.ssp); default: build/harvester_control.ssp, else the one in
              the installed package.
    path      line, square, or a table (.csv) of time, path_radius, path_height, path_angle; default: line and
              square.
    through   Point (forward, left, up [m]) of a path of straight lines, such as 3.6,-2,1; replaces `path`;
              two points or more.
    speed     With `through`: speed along the path [m/s], if the path is long enough to reach it.
    compare   Also run without the controller's feedback.
    limit     Largest tracking error allowed [mm]; above it the exit status is 1; default: no limit.
    out       Folder of tracking.png and tracking.json.
    """
    from fmus.controller.paths import route_start_angles, start_angles, write_route
    from fmus.machine.parts import MACHINES
    from fmus.package_files import PACKAGE
    from orchestrator.studies.path_following import first_point, read_machine
    from orchestrator.studies.path_following import track as run_study

    names = read_machine(PACKAGE / "controller/tracking.toml")
    if path and through:
        raise Problem("--path and --through: expected one of them")
    if through:
        file, highest = write_route(through, speed, out)
        paths = [(file, partial(route_start_angles, through))]
        if highest < speed:
            print(f"note: --speed {speed:g}: the path is too short for more than {highest:.2g} m/s")
    else:
        files = [_file(p) for p in path or PATHS]
        paths = [(file, partial(start_angles, str(file), first_point(file, names.path))) for file in files]
    swapped = {component: str(file) for component, file in (swap or {}).items()}
    machines = {", ".join(map("=".join, swapped.items())): swapped} if swapped else MACHINES
    modes = (True, False) if compare else (True,)
    machine = system_file(system, "harvester_control.ssp")
    tell_built(machine, {})
    allowed = None if limit is None else limit / 1e3
    return run_study(machine, names, paths, machines, out, modes, allowed, set_ or {})


def _file(name: str) -> Path:
    """The scenario of a path."""
    from fmus.package_files import data

    if name in PATHS:
        return data(f"scenarios/{name}.csv")
    if not Path(name).suffix:
        raise Problem(f"--path {name}: expected {', '.join(PATHS)} or a file (.csv, .parquet)")
    return Path(name)
