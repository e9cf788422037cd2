"""Requirements and ports of every variant of the swing drive."""

from __future__ import annotations

from fmus.components import ports
from fmus.components.spool_valve import ValveParameters
from fmus.contract import Scalar, Terminal


def require(x: object, u: object, p: ValveParameters) -> dict[str, Scalar]:
    """What must hold beyond the bounds of single parameters."""
    return {"valve_full_command exceeds valve_dead_band": p.valve_full_command - p.valve_dead_band}


TERMINALS: tuple[Terminal, ...] = (
    ports.shaft("swing", drives=True),
    ports.lever("swing"),
    ports.supply_line(),
    ports.return_line(),
)
