"""`harvester convergence`, `track` and `sweep`: many runs of a system, and what they tell."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Unpack

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.options import Kind, Patterns, Sets, Swaps, Values
from orchestrator.cli.options import BUILD, File, Folder, Scenario, System, command, system_file, tell_built
from orchestrator.engine.arguments import CaseArguments


@command
def convergence(
    system: System = None,
    scenario: Scenario = None,
    reference: File | None = None,
    steps: Annotated[str, Kind("S,S,...")] = "0.0005,0.001,0.002,0.005,0.01,0.02",
    masters: Annotated[str, Kind("NAME,...")] = "",
    signals: Patterns | None = None,
    repeats: Annotated[int | None, Kind("N")] = None,
    scheduler: Annotated[str | None, Kind("URL")] = None,
    out: Folder = BUILD / "convergence",
    **options: Unpack[CaseArguments],
) -> None:
    """Compute the error of each master over the communication step, and its cost.

    Prints tables, and writes them as CSV with figures.

    reference   Reference (.csv with .toml); default: the monolithic solution for the work cycle, the hermite
                run with the smallest step for any other run.
    steps       Communication steps [s], separated by commas.
    masters     Names of masters (jacobi, gauss-seidel, hermite, interface-jacobian), labels of settings such
                as 'hermite 2 passes', or patterns of labels such as '*order 1', separated by commas; default:
                all.
    signals     Signals whose error is computed, such as '*_pressure' or, with component, 'boom_stick.*', one
                table for each; default: speeds and pressures.
    repeats     Number of times that each run is timed, at least 1; the median is reported; default: 3.
    scheduler   Run on this Dask cluster, such as tcp://host:8786, without times: runs that share computers
                have none to compare; default: this computer.
    out         Folder of the tables and figures.
    """
    require("sweep", "harvester convergence", "scipy")
    from fmus.package_files import data
    from orchestrator.lanes.many import connected
    from orchestrator.studies.convergence import convergence_study as study

    if repeats is not None and scheduler:
        raise Problem("--repeats: expected none with --scheduler, whose runs are not timed")
    file, work_cycle = system_file(system), data("reference/work_cycle.csv")
    tell_built(file, {})
    chosen = study.read_steps(steps), study.items(masters), signals or (), 3 if repeats is None else repeats
    with connected(scheduler) as client:
        study.convergence(file, out, *chosen, reference, work_cycle, scenario, client=client, **options)


PATHS = ("line", "square")


@command
def track(
    system: System = None,
    path: Annotated[list[str] | None, Kind("NAME")] = None,
    through: Annotated[list[str] | None, Kind("X,Y,Z")] = None,
    speed: Annotated[float, Kind("V")] = 0.5,
    swap: Swaps | None = None,
    parameters: Sets | None = None,
    set_: Values | None = None,
    compare: bool = True,
    shape_sway: bool = False,
    sway_period: Annotated[float | None, Kind("S", "s", least=0.1)] = None,
    learned: File | None = None,
    limit: Annotated[float | None, Kind("MM")] = None,
    yes: bool = False,
    out: Folder = BUILD,
) -> bool:
    """Move the tip along paths and measure the tracking error, with and without the controller's feedback.

    Runs the machine as built and the detailed one; with --swap only the machine with these variants. A
    variable of --set must exist in each machine, so --set supply.pressure_setting=15e6 needs
    --swap supply=ideal. What a path asks beyond strokes, speeds, flow or pressure is a warning before the
    first run; a path out of reach is refused.

    system       The machine with its controller (.ssp); default: build/harvester_control.ssp, else the one in
                 the installed package.
    path         line, square, or a table (.csv) of time, path_radius, path_height, path_angle; default: line
                 and square.
    through      Point (forward, left, up [m]) of a path of straight lines, such as 3.6,-2,1; replaces `path`;
                 two points or more.
    speed        With `through`: speed along the path [m/s], if the path is long enough to reach it.
    compare      Also run without the controller's feedback.
    shape_sway   Shape each move so that the hanging head is at rest after it; a move lasts one period of each
                 of its modes longer. Writes PATH_shaped.csv.
    sway_period  Shape moves for this period of the head [s]; default: that of the machine.
    learned      Write what the controller of one machine has learned of its valves to this file (.ssv), for
                 `parameters`; each path begins with what was learned on the one before. Needs
                 --set controller.learning=1.
    limit        Largest tracking error allowed [mm]; above it the exit status is 1; default: no limit.
    out          Folder of tracking.png and tracking.json.
    """
    require("model", "harvester track")
    from fmus.controller.paths import route_start_angles, start_angles, write_route
    from fmus.crane.machine import tracked
    from fmus.machine.feasible import MECHANICS
    from fmus.machine.parts import MACHINES
    from fmus.machine.path_following import HARVESTER, first_point
    from fmus.machine.path_following import track as run_study
    from orchestrator.ssp.load import load

    names, mechanics, own = HARVESTER, MECHANICS, False
    machine = system_file(system, "harvester_control.ssp")
    if crane := tracked(load(machine)):
        (names, mechanics), own = crane, True
        if not (path or through):
            harvester = f"{' and '.join(PATHS)} are paths of the harvester"
            raise Problem(f"{machine}: expected --through or --path, got neither: {harvester}")
    if path and through:
        raise Problem("--path and --through: expected one of them")
    if through:
        file, highest = write_route(through, speed, out)
        paths = [(file, partial(route_start_angles, through, controller=mechanics.controller))]
        if highest < speed:
            print(f"note: --speed {speed:g}: the path is too short for more than {highest:.2g} m/s")
    else:
        files = [_file(p) for p in path or PATHS]
        first = {file: first_point(file, names.path) for file in files}
        at_start = partial(start_angles, controller=mechanics.controller)
        paths = [(file, partial(at_start, str(file), at)) for file, at in first.items()]
    swapped = {component: str(file) for component, file in (swap or {}).items()}
    shipped = {machine.stem: {}} if own else MACHINES
    machines = {", ".join(map("=".join, swapped.items())): swapped} if swapped else shipped
    modes = (True, False) if compare else (True,)
    tell_built(machine, {})
    allowed = None if limit is None else limit / 1e3
    sets = parameters or ()
    sway = sway_period or (0.0 if shape_sway else None)
    given = set_ or {}
    return run_study(
        machine,
        names,
        mechanics,
        paths,
        machines,
        out,
        modes,
        allowed,
        given,
        print,
        yes,
        sets,
        sway,
        learned,
    )


def _file(name: str) -> Path:
    """The scenario of a path."""
    from fmus.package_files import data

    if name in PATHS:
        return data(f"scenarios/{name}.csv")
    if not Path(name).suffix:
        raise Problem(f"--path {name}: expected {', '.join(PATHS)} or a file (.csv, .parquet)")
    return Path(name)


@command
def sweep(
    study: Annotated[Path, Kind("STUDY.toml", positional=True)],
    out: Annotated[str | None, Kind("DIR")] = None,
    workers: Annotated[int | None, Kind("N", least=1)] = None,
    scheduler: Annotated[str | None, Kind("URL")] = None,
    fresh: bool = False,
    no_report: bool = False,
) -> bool:
    """Run a parameter study on all cores, or on a cluster.

    An interrupted study continues when it is started again. The exit status is 1 if no run succeeded, or none
    is reliable.

    study       Description of the study: what is varied, what is run, and which results are kept.
    out         Folder of the results, or its URL such as s3://bucket/study; default: build/sweeps/STUDY.
    workers     Number of runs at the same time on this computer; default: one per core.
    scheduler   Run on this Dask cluster instead, such as tcp://host:8786; default: this computer.
    fresh       Delete earlier results in DIR and start again.
    no_report   Leave out the page report.html.
    """
    require("sweep", "harvester sweep")
    from orchestrator.lanes.group import Status
    from orchestrator.studies import parameter_study, read_study
    from orchestrator.studies.store import RUNS, place

    chosen = read_study(study)
    tell_built(chosen.system_file, {})
    if workers and scheduler:
        cluster = "whose cluster determines the number of workers"
        raise Problem(f"--workers: expected none with --scheduler, {cluster}")
    folder = place(out or parameter_study.FOLDER / study.stem)
    run = partial(parameter_study.sweep, workers=workers, scheduler=scheduler, fresh=fresh)
    with parameter_study.progress() as watch:
        results = run(chosen, folder, watch=watch)
    status = results.columns("status")["status"]
    if no_report:
        from orchestrator.studies.analysis.results import counts, failures
        from orchestrator.studies.study_page import causes

        warnings = (f"warning: {w}" for w in results.warnings)
        print("\n".join([counts(results), *causes(failures(results)), *warnings]))
    else:
        from orchestrator.studies import study_page

        print(study_page.write(folder, results).text())
    print(f"\n{folder / RUNS}: {len(status)} runs, {len(results.dataset.schema)} columns")
    if not no_report:
        print(f"report: {folder / study_page.PAGE}")
    return not status.isin((Status.FAILED, Status.NOT_RELIABLE)).all()
