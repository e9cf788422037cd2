"""Options that several commands share, in groups; a command takes a group as one parameter, see `spread`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from orchestrator.commands.texts import assignments, factors, swaps

T = TypeVar("T")


def seconds(text: str) -> float:
    """A time [s] from the text of an option."""
    return _read(text, float, "a number of seconds")


def number(text: str) -> float:
    """A number from the text of an option."""
    return _read(text, float, "a number")


def whole(text: str) -> int:
    """A whole number from the text of an option."""
    return _read(text, int, "a whole number")


def _read(text: str, kind: Callable[[str], T], expected: str) -> T:
    try:
        return kind(text)
    except ValueError:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None


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
    parameters: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SET",
            help="Parameter set: the name of one in the system, such as reach, or a FILE.ssv; repeatable.",
        ),
    ] = None
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Start value of a COMPONENT.VARIABLE, or of all inputs of a name"
            " (supply_pressure sets both drives); repeatable.",
        ),
    ] = None
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


@dataclass(frozen=True)
class Coupled:
    """How the components are coupled: the choices of `Coupling`."""

    master: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="jacobi, gauss-seidel, hermite or interface-jacobian; default: what the system suggests,"
            " else gauss-seidel.",
        ),
    ] = None
    order: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Order at which outputs are extrapolated over a step: 0 (held), 1, 2 or 3; default: 0 for"
            " jacobi and gauss-seidel, else 3.",
            parser=whole,
        ),
    ] = None
    passes: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="hermite: compute a step at most so many times; default: 8.",
            parser=whole,
        ),
    ] = None
    coupling_tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help="hermite: compute a step again while a signal is off by more than TOL of its magnitude;"
            " default: 1e-4, with --adaptive 0.3 of its TOL.",
            parser=number,
        ),
    ] = None
    correct: Annotated[
        bool,
        typer.Option("--correct", help="Give inputs back what extrapolation lost over the step before."),
    ] = False
    lag: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="interface-jacobian: linearise the components every N steps; default: 1.",
            parser=whole,
        ),
    ] = None
    factor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COMPONENT=N",
            help="The component takes N steps in each communication step; repeatable.",
        ),
    ] = None
    adaptive: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help="Let the steps be as long as their error allows, TOL of the magnitude of each signal,"
            " such as 1e-3.",
            parser=number,
        ),
    ] = None
    control: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT",
            help="With --adaptive: what TOL is of: error of the signals (default), or energy of power bonds.",
        ),
    ] = None
    smallest: Annotated[
        float | None,
        typer.Option(metavar="S", help="With --adaptive: shortest step [s]; default: 1e-7.", parser=seconds),
    ] = None
    largest: Annotated[
        float | None,
        typer.Option(metavar="S", help="With --adaptive: longest step [s]; default: 0.1.", parser=seconds),
    ] = None

    def given(self) -> dict[str, Any]:
        """What the user says, named like the fields of `Coupling`."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        found["tolerance"] = found.pop("coupling_tolerance")
        found["factors"] = factors(found.pop("factor") or []) or None
        found["correct"] = self.correct or None
        return {name: value for name, value in found.items() if value is not None}
