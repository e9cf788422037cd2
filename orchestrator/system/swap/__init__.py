"""Another FMU in the place of a component: a variant of it, or any file, checked port by port.

What was connected stays connected, with the units of the new FMU converted; values that are given for a port
from outside (scenarios, parameter sets, --set) stay in the units of the FMU that is replaced.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from orchestrator.errors import Problem, suggest
from orchestrator.files.archive import Location
from orchestrator.system.assembly import open_component
from orchestrator.system.swap.fit import Fit, fit
from orchestrator.system.swap.start import carried
from orchestrator.system.swap.variants import find
from orchestrator.system.system import Component, Connection, Inlet, Outlet, System


def swapped(system: System, swaps: Mapping[str, str | Path]) -> System:
    """The system with other FMUs.

    swaps   component -> the name of a variant, or the path of an .fmu file
    """
    for name, chosen in swaps.items():
        if name not in system.components:
            near = suggest(name, system.components)
            there = ", ".join(system.components)
            raise Problem(f"swap {name}={chosen}: no component {name!r}{near}; there are {there}")
        system = _swap(system, name, find(system.source, name, chosen))
    return system


def _swap(system: System, name: str, file: Location) -> System:
    old, new = system.components[name], _opened(name, file)
    fitting = fit(system, old, new)
    start, notes = carried(old, new)
    face = replace(new.interface, variables={**new.interface.variables, **fitting.assumed})
    component = replace(new, interface=face, start=start, replaced=old.replaced or old.interface)
    told = f"{name} is swapped: {face.identifier} ({file})"
    return replace(
        system,
        components={**system.components, name: component},
        connections=tuple(
            _connection(c, name, fitting) for c in system.connections if _kept(c, name, fitting)
        ),
        inputs={i.name: _inlet(i, name, fitting) for i in system.inputs.values()},
        outputs={o.name: _outlet(o, name, fitting) for o in system.outputs.values()},
        notes=(*system.notes, told, *fitting.notes, *notes),
    )


def _opened(name: str, file: Location) -> Component:
    try:
        return open_component(name, file)
    except Problem as problem:
        raise Problem(f"swap {name}: {problem}") from None


def _kept(c: Connection, name: str, fitting: Fit) -> bool:
    ends = [end.variable for end in (c.source, c.target) if end.component == name]
    return not fitting.dropped.intersection(ends)


def _connection(c: Connection, name: str, fitting: Fit) -> Connection:
    linear = c.map
    if c.source.component == name:
        linear = fitting.outward(c.source.variable).then(linear)
    if c.target.component == name:
        linear = linear.then(fitting.inward(c.target.variable))
    return replace(c, map=linear)


def _inlet(inlet: Inlet, name: str, fitting: Fit) -> Inlet:
    targets = tuple(
        (port, linear.then(fitting.inward(port.variable)) if port.component == name else linear)
        for port, linear in inlet.targets
    )
    return replace(inlet, targets=targets)


def _outlet(outlet: Outlet, name: str, fitting: Fit) -> Outlet:
    if outlet.source.component != name:
        return outlet
    return replace(outlet, map=fitting.outward(outlet.source.variable).then(outlet.map))
