"""From a speed to a command: the valve and the oil of `fmus.components` the other way round.

Speed of a piston at full opening, for chambers at P_h, P_r with capacitances C_h, C_r and areas A_h, A_r,
when the force on the piston stays (A_h dP_h = A_r dP_r) while the oil flows through both edges:

    W = K (A_h/C_h sqrt(P_s - P_h) + A_r/C_r sqrt(P_r - P_t)) / (A_h^2/C_h + A_r^2/C_r)        extending
    W = K (A_h/C_h sqrt(P_h - P_t) + A_r/C_r sqrt(P_s - P_r)) / (A_h^2/C_h + A_r^2/C_r)        retracting

This holds while the pressures settle after a change of direction and not only when they have; its limit is
v^2 (A_h^3 + A_r^3) = K^2 (A_h P_s - A_r P_t - F), used where no pressure is measured. The swing motor is a
cylinder with A_h = A_r = D. With the hose in series (C_R), v = W a/sqrt(1 + C_R K^2 a^2). Small flows are
laminar in the edges: with the mean flow Q of both ports a grows by ((Q^2 + Q_t^2)/Q^2)^(1/4), from eq. (1) as
it is rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components.smooth import capped, direction, positive, ramp, s_curve
from fmus.components.spool_valve import Valve, flow_gain
from fmus.contract import Scalar

ROUNDING = 2e5  # Pa: keeps a root real where a pressure is beyond that behind the edge
SPARE = 5e5  # Pa of the supply above what the load takes, at which the valve may open as far as asked
CAP = 0.1  # width over which the opening is limited to 1
SLOW = 1e-4  # m/s or rad/s: width over which the two directions go over


@dataclass(frozen=True)
class Actuator:
    """Areas A_h, A_r [m2, m3/rad], capacitances [m3/Pa], hose C_R [Pa.s2/m6], valve, density."""

    head: Scalar
    rod: Scalar
    head_capacitance: Scalar
    rod_capacitance: Scalar
    resistance: Scalar
    valve: Valve
    density: Scalar

    @property
    def stiffness(self) -> Scalar:
        """Force per displacement with closed ports [N/m, N.m/rad]."""
        return self.head**2 / self.head_capacitance + self.rod**2 / self.rod_capacitance

    @property
    def gain(self) -> Scalar:
        """K of a fully open edge."""
        return flow_gain(self.valve.area, self.valve.discharge_coefficient, self.density)


def steadied(a: Actuator, head: Scalar, rod: Scalar, load: Scalar) -> tuple[Scalar, Scalar]:
    """The pressures there would be with another force `load`, the piston moving and no oil passing the valve.

    L = P_h C_h/A_h + P_r C_r/A_r does not depend on the motion of the piston, only on the oil let in. So a
    filtered load and this L let the swinging of the force be without losing how the pressures settle.
    """
    c_head, c_rod = a.head_capacitance / a.head, a.rod_capacitance / a.rod
    level = head * c_head + rod * c_rod
    size = a.head * c_rod + a.rod * c_head
    return (load * c_rod + a.rod * level) / size, (a.head * level - load * c_head) / size


def full_speeds(
    a: Actuator, head: Scalar, rod: Scalar, supply: Scalar, tank: Scalar
) -> tuple[Scalar, Scalar]:
    """W [m/s, rad/s] extending and retracting, at these pressures [Pa]."""

    def root(drop: Scalar) -> Scalar:
        return ca.sqrt(positive(drop, ROUNDING))

    by_head, by_rod = a.head / a.head_capacitance, a.rod / a.rod_capacitance
    scale = a.gain / a.stiffness
    return (
        scale * (by_head * root(supply - head) + by_rod * root(rod - tank)),
        scale * (by_head * root(head - tank) + by_rod * root(supply - rod)),
    )


def nominal_full_speeds(a: Actuator, load: Scalar, supply: Scalar) -> tuple[Scalar, Scalar]:
    """W at rest of all pressures, for a load [N, N.m] and a tank without pressure."""
    cubes, width = a.head**3 + a.rod**3, ROUNDING * a.head
    up, down = positive(a.head * supply - load, width), positive(a.rod * supply + load, width)
    return a.gain * ca.sqrt(up / cubes), a.gain * ca.sqrt(down / cubes)


def carried(a: Actuator, load: Scalar, supply: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """0 where the supply cannot move the load [N, N.m] forth and back, 1 from `SPARE` on.

    An open valve would let the arm sink there: the oil goes back into the supply line.
    """

    def share(push: Scalar, behind: Scalar, against: Scalar) -> Scalar:
        return s_curve((push * supply - behind * tank - against) / (push * SPARE))

    return share(a.head, a.rod, load), share(a.rod, a.head, -load)


def opening_for(
    a: Actuator,
    speed: Scalar,
    full: tuple[Scalar, Scalar],
    foot: Scalar,
    shares: tuple[Scalar, Scalar] = (1, 1),
) -> Scalar:
    """Share of the full opening [1], with the sign of the speed; above 1 where it cannot be had.

    shares   what is let through of it, extending and retracting
    """
    size = speed * direction(speed, SLOW)
    plain = (speed + size) / 2 / full[0] * shares[0] + (speed - size) / 2 / full[1] * shares[1]
    hose = a.resistance * a.gain**2
    flow = (a.head + a.rod) / 2 * speed
    least = foot * (full[0] + full[1]) / 2 * (a.head + a.rod) / 2
    laminar = ((flow**2 + a.valve.transition_flow**2 + least**2) / (flow**2 + least**2)) ** 0.25
    return plain * laminar / ca.sqrt(1 - hose * ca.fmin(plain**2, 1))


def limited(opening: Scalar) -> Scalar:
    """Within -1 ... 1, exact up to 0.95."""
    return -capped(-capped(opening, CAP), CAP)


def command(valve: Valve, opening: Scalar, foot: Scalar) -> Scalar:
    """Command [V] that opens the valve by this share: the inverse of `spool_valve.opening`.

    The step over the dead band is rounded where |opening| is about `foot` (1 % above the exact opening at 7
    times that); without it the command would jump with the sign.
    """
    size = ca.sqrt(opening**2 + foot**2)
    z = inverse_ramp(size * ramp(valve.full_command - valve.dead_band, valve.command_rounding), valve)
    return opening / size * (valve.dead_band + z)


def inverse_ramp(value: Scalar, valve: Valve) -> Scalar:
    """z > 0 with ramp(z, w) = value > 0, to rounding.

    Below z = w, s^3 - s^4/2 = c with s = z/w, c = value/w: two steps of Halley's method from a series.
    """
    w = valve.command_rounding
    c = ca.fmin(value / w, 0.5)
    t = c ** (1 / 3)
    s = t * (1 + t / 6 + 0.19 * t**2)
    for _ in range(2):
        f, slope, bend = s**3 - s**4 / 2 - c, 3 * s**2 - 2 * s**3, 6 * s - 6 * s**2
        s = s - 2 * f * slope / (2 * slope**2 - f * bend)
    return w * s + ca.fmax(value - w / 2, 0)
