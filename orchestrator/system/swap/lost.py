"""What was known of the FMUs before the swaps, and is not any more."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.system.interface import Interface
from orchestrator.system.system import Component, System


def lost(system: System) -> Mapping[str, str]:
    """Names that a swapped FMU lacks, or does not let be set as the one before it did -> why."""
    swapped = ((c, c.replaced) for c in system.components.values() if c.replaced)
    return {f"{c.name}.{name}": why for c, before in swapped for name, why in _lost(c, before).items()}


def _lost(component: Component, before: Interface) -> dict[str, str]:
    now = component.interface.variables
    fixed = (n for n, v in before.variables.items() if n in now and v.settable and not now[n].settable)
    return {
        name: f"{component.source} has no such variable" for name in before.variables if name not in now
    } | {name: f"{component.source} determines it itself" for name in fixed}
