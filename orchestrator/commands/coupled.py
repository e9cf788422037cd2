"""Options about the coupling, as a group; a command takes it as one parameter, see `spread`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

import typer

from orchestrator.commands.reading import number, seconds, whole
from orchestrator.commands.texts import factors


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
            " default: 1e-5, with --adaptive 0.3 of its TOL.",
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
    guard: Annotated[
        float | None,
        typer.Option(
            metavar="TOL",
            help="Equal steps: divide one whose estimated error is above TOL, where the components can go"
            " back; 0: never; default: 0.01 for hermite and interface-jacobian, else 0.",
            parser=number,
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
