"""Which ports of a component a system uses, for what, and which of them an FMU may lack.

A rate port carries the time derivative of another port, and no power. Without its wire inputs that moved
inside a step are held: less accurate, nothing worse.
"""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.system.bonds import find_bonds
from orchestrator.system.interface import Variable
from orchestrator.system.system import Component, Connection, Port, System
from orchestrator.units import IDENTITY, Unit

STEMS = {"_rate": ("",), "_acceleration": ("_velocity", "_speed")}  # of names: a derivative, and of what


@dataclass(frozen=True)
class Use:
    """A port in use.

    unit      of the numbers that pass through it
    wires     to or from it
    outside   it is one of the system's own inputs or outputs
    optional  an FMU may lack it
    """

    declared: Variable
    unit: Unit | None
    wires: tuple[Connection, ...]
    outside: bool
    optional: bool

    def __str__(self) -> str:
        return f"{self.declared.causality} {self.declared.name}{f' {self.unit}' if self.unit else ''}"


def uses(system: System, component: Component) -> dict[str, Use]:
    """The ports of a component that the system uses, by name."""
    ports = [end for c in system.connections for end in (c.source, c.target)]
    own = [port for inlet in system.inputs.values() for port, _ in inlet.targets]
    own += [outlet.source for outlet in system.outputs.values()]
    power = carrying(system)
    mine = dict.fromkeys(port for port in ports + own if port.component == component.name)
    return {port.variable: _use(system, port, port in own, power) for port in mine}


def carrying(system: System) -> set[Port]:
    """The inputs that carry power."""
    return {port for bond in find_bonds(system) for port in (bond.effort, bond.flow)}


def _use(system: System, port: Port, outside: bool, power: set[Port]) -> Use:
    wires = tuple(c for c in system.connections if port in (c.source, c.target))
    targets = {c.target for c in wires}
    # without a unit, the number has been that of the other end
    ends = [c.target if c.source == port else c.source for c in wires if c.map == IDENTITY]
    units = [system.variable(p).unit for p in (port, *ends)]
    return Use(
        declared=system.variable(port),
        unit=next((u for u in units if u), None),
        wires=wires,
        outside=outside,
        optional=not outside and not targets & power and all(_is_rate(system, p) for p in targets),
    )


def _is_rate(system: System, port: Port) -> bool:
    """Is an input the time derivative of another one, by declaration or by name?"""
    face, name = system.components[port.component].interface, port.variable
    if name in face.rates.values():
        return name not in face.rates  # else more than a slope: it has a slope itself
    for ending, stems in STEMS.items():
        if name.endswith(ending):
            return any(name.removesuffix(ending) + stem in face.variables for stem in stems)
    return False
