"""Learning of a valve: dead band and flow of each direction, and its play, from what the oil moves.

The oil that the valve lets through moves piston and pressures at the speed

    y' = x' + (F/k)'        F force from both pressures, k stiffness of the oil

whatever the inertia and the load; y' is what the controller commanded, v, if it knows the valve. An observer
with the time constant T, `learning_filter_time`, has the filtered excess n of speed, without a derivative of
a measurement:

    v_l' = (v - v_l)/(T_a + T_l)        s' = c v_l - x_r' - (F - F_load - F_a)/(k T_load) + n
    n = ((F - F_load)/k - e - s)/T      r = n/(dv/dV) sgn(v_ref)

T_a is the lag of the amplifier and T_l that of spool and sensors, `learning_lag`. c corrects the speed for
the force, c = 1 - (F - F_load - F_a) sgn(v_ref)/(2 S), with the force S that the supply has beyond the load;
of a compensated section c = 1. r [V] is what the valve was open too far. With the errors (known minus true)
D~ of the dead band, g~ of the relative flow and b~ of the half width of the play, with Z = |c v_l|/(dv/dV),
and s the side of the play,

    r = D~ - g~ Z + b~ s sgn(v_ref)

D~ acts at any opening, g~ in proportion to it, b~ with the sign of the change. Dead band and flow of the
direction of motion follow by recursive least squares (the Kalman-Bucy filter of two constants), with
z = Z/Z_1, Z_1 a tenth of the commands beyond the dead band:

    k = P (-1, z)        (D', Z_1 g') = w r_b k/T_m        P' = w (I - k k^T - P/100)/T_m
    b' = -w s sgn(v_ref) r_b/(4 T_m)        r_b = r/(1 + (r/r_0)^2)

T_m is `learning_time`. P starts at 0, so the first motions change little; both directions share it. The
weight w is 0 at rest, up to `learning_share` of the speed limit, near full opening, where the supply does
not carry the load, and not engaged; then nothing moves. It falls where the command changes so fast that an
error of T_l in the lag would be one of the valve.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.controller.arm import ControlledAxis
from fmus.controller.valve import Actuator

SIDES = ("up", "down")
LARGEST = 0.5  # V: larger residuals come from stops, ends of strokes and lost supply
NOISE = 0.06  # V: of a residual in steady motion
SHARE = 0.1  # of full opening: the second point of the line
MEMORY = 100  # times T_m: bound of P without excitation
PLAY_SHARE = 0.25  # of the rate of the others: a play shows in half of a motion only
SATURATED = 0.9  # opening from which on nothing is learned


@dataclass(frozen=True)
class Motion:
    """What the reference asks of an actuator [m, rad].

    speed, acceleration   of the reference without its returns to the machine
    rate                  of the reference, with them
    error                 e
    inertia               m [kg, kg.m2]
    force                 F_a [N, N.m]
    """

    speed: Scalar
    acceleration: Scalar
    rate: Scalar
    error: Scalar
    inertia: Scalar
    force: Scalar


@dataclass(frozen=True)
class Wanted:
    """What the controller asks of a valve.

    speed       v_ref [m/s, rad/s]
    commanded   v [m/s, rad/s]
    opening     for it, not limited [1]
    margin      G_+ G_-, 1 if the supply carries the load
    volt        dv/dV beyond the dead band [m/(s.V), rad/(s.V)]
    """

    speed: Scalar
    commanded: Scalar
    opening: Scalar
    margin: Scalar
    volt: Scalar


@dataclass(frozen=True)
class Lesson:
    """Rates of the observer; r_b [V], w [1], z [1] and Z_1 [V]; ahead: v_ref is positive."""

    rates: dict[str, Scalar]
    residual: Scalar
    weight: Scalar
    share: Scalar
    point: Scalar
    ahead: Scalar


def lesson(
    axis: ControlledAxis,
    a: Actuator,
    motion: Motion,
    wanted: Wanted,
    oscillation: Scalar,
    spare: tuple[Scalar, Scalar],
    x: Any,
    p: Any,
) -> Lesson:
    """The equations above up to r_b and w.

    oscillation   F - F_load - F_a [N, N.m]
    spare         S [N, N.m] extending and retracting
    """
    name, speed = axis.name, wanted.speed
    slow = p.learning_share * getattr(p, f"{name}_speed_limit")
    late, shift = getattr(x, f"{name}_late_command"), getattr(x, f"{name}_oil_shift")
    ahead = speed > 0
    sign = ca.if_else(ahead, 1, -1)
    force = ca.if_else(a.section_flows[0] > 0, 0, oscillation)
    moved = late * (1 - force * sign / (2 * ca.if_else(ahead, *spare)))
    excess = ((oscillation + motion.force) / a.stiffness - motion.error - shift) / p.learning_filter_time
    late_rate = (wanted.commanded - late) / (p.amplifier_time + p.learning_lag)
    residual = excess / wanted.volt * sign
    lag = late_rate / wanted.volt * p.learning_lag / NOISE
    moving = ca.fmin(speed * sign, late * sign) / slow
    weight = wanted.margin * ca.fmin(ca.fmax(moving - 1, 0), 1) * (ca.fabs(wanted.opening) < SATURATED)
    point = SHARE * (a.valve.full_command - a.valve.dead_band)
    load_time = getattr(p, f"{axis.loop}_load_time")
    return Lesson(
        rates={
            f"{name}_late_command": late_rate,
            f"{name}_oil_shift": moved - motion.rate - oscillation / a.stiffness / load_time + excess,
        },
        residual=residual / (1 + (residual / LARGEST) ** 2),
        weight=weight / (1 + lag**2),
        share=moved * sign / wanted.volt / point,
        point=point,
        ahead=ahead,
    )


def learned_rates(
    name: str, found: Lesson, side: Scalar, x: Any, p: Any, active: Scalar
) -> tuple[dict[str, Scalar], Scalar]:
    """Rates of dead bands, flows and covariance of a valve, and b' [V/s].

    side     s of the play
    active   1 if the valve follows the controller, which learns
    """
    p11, p12, p22 = (getattr(x, f"{name}_covariance_{n}") for n in ("11", "12", "22"))
    z = found.share
    k1, k2 = p12 * z - p11, p22 * z - p12
    rate = active * found.weight / p.learning_time
    step = rate * found.residual
    rates = {
        f"{name}_covariance_11": rate * (1 - k1 * k1 - p11 / MEMORY),
        f"{name}_covariance_12": rate * (-k1 * k2 - p12 / MEMORY),
        f"{name}_covariance_22": rate * (1 - k2 * k2 - p22 / MEMORY),
    }
    learned = {
        "dead_band": (step * k1, p.dead_band_limit),
        "flow": (step * k2 / found.point, p.gain_limit),
    }
    for of, mine in zip(SIDES, (found.ahead, 1 - found.ahead), strict=True):
        for kind, (change, limit) in learned.items():
            value = getattr(x, f"{name}_{kind}_{of}")
            beyond = value - ca.fmin(ca.fmax(value, -limit), limit)
            rates[f"{name}_{kind}_{of}"] = mine * change - beyond / p.unwinding_time
    return rates, -PLAY_SHARE * step * side * ca.if_else(found.ahead, 1, -1)
