"""Connects, steps, records and judges FMUs. Knows no equation.

from orchestrator import run, load, assemble, read, write, write_ssp

result = run("build/harvester.ssp", scenario="data/scenarios/work_cycle.csv", step=1e-3)
print(result.card.text())
write(result.trace, "build/trace.csv")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.base.coupling import Coupling
    from orchestrator.base.errors import Problem
    from orchestrator.data.trace import Trace, read, write
    from orchestrator.engine.job import Execution, Record
    from orchestrator.engine.result import Card, Interrupted, Result, RunFailed
    from orchestrator.engine.run import run
    from orchestrator.linear.linearize import linearize
    from orchestrator.linear.model import Linear, LinearModel
    from orchestrator.ssp.assembly import assemble
    from orchestrator.ssp.load import load
    from orchestrator.ssp.system import System
    from orchestrator.ssp.write import write_ssp

_WHERE = {
    "Card": "engine.result",
    "Coupling": "base.coupling",
    "Execution": "engine.job",
    "Interrupted": "engine.result",
    "Linear": "linear.model",
    "LinearModel": "linear.model",
    "Problem": "base.errors",
    "Record": "engine.job",
    "Result": "engine.result",
    "RunFailed": "engine.result",
    "System": "ssp.system",
    "Trace": "data.trace",
    "assemble": "ssp.assembly",
    "linearize": "linear.linearize",
    "load": "ssp.load",
    "read": "data.trace",
    "run": "engine.run",
    "write": "data.trace",
    "write_ssp": "ssp.write",
}

__all__ = [
    "Card", "Coupling", "Execution", "Interrupted", "Linear", "LinearModel", "Problem", "Record", "Result",
    "RunFailed", "System", "Trace", "assemble", "linearize", "load", "read", "run", "write", "write_ssp",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import on first use, so that the command line starts fast."""
    if name not in _WHERE:
        raise AttributeError(f"module 'orchestrator' has no attribute {name!r}")
    return getattr(import_module(f"orchestrator.{_WHERE[name]}"), name)
