"""Variables of the manipulator: parameters, states, inputs, outputs; signs as in model.py.

The elbow is the stick pivot, the tip the end of the stick, to which the processing head is fixed. Rate ports:
docs/rate-ports.md.
"""

from fmus import ports
from fmus.components import friction
from fmus.components.mechanics import Point
from fmus.contract import Group, Quantity, Scalar


class CylinderMount(Group):
    """Mounting points and lengths of a cylinder."""

    base_x: Scalar = Quantity(
        "m", "Base pin of the {} cylinder from the {} pivot, along the fixed link", group="{} cylinder"
    )
    base_z: Scalar = Quantity(
        "m", "Base pin of the {} cylinder from the {} pivot, perpendicular to the fixed link"
    )
    pin_x: Scalar = Quantity("m", "Rod pin of the {} cylinder from the {} pivot, along the {}")
    pin_z: Scalar = Quantity("m", "Rod pin of the {} cylinder from the {} pivot, perpendicular to the {}")
    closed_length: Scalar = Quantity("m", "Pin-to-pin length of the closed {} cylinder", minimum=1e-3)
    stroke: Scalar = Quantity("m", "Stroke of the {} cylinder", minimum=1e-3)

    @property
    def pins(self) -> tuple[Point, Point]:
        """Base pin on the fixed link and rod pin on the moving link, relative to the joint [m]."""
        return (self.base_x, self.base_z), (self.pin_x, self.pin_z)


class ArmLink(CylinderMount):
    """Boom or stick with its cylinder, and the friction of both."""

    mass: Scalar = Quantity("kg", "Mass of the {}", 1e2, minimum=1e-3, group="{}")
    inertia: Scalar = Quantity(
        "kg.m2",
        "Moment of inertia of the {} about the joint axis direction through its centre of mass",
        1e2,
        minimum=0.0,
    )
    centre_x: Scalar = Quantity("m", "Centre of mass of the {} from its pivot, along the {}")
    centre_z: Scalar = Quantity("m", "Centre of mass of the {} from its pivot, perpendicular to the {}")
    joint_damping: Scalar = friction.damping("N.m.s/rad", "the {} joint", 1e2, "Friction")
    piston_damping: Scalar = friction.damping("N.s/m", "the {} cylinder's piston", 1e4)

    @property
    def centre(self) -> Point:
        """Centre of mass in the link's frame [m]."""
        return self.centre_x, self.centre_z


class OnColumn(CylinderMount):
    """Mounting points of a cylinder between the column and a link."""

    base_x: Scalar = Quantity(
        "m", "Base pin of the {} cylinder from the {} pivot, radial", group="{} cylinder"
    )
    base_z: Scalar = Quantity("m", "Base pin of the {} cylinder from the {} pivot, upwards")


class Boom(OnColumn, ArmLink):
    """The boom, whose fixed link is the column."""


class ManipulatorParameters(Group, boom=Boom, stick=ArmLink):
    """Parameters; values and sources are in parameters.toml."""

    gravity: Scalar = Quantity("m/s2", "Gravitational acceleration", 10.0, group="Gravity")
    column_inertia: Scalar = Quantity(
        "kg.m2",
        "Moment of inertia of column and gear about the swing axis",
        1e3,
        minimum=1e-3,
        group="Column",
    )
    boom_pivot_x: Scalar = Quantity("m", "Boom pivot on the column, radius from the swing axis")
    boom_pivot_z: Scalar = Quantity("m", "Boom pivot on the column, height above the foot of the column")
    stick_pivot_x: Scalar = Quantity("m", "Stick pivot from the boom pivot, along the boom", group="Boom")
    stick_pivot_z: Scalar = Quantity("m", "Stick pivot from the boom pivot, perpendicular to the boom")
    stick_length: Scalar = Quantity(
        "m", "Length of the stick, from its pivot to the tip", minimum=1e-3, group="Stick"
    )
    head_mass: Scalar = Quantity(
        "kg",
        "Mass of the processing head without payload",
        1e2,
        minimum=1e-3,
        tunable=True,
        group="Processing head",
    )
    payload_grip_time: Scalar = Quantity(
        "s", "Delay of the mass held behind payload_mass, as two lags in series", 0.1, minimum=1e-3
    )
    swing_damping: Scalar = friction.damping("N.m.s/rad", "the swing gear", 1e2, "Friction")
    stop_stiffness: Scalar = Quantity(
        "N/m", "Stiffness of the cylinders' end stops", 1e8, minimum=1.0, group="End stops"
    )
    stop_damping: Scalar = Quantity(
        "s/m", "Contact damping of the end stops (Hunt and Crossley)", minimum=0.0
    )
    stop_rounding: Scalar = Quantity("m", "Smoothing length of the end stop force", 1e-3, minimum=1e-6)
    swing_stop_angle: Scalar = Quantity(
        "rad", "Swing angle, to both sides, at which the end stops of the column begin; 0: none", minimum=0.0
    )
    swing_stop_stiffness: Scalar = Quantity(
        "N.m/rad", "Stiffness of the end stops of the column", 1e6, minimum=1.0
    )
    swing_stop_damping: Scalar = Quantity(
        "s/rad", "Contact damping of the end stops of the column (Hunt and Crossley)", minimum=0.0
    )
    ground_height: Scalar = Quantity(
        "m", "Ground, height above the foot of the column: negative", group="Ground"
    )
    initial_swing_angle: Scalar = Quantity(
        "rad", "Swing angle at the start, counter-clockwise from above", group="Start pose"
    )
    initial_boom_angle: Scalar = Quantity("rad", "Boom angle at the start, above the horizontal")
    initial_stick_angle: Scalar = Quantity(
        "rad", "Stick angle at the start, relative to the boom, negative when folded"
    )


