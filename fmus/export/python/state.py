"""Complete state of an instance in Python, and its bytes: the FMU state.

The bytes are a header that identifies the model, a SHA-256 checksum, and one double per value. So a restored
state is bit-identical in another instance or process and on another machine.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.solver import MEMORY_SIZE, Array
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
