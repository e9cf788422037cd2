"""Manipulator: mechanics of swing column, boom, stick and processing head.

`VARIANTS` are its models by fidelity (dry friction, swinging head); `MANIPULATOR` is the default, rigid.
"""

from fmus.contract import family
from fmus.manipulator.friction import FRICTION
from fmus.manipulator.model import RIGID
from fmus.manipulator.pendulum import PENDULUM, PENDULUM_FRICTION

VARIANTS = family(
    "manipulator", rigid=RIGID, pendulum=PENDULUM, friction=FRICTION, pendulum_friction=PENDULUM_FRICTION
)
MANIPULATOR = VARIANTS["rigid"]

__all__ = ["MANIPULATOR", "VARIANTS"]
