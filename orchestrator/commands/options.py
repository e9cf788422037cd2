"""Options that several commands share, in groups; a command takes a group as one parameter, see `spread`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from orchestrator.commands.reading import seconds
from orchestrator.commands.texts import assignments, swaps

System = Annotated[Path, typer.Argument(metavar="SYSTEM", help="An .ssp, .ssd or .fmu file.")]
Start = Annotated[float | None, typer.Option(metavar="T", help="Start time [s].", parser=seconds)]
Stop = Annotated[float | None, typer.Option(metavar="T", help="Stop time [s].", parser=seconds)]
Swap = Annotated[
    list[str] | None,
    typer.Option(
        metavar="COMPONENT=FMU",
        help="Another FMU in the place of a component: the name of a variant, such as boom_stick=detailed,"
        " or a path, boom_stick=FILE.fmu; repeatable.",
    ),
]

Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--parameters",
        "--pose",
        metavar="SET",
        help="Parameter set: the name of one in the system, such as reach, or a FILE.ssv; repeatable.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Start value of a COMPONENT.VARIABLE, such as manipulator.head_mass=600, or of all inputs of a"
        " name (supply_pressure sets both drives); repeatable.",
    ),
]


@dataclass(frozen=True)
class Case:
    """What is run."""

    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Inputs over time (.csv, .parquet); default: what the system plays by itself,"
            " for the harvester the work cycle.",
        ),
    ] = None
    start: Start = None
    stop: Stop = None
    swap: Swap = None
    parameters: Parameters = None
    set_: Set = None
    cut: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TARGET",
            help="Leave out the connections to these inputs, such as '*_rate'; repeatable.",
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """As the functions of the commands take them, but the scenario."""
        return {
            "start": self.start,
            "stop": self.stop,
            "swap": swaps(self.swap or []),
            "parameters": self.parameters or (),
            "set": assignments(self.set_ or []),
            "cut": self.cut or (),
        }


@dataclass(frozen=True)
class Steps:
    """How long the steps are, and what is recorded of them."""

    step: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Communication step [s], with --adaptive the first to try; default: what the system or its"
            " FMUs suggest, 1e-3 for the harvester.",
            parser=seconds,
        ),
    ] = None
    record_step: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Time between recorded points [s], a multiple of the step; default: 0.005, at least a step."
            " With --adaptive any time; default: every step (validate: 0.005).",
            parser=seconds,
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """As the functions of the commands take them."""
        return {"step": self.step, "record_step": self.record_step}
