"""Variables of the manipulator: parameters, states, inputs, outputs; signs as in arm.py."""

from __future__ import annotations

from fmus.components.mechanics import Point
from fmus.contract import Group, Quantity, Scalar


class CylinderMount(Group):
    """Where a cylinder is fixed, and how long it is."""

    base_x: Scalar = Quantity(
        "m", "Base pin of the {} cylinder from the {} pivot, along what it is fixed to", group="{} cylinder"
    )
    base_z: Scalar = Quantity(
        "m", "Base pin of the {} cylinder from the {} pivot, across what it is fixed to"
    )
    pin_x: Scalar = Quantity("m", "Rod pin of the {} cylinder, along the {} from its pivot")
    pin_z: Scalar = Quantity("m", "Rod pin of the {} cylinder, across the {} from its pivot")
    closed_length: Scalar = Quantity("m", "Pin-to-pin length of the closed {} cylinder", minimum=1e-3)
    stroke: Scalar = Quantity("m", "Stroke of the {} cylinder", minimum=1e-3)

    @property
    def pins(self) -> tuple[Point, Point]:
        """Base pin on the fixed side and rod pin on the link, both from the joint [m]."""
        return (self.base_x, self.base_z), (self.pin_x, self.pin_z)


class ArmLink(CylinderMount):
    """Boom or stick with its cylinder, and their friction."""

    mass: Scalar = Quantity("kg", "Mass of the {}", 1e2, minimum=1e-3, group="{}")
    inertia: Scalar = Quantity(
        "kg.m2", "Inertia of the {} about its centre of mass, across its axis", 1e2, minimum=0.0
    )
    centre_x: Scalar = Quantity("m", "Centre of mass of the {}, along the {} from its pivot")
    centre_z: Scalar = Quantity("m", "Centre of mass of the {}, across the {} from its pivot")
    joint_damping: Scalar = Quantity(
        "N.m.s/rad", "Viscous friction of the {} joint", 1e2, minimum=0.0, tunable=True, group="Friction"
    )
    piston_damping: Scalar = Quantity(
        "N.s/m", "Viscous friction B of the {} cylinder's piston", 1e4, minimum=0.0, tunable=True
    )

    @property
    def centre(self) -> Point:
        """Centre of mass in the link's frame [m]."""
        return self.centre_x, self.centre_z


class ManipulatorParameters(Group, boom=ArmLink, stick=ArmLink):
    """Constants; their numbers and sources are in parameters.toml."""

    boom_base_x: Scalar = Quantity(
        "m", "Base pin of the boom cylinder from the boom pivot, radial", group="Boom cylinder"
    )
    boom_base_z: Scalar = Quantity("m", "Base pin of the boom cylinder from the boom pivot, upwards")
    gravity: Scalar = Quantity("m/s2", "Acceleration of free fall", 10.0, group="Gravity")
    column_inertia: Scalar = Quantity(
        "kg.m2", "Inertia of column and gear about the swing axis", 1e3, minimum=1e-3, group="Column"
    )
    boom_pivot_x: Scalar = Quantity("m", "Boom pivot on the column, radius from the swing axis")
    boom_pivot_z: Scalar = Quantity("m", "Boom pivot on the column, height above the column's foot")
    stick_pivot_x: Scalar = Quantity("m", "Stick pivot, along the boom from the boom pivot", group="Boom")
    stick_pivot_z: Scalar = Quantity("m", "Stick pivot, across the boom from the boom pivot")
    stick_length: Scalar = Quantity("m", "Length of the stick, pivot to head", minimum=1e-3, group="Stick")
    head_mass: Scalar = Quantity(
        "kg",
        "Mass of the processing head with its load",
        1e2,
        minimum=1e-3,
        tunable=True,
        group="Processing head",
    )
    swing_damping: Scalar = Quantity(
        "N.m.s/rad",
        "Viscous friction B_sw of the swing gear",
        1e2,
        minimum=0.0,
        tunable=True,
        group="Friction",
    )
    stop_stiffness: Scalar = Quantity(
        "N/m", "Stiffness of the cylinders' end stops", 1e8, minimum=1.0, group="End stops"
    )
    stop_damping: Scalar = Quantity(
        "s/m", "Contact damping of the end stops (Hunt and Crossley)", minimum=0.0
    )
    stop_rounding: Scalar = Quantity("m", "Penetration over which an end stop takes hold", 1e-3, minimum=1e-6)
    initial_swing_angle: Scalar = Quantity(
        "rad", "Swing angle at the start, counter-clockwise from above", group="Start pose"
    )
    initial_boom_angle: Scalar = Quantity("rad", "Boom angle at the start, above the horizontal")
    initial_stick_angle: Scalar = Quantity(
        "rad", "Stick angle at the start, relative to the boom, negative when folded"
    )


