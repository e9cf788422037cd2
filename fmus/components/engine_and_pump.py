"""Diesel engine with a droop governor, and axial piston pumps that a pressure compensator sets.

**The engine** is a source of torque:

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

**A pump** has a swash plate that the compensator moves:

    x      = s D w                         flow drawn from the tank, s = share of the stroke
    q      = x - k (p - P_t)               left for the outlet line, k: leakage to the case
    T      = s D dp + d(w) c_f D m(dp) + c_v w       torque on the shaft, dp = p - P_t
    s'     = r / sqrt(1 + (r / r_max)^2),     r = (s_target - s) / tau
    s_target = share((P_set - p) / band)

The losses are those of Wilson (Transactions of the ASME 68 (1946) 371; also in Merritt, Hydraulic Control
Systems, 1967): laminar leakage, friction of the bearing surfaces in proportion to the pressure at any stroke,
viscous drag. The compensator senses the pump's own outlet p. Its setting is
the pressure at which the stroke would be zero (dead head); it is on full stroke `band` below. It follows
with the lag tau, and no faster than the control piston can move: r_max = 1/t_on on stroke, 1/t_off back.
As s_target is within 0 ... 1, s stays there whatever p does. Smoothing: s_target is above the straight
line by rounding^2 / (4 s), which lifts the dead head by band rounding^2 / (4 s_0) with the stroke s_0 that
covers the leakage (a thousandth of the band for s_0 = 2.5 %), and is rounded at full stroke.

Valid for mean flows: no ripple of the pistons, no oil for the control piston, no cavitation at the inlet.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.components.smooth import direction, positive, ramp, share, unlimited
from fmus.contract import Group, Quantity, Scalar

_ROUNDING = 0.02  # share of the fuel over which both stops of the rack are rounded
_SPEED_ROUNDING = 1.0  # rad/s: below, friction lets go of the shaft; far below any idle speed
_LEAST = 0.1  # of the rated torque: keeps the curve positive far outside of its range


class DieselEngine(Group):
    """Numbers of the engine."""

    rated_speed: Scalar = Quantity("rad/s", "Speed at rated power", 100.0, minimum=1.0, group="Engine")
    rated_torque: Scalar = Quantity("N.m", "Torque at the shaft at rated power", 100.0, minimum=1.0)
    peak_speed: Scalar = Quantity("rad/s", "Speed of the largest torque", 100.0, minimum=1.0)
    torque_rise: Scalar = Quantity("1", "Largest torque over rated torque, less 1", minimum=0.0)
    no_load_speed: Scalar = Quantity(
        "rad/s", "Speed at which the governor leaves no torque", 100.0, minimum=1.0
    )
    friction: Scalar = Quantity(
        "N.m", "Friction of the engine that does not depend on speed", 10.0, minimum=0.0
    )
    viscous_friction: Scalar = Quantity(
        "N.m.s/rad", "Friction of the engine in proportion to speed", minimum=0.0
    )
    inertia: Scalar = Quantity("kg.m2", "Inertia of engine, flywheel and pumps", minimum=1e-3)
    lag: Scalar = Quantity("s", "Time constant from governor to torque", 0.1, minimum=1e-6)


def net_torque(d: DieselEngine, speed: Scalar) -> Scalar:
    """Torque [N.m] at the shaft with full fuel."""
    y = (speed - d.peak_speed) / (d.rated_speed - d.peak_speed)
    return d.rated_torque * ca.fmax(1 + d.torque_rise * (1 - y**2), _LEAST)


def engine_friction(d: DieselEngine, speed: Scalar) -> Scalar:
    """Torque [N.m] that the engine needs for itself."""
    return d.friction * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def asked_torque(d: DieselEngine, speed: Scalar) -> Scalar:
    """Torque [N.m] of the combustion that the governor asks for."""
    net, own = net_torque(d, speed), ca.fmax(engine_friction(d, speed), 0)  # a trial speed may be negative
    z = (own + net * (d.no_load_speed - speed) / (d.no_load_speed - d.rated_speed)) / (net + own)
    return (net + own) * share(z, _ROUNDING)


def governed_speed(d: DieselEngine, load: Scalar, near: Scalar) -> Scalar:
    """A better guess of the speed [rad/s] that the governor holds under a load [N.m], from one near it."""
    net, own = net_torque(d, near), engine_friction(d, near)
    z = unlimited((load + own) / (net + own), _ROUNDING)
    return d.no_load_speed - (d.no_load_speed - d.rated_speed) * (z * (net + own) - own) / net


_PRESSURE_ROUNDING = 1e4  # Pa: below, the friction under pressure lets go, too


@dataclass(frozen=True)
class Pump:
    """Numbers of one pump: D [m3/rad], k [m3/(s.Pa)], c_f [1], c_v [N.m.s/rad], compensator [Pa, 1, s]."""

    displacement: Scalar
    leakage: Scalar
    pressure_friction: Scalar
    viscous_friction: Scalar
    setting: Scalar
    band: Scalar
    rounding: Scalar
    lag: Scalar
    stroke_time: Scalar
    destroke_time: Scalar


def drawn(d: Pump, stroke: Scalar, speed: Scalar) -> Scalar:
    """Flow [m3/s] that the pistons draw from the tank."""
    return stroke * d.displacement * speed


def pump_friction(d: Pump, speed: Scalar, rise: Scalar) -> Scalar:
    """Torque [N.m] of the friction at a pressure rise [Pa]; against the motion."""
    loaded = d.pressure_friction * d.displacement * positive(rise, _PRESSURE_ROUNDING)
    return loaded * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def torque(d: Pump, stroke: Scalar, speed: Scalar, rise: Scalar) -> Scalar:
    """Torque [N.m] that turns the shaft."""
    return stroke * d.displacement * rise + pump_friction(d, speed, rise)


def loss(d: Pump, speed: Scalar, rise: Scalar) -> Scalar:
    """Power [W] turned into heat by leakage and friction; never negative."""
    return d.leakage * rise**2 + pump_friction(d, speed, rise) * speed


def stroke_rate(d: Pump, stroke: Scalar, pressure: Scalar) -> Scalar:
    """ds/dt [1/s]: what the lag asks for, limited."""
    asked = (share((d.setting - pressure) / d.band, d.rounding) - stroke) / d.lag
    on, off = ca.fmax(asked, 0) * d.stroke_time, ca.fmin(asked, 0) * d.destroke_time
    return asked / ca.sqrt(1 + on**2 + off**2)


def dead_head(d: Pump, speed: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """Stroke and outlet pressure [Pa] of a pump at a speed that delivers nothing but its leakage.

    From s D w = k (p - P_t) and the compensator's line, a quadratic equation of s.
    """
    gain = d.displacement * speed / (d.leakage * d.band)
    level = (d.setting - tank) / d.band
    stroke = (level + ca.sqrt(level**2 + (1 + gain) * d.rounding**2)) / (2 * (1 + gain))
    return stroke, tank + stroke * d.displacement * speed / d.leakage


def check_flow(upstream: Scalar, downstream: Scalar, resistance: Scalar, opening: Scalar) -> Scalar:
    """Flow [m3/s] through a check valve and its line: zero backwards, opens within `opening` [Pa]."""
    return ramp(upstream - downstream, opening) / resistance
