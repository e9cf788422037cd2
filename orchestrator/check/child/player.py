"""Some numeric variables of an instance, read and set together.

Plays an instance, co-simulation and model exchange alike: begin, poke its inputs, advance, read a row.
"""

from __future__ import annotations

import ctypes
import math
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.check.child.binary import Binary
from orchestrator.check.child.description import FLOATS, Declared, Variable
from orchestrator.check.child.instance import Instance
from orchestrator.check.child.model_exchange import Exchange

C2: dict[str, Any] = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
C3: dict[str, Any] = {
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "Boolean": ctypes.c_bool,
    **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
}


class Values:
    """Some numeric variables of an instance, read and set together; arrays lie flat."""

    def __init__(self, instance: Instance, variables: Sequence[Variable]) -> None:
        self.instance, self.variables = instance, list(variables)
        self.names = scalars(variables)
        self._groups = [self._group(kind) for kind in dict.fromkeys(_access(instance, v) for v in variables)]

    def _group(self, kind: str) -> tuple[str, Any, Any, list[int]]:
        """Name of the type, value references, buffer, and the places of its scalars among all."""
        places: list[int] = []
        members: list[Variable] = []
        position = 0
        for v in self.variables:
            if _access(self.instance, v) == kind:
                members.append(v)
                places += range(position, position + v.size)
            position += v.size
        kinds = C2 if self.instance.declared.major == 2 else C3
        references = (ctypes.c_uint * len(members))(*[v.reference for v in members])
        return kind, references, (kinds[kind] * len(places))(), places

    def _arguments(self, references: Any, buffer: Any) -> list[Any]:
        n = ctypes.c_size_t(len(references))
        extra = [ctypes.c_size_t(len(buffer))] if self.instance.declared.major == 3 else []
        return [references, n, buffer, *extra]

    def get(self) -> list[float]:
        """Values in the order of the variables."""
        result = [0.0] * len(self.names)
        for kind, references, buffer, places in self._groups:
            self.instance.call(f"Get{kind}", *self._arguments(references, buffer))
            for place, value in zip(places, buffer, strict=True):
                result[place] = float(value)
        return result

    def set(self, values: Sequence[float]) -> None:
        """Set all; whole numbers and booleans are rounded."""
        shown = zip(self.names, values, strict=True)
        self.instance.binary.beacon.inputs(", ".join(f"{n} = {x:.6g}" for n, x in shown))
        for kind, references, buffer, places in self._groups:
            real = kind in FLOATS
            for i, place in enumerate(places):
                buffer[i] = values[place] if real else int(values[place])
            self.instance.call(f"Set{kind}", *self._arguments(references, buffer))


def scalars(variables: Sequence[Variable]) -> list[str]:
    """Names of the scalars of some variables."""
    return [v.name if v.size == 1 else f"{v.name}[{i}]" for v in variables for i in range(v.size)]


def _access(instance: Instance, v: Variable) -> str:
    """The word in the names of the functions: enumerations are read as whole numbers."""
    if v.kind == "Enumeration":
        return "Integer" if instance.declared.major == 2 else "Int64"
    return v.kind


INNER = 12  # inner steps of model exchange per advance: enough to move, whatever the stiffness
PATTERN = (1.0, -0.5, 0.25, -1.0, 0.5, 0.0, 0.75, -0.25)  # inputs move like this, step by step
PUSH = 1e-3  # of the magnitude of an input: small, because nobody knows what is allowed
ROUNDING = 1e-13  # of the nominal value: less is zero
LOCALS = 100  # variables that are watched where there is no output


def watched(declared: Declared) -> list[Variable]:
    """The outputs; without any, the local variables."""
    outputs = declared.of("output")
    if outputs:
        return outputs
    moving = [v for v in declared.of("local") if v.variability in ("continuous", "discrete")]
    return moving[:LOCALS]


def movable(declared: Declared) -> list[Variable]:
    """Inputs that may be set at any time."""
    return [v for v in declared.of("input") if v.is_float and v.variability == "continuous"]


