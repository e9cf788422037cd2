"""Arm: two links in a vertical plane, the actuator on the first, the second hanging free.

    M(q) q'' + V(q, q') + G(q) = (J (F - c s1'), 0)      q = (theta1, theta2), s1' = J theta1'

Link 1 is a uniform rod from the hinge O to the elbow Q, link 2 is massless from Q to the tip R;
point masses sit at Q and R. The actuator joins a fixed anchor B, level with O, to a pin P on link 1.
M, V and G follow from the energies below (`fmus.components.mechanics`), s1 and J from the triangle
O, B, P (`fmus.components.mechanics`).

Signs: both angles count counter-clockwise from the horizontal; the force is positive when it
extends the actuator, which raises link 1. The friction c s1' of the cylinder belongs here, so that
the force that couples the two FMUs is a function of pressures alone.
Source: the benchmark of F. Gonzalez et al., README.md.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca

from fmus.components import mechanics as components_mechanics
from fmus.components.mechanics import EquationsOfMotion, Triangle, equations_of_motion
from fmus.contract import Group, Quantity, Scalar, Subsystem, column


class ArmParameters(Group):
    """Parameters; values and sources are in parameters.toml."""

    gravity: Scalar = Quantity("m/s2", "Gravitational acceleration", 10.0)
    link1_length: Scalar = Quantity("m", "Length of link 1, hinge to elbow", minimum=1e-3)
    link1_mass: Scalar = Quantity("kg", "Mass of link 1, a uniform rod", 1e2, minimum=0.0)
    elbow_mass: Scalar = Quantity("kg", "Point mass at the elbow", 1e2, minimum=0.0)
    link2_length: Scalar = Quantity("m", "Length of link 2, elbow to tip", minimum=1e-3)
    tip_mass: Scalar = Quantity("kg", "Point mass at the tip", 1e2, minimum=1e-3, tunable=True)
    anchor: Scalar = Quantity("m", "Distance of the actuator's anchor from the hinge")
    pin: Scalar = Quantity("m", "Distance of the actuator's pin from the hinge, along link 1")
    friction: Scalar = Quantity("N.s/m", "Viscous friction of the cylinder", 1e5, minimum=0.0, tunable=True)


class ArmState(Group):
    """Angles of the links from the horizontal, and their speeds."""

    theta1: Scalar = Quantity("rad", "Angle of link 1")
    theta2: Scalar = Quantity("rad", "Angle of link 2")
    theta1_dot: Scalar = Quantity("rad/s", "Speed of link 1", 0.1)
    theta2_dot: Scalar = Quantity("rad/s", "Speed of link 2", 0.1)


class ArmInputs(Group):
    """Force of the hydraulics; the rate input carries its exact time derivative."""

    force: Scalar = Quantity("N", "Hydraulic force, friction not included", 1e4, rate="force_rate")
    force_rate: Scalar = Quantity("N/s", "Rate port: time derivative of force, may stay unconnected", 1e5)


class ArmOutputs(ArmState):
    """The state; the actuator's motion for the hydraulics; the force for the start; and the balances."""

    s1: Scalar = Quantity("m", "Length of the actuator")
    s1_dot: Scalar = Quantity("m/s", "Velocity of the actuator", 0.1)
    s1_ddot: Scalar = Quantity("m/s2", "Rate port: exact time derivative of s1_dot")
    holding_force: Scalar = Quantity("N", "Force that balances gravity on link 1", 1e4)
    f_h: Scalar = Quantity("N", "Force of the actuator on the arm, friction included", 1e4)
    kinetic_energy: Scalar = Quantity("J", "Kinetic energy", 10.0)
    potential_energy: Scalar = Quantity("J", "Potential energy, zero at the hinge", 1e3)
    dissipated_power: Scalar = Quantity("W", "Heat of the cylinder's friction", 1e2)


def mechanics(x: ArmState, p: ArmParameters) -> EquationsOfMotion:
    """M, V, G from the energies of rod, elbow and tip."""
    a, b = p.link1_length, p.link2_length
    at_elbow = p.elbow_mass + p.tip_mass

    def kinetic(q: ca.SX, w: ca.SX) -> Scalar:
        first = (p.link1_mass / 3 + at_elbow) * a**2 * w[0] ** 2
        second = p.tip_mass * b**2 * w[1] ** 2
        return (first + second) / 2 + p.tip_mass * a * b * ca.cos(q[0] - q[1]) * w[0] * w[1]

    def potential(q: ca.SX) -> Scalar:
        moment = (p.link1_mass / 2 + at_elbow) * a
        return p.gravity * (moment * ca.sin(q[0]) + p.tip_mass * b * ca.sin(q[1]))

    return equations_of_motion(
        kinetic, potential, column(x.theta1, x.theta2), column(x.theta1_dot, x.theta2_dot)
    )


def actuator(x: ArmState, p: ArmParameters) -> Triangle:
    """Length s1 of the actuator and its moment arm J = ds1/dtheta1."""
    return components_mechanics.triangle(x.theta1, (p.anchor, 0), (p.pin, 0))


def dynamics(x: ArmState, u: ArmInputs, p: ArmParameters) -> ArmState:
    """Time derivative of the state."""
    arm = actuator(x, p).arm
    torque = arm * (u.force - p.friction * arm * x.theta1_dot)
    acceleration = mechanics(x, p).acceleration(column(torque, 0))
    return ArmState(
        theta1=x.theta1_dot, theta2=x.theta2_dot, theta1_dot=acceleration[0], theta2_dot=acceleration[1]
    )


def observe(x: ArmState, u: ArmInputs, p: ArmParameters) -> ArmOutputs:
    """Outputs; only s1_ddot and f_h depend on the force directly."""
    dx, motion, triangle = dynamics(x, u, p), mechanics(x, p), actuator(x, p)
    velocity = triangle.arm * x.theta1_dot
    return ArmOutputs(
        **vars(x),
        s1=triangle.length,
        s1_dot=velocity,
        s1_ddot=triangle.arm * dx.theta1_dot + triangle.arm_derivative * x.theta1_dot**2,
        holding_force=motion.gravity[0] / triangle.arm,
        f_h=u.force - p.friction * velocity,
        kinetic_energy=motion.kinetic,
        potential_energy=motion.potential,
        dissipated_power=p.friction * velocity**2,
    )


def require(x: ArmState, u: ArmInputs, p: ArmParameters) -> dict[str, Scalar]:
    """The actuator must not lie in line with link 1, where its force has no moment."""
    return {"the moment arm of the actuator at theta1 is positive": actuator(x, p).arm}


ARM = Subsystem(
    name="arm",
    text="Planar arm of two links of the hydraulic manipulator benchmark",
    parameters=ArmParameters,
    states=ArmState,
    inputs=ArmInputs,
    outputs=ArmOutputs,
    dynamics=dynamics,
    observe=observe,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
)
