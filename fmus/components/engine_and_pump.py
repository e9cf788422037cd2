"""Diesel engine with a droop governor, and axial piston pump with a pressure compensator.

**The engine** is a torque source:

    J w'     = b(w) T - T_f(w) - T_load           T: torque of the injected fuel, b: share that burns
    tau T'   = (T_net + T_f) lim(z) - T
    b(w)     = sigma((w - w_s) / (w_i - w_s))     1 above the idle speed w_i, 0 below the stall speed w_s
    T_net(w) = T_r (1 + r (1 - y^2))        y = (w - w_p) / (w_r - w_p)
    T_f(w)   = d(w) c_0 + c_1 w                   friction and pumping losses
    z        = (T_f + T_net (w_0 - w) / (w_0 - w_r)) / (T_net + T_f)

lim limits z to 0 ... 1 (`smooth.unit_limited`), d is the rounded sign (`smooth.direction`), sigma a step
(`smooth.s_curve`). At full fuel above w_i the net torque is a parabola: T_r at the rated speed w_r, maximum
(1 + r) T_r at the speed w_p. The governor is proportional: from full fuel at w_r the net torque falls to zero
at the no-load speed w_0. The fuel is never negative.

**Stall.** If the compression is too slow, the fuel does not ignite. Between w_i and w_s the net torque at
full fuel, b (T_net + T_f) - T_f, falls below zero. At w_s and below all torques brake, whatever the governor
does, so a stalled engine coasts to standstill. There all torques are zero: it stays, and its speed is never
negative. The shape of b is an assumption.

References: Heywood, Internal Combustion Engine Fundamentals, 1988, ch. 13 (friction); Guzzella and Onder,
Introduction to Modeling and Control of Internal Combustion Engine Systems, 2010, sec. 2.5 (mean values).
Valid for the mean torque over a cycle, above idle speed; no turbocharger lag, no smoke limit, no starter.

**A pump** has a swash plate, which the compensator moves:

    x      = s D f(w) w                    flow from the tank, s: stroke relative to the full stroke
    q      = x - k (p - P_t)               flow into the outlet line, k: leakage to the case
    T      = s D f(w) dp + d(w) c_f D m(dp) + c_v w       torque on the shaft, dp = p - P_t
    f(w)   = sigma(w / w_f)                1 above w_f = 10 rad/s, 0 at standstill
    s'     = r / sqrt(1 + (r / r_max)^2),     r = (s_target - s) / tau
    s_target = lim((P_set - p) / band)

Loss model of Wilson (Transactions of the ASME 68 (1946) 371; also in Merritt, Hydraulic Control Systems,
1967): laminar leakage k ~ 1/mu, friction of the bearing surfaces proportional to the pressure at any stroke,
drag c_v, in part ~ mu. The compensator senses the outlet pressure p. Its setting is the pressure at which the
stroke would be zero (dead head); at `band` below the setting the stroke is full. The stroke follows with the
lag tau, limited by the speed of the control piston: r_max = 1/t_on for increasing, 1/t_off for decreasing
stroke. As s_target is within 0 ... 1, so is s for any p. Smoothing: s_target is above the straight line by
rounding^2 / (4 s), which raises the dead head by band rounding^2 / (4 s_0) with the stroke s_0 that covers
the leakage (a thousandth of the band for s_0 = 2.5 %), and is rounded at full stroke.
The pressure behind a check valve does not turn a shaft at standstill: static friction and the compression in
the cylinders hold it. f stands for that. It is in flow and torque, so it takes no energy.

**Several regulators** move the swash plate of a load-sensing pump. P_set is then the pressure of the
load-sensing line plus a margin, and the lowest of three strokes counts:

    s_target = lim(min((P_set - p) / band, (P_off - p) / band_off, T_max / (D dp)))

The second is the pressure cut-off. The third is the power limit: a torque of the swash plate, so that the
power s D dp w is constant at a given speed (a hyperbola of flow over pressure). min is `smooth.lowest`,
rounded over `rounding` like lim: where two strokes are equal, the result is 0.094 rounding lower. Each
regulator has a proportional characteristic; its hysteresis and the motion of its spool are neglected.
Reference: Ivantysyn and Ivantysynova, Hydrostatic Pumps and Motors, 2001, ch. 9.

Valid for mean flows: no piston ripple, no flow to the control piston, no cavitation at the inlet.
"""

from dataclasses import dataclass, replace

import casadi as ca

