"""Gauss-Seidel: components step one after the other, later ones with the new outputs of earlier ones."""

from __future__ import annotations

from orchestrator.coupling.masters.plan import Plan, turns
from orchestrator.settings import Coupling
from orchestrator.system.system import System


def gauss_seidel(system: System, coupling: Coupling) -> Plan:
    """Sources that have stepped are connected at degree `order` + 1, the others are continued at `order`.

    Order of convergence: `order` + 1. At order 0 inputs from components that step later are held, unless an
    FMU moves them itself by a rate input. The order of the components follows from the dependencies.
    """
    order, names = coupling.extrapolation, list(system.components)
    turn = {names[k]: i for i, k in enumerate(turns(system))}
    early = [c for c in system.connections if turn[c.source.component] < turn[c.target.component]]
    return Plan(
        turns(system),
        system.connections if order or coupling.correct else early,
        order,
        degree=min(order + 1, 3),
        sequential=True,
        corrected=coupling.correct,
        watches=coupling.judges,
    )
