"""Masters: how the components take a communication step together. Each makes a `Plan` of a system."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from orchestrator.coupling.masters.gauss_seidel import gauss_seidel
from orchestrator.coupling.masters.hermite import hermite
from orchestrator.coupling.masters.interface_jacobian import interface_jacobian
from orchestrator.coupling.masters.jacobi import jacobi
from orchestrator.coupling.masters.plan import Plan
from orchestrator.settings import Coupling
from orchestrator.system.system import System

MASTERS: Mapping[str, Callable[[System, Coupling], Plan]] = {
    "jacobi": jacobi,
    "gauss-seidel": gauss_seidel,
    "hermite": hermite,
    "interface-jacobian": interface_jacobian,
}


def plan(system: System, coupling: Coupling) -> Plan:
    """The plan of the chosen master."""
    return MASTERS[coupling.master](system, coupling)