from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import direction, lowest, positive, ramp, s_curve, unit_limited, unit_limited_inverse

_ROUNDING = 0.02  # fraction of full fuel over which both limits of the fuel are rounded
_SPEED_ROUNDING = 1.0  # rad/s, far below idle speed; below, the dry friction falls to zero
_LEAST_TORQUE = 0.1  # fraction of the rated torque: lower bound of the parabola outside its range
_PUMPING_SPEED = 10.0  # w_f [rad/s], far below the stall speed
ITERATIONS = 12  # of `governed_speed`; each gains two digits, because torques depend little on the speed
_BEYOND = 2.0  # stroke at which the hyperbola of the power limit ends; above 1 it limits nothing
# of the drag at 20 mPa.s, D C_v mu of a measured pump of 107 cm3/rev, C_v = 23 500 (Pourmovahed, Beachley and
# Fronczak, J. Dynamic Systems, Measurement, and Control 114 (1992) 160), over c_v; the rest is churning
_VISCOUS_SHARE = 0.18
_PRESSURE_ROUNDING = 1e4  # Pa; below, the pressure-dependent friction falls to zero


class DieselEngine(Group):
    """Parameters of the engine."""

    rated_speed: Scalar = Quantity("rad/s", "Speed at rated power", 100.0, minimum=1.0, group="Engine")
    rated_torque: Scalar = Quantity("N.m", "Torque at the shaft at rated power", 100.0, minimum=1.0)
    peak_speed: Scalar = Quantity("rad/s", "Speed of the largest torque", 100.0, minimum=1.0)
    torque_rise: Scalar = Quantity("1", "Largest torque over rated torque, minus 1", minimum=0.0)
    no_load_speed: Scalar = Quantity("rad/s", "Speed at which the net torque is zero", 100.0, minimum=1.0)
    friction: Scalar = Quantity(
        "N.m", "Friction torque of the engine, independent of speed", 10.0, minimum=0.0
    )
    viscous_friction: Scalar = Quantity("N.m.s/rad", "Friction torque of the engine per speed", minimum=0.0)
    idle_speed: Scalar = Quantity("rad/s", "Lowest speed at which all fuel burns", 100.0, minimum=1.0)
    stall_speed: Scalar = Quantity("rad/s", "Speed at and below which no fuel burns", 100.0, minimum=1.0)
    inertia: Scalar = Quantity("kg.m2", "Moment of inertia of engine, flywheel and pumps", minimum=1e-3)
    lag: Scalar = Quantity("s", "Time constant of the torque after the governor", 0.1, minimum=1e-6)


def burning_share(d: DieselEngine, speed: Scalar) -> Scalar:
    """Share b of the injected fuel that burns."""
    return s_curve((speed - d.stall_speed) / (d.idle_speed - d.stall_speed))


def net_torque(d: DieselEngine, speed: Scalar) -> Scalar:
    """Torque [N.m] at the shaft at full fuel, above idle speed."""
    y = (speed - d.peak_speed) / (d.rated_speed - d.peak_speed)
    return d.rated_torque * ca.fmax(1 + d.torque_rise * (1 - y**2), _LEAST_TORQUE)


def engine_friction(d: DieselEngine, speed: Scalar) -> Scalar:
    """Friction torque [N.m] of the engine."""
    return d.friction * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def governor_torque(d: DieselEngine, speed: Scalar) -> Scalar:
    """Torque [N.m] of the fuel that the governor commands."""
    net = net_torque(d, speed)
    friction = ca.fmax(engine_friction(d, speed), 0)  # a trial speed may be negative
    z = (friction + net * (d.no_load_speed - speed) / (d.no_load_speed - d.rated_speed)) / (net + friction)
    return (net + friction) * unit_limited(z, _ROUNDING)


def governed_speed(d: DieselEngine, load: Scalar, guess: Scalar) -> Scalar:
    """One fixed-point iteration for the steady speed [rad/s] under a load [N.m], from a guess.

    The result is in the range of the governor, also for an engine that is too weak.
    """
    net, friction = net_torque(d, guess), engine_friction(d, guess)
    z = unit_limited_inverse((load + friction) / (net + friction), _ROUNDING)
    speed = d.no_load_speed - (d.no_load_speed - d.rated_speed) * (z * (net + friction) - friction) / net
    return ca.fmax(d.peak_speed, ca.fmin(speed, d.no_load_speed))


