"""Inverse model of valve and cylinder chambers: from the speed of an actuator to its valve command.

Speed W of a piston at full opening, for chambers at P_h, P_r with capacitances C_h, C_r and areas A_h, A_r
(head and rod side), at constant force on the piston (A_h dP_h = A_r dP_r) while oil flows through both edges:

    W = K (A_h/C_h sqrt(P_s - P_h) + A_r/C_r sqrt(P_r - P_t)) / (A_h^2/C_h + A_r^2/C_r)        extending
    W = K (A_h/C_h sqrt(P_h - P_t) + A_r/C_r sqrt(P_s - P_r)) / (A_h^2/C_h + A_r^2/C_r)        retracting

with the flow gain K of a fully open edge, supply pressure P_s and tank pressure P_t. This is also valid while
the pressures settle after a change of direction. Without pressure feedback its limit for settled pressures is
used, with the force F of the load and P_t = 0:

    W^2 (A_h^3 + A_r^3) = K^2 (A_h P_s - F)        extending
    W^2 (A_h^3 + A_r^3) = K^2 (A_r P_s + F)        retracting

A pressure-compensated section holds its flow q_0 y at any load that the supply carries. With q_0h to the head
and q_0r to the rod side

    W = q_0h/A_h        extending            W = q_0r/A_r        retracting

Its check valve and the counterbalance valves hold the load, so it opens at any supply pressure: the pump of a
load-sensing machine waits for an open valve.

The swing motor is a cylinder with A_h = A_r = D, its displacement per angle of the column. The hose is in
series with the edge: with its turbulent resistance C_R (`Actuator.hose`), the speed at the opening
a is v = W a/sqrt(1 + C_R K^2 a^2). Laminar flow is left out. In warm edges it counts below 0.1 L/min. In
the hose it counts below 43 L/min at 60 degC and 276 L/min at 20 degC, where it makes up to 0.2 bar of 200.
"""

from dataclasses import dataclass

import casadi as ca

from fmus.components import cylinder
from fmus.components.hose import Law
from fmus.components.orifice import flow_gain
from fmus.components.spool_valve import Valve
from fmus.contract import Scalar
from fmus.smooth import capped, direction, positive, ramp, ramp_inverse, s_curve

ROUNDING = 2e5  # Pa: keeps the root real if the pressure drop over an edge is negative
MARGIN = 5e5  # Pa: excess of supply pressure over what the load needs from which the valve may open fully
CAP = 0.1  # width over which the opening is limited to 1
SLOW = 1e-4  # m/s or rad/s: speed below which the two directions are blended


@dataclass(frozen=True)
class Actuator:
    """A cylinder or the swing motor with its hoses and its valve.

    head_area, rod_area                 A_h, A_r [m2]; of the swing motor the displacement D [m3/rad]
    head_capacitance, rod_capacitance   C_h, C_r [m3/Pa]
    hose                                friction of each hose
    valve                               metering edges and command of the valve
    density                             density of the oil [kg/m3]
    section_flows                       q_0 of a pressure-compensated section to head and rod side [m3/s],
                                        0 of another valve
    """

    head_area: Scalar
    rod_area: Scalar
    head_capacitance: Scalar
    rod_capacitance: Scalar
    hose: Law
    valve: Valve
    density: Scalar
    section_flows: tuple[Scalar, Scalar]

    @property
    def stiffness(self) -> Scalar:
        """Force per displacement with closed ports [N/m, N.m/rad]."""
        return self.head_area**2 / self.head_capacitance + self.rod_area**2 / self.rod_capacitance

    @property
    def gain(self) -> Scalar:
        """Flow gain K of a fully open edge [m3/(s.Pa^0.5)]."""
        return flow_gain(self.valve.area, self.valve.discharge_coefficient, self.density)

    def force(self, head_pressure: Scalar, rod_pressure: Scalar) -> Scalar:
        """Force [N] or torque [N.m] at these pressures [Pa]."""
        return cylinder.force(self.head_area, self.rod_area, head_pressure, rod_pressure)


def pressures_at_load(
    a: Actuator, head_pressure: Scalar, rod_pressure: Scalar, load: Scalar
) -> tuple[Scalar, Scalar]:
    """Chamber pressures [Pa] if the piston moved, with closed valve, until its force is `load` [N, N.m].

    L = P_h C_h/A_h + P_r C_r/A_r does not depend on the motion of the piston, only on the oil that the valve
    lets in or out. Pressures from L and a filtered load therefore follow the settling of the pressures, but
    not the oscillation of the force.
    """
    c_head, c_rod = a.head_capacitance / a.head_area, a.rod_capacitance / a.rod_area
    level = head_pressure * c_head + rod_pressure * c_rod
    size = a.head_area * c_rod + a.rod_area * c_head
    return (load * c_rod + a.rod_area * level) / size, (a.head_area * level - load * c_head) / size


