"""`harvester run`: co-simulate a system and record its signals."""

from __future__ import annotations

from typing import Unpack

from orchestrator.cli.options import BUILD, File, Scenario, System, command, system_file
from orchestrator.engine.arguments import CommandArguments


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
