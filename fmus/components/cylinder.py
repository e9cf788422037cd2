"""Single-ended hydraulic cylinder: areas, chamber capacitances, force, holding pressures, end stops.

Signs: piston position x from the closed end, positive velocity and force extend the rod.
Rigid walls, no piston leakage (paper section 3(d)).
"""

import math
from dataclasses import dataclass

from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import positive, ramp, ramp_integral

STOP_WIDTH = 0.01  # width over which 1 + c d' of an end stop is rounded at zero


class Cylinder(Group):
    """Dimensions of a cylinder."""

    bore: Scalar = Quantity("m", "Bore of the {} cylinder", 0.1, minimum=1e-3, group="{} cylinder")
    rod: Scalar = Quantity("m", "Rod diameter of the {} cylinder", 0.1, minimum=0.0)
    stroke: Scalar = Quantity("m", "Stroke of the {} cylinder", minimum=1e-3)
    dead_volume: Scalar = Quantity("m3", "Dead volume of each chamber of the {} cylinder", 1e-4, minimum=1e-9)

    @property
    def areas(self) -> tuple[Scalar, Scalar]:
        """Head area and rod-side area [m2]."""
        return areas(self.bore, self.rod)

    def volumes(self, position: Scalar) -> tuple[Scalar, Scalar]:
        """Volumes [m3] of the head and rod chambers."""
        return volumes(position, self.stroke, *self.areas, self.dead_volume)


def areas(bore: Scalar, rod: Scalar) -> tuple[Scalar, Scalar]:
    """Head area and rod-side area [m2]."""
    head = math.pi / 4 * bore**2
    return head, head - math.pi / 4 * rod**2


def volumes(
    x: Scalar, stroke: Scalar, head: Scalar, rod: Scalar, dead_volume: Scalar
) -> tuple[Scalar, Scalar]:
    """Volumes [m3] of the head and rod chambers at piston position x [m] (correction E8)."""
    return dead_volume + head * x, dead_volume + rod * (stroke - x)


def force(head: Scalar, rod: Scalar, pressure_head: Scalar, pressure_rod: Scalar) -> Scalar:
    """Hydraulic force [N], eq. (6a): F = A_head P_head - A_rod P_rod."""
    return head * pressure_head - rod * pressure_rod


def holding_pressures(load: Scalar, head: Scalar, rod: Scalar, preload: Scalar) -> tuple[Scalar, Scalar]:
    """Pressures [Pa] of head and rod side that hold the piston at rest under a load [N].

    The rod side stays above `preload` [Pa], the head side above the pressure that balances the preload
    without a load, preload A_rod / A_head. The balance A_head P_head - A_rod P_rod = load is exact.
    """
    width = 0.1 * preload * rod  # the loaded side changes smoothly over loads of 10 % of the preload
    p_rod = preload + positive(-load, width) / rod
    return (load + rod * p_rod) / head, p_rod


@dataclass(frozen=True)
class Stop:
    """End stops of a piston or joint: force [N, N.m], stored energy [J], heat [W]."""

    force: Scalar
    stored: Scalar
    heat: Scalar


def stop(x: Scalar, v: Scalar, stroke: Scalar, stiffness: Scalar, damping: Scalar, rounding: Scalar) -> Stop:
    """End stops of a piston or joint: -F v = dE/dt + heat, where F(x, 0) = -dE/dx."""
    force, elastic = (stop_force(x, w, stroke, stiffness, damping, rounding) for w in (v, 0))
    springs = ramp_integral(-x, rounding) + ramp_integral(x - stroke, rounding)
    return Stop(force, stiffness * positive(1, STOP_WIDTH) * springs, (elastic - force) * v)


def stop_force(
    x: Scalar, v: Scalar, stroke: Scalar, stiffness: Scalar, damping: Scalar, rounding: Scalar
) -> Scalar:
    """Force [N] of the end stops on the piston: elastic with contact damping, zero inside the stroke.

    F = k d (1 + c d') at each end with penetration d, rounded over `rounding` [m] (Hunt and
    Crossley, J. Appl. Mech. 42 (1975) 440). 1 + c d' is rounded at zero, so that a stop never pulls.
    """
    low = stiffness * ramp(-x, rounding) * positive(1 - damping * v, STOP_WIDTH)
    high = stiffness * ramp(x - stroke, rounding) * positive(1 + damping * v, STOP_WIDTH)
    return low - high
