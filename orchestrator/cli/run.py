"""`harvester run` and `reference`: simulate a system and record its signals."""

from __future__ import annotations

from typing import Unpack

from orchestrator.cli.options import BUILD, File, Scenario, System, command, system_file
from orchestrator.engine.arguments import CommandArguments, ReferenceArguments


@command
def run(
    system: System = None,
    scenario: Scenario = None,
    out: File = BUILD / "trace.csv",
    **options: Unpack[CommandArguments],
) -> None:
    """Co-simulate a system and record its signals.

    out   File for the trace (.csv, .parquet, .mat).
    """
    from orchestrator.engine.isolated import start_process

    file = system_file(system)
    start_process()  # before the slow imports
    from orchestrator.engine.run import run_to_file

    result, line = run_to_file(file, scenario, out, default_accuracy=1e-3, **options)
    print(f"{result.card.text()}\n\n{line}")


@command
def reference(
    system: System = None,
    scenario: Scenario = None,
    out: File = BUILD / "reference.csv",
    **options: Unpack[ReferenceArguments],
) -> None:
    """Solve a system as one ODE, to which co-simulations converge.

    With an FMU without Model Exchange the result is a co-simulation with a small step, and says so, with an
    estimate of its error. `harvester compare` compares a run with the result.

    out   File for the trace (.csv, .parquet, .mat).
    """
    from orchestrator.base.files import make_folder
    from orchestrator.data.trace import check_suffix
    from orchestrator.monolithic.reference import reference as solve

    check_suffix(out)
    make_folder(out.parent)
    result = solve(system_file(system), scenario, progress=True, **options)
    print(f"{result.card.text()}\n\n{result.write(out)}")
