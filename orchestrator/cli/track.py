"""`harvester track`: the tip along paths."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.cli.options import BUILD, Set, Swap, app, assignments, number, swaps

CONTROLLED = BUILD / "harvester_control.ssp"
MACHINES = {
    "lumped": dict[str, str](),
    "detailed": {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
}
PATHS = ("line", "square")


@app.command()
def track(
    system: Annotated[
        Path, typer.Argument(metavar="SYSTEM", help="The machine with its controller (.ssp).")
    ] = CONTROLLED,
    path: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="line, square, or a table (.csv) of time, path_radius, path_height, path_angle; repeatable;"
            " default: line and square.",
        ),
    ] = None,
    through: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Straight from point to point instead: forward, to the left, up [m]; repeatable.",
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(
            metavar="V",
            help="With --through: speed [m/s], where the way is long enough to get there.",
            parser=number,
        ),
    ] = 0.5,
    swap: Swap = None,
    set_: Set = None,
    compare: Annotated[
        bool, typer.Option("--compare/--no-compare", help="Run without the controller's feedback, too.")
    ] = True,
    limit: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Exit status 1 if the tip is farther off [mm].", parser=number),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where tracking.png and tracking.json go.")
    ] = BUILD,
) -> None:
    """Draw paths with the tip, and tell how far off it is.

    With the controller's feedback and without.

    By the machine as built and by the detailed one; with --swap by that one alone. A value of --set must be
    there in each: with supply.pressure_setting=15e6 comes --swap supply=ideal.
    """
    from fmus.controller.paths import course, route
    from fmus.controller.paths import through as reached
    from orchestrator.studies.path_following import beginning
    from orchestrator.studies.path_study import track as tracked

    if path and through:
        raise Problem("--path and --through: expected one of them")
    if through:
        file, highest = route(through, speed, out)
        paths = [(file, partial(reached, through))]
        if highest < speed:
            print(f"note: --speed {speed:g}: up to {highest:.2g} m/s, the way is too short for more")
    else:
        files = [_file(p) for p in path or PATHS]
        paths = [(file, partial(course, str(file), beginning(file))) for file in files]
    machines = {", ".join(swap): swaps(swap)} if swap else MACHINES
    modes = (True, False) if compare else (True,)
    most = None if limit is None else limit / 1e3
    if not tracked(system, paths, machines, out, modes, most, set=assignments(set_ or [])):
        raise typer.Exit(1)


def _file(name: str) -> Path:
    """The scenario of a path."""
    from fmus.machine.build import data

    if name in PATHS:
        return data(f"scenarios/{name}.csv")
    if not Path(name).suffix:
        raise Problem(f"--path {name}: expected {', '.join(PATHS)} or a file (.csv, .parquet)")
    return Path(name)
