"""`harvester reference`: solve a system as one ODE, the limit of all co-simulations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import (
    BUILD,
    RunOptions,
    System,
    app,
    number,
    seconds,
    system_file,
    with_option_groups,
)


@app.command()
@with_option_groups
def reference(
    *,
    system: System = None,
    case: RunOptions,
    record_step: Annotated[
        float, typer.Option(metavar="H", help="Time between recorded points [s].", parser=seconds)
    ] = 5e-3,
    tolerance: Annotated[
        float,
        typer.Option(metavar="TOL", help="Relative tolerance of the solver, 1e-14 to 1e-2.", parser=number),
    ] = 2e-14,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the trace (.csv, .parquet, .mat).")
    ] = BUILD / "reference.csv",
) -> None:
    """Solve a system as one ODE, to which co-simulations converge.

    With an FMU without Model Exchange the result is a co-simulation with a small step, and says so, with an
    estimate of its error. `harvester compare` compares a run with the result.
    """
    from orchestrator.base.files import make_folder
    from orchestrator.data.trace import check_suffix
    from orchestrator.monolithic.reference import reference as solve

    check_suffix(out)
    make_folder(out.parent)
    options = case.options()
    options |= {"record_step": record_step, "tolerance": tolerance}
    result = solve(system_file(system), case.scenario, **options, progress=True)
    print(f"{result.card.text()}\n\n{result.write(out)}")
