"""Plays an instance, co-simulation and model exchange alike: begin, poke its inputs, advance, read a row."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.trial.binary import Binary
from orchestrator.trial.declared import Declared, Variable
from orchestrator.trial.exchange import Exchange
from orchestrator.trial.instance import Instance
from orchestrator.trial.values import Values

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
