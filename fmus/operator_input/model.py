r"""Operator input: a program of up to ten strokes on each of three levers, and of up to four payloads.

    command |    ______
            |   /      \
          0 |__/        \____     start, rise, hold, fall: ramps as in the current of a joystick amplifier

    d clock / dt = 1        command = sum of the strokes at `clock`, each a trapezoid
                            payload_mass = sum of the payloads held at `clock`, each from `start` for `hold`

The rates are the right-hand derivatives of the commands. So an FMU that extrapolates value + rate * time
follows the ramps exactly if their corners are communication points.

Signs: a positive command turns left, raises the boom, extends the stick cylinder.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, quantities

AHEAD = 5e-7  # s, lead of the time at which corners are evaluated, see `sample`


class Stroke(Group):
    """One stroke: start [s], command at the top [V], durations of ramp up, top and ramp back [s]."""

    start: Scalar = Quantity("s", "Time at which {} begins")
    command: Scalar = Quantity("V", "Command at the top of {}", 10.0, -10.0, 10.0)
    rise: Scalar = Quantity("s", "Duration of the ramp up of {}", minimum=0.0)
    hold: Scalar = Quantity("s", "Duration of the top of {}", minimum=0.0)
    fall: Scalar = Quantity("s", "Duration of the ramp back to zero of {}", minimum=0.0)


class Payload(Group):
    """One payload."""

    start: Scalar = Quantity("s", "Time at which the head takes up {}")
    mass: Scalar = Quantity("kg", "Mass of {}", 100.0, minimum=0.0)
    hold: Scalar = Quantity("s", "Time for which the head holds {}", minimum=0.0)


def sample(stroke: Stroke, time: Scalar) -> tuple[Scalar, Scalar]:
    """Command [V] and its right-hand derivative [V/s] at `time` [s].

    Corners are evaluated 0.5 us ahead. A clock that adds up steps may be short of a corner by rounding
    (measured: 0.3 us after an hour in steps of 1 ms), and would keep the left-hand derivative for one more
    step.
    """
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    end = down + s.fall
    rising, falling = s.command / _nonzero(s.rise), -s.command / _nonzero(s.fall)
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


def time_to_corner(stroke: Stroke, time: Scalar) -> Scalar:
    """Time [s] from `time` to the next corner as in `sample`; infinite after the last one."""
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    remaining: Scalar = math.inf
    for corner in (down + s.fall, down, up, s.start):
        remaining = ca.if_else(time + AHEAD < corner, corner - time, remaining)
    return ca.if_else(s.command == 0, math.inf, remaining)


def _nonzero(duration: Scalar) -> Scalar:
    """The duration, or 1 if it is zero; the ramp of duration zero is never used, but must be finite."""
    return ca.if_else(duration > 0, duration, 1)


# lever -> what a positive command does
LEVERS = {"swing": "turns left", "boom": "raises the boom", "stick": "folds the stick in"}
AXES = tuple(LEVERS)
NUMBERS = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
STROKES = range(1, 11)
PAYLOADS = range(1, 5)


def _program(group: type[Group], owner: str, heading: str, count: range) -> type[Any]:
    """Several strokes of a lever, or payloads."""
    headed = make_group("Headed", {"start": replace(quantities(group)["start"], group=heading)}, group)
    return make_group(
        "Program", {}, **{f"n{n}": (headed, owner.format(n), f"{n}_{{}}".format) for n in count}
    )


def parameters(levers: Sequence[str]) -> type[Any]:
    """Parameters from two patterns, named for example boom_1_start."""
    return make_group(
        "OperatorParameters",
        {},
        **{
            lever: _program(
                Stroke, f"stroke {{}} of the {lever} lever", f"{lever.capitalize()} lever", STROKES
            )
            for lever in levers
        },
        payload=_program(Payload, "payload {}", "Payloads", PAYLOADS),
    )


class OperatorState(Group):
    """Clock of the program."""

    clock: Scalar = Quantity("s", "Time in the program; starts at 0, independent of the start time")


class OperatorInputs(Group):
    """No inputs."""


def outputs(levers: Mapping[str, str]) -> type[Any]:
    """Commands to the valves and their rates; payload."""
    shown = {
        f"{n}_command": Quantity("V", f"Command to the {n} valve{means and ', positive '}{means}", 10.0)
        for n, means in levers.items()
    }
    shown |= {f"{n}_command_rate": ports.rate_output(f"{n}_command", "V/s", 10.0) for n in levers}
    held = Quantity("kg", "Payload that the head is to hold, in steps", 100.0)
    return make_group("OperatorOutputs", {**shown, "payload_mass": held})


def _strokes(lever: str, p: Any) -> list[Stroke]:
    return list(vars(getattr(p, lever)).values())


def _payloads(p: Any) -> list[Stroke]:
    """Payloads as strokes without ramps."""
    held = vars(p.payload).values()
    return [Stroke(start=h.start, command=h.mass, rise=0, hold=h.hold, fall=0) for h in held]


def _lever(lever: str, clock: Scalar, p: Any) -> tuple[Scalar, Scalar]:
    """Command and rate of one lever; strokes that overlap add up."""
    values, rates = zip(*(sample(stroke, clock) for stroke in _strokes(lever, p)), strict=True)
    return sum(values), sum(rates)


def dynamics(x: OperatorState, u: OperatorInputs, p: Any) -> OperatorState:
    """Time derivative of the state."""
    return OperatorState(clock=1)


def _observe(levers: Sequence[str], group: type[Any], x: OperatorState, u: OperatorInputs, p: Any) -> Any:
    outputs: dict[str, Scalar] = {}
    for lever in levers:
        outputs[f"{lever}_command"], outputs[f"{lever}_command_rate"] = _lever(lever, x.clock, p)
    outputs["payload_mass"] = sum(sample(payload, x.clock)[0] for payload in _payloads(p))
    return group(**outputs)


def _next_event(levers: Sequence[str], x: OperatorState, u: OperatorInputs, p: Any) -> Scalar:
    """Time [s] to the next corner of a stroke; otherwise a solver at rest would step over a stroke."""
    remaining: Scalar = math.inf
    for stroke in (*(s for lever in levers for s in _strokes(lever, p)), *_payloads(p)):
        remaining = ca.fmin(remaining, time_to_corner(stroke, x.clock))
    return remaining


def operator(levers: Mapping[str, str], values: Path | None = None) -> Subsystem:
    """The operator of some levers.

    levers   lever -> what a positive command does, "": it is not said
    values   in the folder of its README; the file itself need not exist
    """
    names, shown = tuple(levers), outputs(levers)
    return Subsystem(
        name="operator_input",
        text=f"Operator: a program of up to ten strokes on each of {NUMBERS.get(len(names), len(names))} "
        "levers, and of up to four payloads",
        parameters=parameters(names),
        states=OperatorState,
        inputs=OperatorInputs,
        outputs=shown,
        dynamics=dynamics,
        observe=partial(_observe, names, shown),
        next_event=partial(_next_event, names),
        terminals=(*(ports.lever(name) for name in names), ports.grip()),
        stiff=False,
        values=values,
    )
