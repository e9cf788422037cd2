"""Everything that the future of an instance depends on, and its bytes: what a saved state holds.

The bytes are a header that names the model, a check sum, and one double per number, so that a restored state
is the same to the last bit, in another instance, process or on another machine.

Inputs inside a step are Taylor polynomials from the values that were set. Their derivatives come from
`fmi2SetRealInputDerivatives` if it was called for the step, else from the inputs that are rates
(docs/design.md, "Inputs inside a step").
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.export.interface import Variable
from fmus.solver import Array, InputPolynomials
from orchestrator.base.errors import Problem

_MAGIC = b"FMUstate python 1 "


@dataclass
class InstanceState:
    """Numbers only, as in native/core.h.

    memory      of the solver, see `solver.StepMemory`
    x, p, u     states, parameters, inputs at the current time
    set         inputs as last set: where the next step starts
    slope       time derivatives of the inputs at the end of the last step
    given       input derivatives of order 1 to 3 set for the next step, shape (n, 3), and for which inputs
    was_given   which inputs followed such derivatives in the last step
    warned      which watched variables are above their limit, by value reference
    initial     1 until the initialisation is over: states follow from their start values
    phase       of the state machine, see `instance`
    """

    x: Array
    p: Array
    u: Array
    set: Array
    slope: Array
    given: Array
    is_given: NDArray[np.bool_]
    was_given: NDArray[np.bool_]
    warned: NDArray[np.bool_]
    time: float = 0.0
    start_time: float = 0.0
    stop_time: float = np.inf
    tolerance: float = 0.0
    memory: Array = field(default_factory=lambda: np.zeros(3))
    initial: float = 1.0
    phase: float = 1.0

    def to_bytes(self, guid: str) -> bytes:
        """The state of the model with this GUID."""
        content = b"".join(np.asarray(v, dtype="<f8").tobytes() for v in vars(self).values())
        return _header(guid) + hashlib.sha256(content).digest() + content

    def from_bytes(self, guid: str, data: bytes) -> InstanceState:
        """The state that `to_bytes` was called with; this one tells how many numbers there are of each."""
        header, expected = _header(guid), len(self.to_bytes(guid))
        if not data.startswith(header):
            raise Problem(f'the saved state is of another model, expected GUID "{guid}"')
        if len(data) != expected:
            raise Problem(f"the saved state has {len(data)} bytes, expected {expected}")
        seal, content = data[len(header) : len(header) + 32], data[len(header) + 32 :]
        if hashlib.sha256(content).digest() != seal:
            raise Problem("the saved state is damaged: its check sum differs")
        numbers, values = np.frombuffer(content, dtype="<f8"), dict[str, Any]()
        for f in fields(self):
            like = np.asarray(getattr(self, f.name))
            part, numbers = numbers[: like.size], numbers[like.size :]
            values[f.name] = part.reshape(like.shape).astype(like.dtype) if like.shape else float(part[0])
        return InstanceState(**values)


def _header(guid: str) -> bytes:
    return _MAGIC + guid.encode() + b"\0"


# ---- inputs inside a step ---------------------------------------------------------------------------


def rates(inputs: Sequence[Variable]) -> list[int]:
    """Index of the input with the time derivative of each one, or -1."""
    index = {v.name: i for i, v in enumerate(inputs)}
    return [index[v.quantity.rate] if v.quantity.rate else -1 for v in inputs]


def derivative(s: InstanceState, rates: Sequence[int], at: Array, i: int, order: int) -> float:
    """Derivative of an input where the values `at` hold."""
    if s.is_given[i]:
        return float(s.given[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(at[rates[i]]) if order == 1 else derivative(s, rates, at, rates[i], order - 1)


def motion(s: InstanceState, rates: Sequence[int]) -> InputPolynomials:
    """Over the next step."""
    numbers = range(s.set.size)
    terms = (
        [derivative(s, rates, s.set, i, k) / scale for i in numbers] for k, scale in ((1, 1), (2, 2), (3, 6))
    )
    return InputPolynomials(np.array([s.set, *terms]))


def slope(s: InstanceState, rates: Sequence[int], i: int) -> float:
    """Time derivative of an input at the current time."""
    if s.is_given[i]:
        return float(s.given[i, 0])
    return float(s.slope[i] if rates[i] < 0 or s.was_given[i] else s.u[rates[i]])


def set_input_derivative(s: InstanceState, i: int, order: int, value: float) -> None:
    """A derivative of an input for the next step; those of other orders are zero unless given, too."""
    s.given[i] = s.given[i] if s.is_given[i] else 0.0
    s.is_given[i], s.given[i, order - 1] = True, value
