"""Inputs inside a step: Taylor polynomials from the values that were set and what carries their derivatives.

Derivatives come from `fmi2SetRealInputDerivatives` if it was called for the step, else from the inputs that
are rates (docs/design.md, "Inputs inside a step").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fmus.export.interface import Variable
from fmus.export.python.state import State
from fmus.solver import Array, Motion


def rates(inputs: Sequence[Variable]) -> list[int]:
    """Index of the input with the time derivative of each one, or -1."""
    index = {v.name: i for i, v in enumerate(inputs)}
    return [index[v.quantity.rate] if v.quantity.rate else -1 for v in inputs]


def derivative(s: State, rates: Sequence[int], at: Array, i: int, order: int) -> float:
    """Derivative of an input where the values `at` hold."""
    if s.is_given[i]:
        return float(s.given[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(at[rates[i]]) if order == 1 else derivative(s, rates, at, rates[i], order - 1)


def motion(s: State, rates: Sequence[int]) -> Motion:
    """Over the next step."""
    numbers = range(s.set.size)
    terms = (
        [derivative(s, rates, s.set, i, k) / scale for i in numbers] for k, scale in ((1, 1), (2, 2), (3, 6))
    )
    return Motion(np.array([s.set, *terms]))


def slope(s: State, rates: Sequence[int], i: int) -> float:
    """Time derivative of an input at the current time."""
    if s.is_given[i]:
        return float(s.given[i, 0])
    return float(s.slope[i] if rates[i] < 0 or s.was_given[i] else s.u[rates[i]])


def give(s: State, i: int, order: int, value: float) -> None:
    """A derivative of an input for the next step; those of other orders are zero unless given, too."""
    s.given[i] = s.given[i] if s.is_given[i] else 0.0
    s.is_given[i], s.given[i, order - 1] = True, value