class ManipulatorState(Group):
    """Joint angles and speeds."""

    swing_angle: Scalar = Quantity("rad", "Swing angle")
    boom_angle: Scalar = Quantity("rad", "Boom angle above the horizontal")
    stick_angle: Scalar = Quantity("rad", "Stick angle relative to the boom")
    swing_speed: Scalar = Quantity("rad/s", "Swing speed")
    boom_speed: Scalar = Quantity("rad/s", "Speed of the boom joint")
    stick_speed: Scalar = Quantity("rad/s", "Speed of the stick joint")


class CylinderInputs(Group):
    """Force of a cylinder; the rate input carries its exact time derivative."""

    force: Scalar = Quantity("N", "Hydraulic force of the {} cylinder", 1e5, rate="force_rate")
    force_rate: Scalar = Quantity("N/s", "Rate port: time derivative of {}_force, may stay unconnected", 1e6)


class ManipulatorInputs(Group, boom=CylinderInputs, stick=CylinderInputs):
    """Torque and forces of the hydraulics; the rate inputs carry their exact time derivatives."""

    swing_torque: Scalar = Quantity(
        "N.m", "Hydraulic torque on the swing column", 1e4, rate="swing_torque_rate"
    )
    swing_torque_rate: Scalar = Quantity(
        "N.m/s", "Rate port: time derivative of swing_torque, may stay unconnected", 1e5
    )


class CylinderOutputs(Group):
    """Motion of a piston for the hydraulics, the holding force for the start, and what a user looks at."""

    position: Scalar = Quantity("m", "Piston position of the {} cylinder from its closed end")
    velocity: Scalar = Quantity("m/s", "Piston velocity of the {} cylinder", 0.1)
    acceleration: Scalar = Quantity("m/s2", "Rate port: exact time derivative of {}_velocity")
    holding_force: Scalar = Quantity("N", "Force of the {} cylinder that balances gravity", 1e5)
    torque: Scalar = Quantity("N.m", "Torque J F of the {} cylinder on its joint", 1e4)
    stop_force: Scalar = Quantity(
        *("N", "Force of the {} cylinder's end stop: not zero at the end of the stroke", 1e5), warn_above=1.0
    )


class ManipulatorOutputs(ManipulatorState, boom=CylinderOutputs, stick=CylinderOutputs):
    """The state, the pistons, where the arm is, and its energies."""

    swing_acceleration: Scalar = Quantity("rad/s2", "Rate port: exact time derivative of swing_speed")
    elbow_radius: Scalar = Quantity("m", "Stick pivot, radius from the swing axis")
    elbow_height: Scalar = Quantity("m", "Stick pivot, height above the foot of the column")
    tip_radius: Scalar = Quantity("m", "Stick end, radius from the swing axis")
    tip_height: Scalar = Quantity("m", "Stick end, height above the foot of the column")
    tip_x: Scalar = Quantity("m", "Stick end, forward at swing angle zero")
    tip_y: Scalar = Quantity("m", "Stick end, to the left at swing angle zero")
    tip_radial_velocity: Scalar = Quantity("m/s", "Velocity of the stick end away from the swing axis")
    tip_vertical_velocity: Scalar = Quantity("m/s", "Velocity of the stick end upwards")
    kinetic_energy: Scalar = Quantity("J", "Kinetic energy", 1e3)
    potential_energy: Scalar = Quantity("J", "Potential energy of gravity, zero at the column's foot", 1e4)
    dissipated_power: Scalar = Quantity("W", "Heat of joint and piston friction", 1e3)
