"""`harvester linearize`: a linear model of a system, and its modes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.cli.options import (
    BUILD,
    SYSTEM,
    Parameters,
    Set,
    Swap,
    System,
    app,
    assignments,
    seconds,
    swaps,
)


@app.command()
def linearize(
    system: System = SYSTEM,
    pose: Parameters = None,
    input_: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="NAME",
            help="Input of the linear model; its wire is cut; repeatable; default: what the levers feed"
            " and inputs of the system.",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Outputs, such as '*_angle'; repeatable; default: all."),
    ] = None,
    steady: Annotated[
        bool,
        typer.Option("--steady", help="Find the steady state: joints held where they are, all else at rest."),
    ] = False,
    speed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=V",
            help="With --steady: speed of a joint, such as boom=0.1 [rad/s]; default 0; repeatable.",
        ),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="Operating point: at this time [s] of a run; default: its start.",
            parser=seconds,
        ),
    ] = None,
    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --time: inputs over time of that run.")
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(metavar="S", help="With --time: communication step of that run [s].", parser=seconds),
    ] = None,
    swap: Swap = None,
    set_: Set = None,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the arrays go (.npz); names and modes: .json beside.")
    ] = BUILD / "linear.npz",
) -> None:
    """Modes of a system at an operating point, and A, B, C, D.

    The point: the start (default), a time of a run (--time), or a steady state (--steady).

    A controller that moves the machine, so that its loops are closed:

    harvester linearize build/harvester_control.ssp --pose reach --time 2 --set engaged=1
    --set radial_velocity=-0.3 --set swing_velocity=0.3
    """
    from orchestrator.base.files import there
    from orchestrator.linear import command

    if time is None and (scenario or step):
        raise Problem("--scenario, --step: expected --time with them, the operating point is the start else")
    command.run(
        there(system),
        out,
        parameters=pose or (),
        inputs=input_ or (),
        outputs=output or (),
        steady=steady,
        speeds=command.speeds(speed or []),
        time=time,
        scenario=scenario,
        step=step,
        swap=swaps(swap or []),
        set=assignments(set_ or []),
    )
