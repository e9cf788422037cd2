"""Manipulator with dry friction: break-away and Stribeck effect in swing gear, joints and pistons.

    R = s0 z + s1(v) z' + b v        z' = v - s0 a(v) z / g(v)        for each contact, v its speed

is the LuGre model of `fmus.components.friction`, dry and viscous friction together. The initial deflections
are zero, so a machine in balance is at rest.

Validity: friction independent of pressure and load, unlike that of real seals and pins. The viscous
coefficients are those of `rigid`, which represent all losses, so dry and viscous friction together tend to
be too high.
"""

from fmus.components.friction import Bristles, Resistance, lugre
from fmus.contract import Group, Quantity, Scalar
from fmus.manipulator.model import manipulator
from fmus.manipulator.variables import ManipulatorOutputs, ManipulatorParameters, ManipulatorState


class JointContact(Group):
    """Dry friction of a joint."""

    coulomb: Scalar = Quantity(
        "N.m", "Coulomb friction of the {}", 100, minimum=0.0, tunable=True, group="Dry friction"
    )


class PistonContact(Group):
    """Dry friction of a piston."""

    coulomb: Scalar = Quantity("N", "Coulomb friction of the {}", 1000, minimum=0.0, tunable=True)


class JointLaw(Group):
    """Shape of the dry friction of all joints."""

    static_ratio: Scalar = Quantity(
        "1", "Break-away friction over Coulomb friction of {}", minimum=0.5, maximum=5.0, tunable=True
    )
    stribeck_speed: Scalar = Quantity("rad/s", "Stribeck speed of {}", 1e-2, minimum=1e-6)
    presliding: Scalar = Quantity(
        "rad", "Bristle deflection of {} at which the force is the Coulomb friction", 1e-4, minimum=1e-9
    )


class PistonLaw(JointLaw):
    """Shape of the dry friction of all pistons."""

    stribeck_speed: Scalar = Quantity("m/s", "Stribeck speed of {}", 1e-2, minimum=1e-6)
    presliding: Scalar = Quantity(
        "m", "Bristle deflection of {} at which the force is the Coulomb friction", 1e-4, minimum=1e-9
    )


class FrictionParameters(
    ManipulatorParameters,
    swing=(JointContact, "swing gear"),
    boom_joint=(JointContact, "boom joint"),
    stick_joint=(JointContact, "stick joint"),
    boom_piston=(PistonContact, "boom cylinder's piston"),
    stick_piston=(PistonContact, "stick cylinder's piston"),
    joint=(JointLaw, "joints and swing gear"),
    piston=(PistonLaw, "pistons"),
):
    """Parameters of the arm, and of dry friction."""

    bristle_damping_time: Scalar = Quantity(
        "s", "Damping of the bristles over their stiffness", 1e-2, minimum=0.0
    )


class JointBristles(Group):
    """State of the friction of a joint."""

    bristle: Scalar = Quantity("rad", "Elastic bristle deflection of the {}", 1e-4)


class PistonBristles(Group):
    """State of the friction of a piston."""

    bristle: Scalar = Quantity("m", "Elastic bristle deflection of the {}", 1e-4)


class FrictionState(
    ManipulatorState,
    swing=(JointBristles, "swing gear"),
    boom_joint=(JointBristles, "boom joint"),
    stick_joint=(JointBristles, "stick joint"),
    boom_piston=(PistonBristles, "boom cylinder's piston"),
    stick_piston=(PistonBristles, "stick cylinder's piston"),
):
    """States of the arm, and the deflections."""


class FrictionOutputs(ManipulatorOutputs):
    """Outputs of the arm, and the friction forces."""

    swing_friction_torque: Scalar = Quantity("N.m", "Friction of the swing gear, against its motion", 100)
    boom_friction_torque: Scalar = Quantity("N.m", "Friction of the boom joint, against its motion", 100)
    stick_friction_torque: Scalar = Quantity("N.m", "Friction of the stick joint, against its motion", 100)
    boom_friction_force: Scalar = Quantity(
        "N", "Friction of the boom cylinder's piston, against its motion", 1000
    )
    stick_friction_force: Scalar = Quantity(
        "N", "Friction of the stick cylinder's piston, against its motion", 1000
    )
    stored_energy: Scalar = Quantity("J", "Elastic energy in the friction of joints and pistons")


def resist(
    contact: str, speed: Scalar, x: FrictionState, p: FrictionParameters, damping: Scalar
) -> Resistance:
    """Resistance of one contact."""
    own = getattr(p, contact)
    law = p.piston if isinstance(own, PistonContact) else p.joint
    dry = Bristles(
        coulomb=own.coulomb,
        static_ratio=law.static_ratio,
        stribeck_speed=law.stribeck_speed,
        deflection=law.presliding,
        damping_time=p.bristle_damping_time,
    )
    return lugre(speed, getattr(x, contact).bristle, dry, damping)


FRICTION = manipulator(
    text="Swing column, boom, stick and processing head with dry and viscous friction",
    validity="rigid slender links, the head does not swing; friction independent of load and pressure",
    parameters=FrictionParameters,
    states=FrictionState,
    outputs=FrictionOutputs,
    dry=resist,
)
