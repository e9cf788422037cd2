"""`harvester linearize`: the linear model of a system at an operating point, and its modes."""

from __future__ import annotations

from typing import Unpack

from orchestrator.base.errors import Problem
from orchestrator.cli.options import BUILD, File, System, command, system_file
from orchestrator.engine.arguments import LinearArguments


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
    from orchestrator.base.files import make_folder, require_system
    from orchestrator.linear.linearize import linearize as run_linearize

    if out.suffix != ".npz":
        raise Problem(f"--out {out}: expected a file name ending in .npz")
    linear = run_linearize(require_system(system_file(system)), scenario, **options)
    make_folder(out.parent)
    print(linear.text())
    arrays, names = linear.save(out)
    print(f"\nA, B, C, D: {arrays}\nnames and modes: {names}")
