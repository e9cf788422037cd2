"""Masters: methods that advance a network by one communication step.

A master is a function that prepares a network once and returns `step(t, h)`, which takes all components
from t to t + h and leaves all outputs and inputs up to date at t + h. MASTERS maps names to masters.
"""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.coupling.masters.gauss_seidel import gauss_seidel
from orchestrator.coupling.masters.jacobi import jacobi
from orchestrator.coupling.network import Network
from orchestrator.errors import Problem

Step = Callable[[float, float], None]
Master = Callable[[Network], Step]

MASTERS: dict[str, Master] = {"jacobi": jacobi, "gauss-seidel": gauss_seidel}


def find(name: str) -> Master:
    """The master of this name."""
    if name not in MASTERS:
        raise Problem(f"unknown master {name!r}, expected one of {', '.join(MASTERS)}")
    return MASTERS[name]