class Player:
    """One run of one instance; summed: the communication points are, which drifts, in place of counted."""

    def __init__(
        self,
        binary: Binary,
        side: str,
        folder: Path,
        start: float = 0.0,
        stop: float | None = None,
        step: float | None = None,
        summed: bool = False,
        inputs: Sequence[Variable] | None = None,
        **options: Any,
    ) -> None:
        self.instance = Instance(binary, side, folder, **options)
        declared = binary.declared
        self.start, self.stop, self.time, self.number = start, stop, start, 0
        self.reached = start  # the time that the FMU says it reached
        self.step, self.summed = step or declared.step, summed
        self.inputs = Values(self.instance, movable(declared) if inputs is None else inputs)
        self.outputs = Values(self.instance, watched(declared))
        self._floors = [ROUNDING * v.nominal for v in self.outputs.variables for _ in range(v.size)]
        self.exchange: Exchange | None = None
        self.rest: list[float] = []  # inputs after initialisation

    def begin(self) -> Player:
        """Initialise."""
        self.instance.enter(self.start, self.stop)
        self.instance.leave()
        self.settle()
        return self

    def settle(self) -> None:
        """After initialisation mode: to where steps are possible."""
        self.time, self.number = self.start, 0
        self.instance.binary.beacon.time = self.start
        if self.instance.side == "me":
            self.exchange = Exchange(self.instance)
            self.exchange.begin(self.start)
        self.rest = self.inputs.get() if self.inputs.names else []

    def poke(self, number: int | None = None, push: float = PUSH) -> None:
        """Move all inputs a little, by a fixed pattern."""
        if not self.inputs.names:
            return
        n = self.number if number is None else number
        flat = [v for v in self.inputs.variables for _ in range(v.size)]
        wanted = [
            min(max(x + push * v.scale * PATTERN[(n + 3 * i) % len(PATTERN)], v.low), v.high)
            for i, (x, v) in enumerate(zip(self.rest, flat, strict=True))
        ]
        self.inputs.set(wanted)

    def advance(self) -> None:
        """One communication step; in model exchange up to INNER inner steps."""
        self.number += 1
        if self.exchange is not None:
            self.exchange.advance(self.step, INNER)
            self.time = self.exchange.time
            return
        self.reached = self.instance.step(self.time, self.step)
        self.time = self.time + self.step if self.summed else self.start + self.number * self.step

    def row(self) -> list[float]:
        """Outputs; what is rounding beside their magnitude is 0, and so is -0."""
        return [
            0.0 if abs(x) <= floor else x for x, floor in zip(self.outputs.get(), self._floors, strict=True)
        ]

    def run(self, count: int, poke: bool = False) -> list[list[float]]:
        """Rows after each of `count` steps."""
        rows = []
        for _ in range(count):
            if self.instance.ended:
                break
            if poke:
                self.poke()
            self.advance()
            rows.append(self.row())
        return rows

    def run_for(self, seconds: float, most: int, poke: bool = False) -> list[list[float]]:
        """Rows of as many steps as fit into some wall time."""
        rows: list[list[float]] = []
        deadline = time.monotonic() + seconds
        while len(rows) < most and (time.monotonic() < deadline or not rows) and not self.instance.ended:
            rows += self.run(1, poke)
        return rows

    def mark(self) -> tuple[Any, ...]:
        """Where the run is, apart from the FMU: to go on from a saved state."""
        e = self.exchange
        return self.number, self.time, (e.time, e.next, e.trial, e.nominal) if e else None

    def back(self, mark: Sequence[Any]) -> None:
        """Go on from a mark."""
        self.number, self.time, inner = mark
        if self.exchange is not None and inner is not None:
            e = self.exchange
            e.time, e.next, e.trial, e.nominal = inner

    def close(self) -> None:
        """Terminate and free."""
        self.instance.terminate()
        self.instance.free()


def bits(rows: Sequence[Sequence[float]]) -> bytes:
    """All bits of some rows, to compare: NaN equals NaN."""
    return b"".join(struct.pack(f"<{len(r)}d", *r) for r in rows)


def difference(
    names: Sequence[str], first: Sequence[Sequence[float]], second: Sequence[Sequence[float]]
) -> str:
    """In words: where two runs differ first; empty when they do not."""
    for n, (a, b) in enumerate(zip(first, second, strict=False), 1):
        for name, x, y in zip(names, a, b, strict=True):
            if struct.pack("<d", x) != struct.pack("<d", y):
                return f"{name} is {y:.17g} in place of {x:.17g} after step {n}"
    return "" if len(first) == len(second) else f"{len(second)} steps in place of {len(first)}"


def odd(names: Sequence[str], row: Sequence[float]) -> str:
    """The first value that is not finite, in words; empty when there is none."""
    return next((f"{n} is {x:g}" for n, x in zip(names, row, strict=True) if not math.isfinite(x)), "")
