"""A recording holds what the operator did: its commands play the run that is compared with it."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.symbols import linear
from orchestrator.system.system import Port, System
from orchestrator.validation.reference import Reference


def played(system: System, reference: Reference, also: Sequence[str] = ()) -> Trace | None:
    """The signals of a reference that are inputs from outside the system, as a scenario; None without any.

    From outside are inputs that nothing feeds and those that a component without inputs of its own feeds,
    such as levers. What another component computes stays its business: such signals are compared.

    also   patterns of further signals that are played all the same, such as a measured supply pressure
    """
    for pattern in also:
        if not any(fnmatchcase(name, pattern) for name in reference.signals):
            told = ", ".join(reference.signals)
            raise Problem(f"--play {pattern}: no such signal in {reference.source}, expected of {told}")
    inputs = {str(p) for p in system.ports("input")}
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    outside = {str(p) for p in system.exposed}
    outside |= {str(c.target) for c in system.connections if c.source.component in sources}
    columns = {}
    for name, signal in reference.signals.items():
        port = _known(system, name)
        wanted = any(fnmatchcase(name, pattern) for pattern in also)
        if wanted and port not in inputs:
            raise Problem(f"--play: {name} is no input of {system.name}, expected one")
        if port not in outside and not wanted:
            continue
        unit = system.unit(system.port(port))
        factor, offset = linear(signal.unit, unit.name, name) if unit else (1.0, 0.0)
        columns[port] = factor * signal.values + offset
    return Trace(reference.time, columns) if columns else None


def _known(system: System, name: str) -> str:
    """The system's name of a signal; a system of one FMU has its variables under one name."""
    if len(system.components) > 1:
        return name
    return str(Port(next(iter(system.components)), name.partition(".")[2]))
