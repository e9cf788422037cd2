"""Limits and time constants of the diagnosis (settings.toml), and references of a healthy machine."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from fmus.contract import Group, Quantity, Scalar, make_group
from fmus.parameters import Number

LITRE = 1 / 6e4  # L/min in m3/s
_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_ROWS = {n: (heading, row) for heading, rows in _TABLES.items() for n, row in rows.items()}
NUMBERS = {n: Number(row["value"], row["unit"], "assumed", row["note"]) for n, (_, row) in _ROWS.items()}
Settings: type[Group] = make_group(
    "Settings",
    {n: Quantity(row["unit"], row["text"], abs(row["value"]), group=g) for n, (g, row) in _ROWS.items()},
)

# of an axis: value if no healthy machine was measured
OF_VALVE = ("gain_up", "dead_band_up", "gain_down", "dead_band_down", "half_hysteresis", "valve_delay")
REFERENCES = dict(zip(OF_VALVE, (1.0, 0.0, 1.0, 0.0, 0.2, 0.02), strict=True)) | {"air": 0.0}
OF_EDGES = ("return_edge_up", "return_edge_down")
REFERENCES |= dict.fromkeys(OF_EDGES, 1.5)
OF_MACHINE = {"return_resistance": 4e7, "pump_pressure": 0.0}


def number(name: str, p: Any) -> Scalar:
    """The reference of a finding, from the parameters."""
    return getattr(p, f"{name}_reference")
