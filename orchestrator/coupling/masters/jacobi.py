"""Jacobi: every component takes the same step with what is known at its start."""

from __future__ import annotations

from orchestrator.coupling.masters.plan import Plan
from orchestrator.settings import Coupling
from orchestrator.system.system import System


def jacobi(system: System, coupling: Coupling) -> Plan:
    """Sources are continued over the step by a polynomial of degree `order`; order of convergence: one more.

    At order 0 inputs are held, unless an FMU moves them itself by a rate input.
    """
    order = coupling.extrapolation
    moved = system.connections if order or coupling.correct else ()
    watches = coupling.judges
    everybody = range(len(system.components))
    return Plan(everybody, moved, order, degree=order, corrected=coupling.correct, watches=watches)
