"""`harvester validate`: co-simulate a system and compare it with a reference."""

from __future__ import annotations

from typing import Annotated, Unpack

from orchestrator.base.options import Kind, Patterns
from orchestrator.cli.options import BUILD, File, Folder, Scenario, System, command, system_file
from orchestrator.engine.arguments import CoupledArguments


@command
def validate(
    system: System = None,
    scenario: Scenario = None,
    reference: File | None = None,
    monolithic: bool = False,
    limit: Annotated[float | None, Kind("E")] = None,
    layout: File | None = None,
    play: Patterns = None,
    out: Folder = BUILD,
    **options: Unpack[CoupledArguments],
) -> bool:
    """Co-simulate a system and compare it with a reference.

    Writes a report. The exit status is 1 if a limit is exceeded.

    reference    Reference or measurement (.csv, .parquet or .mat, each with a .toml that describes the
                 columns); default: the reference of the work cycle.
    monolithic   Compare with the monolithic solution of the same FMUs, as `harvester reference` computes it,
                 not with a reference file.
    limit        With `monolithic`: largest NRMSE of a signal; default: the limits of the work cycle's
                 reference, 0.01 for systems without its signals.
    layout       Description of the figures in the report (.toml); default: the figures of the harvester; for
                 another system with `reference`: one row per signal.
    play         With `reference` and without `scenario`: further signals of the reference that are inputs of
                 the run, in addition to the commands, such as '*.supply_pressure'; default: none.
    out          Folder of run.csv and the report.
    """
    from fmus.package_files import data
    from orchestrator.base.files import DEFAULT_SYSTEM
    from orchestrator.results.validate_system import validate_system

    file = system_file(system)
    return validate_system(
        file,
        scenario,
        reference,
        layout,
        out,
        default=(data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")),
        play=play or (),
        default_system=DEFAULT_SYSTEM if system else file,
        monolithic=monolithic,
        limit=limit,
        default_accuracy=1e-4,
        **options,
    )
