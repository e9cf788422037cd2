"""Inputs inside a step: Taylor polynomials around the values that were set.

The derivatives of an input come from `fmi2SetRealInputDerivatives` if it was called for the step, else from
its rate input, the input that is its time derivative (docs/design.md, "Inputs inside a step").
"""

from collections.abc import Sequence

import numpy as np

from fmus.export.interface import Variable
from fmus.export.python.state import InstanceState
from fmus.solver import Array, InputPolynomials


def rate_indices(inputs: Sequence[Variable]) -> list[int]:
    """For each input the index of its rate input, or -1."""
    index = {v.name: i for i, v in enumerate(inputs)}
    return [index[v.quantity.rate] if v.quantity.rate else -1 for v in inputs]


def derivative(s: InstanceState, rates: Sequence[int], u: Array, i: int, order: int) -> float:
    """Derivative of the given order of input i; u: values of the inputs, rates: as `rate_indices` returns."""
    if s.has_derivatives[i]:
        return float(s.input_derivatives[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(u[rates[i]]) if order == 1 else derivative(s, rates, u, rates[i], order - 1)


def polynomials(s: InstanceState, rates: Sequence[int]) -> InputPolynomials:
    """The polynomials of all inputs over the next step."""
    terms = (
        [derivative(s, rates, s.last_set, i, order) / factorial for i in range(s.last_set.size)]
        for order, factorial in ((1, 1), (2, 2), (3, 6))
    )
    return InputPolynomials(np.array([s.last_set, *terms]))


def current_derivative(s: InstanceState, rates: Sequence[int], i: int) -> float:
    """Time derivative of input i at the current time."""
    if s.has_derivatives[i]:
        return float(s.input_derivatives[i, 0])
    return float(s.end_derivative[i] if rates[i] < 0 or s.had_derivatives[i] else s.u[rates[i]])


def set_input_derivative(s: InstanceState, i: int, order: int, value: float) -> None:
    """Set a derivative of input i for the next step; orders that are not set are zero."""
    if not s.has_derivatives[i]:
        s.input_derivatives[i] = 0.0
    s.has_derivatives[i], s.input_derivatives[i, order - 1] = True, value
