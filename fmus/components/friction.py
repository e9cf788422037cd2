"""Friction of one contact: viscous, or viscous and dry by bristles (LuGre).

Signs: the force acts against the motion of speed v, so it is positive for v > 0. Linear contacts have
m and N, turning ones rad and N.m.

Bristles of mean deflection z stand for the dry part (Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE
Trans. Automatic Control 40 (1995) 419, eqs. 1 to 4):

    F     = s0 z + s1(v) dz/dt + b v        dz/dt = v - s0 a(v) z / g(v)
    g(v)  = Fc (1 + (r - 1) exp(-(v/vs)^2))         steady slip: F = sign(v) g(v) + b v
    s0    = Fc / d                                  d is the deflection that carries the Coulomb friction Fc
    a(v)  = sqrt(v^2 + (c vs)^2),  c = 1e-3         |v|, rounded
    s1(v) = T s0 / (1 + T s0 a / (4 g))             faded with speed

The deflection stays below r d. Rounding |v| from above makes a standing contact creep at c vs under most of
its load instead of holding it for ever, and lowers the slip friction by (c vs / v)^2 / 2.

Passive for any numbers: with s = s1(v), f = s0 z and w = a / g

    F v - d(s0 z^2 / 2)/dt = b v^2 + s (v - w f / 2)^2 + w f^2 (1 - s w / 4)     is the heat, and s w < 4.

With the usual s1 exp(-(v/vd)^2) (Olsson, Control Systems with Friction, Lund 1996) the same identity asks for
s1 vd <= 4 sqrt(2 e) Fc (e = 2.718); a constant s1 fails at high speed.

Validity: friction that does not depend on load, pressure, temperature or time at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.contract import Scalar

CREEP = 1e-3  # c


@dataclass(frozen=True)
class Bristles:
    """Dry friction of a contact.

    coulomb         Fc, friction of fast slip [N]
    static_ratio    r, break-away friction over Fc [1]
    stribeck_speed  vs, at which friction has fallen most of the way from r Fc to Fc [m/s]
    deflection      d [m]
    damping_time    T, damping of the bristles over their stiffness [s]
    """

    coulomb: Scalar
    static_ratio: Scalar
    stribeck_speed: Scalar
    deflection: Scalar
    damping_time: Scalar


@dataclass(frozen=True)
class Resistance:
    """Force [N] against the motion, heat [W], stored energy [J], rate of the bristles' deflection [m/s]."""

    force: Scalar
    heat: Scalar
    stored: Scalar = 0
    deflection_rate: Scalar = 0


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
    own = dry.damping_time * stiffness / fade  # s1(v)
    plain = viscous(v, damping)
    return Resistance(
        force=stiffness * z + own * rate + plain.force,
        heat=plain.heat + own * (v - slip * z / 2) ** 2 + stiffness * slip * z**2 / fade,
        stored=stiffness * z**2 / 2,
        deflection_rate=rate,
    )
