"""Parameter sets that a user picks, such as poses and programs: by name from the SSP, or a .ssv file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from orchestrator.errors import Problem, suggest
from orchestrator.files.archive import Location
from orchestrator.files.xml import parse
from orchestrator.system.ssv import Entry, entries
from orchestrator.system.swap.lost import lost
from orchestrator.system.system import System, coerce, settable
from orchestrator.units import conversion

FOLDER, SUFFIX = "resources", ".ssv"


def with_sets(system: System, sets: Sequence[str | Path]) -> System:
    """The system with start values from parameter sets, later ones over earlier ones.

    A set may name connected inputs: what it says of them holds until the run has initialised. What it says of
    a variable that was lost in a swap, or cannot be set any more, is left out.
    """
    for chosen in sets:
        file = _file(system, chosen)
        gone = lost(system)
        for entry in entries(file, parse(file, "ParameterSet"), {}):
            if entry.name in gone:
                note = f"{file}: {entry.name} is left out: {gone[entry.name]}"
                system = replace(system, notes=(*system.notes, note))
            else:
                system = _with_entry(system, file, entry)
    return system


def _with_entry(system: System, file: Location, entry: Entry) -> System:
    where = f"{file}: parameter {entry.name}"
    try:
        targets = system.targets(entry.name)
    except Problem as problem:
        raise Problem(f"{file}: {problem}") from None
    fresh = {name: dict(c.start) for name, c in system.components.items()}
    notes: list[str] = []
    for port, linear in targets:
        variable = system.variable(port)
        settable(port, system.components[port.component].interface)
        own = system.inputs[entry.name].unit if entry.name in system.inputs else system.unit(port)
        first, note = conversion(entry.unit, own, where)
        notes += [note] if note else []
        fresh[port.component][port.variable] = coerce(where, variable, entry.text, first.then(linear))
    components = {n: replace(c, start=fresh[n]) for n, c in system.components.items()}
    return replace(system, components=components, notes=(*system.notes, *notes))


def _file(system: System, chosen: str | Path) -> Location:
    """The file of a set: one on disk if the name ends in .ssv, else one of the SSP's."""
    if str(chosen).endswith(SUFFIX):
        return Location(Path(chosen))
    known = names(system)
    if str(chosen) not in known:
        home = system.source.parent if system.source and system.source.inside else system.source
        there = f"{home or system.name} holds {', '.join(known) or 'none'}"
        raise Problem(
            f"parameter set {str(chosen)!r} is unknown{suggest(str(chosen), known)}; {there};"
            f" a file name ends in {SUFFIX}"
        )
    return known[str(chosen)]


def names(system: System) -> Mapping[str, Location]:
    """The parameter sets in the resources of an SSP, by name."""
    source = system.source
    if source is None or not str(source).endswith(".ssd"):
        return {}
    home = source.parent if source.inside else Location(source.path.parent / "resources")
    inside = f"{FOLDER}/" if source.inside else ""
    found = [n for n in sorted(home.names()) if n.startswith(inside) and n.endswith(SUFFIX)]
    return {PurePosixPath(n).stem: home.member(n) for n in found if n.count("/") == inside.count("/")}
