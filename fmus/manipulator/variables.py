"""Variables of the manipulator: parameters, states, inputs, outputs; signs as in model.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fmus.contract import Quantity, Scalar


@dataclass(frozen=True)
class ManipulatorParameters:
    """Constants; their numbers and sources are in parameters.toml."""

    gravity: Annotated[Scalar, Quantity("m/s2", "Acceleration of free fall", 10.0, group="Gravity")]
    column_inertia: Annotated[
        Scalar,
        Quantity(
            "kg.m2", "Inertia of column and gear about the swing axis", 1e3, minimum=1e-3, group="Column"
        ),
    ]
    boom_pivot_x: Annotated[Scalar, Quantity("m", "Boom pivot on the column, radius from the swing axis")]
    boom_pivot_z: Annotated[Scalar, Quantity("m", "Boom pivot on the column, height above the column's foot")]
    boom_mass: Annotated[Scalar, Quantity("kg", "Mass of the boom", 1e2, minimum=1e-3, group="Boom")]
    boom_inertia: Annotated[
        Scalar,
        Quantity("kg.m2", "Inertia of the boom about its centre of mass, across its axis", 1e2, minimum=0.0),
    ]
    boom_centre_x: Annotated[
        Scalar, Quantity("m", "Centre of mass of the boom, along the boom from its pivot")
    ]
    boom_centre_z: Annotated[
        Scalar, Quantity("m", "Centre of mass of the boom, across the boom from its pivot")
    ]
    stick_pivot_x: Annotated[Scalar, Quantity("m", "Stick pivot, along the boom from the boom pivot")]
    stick_pivot_z: Annotated[Scalar, Quantity("m", "Stick pivot, across the boom from the boom pivot")]
    stick_mass: Annotated[Scalar, Quantity("kg", "Mass of the stick", 1e2, minimum=1e-3, group="Stick")]
    stick_inertia: Annotated[
        Scalar,
        Quantity("kg.m2", "Inertia of the stick about its centre of mass, across its axis", 1e2, minimum=0.0),
    ]
    stick_centre_x: Annotated[
        Scalar, Quantity("m", "Centre of mass of the stick, along the stick from its pivot")
    ]
    stick_centre_z: Annotated[
        Scalar, Quantity("m", "Centre of mass of the stick, across the stick from its pivot")
    ]
    stick_length: Annotated[Scalar, Quantity("m", "Length of the stick, pivot to head", minimum=1e-3)]
    head_mass: Annotated[
        Scalar,
        Quantity(
            "kg",
            "Mass of the processing head with its load",
            1e2,
            minimum=1e-3,
            tunable=True,
            group="Processing head",
        ),
    ]
    boom_base_x: Annotated[
        Scalar,
        Quantity("m", "Base pin of the boom cylinder from the boom pivot, radial", group="Boom cylinder"),
    ]
    boom_base_z: Annotated[
        Scalar, Quantity("m", "Base pin of the boom cylinder from the boom pivot, upwards")
    ]
    boom_pin_x: Annotated[
        Scalar, Quantity("m", "Rod pin of the boom cylinder, along the boom from its pivot")
    ]
    boom_pin_z: Annotated[
        Scalar, Quantity("m", "Rod pin of the boom cylinder, across the boom from its pivot")
    ]
    boom_closed_length: Annotated[
        Scalar, Quantity("m", "Pin-to-pin length of the closed boom cylinder", minimum=1e-3)
    ]
    boom_stroke: Annotated[Scalar, Quantity("m", "Stroke of the boom cylinder", minimum=1e-3)]
    stick_base_x: Annotated[
        Scalar,
        Quantity(
            "m", "Base pin of the stick cylinder from the stick pivot, along the boom", group="Stick cylinder"
        ),
    ]
    stick_base_z: Annotated[
        Scalar, Quantity("m", "Base pin of the stick cylinder from the stick pivot, across the boom")
    ]
    stick_pin_x: Annotated[
        Scalar, Quantity("m", "Rod pin of the stick cylinder, along the stick from its pivot")
    ]
    stick_pin_z: Annotated[
        Scalar, Quantity("m", "Rod pin of the stick cylinder, across the stick from its pivot")
    ]
    stick_closed_length: Annotated[
        Scalar, Quantity("m", "Pin-to-pin length of the closed stick cylinder", minimum=1e-3)
    ]
    stick_stroke: Annotated[Scalar, Quantity("m", "Stroke of the stick cylinder", minimum=1e-3)]
    swing_damping: Annotated[
        Scalar,
        Quantity(
            "N.m.s/rad",
            "Viscous friction B_sw of the swing gear",
            1e2,
            minimum=0.0,
            tunable=True,
            group="Friction",
        ),
    ]
    boom_joint_damping: Annotated[
        Scalar, Quantity("N.m.s/rad", "Viscous friction of the boom joint", 1e2, minimum=0.0, tunable=True)
    ]
    stick_joint_damping: Annotated[
        Scalar, Quantity("N.m.s/rad", "Viscous friction of the stick joint", 1e2, minimum=0.0, tunable=True)
    ]
    boom_piston_damping: Annotated[
        Scalar,
        Quantity("N.s/m", "Viscous friction B of the boom cylinder's piston", 1e4, minimum=0.0, tunable=True),
    ]
    stick_piston_damping: Annotated[
        Scalar,
        Quantity(
            "N.s/m", "Viscous friction B of the stick cylinder's piston", 1e4, minimum=0.0, tunable=True
        ),
    ]
    stop_stiffness: Annotated[
        Scalar, Quantity("N/m", "Stiffness of the cylinders' end stops", 1e8, minimum=1.0, group="End stops")
    ]
    stop_damping: Annotated[
        Scalar, Quantity("s/m", "Contact damping of the end stops (Hunt and Crossley)", minimum=0.0)
    ]
    stop_rounding: Annotated[
        Scalar, Quantity("m", "Penetration over which an end stop takes hold", 1e-3, minimum=1e-6)
    ]
    initial_swing_angle: Annotated[
        Scalar, Quantity("rad", "Swing angle at the start, counter-clockwise from above", group="Start pose")
    ]
    initial_boom_angle: Annotated[Scalar, Quantity("rad", "Boom angle at the start, above the horizontal")]
    initial_stick_angle: Annotated[
        Scalar, Quantity("rad", "Stick angle at the start, relative to the boom, negative when folded")
    ]


@dataclass(frozen=True)
class ManipulatorState:
    """Joint angles and speeds."""

    swing_angle: Annotated[Scalar, Quantity("rad", "Swing angle")]
    boom_angle: Annotated[Scalar, Quantity("rad", "Boom angle above the horizontal")]
    stick_angle: Annotated[Scalar, Quantity("rad", "Stick angle relative to the boom")]
    swing_speed: Annotated[Scalar, Quantity("rad/s", "Swing speed")]
    boom_speed: Annotated[Scalar, Quantity("rad/s", "Speed of the boom joint")]
    stick_speed: Annotated[Scalar, Quantity("rad/s", "Speed of the stick joint")]


@dataclass(frozen=True)
class ManipulatorInputs:
    """Torque and forces of the hydraulics; the rate inputs carry their exact time derivatives."""

    swing_torque: Annotated[
        Scalar, Quantity("N.m", "Hydraulic torque on the swing column", 1e4, rate="swing_torque_rate")
    ]
    swing_torque_rate: Annotated[
        Scalar, Quantity("N.m/s", "Rate port: time derivative of swing_torque, may stay unconnected", 1e5)
    ]
    boom_force: Annotated[
        Scalar, Quantity("N", "Hydraulic force of the boom cylinder", 1e5, rate="boom_force_rate")
    ]
    boom_force_rate: Annotated[
        Scalar, Quantity("N/s", "Rate port: time derivative of boom_force, may stay unconnected", 1e6)
    ]
    stick_force: Annotated[
        Scalar, Quantity("N", "Hydraulic force of the stick cylinder", 1e5, rate="stick_force_rate")
    ]
    stick_force_rate: Annotated[
        Scalar, Quantity("N/s", "Rate port: time derivative of stick_force, may stay unconnected", 1e6)
    ]


@dataclass(frozen=True)
class ManipulatorOutputs(ManipulatorState):
    """The state; piston motion for the hydraulics; holding forces for the start; and what a user looks at."""

    boom_position: Annotated[
        Scalar, Quantity("m", "Piston position of the boom cylinder from its closed end")
    ]
    boom_velocity: Annotated[Scalar, Quantity("m/s", "Piston velocity of the boom cylinder", 0.1)]
    boom_acceleration: Annotated[
        Scalar, Quantity("m/s2", "Rate port: exact time derivative of boom_velocity")
    ]
    stick_position: Annotated[
        Scalar, Quantity("m", "Piston position of the stick cylinder from its closed end")
    ]
    stick_velocity: Annotated[Scalar, Quantity("m/s", "Piston velocity of the stick cylinder", 0.1)]
    stick_acceleration: Annotated[
        Scalar, Quantity("m/s2", "Rate port: exact time derivative of stick_velocity")
    ]
    swing_acceleration: Annotated[
        Scalar, Quantity("rad/s2", "Rate port: exact time derivative of swing_speed")
    ]
    boom_holding_force: Annotated[
        Scalar, Quantity("N", "Force of the boom cylinder that balances gravity", 1e5)
    ]
    stick_holding_force: Annotated[
        Scalar, Quantity("N", "Force of the stick cylinder that balances gravity", 1e5)
    ]
    boom_torque: Annotated[Scalar, Quantity("N.m", "Torque J F of the boom cylinder on its joint", 1e4)]
    stick_torque: Annotated[Scalar, Quantity("N.m", "Torque J F of the stick cylinder on its joint", 1e4)]
    boom_stop_force: Annotated[
        Scalar,
        Quantity(
            "N",
            "Force of the boom cylinder's end stop: not zero at the end of the stroke",
            1e5,
            warn_above=1.0,
        ),
    ]
    stick_stop_force: Annotated[
        Scalar,
        Quantity(
            "N",
            "Force of the stick cylinder's end stop: not zero at the end of the stroke",
            1e5,
            warn_above=1.0,
        ),
    ]
    elbow_radius: Annotated[Scalar, Quantity("m", "Stick pivot, radius from the swing axis")]
    elbow_height: Annotated[Scalar, Quantity("m", "Stick pivot, height above the foot of the column")]
    tip_radius: Annotated[Scalar, Quantity("m", "Stick end, radius from the swing axis")]
    tip_height: Annotated[Scalar, Quantity("m", "Stick end, height above the foot of the column")]
    tip_x: Annotated[Scalar, Quantity("m", "Stick end, forward at swing angle zero")]
    tip_y: Annotated[Scalar, Quantity("m", "Stick end, to the left at swing angle zero")]
    tip_radial_velocity: Annotated[
        Scalar, Quantity("m/s", "Velocity of the stick end away from the swing axis")
    ]
    tip_vertical_velocity: Annotated[Scalar, Quantity("m/s", "Velocity of the stick end upwards")]
    kinetic_energy: Annotated[Scalar, Quantity("J", "Kinetic energy", 1e3)]
    potential_energy: Annotated[
        Scalar, Quantity("J", "Potential energy of gravity, zero at the column's foot", 1e4)
    ]
    dissipated_power: Annotated[Scalar, Quantity("W", "Heat of joint and piston friction", 1e3)]
