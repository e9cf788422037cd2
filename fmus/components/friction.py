"""Friction of one contact: viscous, or viscous and dry (LuGre model).

Signs: the force acts against the motion of speed v, so it is positive for v > 0. Units are m and N for linear
contacts, rad and N.m for rotary ones.

Dry friction is modelled by bristles of mean deflection z (Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE
Trans. Automatic Control 40 (1995) 419, eqs. 1 to 4):

    F     = s0 z + s1(v) dz/dt + b v        dz/dt = v - s0 a(v) z / g(v)
    g(v)  = Fc (1 + (r - 1) exp(-(v/vs)^2))         steady slip: F = sign(v) g(v) + b v
    s0    = Fc / d                                  d: deflection at the Coulomb friction Fc
    a(v)  = sqrt(v^2 + (c vs)^2),  c = 1e-3         |v|, rounded
    s1(v) = T s0 / (1 + T s0 a / (4 g))             decreases with speed

The deflection stays below r d. Because |v| is rounded from above, a contact at rest creeps at c vs under most
of its load instead of sticking, and the slip friction is lower by the fraction (c vs / v)^2 / 2.

The law is passive for any parameters: with s = s1(v), f = s0 z and w = a / g, s w < 4, the heat is

    F v - d(s0 z^2 / 2)/dt = b v^2 + s (v - w f / 2)^2 + w f^2 (1 - s w / 4)

With the usual s1 exp(-(v/vd)^2) (Olsson, Control Systems with Friction, Lund 1996) the same identity requires
s1 vd <= 4 sqrt(2 e) Fc (e = 2.718); a constant s1 is not passive at high speed.

Validity: friction independent of load, pressure, temperature and time at rest.
"""

from dataclasses import dataclass

import casadi as ca

from fmus.contract import Quantity, Scalar

CREEP = 1e-3  # c, speed at which |v| is rounded over the Stribeck speed


@dataclass(frozen=True)
class Bristles:
    """Dry friction of a contact.

    coulomb         Fc, friction at fast slip [N]
    static_ratio    r, break-away friction over Fc [1]
    stribeck_speed  vs, decay speed of the friction from r Fc to Fc [m/s]
    deflection      d, deflection at the Coulomb friction [m]
    damping_time    T, damping of the bristles over their stiffness [s]
    """

    coulomb: Scalar
    static_ratio: Scalar
    stribeck_speed: Scalar
    deflection: Scalar
    damping_time: Scalar


@dataclass(frozen=True)
class Resistance:
    """Force [N] against the motion, heat [W], stored energy [J], dz/dt [m/s]."""

    force: Scalar
    heat: Scalar
    stored: Scalar = 0
    deflection_rate: Scalar = 0


def damping(unit: str, contact: str, nominal: float = 1.0, group: str = "") -> Quantity:
    """Declaration of the viscous friction coefficient of a contact."""
    text = f"Viscous friction coefficient of {contact}"
    return Quantity(unit, text, nominal, minimum=0.0, tunable=True, group=group)


def viscous(v: Scalar, damping: Scalar) -> Resistance:
    """F = b v."""
    return Resistance(damping * v, damping * v**2)


def lugre(v: Scalar, z: Scalar, dry: Bristles, damping: Scalar) -> Resistance:
    """The equations above, divided by Fc so that Fc = 0 is exactly the viscous law."""
    level = 1 + (dry.static_ratio - 1) * ca.exp(-((v / dry.stribeck_speed) ** 2))  # g / Fc
    slip = ca.sqrt(v**2 + (CREEP * dry.stribeck_speed) ** 2) / (dry.deflection * level)  # s0 a / g
    rate = v - slip * z
    stiffness = dry.coulomb / dry.deflection
    fade = 1 + dry.damping_time * slip / 4
    s1 = dry.damping_time * stiffness / fade
    linear = viscous(v, damping)
    return Resistance(
        force=stiffness * z + s1 * rate + linear.force,
        heat=linear.heat + s1 * (v - slip * z / 2) ** 2 + stiffness * slip * z**2 / fade,
        stored=stiffness * z**2 / 2,
        deflection_rate=rate,
    )