def speed_rate(d: DieselEngine, speed: Scalar, torque: Scalar, load: Scalar) -> Scalar:
    """dw/dt [rad/s2] with a torque of the combustion, b T, and a load [N.m]."""
    return (torque - engine_friction(d, speed) - load) / d.inertia


def torque_rate(d: DieselEngine, speed: Scalar, torque: Scalar) -> Scalar:
    """dT/dt [N.m/s] of the torque of the injected fuel."""
    return (governor_torque(d, speed) - torque) / d.lag


@dataclass(frozen=True)
class Pump:
    """Parameters of a pump: D [m3/rad], k [m3/(s.Pa)], c_f [1], c_v [N.m.s/rad], compensator [Pa, 1, s]."""

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


def at_viscosity(d: Pump, ratio: Scalar) -> Pump:
    """The pump with oil of `ratio` times the viscosity of 20 mPa.s: less leakage, more drag."""
    drag = d.viscous_friction * (_VISCOUS_SHARE * ratio + 1 - _VISCOUS_SHARE)
    return replace(d, leakage=d.leakage / ratio, viscous_friction=drag)


def displaced(d: Pump, stroke: Scalar, speed: Scalar) -> Scalar:
    """Displacement s D f [m3/rad] of a stroke."""
    return stroke * d.displacement * s_curve(speed / _PUMPING_SPEED)


def suction_flow(d: Pump, stroke: Scalar, speed: Scalar) -> Scalar:
    """Flow x [m3/s] from the tank."""
    return displaced(d, stroke, speed) * speed


def pump_friction(d: Pump, speed: Scalar, rise: Scalar) -> Scalar:
    """Friction torque [N.m] at a pressure rise dp [Pa], against the motion."""
    dry = d.pressure_friction * d.displacement * positive(rise, _PRESSURE_ROUNDING)
    return dry * direction(speed, _SPEED_ROUNDING) + d.viscous_friction * speed


def torque(d: Pump, stroke: Scalar, speed: Scalar, rise: Scalar) -> Scalar:
    """Torque T [N.m] on the shaft."""
    return displaced(d, stroke, speed) * rise + pump_friction(d, speed, rise)


def limited_stroke(
    d: Pump, cut_off: Scalar, band: Scalar, torque: Scalar, pressure: Scalar, rise: Scalar
) -> Scalar:
    """Stroke s_target of the lowest of three: compensator, pressure cut-off, power limit.

    cut_off, band   setting and band of the pressure cut-off [Pa]
    torque          of the swash plate that the power limit allows [N.m]
    """
    compensated = (d.setting - pressure) / d.band
    cut = (cut_off - pressure) / band
    beginning = torque / (_BEYOND * d.displacement)  # pressure rise at which the hyperbola begins
    power = torque / (d.displacement * ca.fmax(rise, beginning))
    return unit_limited(lowest(lowest(compensated, cut, d.rounding), power, d.rounding), d.rounding)


def stroke_rate(d: Pump, stroke: Scalar, pressure: Scalar) -> Scalar:
    """ds/dt [1/s] of a pump with a compensator alone."""
    return servo_rate(d, stroke, unit_limited((d.setting - pressure) / d.band, d.rounding))


def servo_rate(d: Pump, stroke: Scalar, target: Scalar) -> Scalar:
    """ds/dt [1/s]: the rate r of the lag, limited by the speed of the control piston."""
    rate = (target - stroke) / d.lag
    on, off = ca.fmax(rate, 0) * d.stroke_time, ca.fmin(rate, 0) * d.destroke_time
    return rate / ca.sqrt(1 + on**2 + off**2)


def dead_head(d: Pump, speed: Scalar, tank: Scalar) -> tuple[Scalar, Scalar]:
    """Stroke and outlet pressure [Pa] at dead head: the flow only covers the leakage.

    s D w = k (p - P_t) and the line of the compensator give a quadratic equation for s.
    """
    gain = d.displacement * speed / (d.leakage * d.band)
    level = (d.setting - tank) / d.band
    stroke = (level + ca.sqrt(level**2 + (1 + gain) * d.rounding**2)) / (2 * (1 + gain))
    return stroke, tank + stroke * d.displacement * speed / d.leakage


def check_flow(resistance: Scalar, opening: Scalar, drop: Scalar) -> Scalar:
    """Flow [m3/s] through a check valve with its line: zero backwards; opens over `opening` [Pa]."""
    return ramp(drop, opening) / resistance
