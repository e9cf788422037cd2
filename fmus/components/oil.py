"""Oil over its temperature: viscosity, density, bulk modulus, and the parameters that follow.

    lg lg (nu + 0.7) = A - B lg T        nu [mm2/s], T [K]                     Walther; ASTM D341
    rho(T)  = rho_ref / (1 + alpha (T - T_ref))                                mu = nu rho
    beta(T) = beta_ref exp(-kappa (T - T_ref))

A and B follow from the viscosities at 40 and 100 degC of a data sheet. The default, 46 and 6.8 mm2/s, is the
middle of the grade ISO VG 46 (ISO 3448) with a viscosity index of 100 by ISO 2909. Valid from -20 to 100
degC; below, waxes make the oil thicker. Beyond -50 and 150 degC the temperature is limited, so that a trial
state of a solver gives finite rates; 0 K, an open input, counts as 60 degC.

Parameters are given at T_ref = 60 degC with the default oil, whose 20.6 mm2/s is the paper's density with 20
mPa.s. With another oil or at another temperature those with `Quantity.warmed` are multiplied, with m =
mu/mu_ref, r = rho(T)/rho_ref, and b = beta(T)/beta_ref:

    viscosity, laminar resistances    m             inertances, density                    r
    leakage conductances              1/m           turbulent resistances of hoses         r^0.75 m^0.25
    bulk modulus                      b             (Blasius at one flow, as in eq. (10))

Leakage is laminar flow through narrow gaps, in proportion to pressure over viscosity: Wilson, Transactions of
the ASME 68 (1946) 371. The change of viscosity with pressure, 20 % at 10 MPa, and that of the gaps is
neglected; they have opposite effects on the leakage. Drag of pumps: `engine_and_pump.at_viscosity`.
Bulk modulus: its logarithm falls in proportion to the temperature (Klaus and O'Brien, J. Basic Engineering 86
(1964) 469), by 0.4 to 0.6 % per kelvin for mineral oils; 0.5 % is 2.0 GPa at 15 degC where it is 1.6 at 60.
"""

import math
from dataclasses import replace
from typing import Any

import casadi as ca

from fmus.contract import Group, Quantity, Scalar, Subsystem, flat, nested, quantities

# exponents of m, r and b in the factor of a parameter
LAMINAR, LEAKAGE, DENSITY = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
TURBULENT, BULK = (0.25, 0.75, 0.0), (0.0, 0.0, 1.0)
REFERENCE = 333.15  # T_ref [K]
_LIMITS = (223.15, 423.15)  # [K], -50 and 150 degC
_LOWEST = 243  # K, -30 degC: a lower input is no temperature of oil, but 60 for 60 degC
_POINTS = (313.15, 373.15)  # [K], 40 and 100 degC
_EXPANSION = 7e-4  # alpha [1/K], mineral oils; density over temperature as in ISO 91
_SOFTENING = 5e-3  # kappa [1/K]


class Grade(Group):
    """Viscosity of the oil in use."""

    oil_viscosity_40: Scalar = Quantity(
        "m2/s",
        "Kinematic viscosity of the oil at 40 degC",
        1e-5,
        minimum=2e-6,
        maximum=1e-3,
        group="Oil",
        value=46e-6,
    )
    oil_viscosity_100: Scalar = Quantity(
        "m2/s",
        "Kinematic viscosity of the oil at 100 degC",
        1e-5,
        minimum=1e-6,
        maximum=1e-4,
        value=6.8e-6,
    )


VG_46 = Grade(oil_viscosity_40=46e-6, oil_viscosity_100=6.8e-6)


def is_oil(grade: Grade) -> dict[str, Scalar]:
    """Requirement: the viscosity falls with the temperature."""
    thinner = grade.oil_viscosity_40 - grade.oil_viscosity_100
    return {"oil_viscosity_40 exceeds oil_viscosity_100": thinner}


def is_liquid(temperature: Scalar) -> dict[str, Scalar]:
    """Requirement on an input: no number of degrees Celsius. An open input is 0."""
    margin = ca.if_else(temperature == 0, 1, temperature - _LOWEST)
    return {f"oil_temperature [K] is above {_LOWEST:g}, or 0 for 60 degC": margin}


def _limited(temperature: Scalar) -> Scalar:
    # many tools set an open input to 0, FMPy also a connected one in its first step
    known = ca.if_else(temperature > 0, temperature, REFERENCE)
    return ca.fmin(ca.fmax(known, _LIMITS[0]), _LIMITS[1])


def _walther(viscosity: Scalar) -> Scalar:
    return ca.log(ca.log(viscosity * 1e6 + 0.7))


def kinematic_viscosity(temperature: Scalar, grade: Grade = VG_46) -> Scalar:
    """nu [m2/s] at a temperature [K]."""
    thick, thin = _walther(grade.oil_viscosity_40), _walther(grade.oil_viscosity_100)
    share = ca.log(_limited(temperature) / _POINTS[0]) / math.log(_POINTS[1] / _POINTS[0])
    return (ca.exp(ca.exp(thick - (thick - thin) * share)) - 0.7) * 1e-6


def density_ratio(temperature: Scalar) -> Scalar:
    """r at a temperature [K]."""
    return 1 / (1 + _EXPANSION * (_limited(temperature) - REFERENCE))


def bulk_modulus_ratio(temperature: Scalar) -> Scalar:
    """b at a temperature [K]."""
    return ca.exp(_SOFTENING * (REFERENCE - _limited(temperature)))


def viscosity_ratio(temperature: Scalar, grade: Grade = VG_46) -> Scalar:
    """m at a temperature [K]."""
    of_reference = kinematic_viscosity(REFERENCE)
    return kinematic_viscosity(temperature, grade) / of_reference * density_ratio(temperature)


def _warmed(p: Any, temperature: Scalar) -> Any:
    """The parameters at a temperature [K]."""
    ratios = (
        viscosity_ratio(temperature, p),
        density_ratio(temperature),
        bulk_modulus_ratio(temperature),
    )
    values = flat(p)
    for name, quantity in quantities(type(p)).items():
        for ratio, exponent in zip(ratios, quantity.warmed or (), strict=False):
            values[name] *= ratio**exponent if exponent else 1
    return nested(type(p), values)


def at_temperature(sub: Subsystem) -> Subsystem:
    """The subsystem with its parameters at the input `oil_temperature`."""
    return replace(
        sub,
        dynamics=lambda x, u, p: sub.dynamics(x, u, _warmed(p, u.oil_temperature)),
        observe=lambda x, u, p: sub.observe(x, u, _warmed(p, u.oil_temperature)),
        initial=lambda x, u, p: sub.initial(x, u, _warmed(p, u.oil_temperature)),
        require=lambda x, u, p: {
            **sub.require(x, u, _warmed(p, u.oil_temperature)),
            **is_oil(p),
            **is_liquid(u.oil_temperature),
        },
        circuits=lambda x, u, p: sub.circuits(x, u, _warmed(p, u.oil_temperature)),
    )
