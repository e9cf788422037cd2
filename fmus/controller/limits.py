"""How much of the wanted speed the reference may have: one share for all joints, so the direction is kept.

    share = 1 / max(1, z)        z = (sum_i (x_i'/v_i)^8 + (outward x_i'/b_i)^8)^(1/8)

with the speed limits v_i and, towards each end of a stroke, b = stroke_gain times what is left of it up to
the margin: a piston comes to an end exponentially and leaves it freely. max is rounded over 0.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.components.smooth import ramp
from fmus.contract import Scalar

SHARPNESS = 8  # of the norm: 1.15 at most where all three actuators are at a limit
CREEP = 1e-6  # m/s, speed into an end of the stroke that remains: keeps the quotient finite
WIDTH = 0.2
FOOT = 1e-3  # m, over which the allowed speed is rounded at the end


@dataclass(frozen=True)
class Use:
    """Speed wanted over speed allowed: by the speed limits, and by the ends of the strokes."""

    speed: Scalar
    stroke: Scalar

    @property
    def share(self) -> Scalar:
        """Of the speed wanted, 1 while nothing is above 0.9."""
        n = SHARPNESS
        z = (self.speed**n + self.stroke**n + 1e-24) ** (1 / n)
        return 1 / (1 + ramp(z - 1 + WIDTH / 2, WIDTH))


def use(swing: Scalar, pistons: list[tuple[str, Scalar, Scalar]], p: Any) -> Use:
    """Of the swing speed [rad/s] and the pistons (name, position [m], velocity [m/s])."""
    n = SHARPNESS
    speed = (swing / p.swing_speed_limit) ** n
    stroke: Scalar = 0
    for name, position, velocity in pistons:
        speed += (velocity / getattr(p, f"{name}_speed_limit")) ** n
        end = getattr(p, f"{name}_stroke") - p.stroke_margin
        for left, outward in ((end - position, velocity), (position - p.stroke_margin, -velocity)):
            allowed = p.stroke_gain * ramp(left, FOOT) + CREEP
            stroke += (ca.fmax(0, outward) / allowed) ** n
    return Use((speed + 1e-32) ** (1 / n), (stroke + 1e-32) ** (1 / n))
