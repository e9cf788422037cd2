"""A swinging head and dry friction together: the equations of `pendulum` and of `friction`."""

from __future__ import annotations

from fmus.contract import Quantity, Scalar
from fmus.manipulator.friction import BRISTLES, FrictionOutputs, FrictionParameters, FrictionState
from fmus.manipulator.model import manipulator
from fmus.manipulator.pendulum import HANGING, PendulumOutputs, PendulumParameters, PendulumState


class PendulumFrictionParameters(PendulumParameters, FrictionParameters):
    """Those of both."""


class PendulumFrictionState(PendulumState, FrictionState):
    """Those of both."""


class PendulumFrictionOutputs(PendulumOutputs, FrictionOutputs):
    """Those of both."""

    stored_energy: Scalar = Quantity(
        "J", "Elastic energy in the friction of joints and pistons and in the head's stops"
    )


PENDULUM_FRICTION = manipulator(
    text="Swing column, boom, stick with dry friction and a processing head that swings in a Hooke joint",
    validity="rigid slender links; head within 80 degrees of the arm's plane; friction independent of load",
    parameters=PendulumFrictionParameters,
    states=PendulumFrictionState,
    outputs=PendulumFrictionOutputs,
    head=HANGING,
    friction=BRISTLES,
)
