"""Mechanics of the arm (swing column, boom, stick): geometry, energies, pistons.

Signs: the boom angle is measured from the horizontal, upwards positive. The stick angle is measured from the
boom, upwards positive; it is negative for a folded stick. The swing angle is counter-clockwise seen from
above. Extending the boom cylinder raises the boom; extending the stick cylinder folds the stick in (J < 0).

**Energies.** The head is a point mass at the tip, plus the energies that a `Head` adds. In the plane of the
arm, stick and point mass enter with their first moment and their moment of inertia about the elbow; their
whole mass moves with the elbow. The links are slender: they have no inertia about their own axis, so the
inertia of a link at pitch f about the vertical is m r^2 + I cos(f)^2.

The payload is a point mass that comes and goes at the place of the head's mass: at the tip for a point mass,
at the centre of mass of a head that swings, because rollers and knives hold the stem there. So the head has
the mass m_head + m_held, and the moment of inertia of the empty head.
"""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus.components import cylinder
from fmus.components.cylinder import Stop
from fmus.components.mechanics import (
    EquationsOfMotion,
    Point,
    Triangle,
    equations_of_motion,
    reach,
    rotate,
    triangle,
)
from fmus.contract import Scalar, column
from fmus.manipulator.design import Head, TipMotion
from fmus.manipulator.variables import ManipulatorParameters, ManipulatorState

SWING_STOP_ROUNDING = 1e-3  # rad, smoothing angle of the torque of the column's end stops


def points(x: Any, p: ManipulatorParameters) -> tuple[Point, Point]:
    """Elbow (stick pivot) and tip (end of the stick) as (radius, height) [m].

    x   angles of boom and stick [rad]: a state, or a setpoint of a controller; the same below
    """
    pitch = x.boom_angle + x.stick_angle
    elbow = _add((p.boom_pivot_x, p.boom_pivot_z), _turn(x.boom_angle, (p.stick_pivot_x, p.stick_pivot_z)))
    return elbow, _add(elbow, _turn(pitch, (p.stick_length, 0)))


def tip_velocity(x: Any, p: ManipulatorParameters) -> Point:
    """Velocity of the tip in the plane of the arm, outwards and upwards [m/s]."""
    elbow, tip = points(x, p)
    upper = _add(elbow, (p.boom_pivot_x, p.boom_pivot_z), -1)
    return _end_velocity(upper, _add(tip, elbow, -1), x.boom_speed, x.boom_speed + x.stick_speed)


def _end_velocity(upper: Point, lower: Point, upper_rate: Scalar, lower_rate: Scalar) -> Point:
    """Velocity of the end of two links `upper` and `lower` with these pitch rates [rad/s]."""
    return -upper_rate * upper[1] - lower_rate * lower[1], upper_rate * upper[0] + lower_rate * lower[0]


def _turn(angle: Scalar, point: Point) -> Point:
    return rotate(ca.cos(angle), ca.sin(angle), point)


def _add(a: Point, b: Point, weight: Scalar = 1) -> Point:
    return a[0] + weight * b[0], a[1] + weight * b[1]


def _dot(a: Point, b: Point) -> Scalar:
    return a[0] * b[0] + a[1] * b[1]


