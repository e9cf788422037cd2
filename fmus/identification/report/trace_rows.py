"""Which signals of a joint are shown together, measured and predicted, as in the paper's Figs. 10 and 11."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.finding import Array
from fmus.units import display

# Below this share of the largest value the range of a signal that stands still is not shown.
REST = 1e-9


@dataclass(frozen=True)
class Line:
    """One signal in its SI unit; `predicted` is None for what is given, such as a command."""

    signal: str
    unit: str
    measured: Array
    predicted: Array | None = None
    name: str = ""

    @property
    def shown(self) -> tuple[str, float]:
        """Display unit and its factor."""
        return display(self.unit) or (self.unit, 1.0)

    @property
    def nrmse(self) -> float | None:
        """Root mean square residual over the range of the measurement, where both are numbers."""
        if self.predicted is None:
            return None
        known = np.isfinite(self.measured) & np.isfinite(self.predicted)
        if not known.any():
            return None
        measured, predicted = self.measured[known], self.predicted[known]
        span = float(np.ptp(measured))
        error = float(np.sqrt(np.mean((predicted - measured) ** 2)))
        return error / span if span > REST * (1 + float(np.abs(measured).max())) else None


@dataclass(frozen=True)
class Row:
    """Signals of one quantity in one panel."""

    label: str
    lines: tuple[Line, ...]


# what the paper's Figs. 10 and 11 show, and the same for the boom: label -> signals with their names
SIGNALS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "swing": {
        "command": {"swing.swing_command": ""},
        "angle": {"manipulator.swing_angle": ""},
        "speed": {"manipulator.swing_speed": ""},
        "flow into A": {"swing.swing_flow_a": ""},
        "pressure": {"swing.swing_pressure_a": "line A", "swing.swing_pressure_b": "line B"},
    },
    **{
        joint: {
            "command": {f"boom_stick.{joint}_command": ""},
            "angle": {f"manipulator.{joint}_angle": ""},
            "speed": {f"manipulator.{joint}_speed": ""},
            "flow into head": {f"boom_stick.{joint}_head_flow": ""},
            "pressure": {
                f"boom_stick.{joint}_head_pressure": "head",
                f"boom_stick.{joint}_rod_pressure": "rod",
            },
        }
        for joint in ("boom", "stick")
    },
}
FIGURES = {"swing": 10, "boom": 0, "stick": 11}


def rows(
    joint: str, measured: Mapping[str, Array], predicted: Mapping[str, Array], units: Mapping[str, str]
) -> list[Row]:
    """The panels of a joint, of the signals that were measured.

    measured, predicted   signals by name, shape (n,), SI; speeds among them
    """
    found = []
    for label, signals in SIGNALS[joint].items():
        lines = tuple(
            Line(signal, units[signal], measured[signal], predicted.get(signal), name)
            for signal, name in signals.items()
            if signal in measured
        )
        if lines:
            found.append(Row(label, lines))
    return found
