"""Variables of the levers: ten strokes per lever, a clock, commands and their rates; as in model.py."""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from typing import Annotated, Any

from fmus.contract import Quantity, Scalar

AXES = ("swing", "boom", "stick")
STROKES = range(1, 11)
WORDS = ("start", "command", "rise", "hold", "fall")  # of one stroke, as in `stroke.Stroke`


def _stroke(lever: str, number: int) -> tuple[Quantity, ...]:
    """The parameters of one stroke, in the order of WORDS."""
    which = f"stroke {number} of the {lever} lever"
    return (
        Quantity("s", f"Time at which {which} begins", group=f"{lever.capitalize()} lever"),
        Quantity("V", f"Command at the top of {which}", 10.0, -10.0, 10.0),
        Quantity("s", f"Duration of the ramp up of {which}", minimum=0.0),
        Quantity("s", f"Duration of the top of {which}", minimum=0.0),
        Quantity("s", f"Duration of the ramp back to zero of {which}", minimum=0.0),
    )


def stroke_name(lever: str, number: int, word: str) -> str:
    """The name of a parameter: boom_1_start."""
    return f"{lever}_{number}_{word}"


# 150 parameters from one pattern; their numbers and sources are in parameters.toml
LeversParameters: type[Any] = make_dataclass(
    "LeversParameters",
    [
        (stroke_name(lever, number, word), Annotated[Scalar, quantity], field())
        for lever in AXES
        for number in STROKES
        for word, quantity in zip(WORDS, _stroke(lever, number), strict=True)
    ],
    frozen=True,
)


@dataclass(frozen=True)
class LeversState:
    """How far the program is."""

    clock: Annotated[Scalar, Quantity("s", "Time in the program; starts at 0, whatever the start time")]


@dataclass(frozen=True)
class LeversInputs:
    """None."""


@dataclass(frozen=True)
class LeversOutputs:
    """Commands to the valves and their rates."""

    swing_command: Annotated[Scalar, Quantity("V", "Command to the swing valve, positive turns left", 10.0)]
    boom_command: Annotated[
        Scalar, Quantity("V", "Command to the boom valve, positive raises the boom", 10.0)
    ]
    stick_command: Annotated[
        Scalar, Quantity("V", "Command to the stick valve, positive folds the stick in", 10.0)
    ]
    swing_command_rate: Annotated[
        Scalar, Quantity("V/s", "Rate port: exact time derivative of swing_command", 10.0)
    ]
    boom_command_rate: Annotated[
        Scalar, Quantity("V/s", "Rate port: exact time derivative of boom_command", 10.0)
    ]
    stick_command_rate: Annotated[
        Scalar, Quantity("V/s", "Rate port: exact time derivative of stick_command", 10.0)
    ]
