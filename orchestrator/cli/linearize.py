"""`harvester linearize`: a linear model of a system, and its modes."""

from __future__ import annotations

from collections.abc import Sequence
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
    from orchestrator.base.files import folder, there
    from orchestrator.linear.linearize import linearize as run_linearize

    if time is None and (scenario or step):
        raise Problem("--scenario, --step: expected --time with them, the operating point is the start else")
    if out.suffix != ".npz":
        raise Problem(f"--out {out}: expected a file name ending in .npz")
    speeds = _speeds(speed or [])
    folder(out.parent)
    linear = run_linearize(
        there(system),
        parameters=pose or (),
        inputs=input_ or (),
        outputs=output or (),
        steady=steady,
        speeds=speeds,
        time=time,
        scenario=scenario,
        step=step,
        swap=swaps(swap or []),
        set=assignments(set_ or []),
    )
    print(linear.text())
    arrays, names = linear.save(out)
    print(f"\nA, B, C, D: {arrays}\nnames and modes: {names}")


def _speeds(texts: Sequence[str]) -> dict[str, float]:
    """{joint: speed} from the texts 'joint=speed'."""
    found = assignments(texts, "--speed", "joint=speed, such as boom=0.1")
    for name, value in found.items():
        try:
            float(value)
        except ValueError:
            raise Problem(f"--speed {name}={value}: expected a number, got {value!r}") from None
    return {name: float(value) for name, value in found.items()}
