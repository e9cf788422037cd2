"""Flow through sharp-edged orifices and pressure-controlled valves, from the pressure difference.

The edges of valves turn from turbulent to laminar flow at a Reynolds number:

    dp = C_R Q (|Q| + Q_t)        C_R = rho / (2 C_d^2 A^2)        Q_t = Re_t nu sqrt(pi A) / 2

eq. (1), (2) of the paper for |Q| >> Q_t, with the other limit C_d = C_d0 sqrt(Re/Re_t). Both cross at
Re_t = (C_d/delta)^2 with Merritt's laminar coefficient delta (section 3.4): 0.2 for a round sharp-edged
orifice and 0.157 for a slit give 9.6 and 15.6. Re = Q D/(A nu) with the diameter D = sqrt(4 A/pi) of a round
opening of the same area. The sum of a viscous and an inertial drop is Idelchik's form (Handbook of Hydraulic
Resistance).
Q is odd and increasing in dp, with a continuous derivative.

Relief valves have a smooth static characteristic:

    Q = g r(dP - P_set, w)        r the ramp of `fmus.smooth`: exactly 0 for dP <= P_set

Above P_set + w this is a straight line of slope g from P_set + w/2. dP is the pressure of the line minus that
of the return line; it has the opposite sign for an anti-cavitation valve, which is an edge of the area

    A(dP) = A_seat s((dP - P_set)/w)        s the `s_curve` of `fmus.smooth`

Poppet dynamics (faster than 5 ms) and hysteresis are neglected.
"""

import math
from typing import Protocol

import casadi as ca

from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import ramp, s_curve

CLOSED = 1e-9  # m2, in Q_t beside the area: keeps Q_t of a closed edge above zero


class Liquid(Protocol):
    """Density rho [kg/m3] and viscosity nu [m2/s] of an oil."""

    @property
    def density(self) -> Scalar:
        """rho."""

    @property
    def kinematic_viscosity(self) -> Scalar:
        """nu."""


class Edge(Group):
    """What the edges of a valve have in common."""

    discharge_coefficient: Scalar = Quantity(
        "1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0, group="Valve"
    )
    transition_reynolds: Scalar = Quantity(
        "1",
        "Reynolds number at which the laminar and the turbulent asymptote of an edge cross",
        10.0,
        minimum=0.1,
        maximum=1e3,
    )

    def square(self, area: Scalar, oil: Liquid) -> Scalar:
        """K^2 = 1 / C_R [m6/(s2.Pa)] of an opening [m2]."""
        return flow_gain(area, self.discharge_coefficient, oil.density) ** 2

    def transition_flow(self, area: Scalar, oil: Liquid, closed: Scalar = CLOSED) -> Scalar:
        """Q_t [m3/s] of an opening [m2]."""
        return self.transition_reynolds * oil.kinematic_viscosity * ca.sqrt(math.pi / 4 * (area + closed))

    def flow(self, area: Scalar, drop: Scalar, oil: Liquid) -> Scalar:
        """Flow [m3/s] through an opening [m2], with the sign of the drop [Pa]; exactly 0 if it is closed."""
        return root(self.square(area, oil) * drop, self.transition_flow(area, oil))


def flow_gain(area: Scalar, discharge_coefficient: Scalar, density: Scalar) -> Scalar:
    """K = C_R^(-1/2) [m3/s/Pa^(1/2)], paper eq. (2)."""
    return discharge_coefficient * area * ca.sqrt(2 / density)


def root(y: Scalar, linear: Scalar, square: Scalar = 1) -> Scalar:
    """The Q with square Q |Q| + linear Q = y. No difference of nearly equal values occurs."""
    return 2 * y / (linear + ca.sqrt(linear**2 + 4 * square * ca.fabs(y)))


class PressureValve(Group):
    """Opening pressure P_set, slope g and rounding w of a valve; declared as that of a relief valve."""

    pressure: Scalar = Quantity(
        "Pa", "Pressure at which a {} valve opens", 1e7, minimum=0.0, group="{} valves"
    )
    gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of a {} valve per pressure above the opening pressure", 1e-9, minimum=0.0
    )
    rounding: Scalar = Quantity("Pa", "Pressure range over which a {} valve begins to open", 1e5, minimum=1.0)

    def flow(self, drop: Scalar) -> Scalar:
        """Flow [m3/s] at a pressure difference [Pa]; never negative if P_set >= 0."""
        return self.gain * ramp(drop - self.pressure, self.rounding)

    def cross_flow(self, drop: Scalar) -> Scalar:
        """Flow [m3/s] of two cross-port valves, with the sign of the pressure difference [Pa]."""
        return self.flow(drop) - self.flow(-drop)


class AntiCavitation(Group):
    """An anti-cavitation valve of an actuator, from the return line: a seat that opens by pressure."""

    pressure: Scalar = Quantity(
        "Pa",
        "Pressure difference below the return line at which an anti-cavitation valve opens",
        1e4,
        minimum=0.0,
        group="Relief valves",
    )
    area: Scalar = Quantity("m2", "Area of the open seat of an anti-cavitation valve", 1e-4, minimum=0.0)
    rounding: Scalar = Quantity(
        "Pa", "Pressure range over which an anti-cavitation valve opens", 1e3, minimum=1.0
    )

    def flow(self, edge: Edge, oil: Liquid, drop: Scalar) -> Scalar:
        """Flow [m3/s] at a pressure difference [Pa]; never negative."""
        return edge.flow(self.area * s_curve((drop - self.pressure) / self.rounding), drop, oil)


class Reliefs(Group, relief=PressureValve, anti_cavitation=AntiCavitation):
    """Relief and anti-cavitation valves of an actuator."""
