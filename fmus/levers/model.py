"""The levers: they play a program of strokes on three levers.

    d clock / dt = 1        command = sum of the strokes at `clock`, each a trapezoid

The rates are the derivatives of the commands to the right of each instant, so that an FMU which continues
value + rate * time follows the ramps exactly when their corners lie on the communication grid.

Signs: a positive command turns left, raises the boom, extends the stick cylinder.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import casadi as ca

from fmus.components import ports
from fmus.contract import Scalar, Subsystem
from fmus.levers.stroke import Stroke, sample, wait
from fmus.levers.variables import (
    AXES,
    STROKES,
    WORDS,
    LeversInputs,
    LeversOutputs,
    LeversParameters,
    LeversState,
    stroke_name,
)


def _strokes(which: str, p: Any) -> list[Stroke]:
    return [Stroke(*(getattr(p, stroke_name(which, n, word)) for word in WORDS)) for n in STROKES]


def _lever(which: str, clock: Scalar, p: Any) -> tuple[Scalar, Scalar]:
    """Command and rate of one lever; strokes that overlap add up."""
    values, rates = zip(*(sample(stroke, clock) for stroke in _strokes(which, p)), strict=True)
    return sum(values), sum(rates)


def dynamics(x: LeversState, u: LeversInputs, p: Any) -> LeversState:
    """Time derivative of the state."""
    return LeversState(clock=1)


def observe(x: LeversState, u: LeversInputs, p: Any) -> LeversOutputs:
    """Outputs."""
    shown: dict[str, Scalar] = {}
    for which in AXES:
        shown[f"{which}_command"], shown[f"{which}_command_rate"] = _lever(which, x.clock, p)
    return LeversOutputs(**shown)


def corner(x: LeversState, u: LeversInputs, p: Any) -> Scalar:
    """Seconds to the next corner of a stroke: a solver at rest would step over a whole one."""
    found: Scalar = math.inf
    for which in AXES:
        for stroke in _strokes(which, p):
            found = ca.fmin(found, wait(stroke, x.clock))
    return found


LEVERS = Subsystem(
    name="levers",
    text="Levers: a program of up to ten strokes on each of three levers",
    parameters=LeversParameters,
    states=LeversState,
    inputs=LeversInputs,
    outputs=LeversOutputs,
    dynamics=dynamics,
    observe=observe,
    corner=corner,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=tuple(ports.lever(axis) for axis in AXES),
    stiff=False,
)
