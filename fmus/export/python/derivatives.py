"""FMI's functions for derivatives, of an instance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fmus.export.python import instance
from fmus.export.python.instance import (
    INITIALIZATION,
    INSTANTIATED,
    STEP_FAILED,
    STEP_MODE,
    TERMINATED,
    Instance,
    refuse,
)
from fmus.solver import Array


def give(run: Instance, references: Sequence[int], orders: Sequence[int], given: Sequence[float]) -> None:
    """Derivatives of order 1 to 3 of inputs, valid for the next step."""
    run.allowed(INSTANTIATED | INITIALIZATION | STEP_MODE)
    for r, order, value in zip(references, orders, given, strict=True):
        v = run.known(r)
        if v.kind != "INPUT":
            refuse(f"{v.name} is not an input")
        if not 1 <= order <= 3:
            refuse(f"{v.name} has derivatives of order 1, 2 and 3 only")
        if not math.isfinite(value):
            refuse(f"the derivative of {v.name} is not a finite number")
    for r, order, value in zip(references, orders, given, strict=True):
        instance.give(run.state, r - run.ends[0], order, value)


def directional(
    run: Instance, unknown: Sequence[int], known: Sequence[int], seed: Sequence[float]
) -> list[float]:
    """Derivatives of unknowns along a direction of knowns."""
    run.allowed(INITIALIZATION | STEP_MODE | STEP_FAILED | TERMINATED)
    direction = np.zeros(len(run.variables))
    more = ("FIXED", "TUNABLE") if run.state.initial else ("CALCULATED_STATE",)
    for r, value in zip(known, seed, strict=True):
        v = run.known(r)
        if v.kind not in ("INPUT", "STATE", *more):
            refuse(f"{v.name} is not a known, expected an input or a state")
        direction[r] += value
    for r in unknown:
        if run.known(r).kind in ("FIXED", "TUNABLE", "INPUT"):
            refuse(f"{run.variables[r].name} is not an unknown, expected an output or a derivative")
    return _finite(run, unknown, _along(run, direction))


def of_outputs(run: Instance, references: Sequence[int], orders: Sequence[int]) -> list[float]:
    """Time derivatives of outputs; orders beyond the first are zero: they are not provided."""
    run.allowed(STEP_MODE | STEP_FAILED | TERMINATED)
    direction, (first, last, end, *_) = np.zeros(len(run.variables)), run.ends
    direction[first:last] = [instance.slope(run.state, run.rates, i) for i in range(last - first)]
    direction[last:end] = run.derivatives()
    for r, order in zip(references, orders, strict=True):
        v = run.known(r)
        if v.kind not in ("OUTPUT", "STATE", "CALCULATED_STATE"):
            refuse(f"{v.name} is not an output")
        if order < 1:
            refuse(f"the order of the derivative of {v.name} is less than 1")
    found = _finite(run, references, _along(run, direction))
    return [0.0 if order > 1 else value for order, value in zip(orders, found, strict=True)]


def _along(run: Instance, direction: Array) -> Array:
    """From the directions of parameters, inputs and states those of all variables."""
    run.start()
    s, parts = run.state, np.split(direction, run.ends[:3])
    x, dx, y = run.model.forward(s.x, s.u, s.p, (parts[0], parts[1], parts[2]), bool(s.initial))
    return np.concatenate([parts[0], parts[1], x, dx, y])


def _finite(run: Instance, references: Sequence[int], values: Array) -> list[float]:
    for r in references:
        if not math.isfinite(values[r]):
            refuse(f"the derivative of {run.variables[r].name} is not finite")
    return [float(values[r]) for r in references]
