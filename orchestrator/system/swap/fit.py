"""Does an FMU fit into the place of a component? Every port that the system uses is checked.

A port fits if the new FMU has it with the same type, a causality that does the same work, and a unit of the
same dimension. Wires to and from rate ports that it lacks are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches

from orchestrator.errors import Problem
from orchestrator.system.assembly import family
from orchestrator.system.interface import Interface, Variable
from orchestrator.system.swap.start import listed
from orchestrator.system.swap.uses import Use, carrying, uses
from orchestrator.system.system import Component, Port, System
from orchestrator.units import IDENTITY, Linear, Unit, conversion

# what a port may be in the new FMU to do the work of the old one: more may change than before, not less
SERVES = {
    "input": ("input",),
    "parameter": ("parameter", "input"),
    "structuralParameter": ("structuralParameter", "parameter", "input"),
    "output": ("output",),
    "calculatedParameter": ("calculatedParameter", "output"),
    "local": ("local", "output"),
}


@dataclass(frozen=True)
class Fit:
    """How a new FMU takes the place of an old one.

    expected   port -> the unit that the system gives or takes
    found      port -> the unit of the new FMU
    dropped    ports whose wires are left out
    assumed    ports for which the new FMU states no unit, with the expected one
    """

    expected: Mapping[str, Unit | None]
    found: Mapping[str, Unit | None]
    dropped: frozenset[str]
    assumed: Mapping[str, Variable]
    notes: tuple[str, ...]

    def inward(self, port: str) -> Linear:
        """From the expected unit to that of the new FMU."""
        return conversion(self.expected.get(port), self.found.get(port), port)[0]

    def outward(self, port: str) -> Linear:
        """From the unit of the new FMU to the expected one."""
        return conversion(self.found.get(port), self.expected.get(port), port)[0]


def fit(system: System, old: Component, new: Component) -> Fit:
    """How the new component takes the place of the old one; a Problem tells all that does not fit."""
    used = uses(system, old)
    dropped = [n for n, use in used.items() if use.optional and n not in new.interface.variables]
    needed = {name: use for name, use in used.items() if name not in dropped}
    free = {n: v for n, v in new.interface.variables.items() if n not in used}
    faults = {name: fault for name, use in needed.items() if (fault := _fault(use, new.interface, free))}
    if faults:
        told = "; ".join(faults.values())
        raise Problem(f"swap {new.name}: {new.source} does not fit: {told}{_way_out(system, new, faults)}")
    found = {name: new.interface.variables[name] for name in needed}
    bare = [name for name, v in found.items() if v.unit is None and needed[name].unit]
    expected, units = {n: use.unit for n, use in needed.items()}, {n: v.unit for n, v in found.items()}
    remarks = (conversion(units[n], expected[n], f"{new.name}.{n} in {new.source}")[1] for n in needed)
    return Fit(
        expected=expected,
        found=units,
        dropped=frozenset(dropped),
        assumed={name: replace(found[name], unit=expected[name]) for name in bare},
        notes=(*_notes(old, new, dropped, bare), *filter(None, remarks)),
    )


def _fault(use: Use, face: Interface, free: Mapping[str, Variable]) -> str:
    """What is wrong with one port, as 'expected ..., got ...'; empty if it fits.

    free   the variables that may be meant by a name that is not there
    """
    name = use.declared.name
    if name in face.refused:
        return f"expected {use}, got {face.refused[name]}"
    if name in face.variables:
        return _mismatch(use, face.variables[name])
    meant = [other for other, v in free.items() if not _mismatch(use, v)]
    near = get_close_matches(name, meant, n=1, cutoff=0.8)
    return f"expected {use}, got none{f' (it has {near[0]})' if near else ''}"


def _mismatch(use: Use, found: Variable) -> str:
    """Where a variable differs from what is used."""
    old = use.declared
    if found.causality not in SERVES[old.causality]:
        return f"expected {use}, got {_article(found.causality)}"
    if family(found) != family(old):
        return f"expected {old.causality} {old.name} of type {old.kind}, got type {found.kind}"
    if found.unit and use.unit and found.unit.exponents is None and found.unit.name != use.unit.name:
        return f"expected {use}, got {found.unit}, a unit without definition"
    try:
        conversion(found.unit, use.unit, "")
    except Problem:
        return f"expected {use}, got {found.unit}"
    return ""


def _article(causality: str) -> str:
    kind = "local variable" if causality == "local" else causality
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _way_out(system: System, new: Component, faults: Iterable[str]) -> str:
    """How to do without inputs, where that is all that is wrong."""
    ports = [Port(new.name, name) for name in faults]
    fed = {c.target for c in system.connections} - carrying(system)
    lacking = [p for p in ports if p in fed and p.variable not in new.interface.variables]
    if len(lacking) < len(ports):
        return ""
    return f"; to do without: {' '.join(f'--cut {port}' for port in lacking)}"


def _notes(old: Component, new: Component, dropped: list[str], bare: list[str]) -> Iterator[str]:
    if dropped:
        yield (
            f"{new.source} has no {listed(dropped)}: without these rates inputs are held during a step,"
            " which costs accuracy"
        )
    if bare:
        yield f"{new.source} states no unit of {listed(bare)}: taken as that of the FMU it replaces"
    converted = [
        f"{v.name} in {v.unit}, not {before.unit}"
        for v in new.interface.variables.values()
        if (before := old.interface.variables.get(v.name)) and v.unit and before.unit
        if v.causality == before.causality and (v.settable or v.causality == "output")
        if _differ(before.unit, v.unit)
    ]
    idle = [v.name for v in new.interface.of("input") if v.name not in old.interface.variables]
    if idle:
        yield f"{new.source} has inputs of its own, {listed(idle)}: no wire feeds them"
    if converted:
        yield f"{new.source} has {listed(converted)}: converted; given values stay in the latter"


def _differ(old: Unit, new: Unit) -> bool:
    """Do two units of one dimension differ by more than their name?"""
    return old.dimension == new.dimension is not None and conversion(old, new, "")[0] != IDENTITY
