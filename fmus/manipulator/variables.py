"""Variables of the manipulator: parameters, states, inputs, outputs; signs as in model.py."""

from __future__ import annotations

from fmus.contract import Group, Quantity, Scalar


class ManipulatorParameters(Group):
    """Constants; their numbers and sources are in parameters.toml."""

    gravity: Scalar = Quantity("m/s2", "Acceleration of free fall", 10.0, group="Gravity")
    column_inertia: Scalar = Quantity(
        "kg.m2", "Inertia of column and gear about the swing axis", 1e3, minimum=1e-3, group="Column"
    )
    boom_pivot_x: Scalar = Quantity("m", "Boom pivot on the column, radius from the swing axis")
    boom_pivot_z: Scalar = Quantity("m", "Boom pivot on the column, height above the column's foot")
    boom_mass: Scalar = Quantity("kg", "Mass of the boom", 1e2, minimum=1e-3, group="Boom")
    boom_inertia: Scalar = Quantity(
        "kg.m2", "Inertia of the boom about its centre of mass, across its axis", 1e2, minimum=0.0
    )
    boom_centre_x: Scalar = Quantity("m", "Centre of mass of the boom, along the boom from its pivot")
    boom_centre_z: Scalar = Quantity("m", "Centre of mass of the boom, across the boom from its pivot")
    stick_pivot_x: Scalar = Quantity("m", "Stick pivot, along the boom from the boom pivot")
    stick_pivot_z: Scalar = Quantity("m", "Stick pivot, across the boom from the boom pivot")
    stick_mass: Scalar = Quantity("kg", "Mass of the stick", 1e2, minimum=1e-3, group="Stick")
    stick_inertia: Scalar = Quantity(
        "kg.m2", "Inertia of the stick about its centre of mass, across its axis", 1e2, minimum=0.0
    )
    stick_centre_x: Scalar = Quantity("m", "Centre of mass of the stick, along the stick from its pivot")
    stick_centre_z: Scalar = Quantity("m", "Centre of mass of the stick, across the stick from its pivot")
    stick_length: Scalar = Quantity("m", "Length of the stick, pivot to head", minimum=1e-3)
    head_mass: Scalar = Quantity(
        "kg",
        "Mass of the processing head with its load",
        1e2,
        minimum=1e-3,
        tunable=True,
        group="Processing head",
    )
    boom_base_x: Scalar = Quantity(
        "m", "Base pin of the boom cylinder from the boom pivot, radial", group="Boom cylinder"
    )
    boom_base_z: Scalar = Quantity("m", "Base pin of the boom cylinder from the boom pivot, upwards")
    boom_pin_x: Scalar = Quantity("m", "Rod pin of the boom cylinder, along the boom from its pivot")
    boom_pin_z: Scalar = Quantity("m", "Rod pin of the boom cylinder, across the boom from its pivot")
    boom_closed_length: Scalar = Quantity("m", "Pin-to-pin length of the closed boom cylinder", minimum=1e-3)
    boom_stroke: Scalar = Quantity("m", "Stroke of the boom cylinder", minimum=1e-3)
    stick_base_x: Scalar = Quantity(
        "m", "Base pin of the stick cylinder from the stick pivot, along the boom", group="Stick cylinder"
    )
    stick_base_z: Scalar = Quantity(
        "m", "Base pin of the stick cylinder from the stick pivot, across the boom"
    )
    stick_pin_x: Scalar = Quantity("m", "Rod pin of the stick cylinder, along the stick from its pivot")
    stick_pin_z: Scalar = Quantity("m", "Rod pin of the stick cylinder, across the stick from its pivot")
    stick_closed_length: Scalar = Quantity(
        "m", "Pin-to-pin length of the closed stick cylinder", minimum=1e-3
    )
    stick_stroke: Scalar = Quantity("m", "Stroke of the stick cylinder", minimum=1e-3)
    swing_damping: Scalar = Quantity(
        "N.m.s/rad",
        "Viscous friction B_sw of the swing gear",
        1e2,
        minimum=0.0,
        tunable=True,
        group="Friction",
    )
    boom_joint_damping: Scalar = Quantity(
        "N.m.s/rad", "Viscous friction of the boom joint", 1e2, minimum=0.0, tunable=True
    )
    stick_joint_damping: Scalar = Quantity(
        "N.m.s/rad", "Viscous friction of the stick joint", 1e2, minimum=0.0, tunable=True
    )
    boom_piston_damping: Scalar = Quantity(
        "N.s/m", "Viscous friction B of the boom cylinder's piston", 1e4, minimum=0.0, tunable=True
    )
    stick_piston_damping: Scalar = Quantity(
        "N.s/m", "Viscous friction B of the stick cylinder's piston", 1e4, minimum=0.0, tunable=True
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


class ManipulatorInputs(Group):
    """Torque and forces of the hydraulics; the rate inputs carry their exact time derivatives."""

    swing_torque: Scalar = Quantity(
        "N.m", "Hydraulic torque on the swing column", 1e4, rate="swing_torque_rate"
    )
    swing_torque_rate: Scalar = Quantity(
        "N.m/s", "Rate port: time derivative of swing_torque, may stay unconnected", 1e5
    )
    boom_force: Scalar = Quantity("N", "Hydraulic force of the boom cylinder", 1e5, rate="boom_force_rate")
    boom_force_rate: Scalar = Quantity(
        "N/s", "Rate port: time derivative of boom_force, may stay unconnected", 1e6
    )
    stick_force: Scalar = Quantity("N", "Hydraulic force of the stick cylinder", 1e5, rate="stick_force_rate")
    stick_force_rate: Scalar = Quantity(
        "N/s", "Rate port: time derivative of stick_force, may stay unconnected", 1e6
    )


class ManipulatorOutputs(ManipulatorState):
    """The state; piston motion for the hydraulics; holding forces for the start; and what a user looks at."""

    boom_position: Scalar = Quantity("m", "Piston position of the boom cylinder from its closed end")
    boom_velocity: Scalar = Quantity("m/s", "Piston velocity of the boom cylinder", 0.1)
    boom_acceleration: Scalar = Quantity("m/s2", "Rate port: exact time derivative of boom_velocity")
    stick_position: Scalar = Quantity("m", "Piston position of the stick cylinder from its closed end")
    stick_velocity: Scalar = Quantity("m/s", "Piston velocity of the stick cylinder", 0.1)
    stick_acceleration: Scalar = Quantity("m/s2", "Rate port: exact time derivative of stick_velocity")
    swing_acceleration: Scalar = Quantity("rad/s2", "Rate port: exact time derivative of swing_speed")
    boom_holding_force: Scalar = Quantity("N", "Force of the boom cylinder that balances gravity", 1e5)
    stick_holding_force: Scalar = Quantity("N", "Force of the stick cylinder that balances gravity", 1e5)
    boom_torque: Scalar = Quantity("N.m", "Torque J F of the boom cylinder on its joint", 1e4)
    stick_torque: Scalar = Quantity("N.m", "Torque J F of the stick cylinder on its joint", 1e4)
    boom_stop_force: Scalar = Quantity(
        "N", "Force of the boom cylinder's end stop: not zero at the end of the stroke", 1e5, warn_above=1.0
    )
    stick_stop_force: Scalar = Quantity(
        "N", "Force of the stick cylinder's end stop: not zero at the end of the stroke", 1e5, warn_above=1.0
    )
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
