"""How fast a machine or a replay may go."""

from __future__ import annotations

SLOWEST, FASTEST = 0.1, 10.0  # times real time


def factor_of(factor: float) -> float:
    """A speed factor that is possible."""
    from orchestrator.errors import Problem

    if not SLOWEST <= factor <= FASTEST:
        raise Problem(f"speed: expected a factor from {SLOWEST:g} to {FASTEST:g}, got {factor:g}")
    return float(factor)
