"""Manipulator: equations of motion and subsystem, from the arm, a processing head and a friction law.

    M(q) q'' + V(q, q') + G(q) = tau + tau_pick-up             eq. (4), q = (swing, boom, stick, head)
    tau_swing = swing_torque - R_swing + tau_stop              eq. (8)
    tau_i     = J_i (F_i - R_piston,i + F_stop,i) - R_joint,i  eqs. (5) to (7), i = boom, stick

with the friction forces R; the joint of the head also acts on stick and boom. M, V and G follow from the
energies (`fmus.manipulator.arm`, `fmus.components.mechanics`).

The head holds a payload, a point mass m_h (`held_mass`) at the place of the head's own mass. It follows the
input m_in = `payload_mass` by lags of 2 T/3 and T/3 in series, T = `payload_grip_time`, so that its rate
(`payload_flow`) is a state and no force jumps. After a step it is m_in (1 - exp(-1.5 t/T))^2:

    m_h'' = 4.5 ((m_in - m_h)/T - m_h')/T                      from m_h = m_in, m_h' = 0 at the start
    tau_pick-up = -max(m_h', 0) d(M q')/dm_h                   mass comes from rest, leaves with its velocity

The pick-up is inelastic: max(m_h', 0) v^2/2 is heat, v the speed of the payload. With the mass the power
m_h' g z + min(m_h', 0) v^2/2 enters, z its height (`payload_power`). Derivation: `fmus.components.mechanics`.
"""

from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.friction import Resistance
from fmus.contract import Scalar, Subsystem, column, flat, nested, quantities
from fmus.manipulator import arm
from fmus.manipulator.arm import Piston
from fmus.manipulator.design import CONTACTS, Design, viscous_friction
from fmus.manipulator.variables import (
    ManipulatorInputs,
    ManipulatorOutputs,
    ManipulatorParameters,
    ManipulatorState,
)

PORTS = (
    ports.shaft("swing", drives=False),
    *(ports.rod(axis, drives=False) for axis in ("boom", "stick")),
    ports.grip(),
)


def manipulator(design: Design, *, text: str, validity: str, parameters: type[Any]) -> Subsystem:
    """The subsystem with a head and a friction law."""
    return Subsystem(
        name="manipulator",
        text=text,
        validity=validity,
        parameters=parameters,
        states=design.states,
        inputs=ManipulatorInputs,
        outputs=design.outputs,
        dynamics=partial(dynamics, design),
        observe=partial(observe, design),
        initial=partial(initial, design),
        require=partial(require, design),
        values=Path(__file__).with_name("parameters.toml"),
        terminals=PORTS,
        # bristles are stiff; end stops are as well, but seldom reached
        stiff=design.friction is not viscous_friction,
    )


def _resistances(design: Design, x: Any, p: Any, boom: Piston, stick: Piston) -> dict[str, Resistance]:
    """Friction of each contact."""
    speeds = (x.swing_speed, x.boom_speed, x.stick_speed, boom.velocity, stick.velocity)
    return {c: design.friction(c, v, x, p) for c, v in zip(CONTACTS, speeds, strict=True)}


def forces(design: Design, x: Any, u: ManipulatorInputs, p: Any) -> tuple[ca.SX, dict[str, Resistance]]:
    """tau of eq. (4), shape (n, 1): hydraulics, friction and end stops; and the friction of each contact."""
    boom, stick = arm.pistons(x, p)
    r, joint = _resistances(design, x, p, boom, stick), design.head.joint(x, p)
    tau: ca.SX = column(
        u.swing_torque - r["swing"].force + arm.swing_stop(x, p).force,
        boom.triangle.arm * (u.boom.force - r["boom_piston"].force + boom.stop.force)
        - r["boom_joint"].force
        + joint.on_stick,
        stick.triangle.arm * (u.stick.force - r["stick_piston"].force + stick.stop.force)
        - r["stick_joint"].force
        + joint.on_stick,
        *joint.on_head,
    )
    return tau, r


def dynamics(design: Design, x: Any, u: ManipulatorInputs, p: Any) -> Any:
    """Time derivative of the state, field by field."""
    motion, (tau, r) = arm.mechanics(x, p, design.head), forces(design, x, u, p)
    acceleration = motion.acceleration(tau + motion.per_kilogram.drag(x.payload_flow))
    speeds = ("swing_speed", "boom_speed", "stick_speed", *design.head.speeds)
    angles = ("swing_angle", "boom_angle", "stick_angle", *design.head.angles)
    rates: dict[str, Scalar] = {n: acceleration[i] for i, n in enumerate(speeds)}
    rates |= {n: getattr(x, speed) for n, speed in zip(angles, speeds, strict=True)}
    rates |= {"held_mass": x.payload_flow, "payload_flow": _grip(x, u, p)}
    if design.friction is not viscous_friction:
        rates |= {f"{contact}_bristle": r[contact].deflection_rate for contact in CONTACTS}
    return nested(design.states, rates)


