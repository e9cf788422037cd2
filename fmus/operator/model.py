"""The operator: plays a program of strokes on three levers.

    d clock / dt = 1        command = sum of the strokes at `clock`, each a trapezoid

The rates are the derivatives of the commands to the right of each instant, so that an FMU which continues
value + rate * time follows the ramps exactly when their corners lie on the communication grid.

Signs: a positive command turns left, raises the boom, extends the stick cylinder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmus.components.ports import lever
from fmus.contract import Scalar, Subsystem
from fmus.operator.stroke import Stroke, sample
from fmus.operator.variables import (
    LEVERS,
    STROKES,
    WORDS,
    OperatorInputs,
    OperatorOutputs,
    OperatorParameters,
    OperatorState,
    stroke_name,
)


def _lever(which: str, clock: Scalar, p: Any) -> tuple[Scalar, Scalar]:
    """Command and rate of one lever; strokes that overlap add up."""
    strokes = [Stroke(*(getattr(p, stroke_name(which, n, word)) for word in WORDS)) for n in STROKES]
    values, rates = zip(*(sample(stroke, clock) for stroke in strokes), strict=True)
    return sum(values), sum(rates)


def dynamics(x: OperatorState, u: OperatorInputs, p: Any) -> OperatorState:
    """Time derivative of the state."""
    return OperatorState(clock=1)


def observe(x: OperatorState, u: OperatorInputs, p: Any) -> OperatorOutputs:
    """Outputs."""
    shown: dict[str, Scalar] = {}
    for which in LEVERS:
        shown[f"{which}_command"], shown[f"{which}_command_rate"] = _lever(which, x.clock, p)
    return OperatorOutputs(**shown)


OPERATOR = Subsystem(
    name="operator",
    text="Operator: a program of up to ten strokes on each of three levers",
    parameters=OperatorParameters,
    states=OperatorState,
    inputs=OperatorInputs,
    outputs=OperatorOutputs,
    dynamics=dynamics,
    observe=observe,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=tuple(lever(axis) for axis in LEVERS),
)
