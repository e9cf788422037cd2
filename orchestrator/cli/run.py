"""`harvester run`, `reference` and `linearize`: simulate a system, solve it as one ODE, or linearize it."""

from __future__ import annotations

from typing import Unpack

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import make_folder, require_system
from orchestrator.base.options import chosen
from orchestrator.cli.options import BUILD, File, Scenario, System, command, system_file
from orchestrator.engine.arguments import CommandArguments, LinearArguments, ReferenceArguments
from orchestrator.engine.options import DEFAULT_ACCURACY, RunOptions

NOT_RELIABLE = 3  # exit status


@command
def run(
    system: System = None,
    scenario: Scenario = None,
    out: File = BUILD / "trace.csv",
    **options: Unpack[CommandArguments],
) -> int:
    """Co-simulate a system and record its signals.

    The exit status is 3 if the error of the coupling is so large that the result is not reliable.

    out   File for the trace (.csv, .parquet, .mat).
    """
    from orchestrator.engine.isolated import start_process

    file = system_file(system)
    start_process()  # before the slow imports
    from orchestrator.engine.run import run_to_file

    asked = chosen(RunOptions, options, "run")
    result, line = run_to_file(file, scenario, out, default_accuracy=DEFAULT_ACCURACY["run"], options=asked)
    print(f"{result.card.text()}\n\n{line}")
    return 0 if result.reliable else NOT_RELIABLE


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
    from orchestrator.data.trace import check_suffix
    from orchestrator.monolithic.reference import reference as solve

    check_suffix(out)
    make_folder(out.parent)
    result = solve(system_file(system), scenario, progress=True, **options)
    print(f"{result.card.text()}\n\n{result.write(out)}")


@command
def linearize(
    system: System = None,
    scenario: File | None = None,
    out: File = BUILD / "linear.npz",
    **options: Unpack[LinearArguments],
) -> None:
    """Linearize a system at an operating point: A, B, C, D and the modes.

    The operating point is the start (default), a time of a run (--time), or a steady state (--steady).

    Example with a controller that moves the machine, so that its loops are closed:

    harvester linearize build/harvester_control.ssp --pose reach --time 2 --set engaged=1
    --set radial_velocity=-0.3 --set swing_velocity=0.3

    scenario   With `time`: inputs of that run over time (.csv, .parquet, .mat); default: the inputs in the
               system.
    out        File for A, B, C, D (.npz); names and modes go to a .json of the same name.
    """
    from orchestrator.linear.linearize import linearize as run_linearize

    require("control", "harvester linearize", "scipy")
    if out.suffix != ".npz":
        raise Problem(f"--out {out}: expected a file name ending in .npz")
    linear = run_linearize(require_system(system_file(system)), scenario, **options)
    make_folder(out.parent)
    print(linear.text())
    arrays, names = linear.save(out)
    print(f"\nA, B, C, D: {arrays}\nnames and modes: {names}")
