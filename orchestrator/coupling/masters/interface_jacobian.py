"""Interface-Jacobian: the components' own linearisations, joined, say what all inputs will do in the step.

Directional derivatives of the FMUs make one linear system of all components, see `foresight.py`. Its solution
over the step gives every input as a cubic; one pass, no rollback. Components whose future does not depend on
others step first, and are followed as they went. docs/coupling.md has the equations and the measurements.
"""

from __future__ import annotations

from collections.abc import Iterable

from orchestrator.coupling.masters.plan import Outlook, Plan, turns
from orchestrator.settings import Coupling
from orchestrator.system.interface import Interface
from orchestrator.system.system import Port, System


def interface_jacobian(system: System, coupling: Coupling) -> Plan:
    """All inputs are foretold; those from components that have stepped are bent to where they arrived."""
    heard = _heard(system)
    leads = _leads(system, heard)
    needed = _needed(system, leads, heard)
    open_ = frozenset(name for name in needed if _tells(system.components[name].interface))
    order = [*(k for k in turns(system) if k in leads), *(k for k in turns(system) if k not in leads)]
    return Plan(
        order,
        system.connections,
        order=coupling.extrapolation,
        degree=3,
        sequential=True,
        watches=coupling.judges,
        outlook=Outlook(len(leads), open_, open_ == needed, heard, coupling.lag),
    )


def _heard(system: System) -> frozenset[Port]:
    """Inputs that a state depends on, or an output that feeds another component."""
    sources: dict[str, set[str]] = {name: set() for name in system.components}
    for c in system.connections:
        if c.target.variable not in system.components[c.target.component].interface.inert:
            sources[c.source.component].add(c.source.variable)
    return frozenset(
        Port(name, v.name)
        for name, component in system.components.items()
        for v in component.interface.of("input")
        if _matters(component.interface, v.name, sources[name])
    )


def _matters(face: Interface, variable: str, outputs: Iterable[str]) -> bool:
    if variable in face.inert:
        return False
    if not (face.states or face.stateless):
        return True
    told = [face.knowns.get(rate) for rate in face.states.values()]
    moves = any(known is None or variable in known for known in told)
    return moves or any(variable in face.depends(y) for y in outputs)


def _leads(system: System, heard: frozenset[Port]) -> set[int]:
    """Components that hear of nobody but each other: sources, and what merely follows sources."""
    names, found = list(system.components), set[int]()
    wires = [c for c in system.connections if c.target in heard and c.source.component != c.target.component]
    while True:
        done = {names[k] for k in found}
        behind = {c.target.component for c in wires if c.source.component not in done}
        more = {k for k, name in enumerate(names) if name not in behind and not _loops(system, name, heard)}
        if more == found:
            return found
        found = more


def _loops(system: System, name: str, heard: frozenset[Port]) -> bool:
    """Does a component feed itself?"""
    return any(
        c.source.component == c.target.component == name and c.target in heard for c in system.connections
    )


def _needed(system: System, leads: set[int], heard: frozenset[Port]) -> frozenset[str]:
    """Components whose future is to be foretold: they do not lead, and feed one that does not."""
    others = {name for k, name in enumerate(system.components) if k not in leads}
    wires = [c for c in system.connections if c.target in heard and c.target.component in others]
    return frozenset({c.source.component for c in wires} & others)


def _tells(face: Interface) -> bool:
    """Does a component declare to tell how its states and outputs change?"""
    return face.directional and bool(face.states or face.stateless)