def _grip(x: Any, u: ManipulatorInputs, p: Any) -> Scalar:
    """m_h'' [kg/s2]: lags of 2 T/3 and T/3 in series, so the mass held stays between the masses asked for."""
    time = p.payload_grip_time
    return 4.5 * ((u.payload_mass - x.held_mass) / time - x.payload_flow) / time


def observe(design: Design, x: Any, u: ManipulatorInputs, p: Any) -> Any:
    """Outputs; only the accelerations and the torques J F depend directly on the inputs."""
    boom, stick = arm.pistons(x, p)
    r, joint = _resistances(design, x, p, boom, stick), design.head.joint(x, p)
    dx, motion = dynamics(design, x, u, p), arm.mechanics(x, p, design.head)
    load, declared = motion.per_kilogram, quantities(design.outputs)
    swing_stop = arm.swing_stop(x, p)
    stops = (swing_stop, boom.stop, stick.stop)
    values: dict[str, Scalar] = {n: value for n, value in flat(x).items() if n in declared}
    if "stored_energy" in declared:
        values["stored_energy"] = sum((c.stored for c in r.values()), joint.stored)
    values |= {name: r[contact].force for contact, name in CONTACTS.items() if name in declared}
    found = dict(
        **values,
        **_piston_outputs(x, dx, boom, stick),
        **_positions(x, p),
        **design.head.outputs(x, p),
        swing_acceleration=dx.swing_speed,
        boom_holding_force=motion.gravity[1] / boom.triangle.arm,
        stick_holding_force=motion.gravity[2] / stick.triangle.arm,
        boom_torque=boom.triangle.arm * u.boom.force,
        stick_torque=stick.triangle.arm * u.stick.force,
        kinetic_energy=motion.kinetic,
        potential_energy=motion.potential,
        swing_stop_torque=swing_stop.force,
        stop_energy=sum(s.stored for s in stops),
        dissipated_power=sum((c.heat for c in r.values()), joint.heat)
        + sum(s.heat for s in stops)
        + load.heat(x.payload_flow),
        payload_power=load.inflow(x.payload_flow),
    )
    return nested(design.outputs, found)


def initial(design: Design, x: Any, u: ManipulatorInputs, p: Any) -> dict[str, Scalar]:
    """Initial pose from parameters, because not every tool can set the start value of an output.

    A payload that the input has at the start is held from the start.
    """
    return {
        "swing_angle": p.initial_swing_angle,
        "boom_angle": p.initial_boom_angle,
        "stick_angle": p.initial_stick_angle,
        "held_mass": u.payload_mass,
        **design.head.initial(p),
    }


def require(design: Design, x: Any, u: ManipulatorInputs, p: Any) -> dict[str, Scalar]:
    """Requirements of arm and head."""
    return {**arm.require(x, p), **design.head.require(x, p)}


def _piston_outputs(x: Any, dx: Any, boom: Piston, stick: Piston) -> dict[str, Scalar]:
    values: dict[str, Scalar] = {}
    for name, piston in (("boom", boom), ("stick", stick)):
        speed, acceleration = getattr(x, f"{name}_speed"), getattr(dx, f"{name}_speed")
        values[f"{name}_position"] = piston.position
        values[f"{name}_velocity"] = piston.velocity
        values[f"{name}_acceleration"] = (
            piston.triangle.arm * acceleration + piston.triangle.arm_derivative * speed**2
        )
        values[f"{name}_stop_force"] = piston.stop.force
    return values


def _positions(x: Any, p: Any) -> dict[str, Scalar]:
    elbow, tip = arm.points(x, p)
    radial, vertical = arm.tip_velocity(x, p)
    return {
        "elbow_radius": elbow[0],
        "elbow_height": elbow[1],
        "tip_radius": tip[0],
        "tip_height": tip[1],
        "tip_x": tip[0] * ca.cos(x.swing_angle),
        "tip_y": tip[0] * ca.sin(x.swing_angle),
        "tip_radial_velocity": radial,
        "tip_vertical_velocity": vertical,
        "tip_depth": ca.fmax(p.ground_height - tip[1], 0),
    }


# the paper's manipulator: the head is a point mass at the tip, the friction viscous (correction E4),
# R = B x' in the pistons, B_sw q1' in the swing gear, b_i q_i' in the joints
RIGID = manipulator(
    Design(ManipulatorState, ManipulatorOutputs),
    text="Swing column, boom, stick and rigid processing head; viscous friction of joints and pistons",
    validity="rigid slender links, the head does not swing, viscous friction",
    parameters=ManipulatorParameters,
)
