"""A linear model with names and units, its modes, and how it is printed, saved and handed to other tools."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.text import TextTable
from orchestrator.base.units import DeclaredUnit
from orchestrator.linear.modes import Mode, modes

COLUMNS = ("frequency [Hz]", "damping [1]", "time constant [s]", "mode", "states")
ROUNDING = 1e-12
STEADY_RATE = 1e-4  # of its size per second: a state that moves no faster counts as steady in the text
FAST = 1e-3  # s: a state that settles so soon does not count as moving ...
FAST_RANGE = 1e-2  # ... if it goes no further than this share of its size
Array = NDArray[np.float64]


class LinearVariable(NamedTuple):
    """A state, input or output: its name, unit, description, and usual magnitude."""

    name: str
    unit: DeclaredUnit | None
    description: str
    nominal: float


@dataclass(frozen=True)
class LinearModel:
    """d(dx)/dt = A dx + B du, dy = C dx + D du around x0, u0, y0; dx, du, dy are changes from there.

    f0      time derivatives of the states there, not zero unless it is a steady state
    time    of the operating point [s]
    notes   remarks for the user
    """

    name: str
    states: tuple[LinearVariable, ...]
    inputs: tuple[LinearVariable, ...]
    outputs: tuple[LinearVariable, ...]
    a: Array
    b: Array
    c: Array
    d: Array
    x0: Array
    u0: Array
    y0: Array
    f0: Array
    time: float = 0.0
    notes: tuple[str, ...] = field(default=())

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Eigenvalues, slowest first, with the states that take part in each."""
        return modes(self.a, self.states)

    def text(self) -> str:
        """Operating point and modes."""
        groups = {"state": self.states, "input": self.inputs, "output": self.outputs}
        count = ", ".join(f"{len(group)} {word}{'s' * (len(group) != 1)}" for word, group in groups.items())
        lines = [f"{self.name} at t = {self.time:g} s: {count}", *_operating_point(self)]
        lines += [_stability(self.modes), ""] if self.modes else [""]
        lines += TextTable(COLUMNS, [_row(m) for m in self.modes], left=(3, 4)).lines()
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def to_control(self) -> Any:
        """A StateSpace of the package python-control; names have _ where it does not allow a dot."""
        try:
            import control
        except ImportError:
            raise Problem("python-control is not installed; install it with: pip install control") from None
        names = {
            kind: [n.name.replace(".", "_") for n in group]
            for kind, group in (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs))
        }
        return control.StateSpace(self.a, self.b, self.c, self.d, name=self.name, **names)

    def save(self, path: Path) -> tuple[Path, Path]:
        """Write the arrays to `path` (.npz) and the names and modes next to it (.json)."""
        if path.suffix != ".npz":
            raise Problem(f"--out {path}: expected a name that ends in .npz")
        arrays = {"A": self.a, "B": self.b, "C": self.c, "D": self.d}
        points = {"x0": self.x0, "u0": self.u0, "y0": self.y0, "f0": self.f0}
        np.savez(path, allow_pickle=False, **arrays, **points)
        names = path.with_suffix(".json")
        names.write_text(json.dumps(self._as_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path, names

    def _as_dict(self) -> dict[str, Any]:
        def described(group: tuple[LinearVariable, ...], values: Array) -> list[dict[str, Any]]:
            return [
                {
                    "name": n.name,
                    "unit": n.unit.name if n.unit else "",
                    "text": n.description,
                    "value": float(v),
                }
                for n, v in zip(group, values, strict=True)
            ]

        return {
            "system": self.name,
            "time": self.time,
            "states": described(self.states, self.x0),
            "inputs": described(self.inputs, self.u0),
            "outputs": described(self.outputs, self.y0),
            "modes": [m.as_dict() for m in self.modes],
            "notes": list(self.notes),
        }


Linear = LinearModel  # its name until this release


def _operating_point(linear: LinearModel) -> list[str]:
    """The inputs, and what is not at rest."""
    inputs = [f"{i.name} = {_value(v, i)}{_unit(i)}" for i, v in zip(linear.inputs, linear.u0, strict=True)]
    rate = _relative_rates(linear)
    fastest = [(linear.states[i], linear.f0[i]) for i in np.argsort(-rate)[:3] if rate[i] > STEADY_RATE]
    moving = [f"{state.name} by {f:.3g}{_unit(state)} per s" for state, f in fastest]
    return [f"inputs: {', '.join(inputs) or 'none'}", f"not at rest: {', '.join(moving) or 'nothing'}"]


def _relative_rates(linear: LinearModel) -> Array:
    """How fast each state moves, of its size per second; 0 where it settles at once, as the flow in a line.

    By itself a state of time constant T = -1 / A_ii goes f0 T further.
    """
    rate = np.abs(linear.f0) / np.array([s.nominal for s in linear.states])
    own = -np.diag(linear.a)
    return np.where((own > 1.0 / FAST) & (rate <= FAST_RANGE * own), 0.0, rate)


def _stability(modes: Sequence[Mode]) -> str:
    """What does not come back."""
    grows = [m.name for m in modes if m.value.real > 0.0]
    stays = [m.name for m in modes if m.value.real == 0.0]
    result = f"unstable: {', '.join(grows)}" if grows else "stable"
    return f"{result}; on the limit: {', '.join(stays)}" if stays else result


def _value(value: float, named: LinearVariable) -> str:
    """With 6 digits; 0 for what is rounding next to its usual magnitude."""
    return f"{0.0 if abs(value) < ROUNDING * named.nominal else value:.6g}"


def _unit(named: LinearVariable) -> str:
    return f" {named.unit.name}" if named.unit and named.unit.name != "1" else ""


def _row(mode: Mode) -> tuple[str, ...]:
    frequency = f"{mode.frequency:.4g}" if mode.oscillates else ""
    lasts = f"{mode.time_constant:.4g}" if math.isfinite(mode.time_constant) else ""
    damping = f"{mode.damping:.3f}" if mode.oscillates else ""
    return frequency, damping, lasts, mode.name, ", ".join(mode.main_states)
