"""One actuator: from reference and measurements to a command.

    v   = (1 + h) v_ref + kp e - g (F - F_load)/k        what the valve is asked for
    h'  = (ki e - (v - v_possible)/T) v_ref/(v_ref^2 + v_0^2)        bounded, as is h
    F_load' = (F - F_load)/T_load

v_ref is the reference speed, taken ahead by the lag of amplifier, valve and oil; e the position error, k the
stiffness of the oil. h integrates the error of the feedforward as a share of it: what an area, a pressure or
a density does that is not as assumed. It turns round with the direction and does nothing at rest, where a
plain integrator would hold the valve at one edge of its dead band and have to run to the other before the
next move. At constant speed both are the same.

The pressure feedback lets the force of an oscillation decay with the rate g, whatever mass swings; the load
passes, as its slow part is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.components.smooth import ramp
from fmus.contract import Scalar
from fmus.controller import valve
from fmus.controller.valve import Actuator

FASTEST = 2.0  # 1/s: largest rate of the correction, far above that of any number that is off


@dataclass(frozen=True)
class Measured:
    """What is known of one actuator: pressures of head (A) and rod (B) side, supply and tank [Pa]."""

    head: Scalar
    rod: Scalar
    supply: Scalar
    tank: Scalar


@dataclass(frozen=True)
class Demand:
    """Speed that the reference asks for, position error, and the speed limit, which scales what is slow."""

    speed: Scalar
    error: Scalar
    limit: Scalar


@dataclass(frozen=True)
class Loop:
    """Of a drive: kp [1/s], ki [1/s2], rate g at which a force decays [1/s], time of a steady load [s]."""

    position_gain: Scalar
    integral_gain: Scalar
    damping_rate: Scalar
    load_time: Scalar


@dataclass(frozen=True)
class Action:
    """Command [V] and the rates of the gain and of the steady load."""

    command: Scalar
    gain_rate: Scalar
    load_rate: Scalar


def force(a: Actuator, m: Measured) -> Scalar:
    """Force or torque of the actuator."""
    return a.head * m.head - a.rod * m.rod


def action(
    a: Actuator,
    m: Measured,
    task: Demand,
    loop: Loop,
    gain: Scalar,
    load: Scalar,
    nominal_load: Scalar,
    p: Any,
) -> Action:
    """What the drive does."""
    swinging = force(a, m) - load
    damping = loop.damping_rate * swinging / a.stiffness
    corrected = loop.position_gain * task.error + gain * task.speed - damping
    wanted = task.speed + p.feedback * corrected
    nominal = valve.nominal_full_speeds(a, nominal_load, p.nominal_supply_pressure)
    known = valve.full_speeds(a, *valve.steadied(a, m.head, m.rod, load), m.supply, m.tank)
    full = tuple(n + p.feedback * (k - n) for n, k in zip(nominal, known, strict=True))
    up, down = valve.carried(a, load, m.supply, m.tank)
    shares = 1 + p.feedback * (up - 1), 1 + p.feedback * (down - 1)
    opening = valve.opening_for(a, wanted, (full[0], full[1]), p.foot_share, shares)
    possible = valve.limited(opening)
    beyond = (opening - possible) * (full[0] + full[1]) / 2
    slow = p.learning_share * task.limit
    moving = task.speed / (task.speed**2 + slow**2)
    largest = p.gain_limit
    learnt = (loop.integral_gain * task.error - beyond / p.unwinding_time) * moving
    over = ramp(gain - largest, largest / 10) - ramp(-gain - largest, largest / 10)
    return Action(
        command=valve.command(a.valve, possible, p.foot_share),
        gain_rate=learnt / ca.sqrt(1 + (learnt / FASTEST) ** 2) - over / p.unwinding_time,
        load_rate=swinging / loop.load_time,
    )
