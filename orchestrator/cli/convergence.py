"""`harvester convergence`: the error of each master over the communication step."""

from __future__ import annotations

from typing import Annotated, Unpack

from orchestrator.base.options import Kind, Patterns
from orchestrator.cli.options import BUILD, File, Folder, Scenario, System, command, system_file, tell_built
from orchestrator.engine.arguments import CaseArguments


@command
def convergence(
    system: System = None,
    scenario: Scenario = None,
    reference: File | None = None,
    steps: Annotated[str, Kind("S,S,...")] = "0.0005,0.001,0.002,0.005,0.01,0.02",
    masters: Annotated[str, Kind("NAME,...")] = "",
    signals: Patterns = None,
    repeats: Annotated[int, Kind("N")] = 3,
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
    signals     Signals whose error is computed, such as '*_pressure*', one table for each; default: speeds
                and pressures.
    repeats     Number of times that each run is timed, at least 1; the median is reported.
    out         Folder of the tables and figures.
    """
    from fmus.package_files import data
    from orchestrator.studies.convergence.convergence_study import convergence as study

    file, work_cycle = system_file(system), data("reference/work_cycle.csv")
    tell_built(file, {})
    study(file, reference, out, steps, masters, signals or (), repeats, work_cycle, scenario, **options)
