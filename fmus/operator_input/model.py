r"""The operator: plays a program of up to ten strokes on each of three levers.

    command |    ______
            |   /      \
          0 |__/        \____     start, then rise, hold and fall: as a joystick amplifier ramps its current

    d clock / dt = 1        command = sum of the strokes at `clock`, each a trapezoid

The rates are the derivatives of the commands to the right of each instant, so that an FMU which continues
value + rate * time follows the ramps exactly when their corners lie on the communication grid.

Signs: a positive command turns left, raises the boom, extends the stick cylinder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca

from fmus.components import ports
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group

AHEAD = 5e-7  # s, see `sample`


@dataclass(frozen=True)
class Stroke:
    """Begin [s], command at the top [V], durations of ramp up, top and ramp back [s]."""

    start: Scalar
    command: Scalar
    rise: Scalar
    hold: Scalar
    fall: Scalar


def sample(stroke: Stroke, time: Scalar) -> tuple[Scalar, Scalar]:
    """Command [V] and its rate [V/s] at `time` [s]; at a corner the rate to the right of it.

    It is looked for 0.5 us ahead: a clock that adds up steps may be short of a corner by rounding (measured:
    0.3 us after an hour in steps of 1 ms), and the rate of the left side would hold for one step more.
    """
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    end = down + s.fall
    rising, falling = s.command / _not_zero(s.rise), -s.command / _not_zero(s.fall)
    pieces = (
        (s.start, 0, 0),
        (up, rising * (time - s.start), rising),
        (down, s.command, 0),
        (end, falling * (time - end), falling),
    )
    value: Scalar = 0
    rate: Scalar = 0
    for corner, value_before, rate_before in reversed(pieces):
        before = time + AHEAD < corner
        value = ca.if_else(before, value_before, value)
        rate = ca.if_else(before, rate_before, rate)
    return value, rate


def wait(stroke: Stroke, time: Scalar) -> Scalar:
    """Seconds from `time` to the next corner, as `sample` sees it; infinite for none."""
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    found: Scalar = math.inf
    for corner in (down + s.fall, down, up, s.start):
        found = ca.if_else(time + AHEAD < corner, corner - time, found)
    return ca.if_else(s.command == 0, math.inf, found)


def _not_zero(duration: Scalar) -> Scalar:
    """The duration; 1 for none, whose piece is never looked at but must not divide by zero."""
    return ca.if_else(duration > 0, duration, 1)


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
OperatorParameters = make_group(
    "OperatorParameters",
    {
        stroke_name(lever, number, word): quantity
        for lever in AXES
        for number in STROKES
        for word, quantity in zip(WORDS, _stroke(lever, number), strict=True)
    },
)


class OperatorState(Group):
    """How far the program is."""

    clock: Scalar = Quantity("s", "Time in the program; starts at 0, whatever the start time")


class OperatorInputs(Group):
    """None."""


class OperatorOutputs(Group):
    """Commands to the valves and their rates."""

    swing_command: Scalar = Quantity("V", "Command to the swing valve, positive turns left", 10.0)
    boom_command: Scalar = Quantity("V", "Command to the boom valve, positive raises the boom", 10.0)
    stick_command: Scalar = Quantity("V", "Command to the stick valve, positive folds the stick in", 10.0)
    swing_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of swing_command", 10.0)
    boom_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of boom_command", 10.0)
    stick_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of stick_command", 10.0)


def _strokes(which: str, p: Any) -> list[Stroke]:
    return [Stroke(*(getattr(p, stroke_name(which, n, word)) for word in WORDS)) for n in STROKES]


def _lever(which: str, clock: Scalar, p: Any) -> tuple[Scalar, Scalar]:
    """Command and rate of one lever; strokes that overlap add up."""
    values, rates = zip(*(sample(stroke, clock) for stroke in _strokes(which, p)), strict=True)
    return sum(values), sum(rates)


def dynamics(x: OperatorState, u: OperatorInputs, p: Any) -> OperatorState:
    """Time derivative of the state."""
    return OperatorState(clock=1)


def observe(x: OperatorState, u: OperatorInputs, p: Any) -> OperatorOutputs:
    """Outputs."""
    shown: dict[str, Scalar] = {}
    for which in AXES:
        shown[f"{which}_command"], shown[f"{which}_command_rate"] = _lever(which, x.clock, p)
    return OperatorOutputs(**shown)


def next_event(x: OperatorState, u: OperatorInputs, p: Any) -> Scalar:
    """Seconds to the next corner of a stroke: a solver at rest would step over a whole one."""
    found: Scalar = math.inf
    for which in AXES:
        for stroke in _strokes(which, p):
            found = ca.fmin(found, wait(stroke, x.clock))
    return found


OPERATOR = Subsystem(
    name="operator_input",
    text="Operator: a program of up to ten strokes on each of three levers",
    parameters=OperatorParameters,
    states=OperatorState,
    inputs=OperatorInputs,
    outputs=OperatorOutputs,
    dynamics=dynamics,
    observe=observe,
    next_event=next_event,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=tuple(ports.lever(axis) for axis in AXES),
    stiff=False,
)
