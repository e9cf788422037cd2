"""Control law of one actuator: from reference speed and measured pressures to a valve command.

    v   = (1 + h) v_ref + kp e - g (F - F_load - F_a)/k        commanded speed
    h'  = (ki e - (v - v_possible)/T) v_ref/(v_ref^2 + v_0^2)        h and h' are bounded
    F_load' = (F - F_load - F_a)/T_load
    kp = Kp/(1 + (Kp/(c w))^8)^(1/8)        ki = Ki (kp/Kp)^2        w^2 = k/m

v_ref is the reference speed with a lead that compensates the lag of amplifier and valve; e is the position
error, F the measured force and k the stiffness of the oil. F_a is the force that accelerates what the arm
carries along the reference, and m its inertia (`Arm.carried`). v_possible is the speed at the limited
opening, T `unwinding_time`, and v_0 `learning_share` times the speed limit.

The gains Kp and Ki are lowered where the load oscillates slowly on its oil: the position gain is at most
the share c of the natural frequency w, `frequency_share`.

h integrates the relative error of the feedforward, which a wrong area, pressure or density causes. The effect
of h changes sign with the direction of motion, and h is constant at rest. A plain integrator would hold the
valve at one edge of its dead band at rest and would have to cross the dead band before the next motion. At
constant speed both are the same.

The pressure feedback damps oscillations of the force at the rate g for any inertia. The steady load F_load
and the force F_a of the reference are subtracted, so the feedback acts on neither.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.controller import valve
from fmus.controller.arm import ControlledAxis
from fmus.controller.learning import SIDES, Lesson, Motion, Wanted, lesson
from fmus.controller.valve import Actuator
from fmus.smooth import direction, ramp

BEND = 0.05  # 1/s: acceleration over speed limit below which a motion counts as steady
LARGEST_RATE = 2.0  # 1/s: bound of h', far above any rate that a wrong parameter value causes


@dataclass(frozen=True)
class ActuatorCommand:
    """Command of the spool [V], h' [1/s], F_load' [N/s, N.m/s], and what the spool lacks [V.s].

    missing   position error as a voltage, in motion: positive if the spool lags behind its changes
    lesson    what the motion teaches of the valve
    """

    command: Scalar
    gain_rate: Scalar
    load_rate: Scalar
    missing: Scalar
    lesson: Lesson


def actuator_command(
    axis: ControlledAxis,
    a: Actuator,
    pressures: tuple[Scalar, Scalar],
    motion: Motion,
    x: Any,
    u: Any,
    p: Any,
) -> ActuatorCommand:
    """The equations above for one axis.

    pressures   measured, head side (A) and rod side (B) [Pa]
    """
    name, change, error = axis.name, motion.acceleration, motion.error
    gain, load = getattr(x, f"{name}_gain"), getattr(x, f"{name}_load")  # h, F_load
    position_gain, integral_gain, damping_rate, load_time = (
        getattr(p, f"{axis.loop}_{n}")
        for n in ("position_gain", "integral_gain", "damping_rate", "load_time")
    )
    compensated = a.section_flows[0] > 0
    slower = (1 + ((position_gain / p.frequency_share) ** 2 * motion.inertia / a.stiffness) ** 4) ** -0.125
    position_gain, integral_gain = position_gain * slower, integral_gain * slower**2
    speed = motion.speed + p.lead_time * change
    nominal_load = 0 if axis.turns else getattr(p, f"nominal_{name}_holding_force")
    lines = (u.supply_pressure, u.tank_pressure)
    oscillation = a.force(*pressures) - load - motion.force
    damping = damping_rate * oscillation / a.stiffness
    correction = position_gain * error + gain * speed - damping
    commanded = speed + p.feedback * correction
    nominal = valve.nominal_full_speeds(a, nominal_load, p.nominal_supply_pressure)
    moved, sections = load + motion.force, valve.section_speeds(a)
    actual = valve.full_speeds(a, *valve.pressures_at_load(a, *pressures, moved), *lines)
    full = tuple(
        ca.if_else(compensated, w, n + p.feedback * (k - n))
        for w, n, k in zip(sections, nominal, actual, strict=True)
    )
    up, down = (
        1 + p.feedback * ca.if_else(compensated, 0, factor - 1)
        for factor in valve.supply_margins(a, load, *lines)
    )
    flows, dead_bands = (tuple(getattr(x, f"{name}_{n}_{of}") for of in SIDES) for n in ("flow", "dead_band"))
    full = (full[0] * (1 + flows[0]), full[1] * (1 + flows[1]))
    opening = valve.opening_for(a, commanded, full, (up, down))
    possible = valve.limited(opening)
    excess = (opening - possible) * (full[0] + full[1]) / 2
    slow = p.learning_share * getattr(p, f"{name}_speed_limit")
    weight = speed / (speed**2 + slow**2)
    limit = p.gain_limit
    volt = (full[0] + full[1]) / 2 / (a.valve.full_command - a.valve.dead_band)  # speed per volt
    rate = (integral_gain * error - excess / p.unwinding_time) * weight
    beyond_limit = ramp(gain - limit, limit / 10) - ramp(-gain - limit, limit / 10)
    wanted, spare = Wanted(speed, commanded, opening, up * down, volt), valve.spare_forces(a, load, *lines)
    return ActuatorCommand(
        command=valve.command(a.valve, possible, p.foot_share, (dead_bands[0], dead_bands[1])),
        gain_rate=rate / ca.sqrt(1 + (rate / LARGEST_RATE) ** 2) - beyond_limit / p.unwinding_time,
        load_rate=oscillation / load_time,
        missing=error * weight * speed / volt * direction(change, BEND * getattr(p, f"{name}_speed_limit")),
        lesson=lesson(axis, a, motion, wanted, oscillation, spare, x, p),
    )
