"""Hermite: the step is repeated until every input is the cubic between the ends of its source.

Values and slopes at both ends of a step make a cubic. In the first pass the far end is not known yet, and
sources are continued as Gauss-Seidel does it; each further pass starts again from the saved states, with the
cubics to where the pass before it ended. When passes change nothing any more the input of every component is
its source up to h^4, so the order of convergence is 4; docs/coupling.md has the measurements.

A component that only hears from ones that have stepped before it is right in the first pass already. When all
others can go back to a saved state the step is repeated, else it is computed once.
"""

from __future__ import annotations

from orchestrator.coupling.masters.plan import Plan, turns, unsettled
from orchestrator.settings import Coupling
from orchestrator.system.system import System


def hermite(system: System, coupling: Coupling) -> Plan:
    """At most `passes` passes, fewer when one changes all signals by less than the tolerance."""
    order = turns(system)
    repeated, components = unsettled(system, order), list(system.components.values())
    stuck = [components[k].name for k in sorted(repeated) if not components[k].interface.rollback]
    told = f"hermite computes every step once: {', '.join(stuck)} cannot go back to a saved state"
    passes = 1 if stuck else coupling.rounds
    return Plan(
        order,
        system.connections,
        coupling.extrapolation,
        degree=3,
        sequential=True,
        passes=passes,
        tolerance=coupling.miss,
        corrected=coupling.correct,
        watches=coupling.judges,
        repeated=repeated,
        notes=(told,) if stuck and coupling.rounds > 1 else (),
    )
