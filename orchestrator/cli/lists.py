"""`harvester variants`, `parameters`, `signals`: what there is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, SYSTEM, Swap, System, app, swaps


@app.command()
def variants(
    system: Annotated[
        Path, typer.Argument(metavar="SYSTEM", help="The built system, to measure costs in.")
    ] = SYSTEM,
    combinations: Annotated[
        bool, typer.Option("--combinations", help="Run the work cycle with every combination of variants.")
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the table of combinations goes (.csv).")
    ] = BUILD / "combinations.csv",
) -> None:
    """List the variants of each part, and what they cost here.

    With states, inputs and range of validity.
    """
    from fmus.machine.parts import FAMILIES
    from fmus.machine.tables import variant_lines, variant_names
    from orchestrator.studies.variants import costs, table

    if combinations:
        joints = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
        if not table(system, {part: list(family) for part, family in FAMILIES.items()}, joints, out):
            raise typer.Exit(1)
        return
    print("\n".join(variant_lines(costs(system, variant_names()) if system.exists() else {})))
    if not system.exists():
        print(f"{system} is not built: no costs measured; make it with: harvester build")


@app.command()
def parameters(
    subsystem: Annotated[
        str | None,
        typer.Argument(
            help="A part or a variant of it, such as swing or swing_detailed; default: the machine"
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="WORD", help="Only numbers with this source, such as paper or assumed."),
    ] = None,
) -> None:
    """Print the numbers of the model with unit and source."""
    from fmus.machine.tables import print_parameters

    print_parameters(subsystem, source)


@app.command()
def signals(
    system: System = SYSTEM,
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Only input, output or parameter.")] = None,
    swap: Swap = None,
) -> None:
    """List the variables of a system with unit and meaning."""

    from orchestrator.base.files import there
    from orchestrator.ssp.listing import lines
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    print("\n".join(lines(with_swaps(load(there(system)), swaps(swap or [])), kind)))
