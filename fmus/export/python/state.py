"""Complete state of an instance in Python, its bytes (the FMU state), and its inputs inside a step.

The bytes are a header that identifies the model, a SHA-256 checksum, and one double per value. So a restored
state is bit-identical in another instance or process and on another machine.

Inputs inside a step are Taylor polynomials around the values that were set. The derivatives of an input come
from `fmi2SetRealInputDerivatives` if it was called for the step, else from its rate input, the input that is
its time derivative (docs/design.md, "Inputs inside a step").
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.export.interface import Variable
from fmus.solver import MEMORY_SIZE, Array, InputPolynomials
from orchestrator.base.errors import Problem

_MAGIC = b"FMUstate python 1 "


@dataclass
class InstanceState:
    """The state of an instance; all members are stored as doubles, with the names of native/core.h.

    x, p, u             states, parameters, inputs at the current time
    last_set            inputs as last set: their values at the start of the next step
    end_derivative      time derivatives of the inputs at the end of the last step
    input_derivatives   derivatives of order 1 to 3 that were set for the next step, shape (n, 3)
    has_derivatives     inputs for which such derivatives were set
    had_derivatives     inputs for which they were set for the last step
    beyond              1 for watched variables above their limit, -1 for those below, by value reference
    warnings            that were logged of each variable
    time, start_time, stop_time   [s]; stop_time is infinite if it is not defined
    tolerance           relative tolerance of the solver
    memory              memory of the solver between steps, see `fmus.solver.solve`
    initial             1 until the initialisation is over: the states are computed from their start values
    phase               state of the FMI state machine, see `instance`
    """

    x: Array
    p: Array
    u: Array
    last_set: Array
    end_derivative: Array
    input_derivatives: Array
    has_derivatives: NDArray[np.bool_]
    had_derivatives: NDArray[np.bool_]
    beyond: NDArray[np.int_]
    warnings: NDArray[np.int_]
    time: float = 0.0
    start_time: float = 0.0
    stop_time: float = np.inf
    tolerance: float = 0.0
    memory: Array = field(default_factory=lambda: np.zeros(MEMORY_SIZE))
    initial: float = 1.0
    phase: float = 1.0

    def to_bytes(self, guid: str) -> bytes:
        """The state as bytes; the GUID identifies the model."""
        content = b"".join(np.asarray(v, dtype="<f8").tobytes() for v in vars(self).values())
        return _header(guid) + hashlib.sha256(content).digest() + content

    def from_bytes(self, guid: str, data: bytes) -> InstanceState:
        """The state in these bytes; `self` is any state of the model and supplies the array shapes."""
        header, size = _header(guid), len(self.to_bytes(guid))
        if not data.startswith(header):
            raise Problem(f'the saved state belongs to another model, expected GUID "{guid}"')
        if len(data) != size:
            raise Problem(f"the saved state has {len(data)} bytes, expected {size}")
        digest, content = data[len(header) : len(header) + 32], data[len(header) + 32 :]
        if hashlib.sha256(content).digest() != digest:
            raise Problem("the saved state is damaged: its checksum differs")
        remaining, values = np.frombuffer(content, dtype="<f8"), dict[str, Any]()
        for f in fields(self):
            like = np.asarray(getattr(self, f.name))
            part, remaining = remaining[: like.size], remaining[like.size :]
            values[f.name] = part.reshape(like.shape).astype(like.dtype) if like.shape else float(part[0])
        return InstanceState(**values)


def _header(guid: str) -> bytes:
    return _MAGIC + guid.encode() + b"\0"


# ---- inputs inside a step


def rate_indices(inputs: Sequence[Variable]) -> list[int]:
    """For each input the index of its rate input, or -1."""
    index = {v.name: i for i, v in enumerate(inputs)}
    return [index[v.quantity.rate] if v.quantity.rate else -1 for v in inputs]


def _derivative(s: InstanceState, rates: Sequence[int], u: Array, i: int, order: int) -> float:
    """Derivative of the given order of input i; u: values of the inputs, rates: as `rate_indices` returns."""
    if s.has_derivatives[i]:
        return float(s.input_derivatives[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(u[rates[i]]) if order == 1 else _derivative(s, rates, u, rates[i], order - 1)


def input_polynomials(s: InstanceState, rates: Sequence[int]) -> InputPolynomials:
    """The polynomials of all inputs over the next step."""
    terms = (
        [_derivative(s, rates, s.last_set, i, order) / factorial for i in range(s.last_set.size)]
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
