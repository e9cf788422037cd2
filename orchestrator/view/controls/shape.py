"""From the deflection of one axis to the share of full speed that is meant.

    s(x) = sign(x) ((1 - c) u + c u^3),   u = max(0, (|x| - d) / (1 - d))

d  dead zone: a worn stick does not come back to zero exactly
c  progression: 0 is a straight line, 1 a pure cubic; small movements stay small, full is still full

s is odd, never falls, continuous, and 1 at full deflection. The form is ours; linear plus cubic is what
remote controls call "expo".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orchestrator.errors import Problem


@dataclass(frozen=True)
class Curve:
    """Dead zone and progression [1] of all four axes."""

    dead_zone: float = 0.08
    progression: float = 0.6

    def __post_init__(self) -> None:
        if not 0 <= self.dead_zone < 1:
            raise Problem(f"curve: expected a dead zone from 0 to below 1, found {self.dead_zone}")
        if not 0 <= self.progression <= 1:
            raise Problem(f"curve: expected a progression from 0 to 1, found {self.progression}")


def shaped(deflection: float, curve: Curve) -> float:
    """Share of full speed [1], -1 to 1, that a deflection means; beyond the stop is the stop."""
    beyond = (min(abs(deflection), 1.0) - curve.dead_zone) / (1 - curve.dead_zone)
    if not beyond > 0:  # also where the deflection is not a number
        return 0.0
    return math.copysign((1 - curve.progression) * beyond + curve.progression * beyond**3, deflection)
