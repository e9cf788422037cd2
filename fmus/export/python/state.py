"""Everything that the future of an instance depends on, and its bytes: what a saved state holds.

The bytes are a header that names the model, a check sum, and one double per number, so that a restored
state is the same to the last bit, in another instance, process or on another machine.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.solver import Array

_MAGIC = b"FMUstate python 1 "


@dataclass
class State:
    """Numbers only, as in native/core.h.

    memory      of the solver, see `solver.Pace`
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

    def from_bytes(self, guid: str, data: bytes) -> State:
        """The state that `to_bytes` was called with; this one tells how many numbers there are of each."""
        header, expected = _header(guid), len(self.to_bytes(guid))
        if not data.startswith(header):
            raise ModelError(f'the saved state is of another model, expected GUID "{guid}"')
        if len(data) != expected:
            raise ModelError(f"the saved state has {len(data)} bytes, expected {expected}")
        seal, content = data[len(header) : len(header) + 32], data[len(header) + 32 :]
        if hashlib.sha256(content).digest() != seal:
            raise ModelError("the saved state is damaged: its check sum differs")
        return self._filled(np.frombuffer(content, dtype="<f8"))

    def _filled(self, numbers: Array) -> State:
        found: dict[str, Any] = {}
        for f in fields(self):
            like = np.asarray(getattr(self, f.name))
            part, numbers = numbers[: like.size], numbers[like.size :]
            found[f.name] = part.reshape(like.shape).astype(like.dtype) if like.shape else float(part[0])
        return State(**found)


def _header(guid: str) -> bytes:
    return _MAGIC + guid.encode() + b"\0"