def full_speeds(
    a: Actuator, head_pressure: Scalar, rod_pressure: Scalar, supply: Scalar, tank: Scalar
) -> tuple[Scalar, Scalar]:
    """W [m/s, rad/s] extending and retracting, at these pressures [Pa]."""

    def root(drop: Scalar) -> Scalar:
        return ca.sqrt(positive(drop, ROUNDING))

    by_head, by_rod = a.head_area / a.head_capacitance, a.rod_area / a.rod_capacitance
    scale = a.gain / a.stiffness
    return (
        scale * (by_head * root(supply - head_pressure) + by_rod * root(rod_pressure - tank)),
        scale * (by_head * root(head_pressure - tank) + by_rod * root(supply - rod_pressure)),
    )


def nominal_full_speeds(a: Actuator, load: Scalar, supply: Scalar) -> tuple[Scalar, Scalar]:
    """W [m/s, rad/s] for settled pressures, a load F [N, N.m] and a tank pressure of zero."""
    cubes, width = a.head_area**3 + a.rod_area**3, ROUNDING * a.head_area
    up, down = positive(a.head_area * supply - load, width), positive(a.rod_area * supply + load, width)
    return a.gain * ca.sqrt(up / cubes), a.gain * ca.sqrt(down / cubes)


def section_speeds(a: Actuator) -> tuple[Scalar, Scalar]:
    """W [m/s, rad/s] of a pressure-compensated section, extending and retracting."""
    head, rod = a.section_flows
    return head / a.head_area, rod / a.rod_area


def needed_pressures(a: Actuator, load: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """Supply pressure [Pa] that the load [N, N.m] needs, extending and retracting."""
    extending, retracting = load + a.rod_area * tank, a.head_area * tank - load
    return extending / a.head_area, retracting / a.rod_area


def spare_forces(a: Actuator, load: Scalar, supply: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """Force [N, N.m] of the supply beyond the load, extending and retracting; at least that of `MARGIN`."""
    up, down = (ca.fmax(supply - needed, MARGIN) for needed in needed_pressures(a, load, tank))
    return a.head_area * up, a.rod_area * down


def supply_margins(a: Actuator, load: Scalar, supply: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """Factors on the opening, extending and retracting: 0 if the supply cannot move the load, else up to 1.

    With too little supply pressure an open valve would let the arm sink: oil would flow back into the supply.
    """
    up, down = (s_curve((supply - needed) / MARGIN) for needed in needed_pressures(a, load, tank))
    return up, down


def opening_for(
    a: Actuator,
    speed: Scalar,
    full: tuple[Scalar, Scalar],
    factors: tuple[Scalar, Scalar] = (1, 1),
) -> Scalar:
    """Valve opening [1] for a speed, with the sign of the speed; above 1 if the speed cannot be reached.

    full               W extending and retracting
    factors            reduction of the opening, extending and retracting
    """
    size = speed * direction(speed, SLOW)
    plain = (speed + size) / 2 / full[0] * factors[0] + (speed - size) / 2 / full[1] * factors[1]
    hose = ca.if_else(a.section_flows[0] > 0, 0, a.hose.turbulent * a.gain**2)
    return plain / ca.sqrt(1 - hose * ca.fmin(plain**2, 1))


def limited(opening: Scalar) -> Scalar:
    """The opening limited to -1 ... 1, unchanged up to 0.95."""
    return -capped(-capped(opening, CAP), CAP)


def command(
    valve: Valve, opening: Scalar, rounding_opening: Scalar, offsets: tuple[Scalar, Scalar] = (0, 0)
) -> Scalar:
    """Command [V] for an opening [1]: the inverse of `spool_valve.opening`.

    The step over the dead band is rounded for |opening| around `rounding_opening`; otherwise the command
    would jump at a change of sign. With the values of parameters.toml the valve therefore opens less than
    asked: by 10 % at 7 times `rounding_opening`, by 0.8 % at 20 times.
    """
    size = ca.sqrt(opening**2 + rounding_opening**2)
    width, (up, down) = valve.command_rounding, offsets
    dead_band = valve.dead_band + ((up + down) + (up - down) * opening / size) / 2
    z = ramp_inverse(size * ramp(valve.full_command - dead_band, width), width)
    return opening / size * (dead_band + z)