def mechanics(x: ManipulatorState, p: ManipulatorParameters, head: Head) -> EquationsOfMotion:
    """M, V, G of eq. (4) from the energies of boom, stick and head, q = (swing, boom, stick, head angles)."""
    carried, empty = ca.SX.sym("head_mass"), p
    p = replace(p, head_mass=carried)
    pivot, elbow = (p.boom_pivot_x, p.boom_pivot_z), (p.stick_pivot_x, p.stick_pivot_z)
    boom, stick, tip = p.boom.centre, p.stick.centre, (p.stick_length, 0)
    outboard = p.stick.mass + p.head_mass
    moment = _add((p.head_mass * p.stick_length, 0), stick, p.stick.mass)  # about the elbow [kg.m]
    inertia_boom = p.boom.inertia + p.boom.mass * _dot(boom, boom) + outboard * _dot(elbow, elbow)
    inertia_stick = p.stick.inertia + p.stick.mass * _dot(stick, stick) + p.head_mass * p.stick_length**2

    def kinetic(q: ca.SX, w: ca.SX) -> Scalar:
        pitch = q[1] + q[2]
        at_elbow = _add(pivot, _turn(q[1], elbow))
        at_tip = _add(at_elbow, _turn(pitch, tip))
        radii = [(p.boom.mass, _add(pivot, _turn(q[1], boom))[0])]
        radii += [(p.stick.mass, _add(at_elbow, _turn(pitch, stick))[0])]
        radii += [(p.head_mass, at_tip[0])]
        yaw = p.column_inertia + p.boom.inertia * ca.cos(q[1]) ** 2 + p.stick.inertia * ca.cos(pitch) ** 2
        yaw += sum(m * r**2 for m, r in radii)
        coupling = _dot(elbow, _turn(q[2], moment))
        pitch_rate = w[1] + w[2]
        planar = inertia_boom * w[1] ** 2 + inertia_stick * pitch_rate**2 + 2 * coupling * w[1] * pitch_rate
        out, up = _end_velocity(_add(at_elbow, pivot, -1), _add(at_tip, at_elbow, -1), w[1], pitch_rate)
        motion = TipMotion(velocity=(out, at_tip[0] * w[0], up), yaw_rate=w[0])
        return (yaw * w[0] ** 2 + planar) / 2 + head.kinetic(motion, q[3:], w[3:], p)

    def potential(q: ca.SX) -> Scalar:
        first = _turn(q[1], _add((p.boom.mass * boom[0], p.boom.mass * boom[1]), elbow, outboard))
        second = _turn(q[1] + q[2], moment)
        arm = p.gravity * ((p.boom.mass + outboard) * pivot[1] + first[1] + second[1])
        return arm + head.potential(q[3:], p)

    angles = (x.swing_angle, x.boom_angle, x.stick_angle, *(getattr(x, n) for n in head.angles))
    speeds = (x.swing_speed, x.boom_speed, x.stick_speed, *(getattr(x, n) for n in head.speeds))
    total = empty.head_mass + x.held_mass
    return equations_of_motion(kinetic, potential, column(*angles), column(*speeds), (carried, total))


def triangles(x: Any, p: Any) -> tuple[Triangle, Triangle]:
    """Cylinder triangles of boom and stick."""
    return triangle(x.boom_angle, *p.boom.pins), triangle(x.stick_angle, *p.stick.pins)


@dataclass(frozen=True)
class Piston:
    """Piston of a cylinder: geometry at the joint, position [m], velocity [m/s] and end stops."""

    triangle: Triangle
    position: Scalar
    velocity: Scalar
    stop: Stop


def swing_stop(x: ManipulatorState, p: ManipulatorParameters) -> Stop:
    """End stops of the swing at +- `swing_stop_angle`, none if that is 0."""
    end = p.swing_stop_angle
    stiffness = ca.if_else(end > 0, p.swing_stop_stiffness, 0)
    law = (stiffness, p.swing_stop_damping, SWING_STOP_ROUNDING)
    return cylinder.stop(x.swing_angle + end, x.swing_speed, 2 * end, *law)


def pistons(x: ManipulatorState, p: ManipulatorParameters) -> tuple[Piston, Piston]:
    """Boom and stick pistons."""
    boom, stick = triangles(x, p)
    stops = (p.stop_stiffness, p.stop_damping, p.stop_rounding)

    def piston(t: Triangle, speed: Scalar, closed: Scalar, stroke: Scalar) -> Piston:
        position, velocity = t.length - closed, t.arm * speed
        return Piston(t, position, velocity, cylinder.stop(position, velocity, stroke, *stops))

    return (
        piston(boom, x.boom_speed, p.boom.closed_length, p.boom.stroke),
        piston(stick, x.stick_speed, p.stick.closed_length, p.stick.stroke),
    )


def require(x: ManipulatorState, p: ManipulatorParameters) -> dict[str, Scalar]:
    """Requirements: cylinder triangles close over the whole stroke, pistons stay within their strokes."""
    conditions: dict[str, Scalar] = {}
    boom, stick = pistons(x, p)
    for name, piston, mount in (("boom", boom, p.boom), ("stick", stick, p.stick)):
        shortest, longest = reach(*mount.pins)
        margin = 0.05 * mount.stroke  # penetration of an end stop up to which its model is valid
        angle = f"{name}_angle [rad], at the start initial_{name}_angle,"
        conditions |= {
            f"{name}_closed_length is above the shortest reach of its pins": mount.closed_length - shortest,
            f"{name}_closed_length + {name}_stroke is below the longest reach of its pins": longest
            - mount.closed_length
            - mount.stroke,
            f"{angle} keeps the {name} piston above its closed end": piston.position + margin,
            f"{angle} keeps the {name} piston below its open end": mount.stroke + margin - piston.position,
        }
    conditions["boom_angle keeps the pins of the boom cylinder out of line (J > 0)"] = boom.triangle.arm
    conditions["stick_angle keeps the pins of the stick cylinder out of line (J < 0)"] = -stick.triangle.arm
    return conditions
