"""Connects, steps, records and judges FMUs. Knows no equation.

from orchestrator import run, load, assemble, read, write

result = run("build/harvester.ssp", scenario="data/scenarios/work_cycle.csv", step=1e-3)
print(result.card.text())
write(result.trace, "build/trace.csv")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.assembly import assemble
    from orchestrator.card import Card
    from orchestrator.errors import Problem
    from orchestrator.simulation import Interrupted, Result, RunFailed, run
    from orchestrator.ssp import load
    from orchestrator.system import System
    from orchestrator.trace import Trace, read, write

_WHERE = {
    "Card": "card",
    "Interrupted": "simulation",
    "Problem": "errors",
    "Result": "simulation",
    "RunFailed": "simulation",
    "System": "system",
    "Trace": "trace",
    "assemble": "assembly",
    "load": "ssp",
    "read": "trace",
    "run": "simulation",
    "write": "trace",
}

__all__ = [
    "Card", "Interrupted", "Problem", "Result", "RunFailed", "System", "Trace",
    "assemble", "load", "read", "run", "write",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use, so that the command line starts fast."""
    if name not in _WHERE:
        raise AttributeError(f"module 'orchestrator' has no attribute {name!r}")
    return getattr(import_module(f"orchestrator.{_WHERE[name]}"), name)
