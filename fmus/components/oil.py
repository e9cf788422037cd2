"""Oil with entrained air: compliance that falls with the pressure, and the energy that goes with it.

    kappa(P) = 1/beta + a/(n p) (p_0/p)^(1/n)        p = P + p_0 absolute        beta_eff = 1/kappa

a is the volume of free air at atmospheric pressure p_0 per volume of oil, n its polytropic exponent: 1 for
slow changes, 1.4 for fast ones. The compliances of oil and air add up (H. E. Merritt, Hydraulic Control
Systems, 1967, chapter 2); nothing is dissolved. Exact is the division by the volume that the mixture
has at P, which has no energy in closed form; for 1 % of air kappa strays from it by 0.3 % above 10 bar
and by 1 %, which is a, at atmospheric pressure. Below `FLOOR` the law goes on as its tangent, so that
a trial pressure below vacuum is finite: there the void of `fmus.components.chamber` rules.

With e(P) = int_0^P P' kappa(P') dP' a volume V at P stores V e(P).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components import chamber
from fmus.contract import Scalar

ATMOSPHERE = 101325.0  # p_0 [Pa], standard
FLOOR = 20e3  # absolute pressure [Pa] down to which the polytropic law is used; 80 kPa below tank


@dataclass(frozen=True)
class Fluid:
    """Density [kg/m3], dynamic viscosity [Pa.s], bulk modulus [Pa], air share a [1], exponent n [1]."""

    density: Scalar
    viscosity: Scalar
    bulk_modulus: Scalar
    air: Scalar
    polytropic_exponent: Scalar


def _held(pressure: Scalar) -> tuple[Scalar, Scalar]:
    """Absolute pressure, not below the floor, and by how much it would be."""
    absolute = pressure + ATMOSPHERE
    return ca.fmax(absolute, FLOOR), ca.fmax(FLOOR - absolute, 0)


def _air(fluid: Fluid, absolute: Scalar) -> tuple[Scalar, Scalar]:
    """Volume [1] of the air per volume of oil, and its compliance [1/Pa]."""
    s = 1 / fluid.polytropic_exponent
    share = fluid.air * (ATMOSPHERE / absolute) ** s
    return share, s * share / absolute


def compliance(fluid: Fluid, pressure: Scalar) -> Scalar:
    """kappa [1/Pa] at a gauge pressure."""
    absolute, depth = _held(pressure)
    _, air = _air(fluid, absolute)
    tangent = 1 + (1 + 1 / fluid.polytropic_exponent) * depth / absolute
    return 1 / fluid.bulk_modulus + air * tangent


def bulk_modulus(fluid: Fluid, pressure: Scalar) -> Scalar:
    """beta_eff [Pa] at a gauge pressure, without walls."""
    return 1 / compliance(fluid, pressure)


def energy_density(fluid: Fluid, pressure: Scalar) -> Scalar:
    """e [J/m3]: what a unit of volume stores at a gauge pressure."""
    s, (absolute, d) = 1 / fluid.polytropic_exponent, _held(pressure)
    share, air = _air(fluid, absolute)
    polytropic = s * (absolute * share / (1 - s) + ATMOSPHERE * share / s)
    zero = fluid.air * ATMOSPHERE * (s / (1 - s) + 1)
    gauge, bend = absolute - ATMOSPHERE, (1 + s) / absolute
    below = air * (gauge * d + (gauge * bend - 1) * d**2 / 2 - bend * d**3 / 3)  # on the tangent
    return pressure**2 / (2 * fluid.bulk_modulus) + polytropic - zero - below


def pressure_rate(pressure: Scalar, net_flow: Scalar, capacitance: Scalar, voids: Scalar = 1.0) -> Scalar:
    """dP/dt [Pa/s] with `voids` times the void of a chamber; with 1 that of `chamber`."""
    return net_flow / (capacitance + voids * chamber.void_capacitance(pressure))


def void_energy(pressure: Scalar, voids: Scalar = 1.0) -> Scalar:
    """Energy [J] of the void, from its closure at high pressure."""
    return voids * chamber.stored_energy(pressure, 0.0)
