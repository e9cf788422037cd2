"""Axial piston pump with a swash plate that a pressure compensator sets.

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

from fmus.components.smooth import direction, positive, ramp, share
from fmus.contract import Scalar

_SPEED_ROUNDING = 1.0  # rad/s: below, friction lets go of the shaft; far below any idle speed
_PRESSURE_ROUNDING = 1e4  # Pa: the same for the friction under pressure


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


def friction(d: Pump, speed: Scalar, rise: Scalar) -> Scalar:
    """Torque [N.m] of the friction at a pressure rise [Pa]; against the motion."""
    loaded = d.pressure_friction * d.displacement * positive(rise, _PRESSURE_ROUNDING)
    return loaded * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def torque(d: Pump, stroke: Scalar, speed: Scalar, rise: Scalar) -> Scalar:
    """Torque [N.m] that turns the shaft."""
    return stroke * d.displacement * rise + friction(d, speed, rise)


def loss(d: Pump, speed: Scalar, rise: Scalar) -> Scalar:
    """Power [W] turned into heat by leakage and friction; never negative."""
    return d.leakage * rise**2 + friction(d, speed, rise) * speed


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
