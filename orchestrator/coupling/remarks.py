"""What the components of a run cannot do of what its master would do with them."""

from __future__ import annotations

from collections.abc import Iterable

from orchestrator.coupling.masters.plan import Plan
from orchestrator.coupling.network import Network
from orchestrator.coupling.signal import DRIVEN, NO_SLOPE
from orchestrator.settings import Coupling

SHOWN = 4  # names in a list


def remarks(network: Network, plan: Plan, coupling: Coupling) -> tuple[str, ...]:
    """One line for each way in which the master had to do without something."""
    notes = plan.notes
    stuck = _listed(name for name, slave in network.slaves.items() if not slave.interface.rollback)
    if coupling.adaptive is not None and stuck:
        notes += (f"adaptive steps with too large an error stand: {stuck} cannot go back to a saved state",)
    if not plan.sloped:
        return notes
    names = {place: str(port) for port, place in network.real.index.items()}
    wired = [s for s in network.signals if s.maker != DRIVEN and s.wanted]
    asked = [plan.asks(name) for name in network.slaves]
    silent = _listed(names[s.source] for s in wired if s.slope == NO_SLOPE and asked[s.maker])
    still = _listed(names[s.target] for s in wired if s.degree == 0)
    straight = _listed(names[s.target] for s in wired if 0 < s.degree < s.wanted)
    told = {
        "slopes from differences of values, because the FMUs tell none": silent,
        "inputs held at their mean over a step, because the FMUs take no slopes": still,
        "inputs moved at straight lines, because the FMUs take no curves": straight,
    }
    return (*notes, *(f"{what}: {which}" for what, which in told.items() if which))


def _listed(names: Iterable[str]) -> str:
    found = list(dict.fromkeys(names))
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return f"{', '.join(found[:SHOWN])}{more}"
