"""A volume of oil: capacitance, entrained air, and cavities that open instead of tension in the oil.

    dP/dt = net inflow / (C + C_c(P))                   eq. (9a)

The paper's capacitance C = V / beta is right above the vapour pressure.

**Cavitation.** Below the vapour pressure P_v a cavity takes up volume at nearly constant pressure. It is
modelled as a capacitance

    C_c(P) = C_ref exp((P_v - P) / dP)          volume of the cavity = dP C_c(P)

which conserves oil: what left the chamber has to come back before the pressure rises.
With C_ref = 1e-12 m3/Pa, P_v = -20 kPa, dP = 5 kPa (gauge) a cavity of 1 litre lies at
-81 kPa, and 50 kPa above P_v the cavity is 2e-13 m3. Assumed: a smooth stand-in for vapour and
released air, not a bubble model. Valid down to 0.2 MPa below P_v, where the exponent is cut off.

**Entrained air** gives a compliance that falls with the pressure:

    kappa(P) = 1/beta + a/(n p) (p_0/p)^(1/n)        p = P + p_0 absolute        beta_eff = 1/kappa

a is the volume of free air at atmospheric pressure p_0 per volume of oil, n its polytropic exponent: 1 for
slow changes, 1.4 for fast ones. The compliances of oil and air add up (H. E. Merritt, Hydraulic Control
Systems, 1967, chapter 2); nothing is dissolved. Exact is the division by the volume that the mixture
has at P, which has no energy in closed form; for 1 % of air kappa strays from it by 0.3 % above 10 bar
and by 1 %, which is a, at atmospheric pressure. Below `FLOOR` the law goes on as its tangent, so that
a trial pressure below vacuum is finite: there the cavity rules.

With e(P) = int_0^P P' kappa(P') dP' a volume V at P stores V e(P).
"""

from __future__ import annotations

import casadi as ca

from fmus.contract import Group, Quantity, Scalar

CAVITY_CAPACITANCE = 1e-12  # C_ref [m3/Pa], about that of a 4 m hose: the cavity is felt from P_v on
VAPOUR_PRESSURE = -20e3  # P_v [Pa] gauge
CAVITY_SCALE = 5e3  # dP [Pa]
_LARGEST_EXPONENT = 40.0  # keeps trial steps of a solver finite: a cavity of 1e9 m3
_SMALLEST_EXPONENT = -60.0  # keeps exp() out of the slow denormal numbers: 1e-26 of C_ref

ATMOSPHERE = 101325.0  # p_0 [Pa], standard
FLOOR = 20e3  # absolute pressure [Pa] down to which the polytropic law is used; 80 kPa below tank


def pressure(text: str) -> Quantity:
    """A pressure of oil as a state: about 10 MPa, but where it cavitates errors must be small beside dP.

    After strokes of 1 to 6 V, some of which open cavities, the pressures are within 0.004 % of their range,
    at a tolerance of 1e-6; with the absolute tolerance that belongs to 10 MPa 0.35 % at the same cost.
    """
    return Quantity("Pa", text, 1e7, absolute=1e5)


def cavity(text: str) -> Quantity:
    """The volume of cavities as an output, with a warning where the oil cavitates."""
    return Quantity("m3", f"Cavities in {text}: above 1e-7 the oil cavitates", 1e-6, warn_above=1e-7)


def cavity_capacitance(pressure: Scalar) -> Scalar:
    """C_c(P) [m3/Pa]."""
    exponent = (VAPOUR_PRESSURE - pressure) * (1 / CAVITY_SCALE)
    return CAVITY_CAPACITANCE * ca.exp(ca.fmax(_SMALLEST_EXPONENT, ca.fmin(exponent, _LARGEST_EXPONENT)))


def cavity_volume(pressure: Scalar) -> Scalar:
    """Volume of the cavity [m3]: the integral of C_c from P up."""
    return CAVITY_SCALE * cavity_capacitance(pressure)


def pressure_rate(pressure: Scalar, net_flow: Scalar, capacitance: Scalar, share: float = 1.0) -> Scalar:
    """dP/dt [Pa/s] = net inflow / (C + C_c(P)), eq. (9a); a part of a volume has a `share` of its cavity."""
    return net_flow / (capacitance + share * cavity_capacitance(pressure))


def stored_energy(pressure: Scalar, capacitance: Scalar) -> Scalar:
    """Integral of P (C + C_c(P)) dP [J] from 0, the cavity's part from its closure at high pressure."""
    return capacitance * pressure**2 / 2 - cavity_volume(pressure) * (pressure + CAVITY_SCALE)


class Oil(Group):
    """The oil of a machine."""

    density: Scalar = Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0, group="Oil")
    bulk_modulus: Scalar = Quantity("Pa", "Bulk modulus of the oil", 1e9, minimum=1e7)


class Fluid(Oil):
    """With its viscosity and the air in it."""

    viscosity: Scalar = Quantity("Pa.s", "Dynamic viscosity of the oil", 1e-2, minimum=1e-7)
    air_share: Scalar = Quantity(
        "1", "Free air at atmospheric pressure, per volume of oil", 1e-2, minimum=0.0, maximum=0.2
    )
    air_exponent: Scalar = Quantity("1", "Polytropic exponent of the air", minimum=1.01, maximum=1.7)


def _held(pressure: Scalar) -> tuple[Scalar, Scalar]:
    """Absolute pressure, not below the floor, and by how much it would be."""
    absolute = pressure + ATMOSPHERE
    return ca.fmax(absolute, FLOOR), ca.fmax(FLOOR - absolute, 0)


def _air(fluid: Fluid, absolute: Scalar) -> tuple[Scalar, Scalar]:
    """Volume [1] of the air per volume of oil, and its compliance [1/Pa]."""
    s = 1 / fluid.air_exponent
    share = fluid.air_share * (ATMOSPHERE / absolute) ** s
    return share, s * share / absolute


def compliance(fluid: Fluid, pressure: Scalar) -> Scalar:
    """kappa [1/Pa] at a gauge pressure."""
    absolute, depth = _held(pressure)
    _, air = _air(fluid, absolute)
    tangent = 1 + (1 + 1 / fluid.air_exponent) * depth / absolute
    return 1 / fluid.bulk_modulus + air * tangent


def bulk_modulus(fluid: Fluid, pressure: Scalar) -> Scalar:
    """beta_eff [Pa] at a gauge pressure, without walls."""
    return 1 / compliance(fluid, pressure)


def energy_density(fluid: Fluid, pressure: Scalar) -> Scalar:
    """e [J/m3]: what a unit of volume stores at a gauge pressure."""
    s, (absolute, d) = 1 / fluid.air_exponent, _held(pressure)
    share, air = _air(fluid, absolute)
    polytropic = s * (absolute * share / (1 - s) + ATMOSPHERE * share / s)
    zero = fluid.air_share * ATMOSPHERE * (s / (1 - s) + 1)
    gauge, bend = absolute - ATMOSPHERE, (1 + s) / absolute
    below = air * (gauge * d + (gauge * bend - 1) * d**2 / 2 - bend * d**3 / 3)  # on the tangent
    return pressure**2 / (2 * fluid.bulk_modulus) + polytropic - zero - below