class ManipulatorState(Group):
    """Joint angles and speeds, and the payload."""

    swing_angle: Scalar = Quantity(
        "rad", "Swing angle, counter-clockwise from above; counts turns if there are no stops"
    )
    boom_angle: Scalar = Quantity("rad", "Boom angle above the horizontal")
    stick_angle: Scalar = Quantity("rad", "Stick angle relative to the boom, negative when folded")
    swing_speed: Scalar = Quantity("rad/s", "Swing speed, counter-clockwise from above")
    boom_speed: Scalar = Quantity("rad/s", "Speed of the boom joint")
    stick_speed: Scalar = Quantity("rad/s", "Speed of the stick joint")
    held_mass: Scalar = Quantity("kg", "Mass of the payload that the head holds", 100.0)
    payload_flow: Scalar = Quantity("kg/s", "Mass flow into the head: rate of held_mass", 1000.0)


class CylinderInputs(Group):
    """Force of a cylinder; the rate input carries its exact time derivative."""

    force: Scalar = Quantity("N", "Hydraulic force of the {} cylinder", 1e5, rate="force_rate")
    force_rate: Scalar = ports.rate_input("{}_force", "N/s", 1e6)


class ManipulatorInputs(Group, boom=CylinderInputs, stick=CylinderInputs):
    """Torque and forces of the hydraulics, with their exact time derivatives; the payload."""

    swing_torque: Scalar = Quantity(
        "N.m", "Torque of the drive on the swing column", 1e4, rate="swing_torque_rate"
    )
    swing_torque_rate: Scalar = ports.rate_input("swing_torque", "N.m/s", 1e5)
    payload_mass: Scalar = Quantity(
        "kg",
        "Payload that the head is to hold; a smaller value drops mass",
        100.0,
        minimum=0.0,
        optional="the head holds nothing",
    )


class CylinderOutputs(Group):
    """Piston motion (to the hydraulics), holding force (for initialisation) and monitoring outputs."""

    position: Scalar = Quantity("m", "Piston position of the {} cylinder from its closed end")
    velocity: Scalar = Quantity("m/s", "Piston velocity of the {} cylinder", 0.1)
    acceleration: Scalar = ports.rate_output("{}_velocity", "m/s2")
    holding_force: Scalar = Quantity("N", "Static holding force of the {} cylinder against gravity", 1e5)
    torque: Scalar = Quantity("N.m", "Torque of the {} cylinder on its joint: moment arm times force", 1e4)
    stop_force: Scalar = Quantity(
        "N",
        "Force of the {} cylinder's end stops: zero except at the ends of the stroke",
        1e5,
        warn_above=1.0,
        meaning="{} reaches the end of its stroke",
    )


class ManipulatorOutputs(ManipulatorState, boom=CylinderOutputs, stick=CylinderOutputs):
    """States, piston motion, positions, energies."""

    swing_acceleration: Scalar = ports.rate_output("swing_speed", "rad/s2")
    elbow_radius: Scalar = Quantity("m", "Elbow (stick pivot), radius from the swing axis")
    elbow_height: Scalar = Quantity("m", "Elbow (stick pivot), height above the foot of the column")
    tip_radius: Scalar = Quantity("m", "Tip, radius from the swing axis")
    tip_height: Scalar = Quantity("m", "Tip, height above the foot of the column")
    tip_x: Scalar = Quantity("m", "Tip, forward at swing angle zero")
    tip_y: Scalar = Quantity("m", "Tip, to the left at swing angle zero")
    tip_radial_velocity: Scalar = Quantity("m/s", "Velocity of the tip away from the swing axis")
    tip_vertical_velocity: Scalar = Quantity("m/s", "Velocity of the tip upwards")
    tip_depth: Scalar = Quantity(
        "m",
        "Depth of the tip below the ground, else zero: nothing stops it there",
        0.1,
        warn_above=0.01,
        meaning="the tip is in the ground: nothing stops it there",
    )
    swing_stop_torque: Scalar = Quantity(
        "N.m",
        "Torque of the end stops of the column: zero except at the ends of its range",
        1e4,
        warn_above=1.0,
        meaning="swing reaches the end of its range",
    )
    stop_energy: Scalar = Quantity("J", "Elastic energy in the end stops of cylinders and column", 1e3)
    kinetic_energy: Scalar = Quantity("J", "Kinetic energy", 1e3)
    potential_energy: Scalar = Quantity(
        "J", "Potential energy of gravity, zero at the foot of the column", 1e4
    )
    dissipated_power: Scalar = Quantity(
        "W",
        "Power dissipated by friction of joints and pistons, by end stops and by the inelastic pick-up of"
        " payload",
        1e3,
    )
    payload_power: Scalar = Quantity(
        "W", "Power that enters with payload: picked up at rest, let go with the speed that it has", 1e3
    )
