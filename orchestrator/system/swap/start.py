"""Start values of a component that go over to the FMU in its place."""

from __future__ import annotations

from orchestrator.system.interface import Value
from orchestrator.system.system import FEW, Component, coerce
from orchestrator.units import conversion


def carried(old: Component, new: Component) -> tuple[dict[str, Value], tuple[str, ...]]:
    """The start values in the units of the new FMU, and what to say about those that it cannot take."""
    start: dict[str, Value] = {}
    lacking, fixed = list[str](), list[str]()
    for name, value in old.start.items():
        variable = new.interface.variables.get(name)
        if variable is None:
            lacking.append(name)
        elif not variable.settable:
            fixed.append(name)
        else:
            where = f"{new.name}: {new.source}: start value of {name}"
            linear, _ = conversion(old.interface.variables[name].unit, variable.unit, where)
            start[name] = coerce(where, variable, value, linear)
    notes = (
        [f"{new.source} has no {listed(lacking)}: what the system sets there is left out"] if lacking else []
    )
    notes += (
        [f"{new.source} determines {listed(fixed)} itself: what the system sets is left out"] if fixed else []
    )
    return start, tuple(notes)


def listed(names: list[str]) -> str:
    """The first few names."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return f"{', '.join(names[:FEW])}{more}"
