"""State-space model with names and units: modes, text output, files, export to python-control."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import write_whole
from orchestrator.base.text import TextTable
from orchestrator.data.table import Array
from orchestrator.linear.modes import LinearVariable, Mode, modes
from orchestrator.results.report import Part, Report, Table, Text

COLUMNS = ("frequency [Hz]", "damping ratio [1]", "time constant [s]", "mode", "states")
ROUNDING = 1e-12  # relative to nominal; smaller values are printed as 0
STEADY_RATE = 1e-4  # [1/s], relative to nominal; states with a smaller rate are printed as steady
FAST = 1e-3  # [s]; a state with a smaller time constant T is regarded as steady ...
FAST_RANGE = 1e-2  # ... if its remaining change |f0| T is below this fraction of nominal


@dataclass(frozen=True)
class LinearModel:
    """Linear model at an operating point x0, u0, y0, with the deviations dx, du, dy from it.

        d(dx)/dt = f0 + A dx + B du
        dy = C dx + D du

    f0      state derivatives at the operating point, zero in a steady state
    time    of the operating point [s]
    moving  names of the positions whose constant speed was asked for
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
    moving: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lines = (shorten(line, 120, placeholder=" ...") for line in self.text().splitlines()[:4])
        return "\n".join([*lines, "print(model.text())"])

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """Eigenvalues with their participating states: oscillations, then the others, each slowest first."""
        return modes(self.a, self.states)

    def report(self) -> Report:
        """Operating point, stability and modes."""
        groups = {"state": self.states, "input": self.inputs, "output": self.outputs}
        count = ", ".join(f"{len(group)} {name}{'s' * (len(group) != 1)}" for name, group in groups.items())
        stability = _stability(self.modes) if self.modes else ""
        head = [f"{self.name} at t = {self.time:g} s: {count}", *_operating_point(self)]
        table = TextTable(COLUMNS, [_row(m) for m in self.modes], left=(3, 4))
        notes = [f"note: {note}" for note in self.notes]
        parts: list[Part] = [Text([*head, *filter(None, [stability])]), Table(table, notes)]
        return Report(f"Linear model of {self.name}", stability, parts, self._as_dict())

    def text(self) -> str:
        """Summary of the operating point and the modes."""
        return self.report().text(verdict=False)

    def to_control(self) -> Any:
        """Convert to a StateSpace of the package python-control; dots in names become underscores."""
        require("control", "to_control()", "control")
        import control

        groups = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        names = {group: [v.name.replace(".", "_") for v in groups[group]] for group in groups}
        return control.StateSpace(self.a, self.b, self.c, self.d, name=self.name, **names)

    control = to_control  # old name, kept for compatibility

    def save(self, path: Path) -> tuple[Path, Path]:
        """Write the arrays to `path` (.npz) and the names and modes next to it (.json)."""
        if path.suffix != ".npz":
            raise Problem(f"{path}: expected a file name ending in .npz")
        matrices = {"A": self.a, "B": self.b, "C": self.c, "D": self.d}
        point = {"x0": self.x0, "u0": self.u0, "y0": self.y0, "f0": self.f0}
        arrays = BytesIO()
        np.savez(arrays, allow_pickle=False, **matrices, **point)
        write_whole(path, arrays.getvalue())
        json_path = path.with_suffix(".json")
        return path, write_whole(json_path, self.report().json() + "\n")

    def _as_dict(self) -> dict[str, Any]:
        def variables(group: tuple[LinearVariable, ...], values: Array) -> list[dict[str, Any]]:
            return [
                {
                    "name": variable.name,
                    "unit": variable.unit.name if variable.unit else "",
                    "text": variable.description,
                    "value": float(value),
                }
                for variable, value in zip(group, values, strict=True)
            ]

        return {
            "system": self.name,
            "time": self.time,
            "states": variables(self.states, self.x0),
            "inputs": variables(self.inputs, self.u0),
            "outputs": variables(self.outputs, self.y0),
            "modes": [m.as_dict() for m in self.modes],
            "notes": list(self.notes),
        }


Linear = LinearModel  # old name, kept for compatibility


def _operating_point(linear: LinearModel) -> list[str]:
    """Input values, the up to three states with the largest relative rates, and the given speeds."""
    inputs = [f"{i.name} = {_value(v, i)}{_unit(i)}" for i, v in zip(linear.inputs, linear.u0, strict=True)]
    moving = [state.name in linear.moving for state in linear.states]
    rates = np.where(moving, 0.0, _relative_rates(linear))
    fastest = [i for i in np.argsort(-rates)[:3] if rates[i] > STEADY_RATE]
    texts = [f"{f:.3g}{_unit(s)} per s" for s, f in zip(linear.states, linear.f0, strict=True)]
    changes = [f"{linear.states[i].name} changes by {texts[i]}" for i in fastest]
    speeds = "".join(f"; {linear.states[i].name} moves at {texts[i]}" for i in np.flatnonzero(moving))
    steady = f"not a steady state: {', '.join(changes)}" if changes else "steady state"
    return [f"inputs: {', '.join(inputs) or 'none'}", f"{steady}{speeds}"]


def _relative_rates(linear: LinearModel) -> Array:
    """Relative rates |f0| / nominal [1/s]; 0 for fast states (T = -1 / A_ii) with a negligible |f0| T."""
    rates = np.abs(linear.f0) / np.array([s.nominal for s in linear.states])
    decay_rates = -np.diag(linear.a)
    return np.where((decay_rates > 1.0 / FAST) & (rates <= FAST_RANGE * decay_rates), 0.0, rates)


def _stability(modes: Sequence[Mode]) -> str:
    """Names of the unstable and of the marginally stable modes; "stable" without any."""
    unstable = [m.name for m in modes if m.value.real > 0.0]
    marginal = [m.name for m in modes if m.value.real == 0.0]
    parts = [f"unstable: {', '.join(unstable)}"] if unstable else []
    parts += [f"marginally stable: {', '.join(marginal)}"] if marginal else []
    return "; ".join(parts) or "stable"


def _value(value: float, variable: LinearVariable) -> str:
    """A value with six digits; 0 for a value below the rounding error relative to nominal."""
    return f"{0.0 if abs(value) < ROUNDING * variable.nominal else value:.6g}"


def _unit(variable: LinearVariable) -> str:
    return f" {variable.unit.name}" if variable.unit and variable.unit.name != "1" else ""


def _row(mode: Mode) -> tuple[str, ...]:
    frequency = f"{mode.frequency:.4g}" if mode.oscillates else ""
    time_constant = f"{mode.time_constant:.4g}" if math.isfinite(mode.time_constant) else ""
    damping = f"{mode.damping:.3f}" if mode.oscillates else ""
    return frequency, damping, time_constant, mode.name, ", ".join(mode.main_states)
