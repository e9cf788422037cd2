"""Diesel engine with a droop governor, as a source of torque.

    J w'     = T - T_f(w) - T_load                T: torque of the combustion
    tau T'   = (T_net + T_f) share(z) - T         follows the injected fuel
    T_net(w) = T_r (1 + r (1 - y^2))        y = (w - w_p) / (w_r - w_p)
    T_f(w)   = d(w) c_0 + c_1 w                   own friction and pumping
    z        = (T_f + T_net (w_0 - w) / (w_0 - w_r)) / (T_net + T_f)

At full fuel the net torque is T_r at the rated speed w_r and 1 + r of that at the speed w_p of its peak,
a parabola through both. The governor is proportional: from full fuel at w_r the net torque falls to zero at
the no-load speed w_0. The fuel never goes below zero, so the speed stays positive: what brakes the shaft
(friction, pumps behind check valves) ends as it stops.

References: Heywood, Internal Combustion Engine Fundamentals, 1988, ch. 13 (friction); Guzzella and Onder,
Introduction to Modeling and Control of Internal Combustion Engine Systems, 2010, sec. 2.5 (mean values).
Valid for mean torque over a cycle above some 800 rpm; no turbocharger lag, no smoke limit, no stall.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components.smooth import direction, share, unlimited
from fmus.contract import Scalar

_ROUNDING = 0.02  # share of the fuel over which both stops of the rack are rounded
_SPEED_ROUNDING = 1.0  # rad/s
_LEAST = 0.1  # of the rated torque: keeps the curve positive far outside of its range


@dataclass(frozen=True)
class Engine:
    """Numbers of the engine: speeds [rad/s], torques [N.m], inertia [kg.m2], lag [s]."""

    rated_speed: Scalar
    rated_torque: Scalar
    peak_speed: Scalar
    torque_rise: Scalar
    no_load_speed: Scalar
    friction: Scalar
    viscous_friction: Scalar
    inertia: Scalar
    lag: Scalar


def net_torque(d: Engine, speed: Scalar) -> Scalar:
    """Torque [N.m] at the shaft with full fuel."""
    y = (speed - d.peak_speed) / (d.rated_speed - d.peak_speed)
    return d.rated_torque * ca.fmax(1 + d.torque_rise * (1 - y**2), _LEAST)


def friction(d: Engine, speed: Scalar) -> Scalar:
    """Torque [N.m] that the engine needs for itself."""
    return d.friction * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def asked_torque(d: Engine, speed: Scalar) -> Scalar:
    """Torque [N.m] of the combustion that the governor asks for."""
    net, own = net_torque(d, speed), ca.fmax(friction(d, speed), 0)  # a trial speed may be negative
    z = (own + net * (d.no_load_speed - speed) / (d.no_load_speed - d.rated_speed)) / (net + own)
    return (net + own) * share(z, _ROUNDING)


def governed_speed(d: Engine, load: Scalar, near: Scalar) -> Scalar:
    """A better guess of the speed [rad/s] that the governor holds under a load [N.m], from one near it."""
    net, own = net_torque(d, near), friction(d, near)
    z = unlimited((load + own) / (net + own), _ROUNDING)
    return d.no_load_speed - (d.no_load_speed - d.rated_speed) * (z * (net + own) - own) / net
