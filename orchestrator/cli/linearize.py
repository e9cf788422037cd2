"""`harvester linearize`: the linear model of a system at an operating point, and its modes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.cli.options import (
    BUILD,
    Parameters,
    Set,
    Swap,
    System,
    app,
    assignments,
    seconds,
    swaps,
    system_file,
)


@app.command()
def linearize(
    system: System = None,
    pose: Parameters = None,
    input_: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="NAME",
            help=(
                "Input of the linear model, COMPONENT.VARIABLE or all inputs with this name; its "
                "connection is removed; repeatable; default: the inputs of the system, and the "
                "inputs that are connected to operator_input."
            ),
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Outputs COMPONENT.VARIABLE that match, such as '*_angle'; repeatable; default: all.",
        ),
    ] = None,
    steady: Annotated[
        bool,
        typer.Option(
            "--steady",
            help=(
                "Linearize at the steady state with the joint angles of the operating point; all "
                "other states are computed."
            ),
        ),
    ] = False,
    speed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=V",
            help="With --steady: constant speed of a joint [rad/s], such as boom=0.1; repeatable; default:"
            " 0.",
        ),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="Linearize at this time of a run [s]; default: at the start.",
            parser=seconds,
        ),
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=(
                "With --time: inputs of that run over time (.csv, .parquet, .mat); default: the "
                "inputs in the system."
            ),
        ),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help=(
                "With --time: communication step of that run [s]; default: the step in the "
                "system or its FMUs."
            ),
            parser=seconds,
        ),
    ] = None,
    swap: Swap = None,
    set_: Set = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="File for A, B, C, D (.npz); names and modes go to a .json of the same name."
        ),
    ] = BUILD / "linear.npz",
) -> None:
    """Linearize a system at an operating point: A, B, C, D and the modes.

    The operating point is the start (default), a time of a run (--time), or a steady state (--steady).

    Example with a controller that moves the machine, so that its loops are closed:

    harvester linearize build/harvester_control.ssp --pose reach --time 2 --set engaged=1
    --set radial_velocity=-0.3 --set swing_velocity=0.3
    """
    from orchestrator.base.files import make_folder, require_system
    from orchestrator.linear.linearize import linearize as run_linearize

    if time is None and (scenario or step):
        raise Problem(
            "--scenario, --step: expected --time as well; without --time the operating point is the start"
        )
    if out.suffix != ".npz":
        raise Problem(f"--out {out}: expected a file name ending in .npz")
    speeds = _speeds(speed or [])
    make_folder(out.parent)
    linear = run_linearize(
        require_system(system_file(system)),
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
    speeds = assignments(texts, "--speed", "joint=speed, such as boom=0.1")
    for name, value in speeds.items():
        try:
            float(value)
        except ValueError:
            raise Problem(f"--speed {name}={value}: expected a number, got {value!r}") from None
    return {name: float(value) for name, value in speeds.items()}
