"""`harvester variants`, `parameters` and `signals`: lists of what the machine and a system contain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, Swap, System, app, swaps, system_file


@app.command()
def variants(
    system: Annotated[
        Path | None,
        typer.Argument(
            metavar="SYSTEM",
            help="System in which the cost of the variants is measured; default: build/harvester.ssp, else"
            " the one in the installed package.",
        ),
    ] = None,
    combinations: Annotated[
        bool,
        typer.Option("--combinations", help="Run the work cycle with every combination of variants instead."),
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="With --combinations: file for the table (.csv).")
    ] = BUILD / "combinations.csv",
) -> None:
    """List the variants of each part, with numbers of states and inputs, and the range of validity.

    Also measures the simulation time of each variant on this computer.
    """
    from fmus.machine.parts import FAMILIES
    from fmus.machine.tables import variant_lines, variant_names
    from orchestrator.studies.variants import costs, table

    system = system_file(system)
    if combinations:
        joints = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
        if not table(system, {part: list(family) for part, family in FAMILIES.items()}, joints, out):
            raise typer.Exit(1)
        return
    print("\n".join(variant_lines(costs(system, variant_names()) if system.exists() else {})))
    if not system.exists():
        print(f"{system} does not exist, so no cost was measured; build it with: harvester build")


@app.command()
def parameters(
    subsystem: Annotated[
        str | None,
        typer.Argument(
            help="A part or a variant of a part, such as swing or swing_detailed, or a part of the names of"
            " parameters, such as hose; default: the whole machine."
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="Only parameters of this source: paper, derived, literature, assumed or identified;"
            " default: all.",
        ),
    ] = None,
) -> None:
    """Print the parameters of the model with value, unit and source.

    If FMUs in the folder build were built with other values, prints these and the shipped values.
    """
    from fmus.machine.tables import print_parameters

    print_parameters(subsystem, source, BUILD)


@app.command()
def signals(
    system: System = None,
    kind: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="Only this kind: input, output or parameter; default: all."),
    ] = None,
    swap: Swap = None,
) -> None:
    """List the variables of a system with unit and description."""
    from orchestrator.base.files import require_system
    from orchestrator.ssp.listing import lines
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    print("\n".join(lines(with_swaps(load(require_system(system_file(system))), swaps(swap or [])), kind)))
