"""A linear model with names and units: what it is, what its modes are, and what others take it as."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.linear.modes import Mode, modes
from orchestrator.units import Unit

Array = NDArray[np.float64]


class Named(NamedTuple):
    """A state, input or output: its name, unit, description, and usual magnitude."""

    name: str
    unit: Unit | None
    text: str
    size: float


@dataclass(frozen=True)
class Linear:
    """d(dx)/dt = A dx + B du, dy = C dx + D du around x0, u0, y0; dx, du, dy are changes from there.

    f0      time derivatives of the states there, not zero unless it is a steady state
    time    of the operating point [s]
    notes   remarks for the user
    """

    name: str
    states: tuple[Named, ...]
    inputs: tuple[Named, ...]
    outputs: tuple[Named, ...]
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

    def control(self) -> Any:
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
        """Write the arrays to `path` (.npz) and the names and modes beside it (.json)."""
        if path.suffix != ".npz":
            raise Problem(f"--out {path}: expected a name that ends in .npz")
        arrays = {"A": self.a, "B": self.b, "C": self.c, "D": self.d}
        points = {"x0": self.x0, "u0": self.u0, "y0": self.y0, "f0": self.f0}
        np.savez(path, allow_pickle=False, **arrays, **points)
        beside = path.with_suffix(".json")
        beside.write_text(json.dumps(self._described(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path, beside

    def _described(self) -> dict[str, Any]:
        def told(group: tuple[Named, ...], values: Array) -> list[dict[str, Any]]:
            return [
                {"name": n.name, "unit": n.unit.name if n.unit else "", "text": n.text, "value": float(v)}
                for n, v in zip(group, values, strict=True)
            ]

        return {
            "system": self.name,
            "time": self.time,
            "states": told(self.states, self.x0),
            "inputs": told(self.inputs, self.u0),
            "outputs": told(self.outputs, self.y0),
            "modes": [m.described() for m in self.modes],
            "notes": list(self.notes),
        }
