"""Manipulator: swing column, boom, stick and a processing head that is a point mass at the stick end.

    M(q) q'' + V(q, q') + G(q) = tau - b q'                    eq. (4), q = (swing, boom, stick)
    tau_swing = swing_torque                                   eq. (8)
    tau_i     = J_i (F_i - B_i x_i' + F_stop,i)                eqs. (5) to (7), x_i' = J_i q_i'

M, V and G follow from the energies below (`fmus.components.rigid_body`).

Signs: the boom angle counts from the horizontal, up positive; the stick angle from the boom, up
positive (a folded stick is negative); the swing angle counter-clockwise seen from above. Extending
the boom cylinder raises the boom; extending the stick cylinder folds the stick in (J < 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from fmus.components import cylinder, linkage, ports
from fmus.components.linkage import Point, Triangle
from fmus.components.rigid_body import EquationsOfMotion, equations_of_motion
from fmus.contract import Scalar, Subsystem, column
from fmus.manipulator.variables import (
    ManipulatorInputs,
    ManipulatorOutputs,
    ManipulatorParameters,
    ManipulatorState,
)


def points(x: ManipulatorState, p: ManipulatorParameters) -> tuple[Point, Point]:
    """Stick pivot (elbow) and stick end (tip) as (radius, height) [m]."""
    pitch = x.boom_angle + x.stick_angle
    elbow = _add((p.boom_pivot_x, p.boom_pivot_z), _turn(x.boom_angle, (p.stick_pivot_x, p.stick_pivot_z)))
    return elbow, _add(elbow, _turn(pitch, (p.stick_length, 0)))


def _turn(angle: Scalar, point: Point) -> Point:
    return linkage.rotate(ca.cos(angle), ca.sin(angle), point)


def _add(a: Point, b: Point, weight: Scalar = 1) -> Point:
    return a[0] + weight * b[0], a[1] + weight * b[1]


def _dot(a: Point, b: Point) -> Scalar:
    return a[0] * b[0] + a[1] * b[1]


def mechanics(x: ManipulatorState, p: ManipulatorParameters) -> EquationsOfMotion:
    """M, V, G of eq. (4) from the energies of boom, stick and head.

    In the plane of the arm the stick and the head count by their first moment about the elbow and
    their inertia; everything outboard of the elbow moves with it. The links are slender: no
    inertia about their own axis, so about the vertical a link at pitch f has m r^2 + I cos(f)^2.
    """
    pivot, elbow = (p.boom_pivot_x, p.boom_pivot_z), (p.stick_pivot_x, p.stick_pivot_z)
    boom, stick, tip = (
        (p.boom_centre_x, p.boom_centre_z),
        (p.stick_centre_x, p.stick_centre_z),
        (p.stick_length, 0),
    )
    outboard = p.stick_mass + p.head_mass
    moment = _add((p.head_mass * p.stick_length, 0), stick, p.stick_mass)  # about the elbow [kg.m]
    inertia_boom = p.boom_inertia + p.boom_mass * _dot(boom, boom) + outboard * _dot(elbow, elbow)
    inertia_stick = p.stick_inertia + p.stick_mass * _dot(stick, stick) + p.head_mass * p.stick_length**2

    def kinetic(q: ca.SX, w: ca.SX) -> Scalar:
        pitch = q[1] + q[2]
        at_elbow = _add(pivot, _turn(q[1], elbow))
        radii = [(p.boom_mass, _add(pivot, _turn(q[1], boom))[0])]
        radii += [(p.stick_mass, _add(at_elbow, _turn(pitch, stick))[0])]
        radii += [(p.head_mass, _add(at_elbow, _turn(pitch, tip))[0])]
        yaw = p.column_inertia + p.boom_inertia * ca.cos(q[1]) ** 2 + p.stick_inertia * ca.cos(pitch) ** 2
        yaw += sum(m * r**2 for m, r in radii)
        coupling = _dot(elbow, _turn(q[2], moment))
        turn = w[1] + w[2]
        planar = inertia_boom * w[1] ** 2 + inertia_stick * turn**2 + 2 * coupling * w[1] * turn
        return (yaw * w[0] ** 2 + planar) / 2

    def potential(q: ca.SX) -> Scalar:
        first = _turn(q[1], _add((p.boom_mass * boom[0], p.boom_mass * boom[1]), elbow, outboard))
        second = _turn(q[1] + q[2], moment)
        return p.gravity * ((p.boom_mass + outboard) * pivot[1] + first[1] + second[1])

    angles = column(x.swing_angle, x.boom_angle, x.stick_angle)
    return equations_of_motion(kinetic, potential, angles, column(x.swing_speed, x.boom_speed, x.stick_speed))


def triangles(x: ManipulatorState, p: ManipulatorParameters) -> tuple[Triangle, Triangle]:
    """Cylinder triangles of boom and stick."""
    return (
        linkage.triangle(x.boom_angle, (p.boom_base_x, p.boom_base_z), (p.boom_pin_x, p.boom_pin_z)),
        linkage.triangle(x.stick_angle, (p.stick_base_x, p.stick_base_z), (p.stick_pin_x, p.stick_pin_z)),
    )


@dataclass(frozen=True)
class Piston:
    """One cylinder seen from the mechanics: geometry, motion, friction and stop force."""

    triangle: Triangle
    position: Scalar
    velocity: Scalar
    friction: Scalar
    stop: Scalar


def pistons(x: ManipulatorState, p: ManipulatorParameters) -> tuple[Piston, Piston]:
    """Boom and stick pistons."""
    boom, stick = triangles(x, p)
    stops = (p.stop_stiffness, p.stop_damping, p.stop_rounding)

    def piston(t: Triangle, speed: Scalar, closed: Scalar, stroke: Scalar, damping: Scalar) -> Piston:
        position, velocity = t.length - closed, t.arm * speed
        return Piston(
            t, position, velocity, damping * velocity, cylinder.stop_force(position, velocity, stroke, *stops)
        )

    return (
        piston(boom, x.boom_speed, p.boom_closed_length, p.boom_stroke, p.boom_piston_damping),
        piston(stick, x.stick_speed, p.stick_closed_length, p.stick_stroke, p.stick_piston_damping),
    )


def dynamics(x: ManipulatorState, u: ManipulatorInputs, p: ManipulatorParameters) -> ManipulatorState:
    """Time derivative of the state, field by field."""
    boom, stick = pistons(x, p)
    tau = column(
        u.swing_torque - p.swing_damping * x.swing_speed,
        boom.triangle.arm * (u.boom_force - boom.friction + boom.stop) - p.boom_joint_damping * x.boom_speed,
        stick.triangle.arm * (u.stick_force - stick.friction + stick.stop)
        - p.stick_joint_damping * x.stick_speed,
    )
    acceleration = mechanics(x, p).acceleration(tau)
    return ManipulatorState(
        swing_angle=x.swing_speed,
        boom_angle=x.boom_speed,
        stick_angle=x.stick_speed,
        swing_speed=acceleration[0],
        boom_speed=acceleration[1],
        stick_speed=acceleration[2],
    )


def observe(x: ManipulatorState, u: ManipulatorInputs, p: ManipulatorParameters) -> ManipulatorOutputs:
    """Outputs; only accelerations depend on the inputs directly, and the torques J F."""
    dx, motion = dynamics(x, u, p), mechanics(x, p)
    boom, stick = pistons(x, p)
    elbow, tip = points(x, p)
    along_boom, along_stick = x.boom_speed, x.boom_speed + x.stick_speed
    tip_velocity = (
        -along_boom * (elbow[1] - p.boom_pivot_z) - along_stick * (tip[1] - elbow[1]),
        along_boom * (elbow[0] - p.boom_pivot_x) + along_stick * (tip[0] - elbow[0]),
    )
    heat = (
        p.swing_damping * x.swing_speed**2 + boom.friction * boom.velocity + stick.friction * stick.velocity
    )
    heat += p.boom_joint_damping * x.boom_speed**2 + p.stick_joint_damping * x.stick_speed**2
    return ManipulatorOutputs(
        **vars(x),
        boom_position=boom.position,
        boom_velocity=boom.velocity,
        boom_acceleration=boom.triangle.arm * dx.boom_speed + boom.triangle.arm_slope * x.boom_speed**2,
        stick_position=stick.position,
        stick_velocity=stick.velocity,
        stick_acceleration=stick.triangle.arm * dx.stick_speed + stick.triangle.arm_slope * x.stick_speed**2,
        swing_acceleration=dx.swing_speed,
        boom_holding_force=motion.gravity[1] / boom.triangle.arm,
        stick_holding_force=motion.gravity[2] / stick.triangle.arm,
        boom_torque=boom.triangle.arm * u.boom_force,
        stick_torque=stick.triangle.arm * u.stick_force,
        boom_stop_force=boom.stop,
        stick_stop_force=stick.stop,
        elbow_radius=elbow[0],
        elbow_height=elbow[1],
        tip_radius=tip[0],
        tip_height=tip[1],
        tip_x=tip[0] * ca.cos(x.swing_angle),
        tip_y=tip[0] * ca.sin(x.swing_angle),
        tip_radial_velocity=tip_velocity[0],
        tip_vertical_velocity=tip_velocity[1],
        kinetic_energy=motion.kinetic,
        potential_energy=motion.potential,
        dissipated_power=heat,
    )


def initial(x: ManipulatorState, u: ManipulatorInputs, p: ManipulatorParameters) -> dict[str, Scalar]:
    """The pose to start from, a parameter because not every tool can set the start value of an output."""
    return {
        "swing_angle": p.initial_swing_angle,
        "boom_angle": p.initial_boom_angle,
        "stick_angle": p.initial_stick_angle,
    }


def require(x: ManipulatorState, u: ManipulatorInputs, p: ManipulatorParameters) -> dict[str, Scalar]:
    """Cylinder triangles must close over the whole stroke, and the pistons stay near their strokes."""
    conditions: dict[str, Scalar] = {}
    pins = {
        "boom": (
            (p.boom_base_x, p.boom_base_z),
            (p.boom_pin_x, p.boom_pin_z),
            p.boom_closed_length,
            p.boom_stroke,
        ),
        "stick": (
            (p.stick_base_x, p.stick_base_z),
            (p.stick_pin_x, p.stick_pin_z),
            p.stick_closed_length,
            p.stick_stroke,
        ),
    }
    for (name, (base, rod, closed, stroke)), piston in zip(pins.items(), pistons(x, p), strict=True):
        shortest, longest = linkage.reach(base, rod)
        margin = 0.05 * stroke  # a piston this far beyond its stop has left the range of the stop model
        conditions[f"{name}_closed_length is above the shortest reach of its pins"] = closed - shortest
        conditions[f"{name}_closed_length + {name}_stroke is below the longest reach of its pins"] = (
            longest - closed - stroke
        )
        angle = f"{name}_angle [rad], at the start initial_{name}_angle,"
        conditions[f"{angle} keeps the {name} piston above its closed end"] = piston.position + margin
        conditions[f"{angle} keeps the {name} piston below its open end"] = stroke + margin - piston.position
    boom, stick = triangles(x, p)
    conditions["boom_angle keeps the pins of the boom cylinder out of line (J > 0)"] = boom.arm
    conditions["stick_angle keeps the pins of the stick cylinder out of line (J < 0)"] = -stick.arm
    return conditions


MANIPULATOR = Subsystem(
    name="manipulator",
    text="Swing column, boom, stick and processing head with joint and piston friction",
    parameters=ManipulatorParameters,
    states=ManipulatorState,
    inputs=ManipulatorInputs,
    outputs=ManipulatorOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=(
        ports.shaft("swing", drives=False),
        *(ports.rod(axis, drives=False) for axis in ("boom", "stick")),
    ),
)
