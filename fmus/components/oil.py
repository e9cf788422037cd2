"""Oil of the grade ISO VG 46: viscosity and density over the temperature, and the parameters that follow.

    lg lg (nu + 0.7) = A - B lg T        nu [mm2/s], T [K]                     Walther; ASTM D341
    rho(T) = rho_ref / (1 + alpha (T - T_ref))                                 mu = nu rho

A and B follow from 46 mm2/s at 40 degC, the middle of the grade (ISO 3448), and 6.8 mm2/s at 100 degC, a
viscosity index of 100 by ISO 2909. Valid from -20 to 100 degC; below, waxes make the oil thicker. Beyond
-50 and 150 degC the temperature is limited, so that a trial state of a solver gives finite rates.

Parameters are given at T_ref = 60 degC, where 20.6 mm2/s is the paper's density with 20 mPa.s. At another
temperature those with `Quantity.warmed` are multiplied, with m = mu(T)/mu(T_ref) and r = rho(T)/rho(T_ref):

    viscosity, laminar resistances    m             inertances, density                    r
    leakage conductances              1/m           turbulent resistances of hoses         r^0.75 m^0.25
    transition flows of edges         m/r           (Blasius, as in eq. (10); edges: r, through eq. (2))

Leakage is laminar flow through narrow gaps, in proportion to pressure over viscosity: Wilson, Transactions of
the ASME 68 (1946) 371. The change of viscosity with pressure, 20 % at 10 MPa, and that of the gaps is
neglected; they have opposite effects on the leakage. Drag of pumps: `engine_and_pump.at_viscosity`.
"""

import math
from dataclasses import replace
from typing import Any

import casadi as ca

from fmus.contract import Group, Quantity, Scalar, Subsystem, flat, nested, quantities

# exponents of m and r in the factor of a parameter
LAMINAR, LEAKAGE, DENSITY = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)
TURBULENT, TRANSITION = (0.25, 0.75), (1.0, -1.0)
REFERENCE = 333.15  # T_ref [K]
_LIMITS = (223.15, 423.15)  # [K], -50 and 150 degC
_POINTS = ((313.15, 46.0), (373.15, 6.8))  # T [K], nu [mm2/s]
_EXPANSION = 7e-4  # alpha [1/K], mineral oils; density over temperature as in ISO 91
_NEPERS = [math.log(math.log(nu + 0.7)) for _, nu in _POINTS]
_SLOPE = (_NEPERS[0] - _NEPERS[1]) / math.log(_POINTS[1][0] / _POINTS[0][0])  # B


class OilTemperature(Group):
    """Temperature of the oil in a drive."""

    oil_temperature: Scalar = Quantity(
        "K",
        "Temperature of the oil; viscosity, density, leakage and inertances are given at 333.15 K (60 degC)",
        300.0,
        minimum=243.15,
        maximum=373.15,
        group="Oil",
    )


def _limited(temperature: Scalar) -> Scalar:
    return ca.fmin(ca.fmax(temperature, _LIMITS[0]), _LIMITS[1])


def kinematic_viscosity(temperature: Scalar) -> Scalar:
    """nu [mm2/s] at a temperature [K]."""
    return ca.exp(ca.exp(_NEPERS[0] - _SLOPE * ca.log(_limited(temperature) / _POINTS[0][0]))) - 0.7


def density_ratio(temperature: Scalar) -> Scalar:
    """r at a temperature [K]."""
    return 1 / (1 + _EXPANSION * (_limited(temperature) - REFERENCE))


def viscosity_ratio(temperature: Scalar) -> Scalar:
    """m at a temperature [K]."""
    return kinematic_viscosity(temperature) / kinematic_viscosity(REFERENCE) * density_ratio(temperature)


def _warmed(p: Any) -> Any:
    """The parameters at `oil_temperature`."""
    m, r = viscosity_ratio(p.oil_temperature), density_ratio(p.oil_temperature)
    values = flat(p)
    for name, quantity in quantities(type(p)).items():
        if quantity.warmed:
            of_m, of_r = quantity.warmed
            values[name] *= m**of_m * r**of_r
    return nested(type(p), values)


def at_temperature(sub: Subsystem) -> Subsystem:
    """The subsystem with its parameters at `oil_temperature`."""
    return replace(
        sub,
        dynamics=lambda x, u, p: sub.dynamics(x, u, _warmed(p)),
        observe=lambda x, u, p: sub.observe(x, u, _warmed(p)),
        initial=lambda x, u, p: sub.initial(x, u, _warmed(p)),
        require=lambda x, u, p: sub.require(x, u, _warmed(p)),
        circuits=lambda x, u, p: sub.circuits(x, u, _warmed(p)),
    )
