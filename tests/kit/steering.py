"""The controller's equations as functions of numbers, for its tests."""

from functools import cache

import casadi as ca
import numpy as np

from fmus.contract import Symbolic, quantities, symbolic
from fmus.controller.model import CONTROLLER
from fmus.parameters import values

V = values(CONTROLLER)
STATES, INPUTS, OUTPUTS = (
    list(quantities(group)) for group in (CONTROLLER.states, CONTROLLER.inputs, CONTROLLER.outputs)
)


@cache
def model() -> tuple[Symbolic, ca.Function, ca.Function]:
    """The equations; as functions (x, u, p) -> dx, y and (x, u, p) -> the start."""
    whole = symbolic(CONTROLLER)
    return whole, whole.function(), whole.initial()


def measured(boom: float, stick: float, **given: float) -> dict[str, float]:
    """Inputs of a machine at rest in a pose, engaged."""
    return {**V.u, "boom_angle": boom, "stick_angle": stick, "engaged": 1.0, **given}


def rates(x: np.ndarray, u: dict[str, float], **p: float) -> np.ndarray:
    """dx/dt."""
    return model()[1](x, list(u.values()), list((V.p | p).values()))[0].full()[:, 0]


def outputs(x: np.ndarray, u: dict[str, float]) -> dict[str, float]:
    """The outputs by name."""
    found = model()[1](x, list(u.values()), list(V.p.values()))[1].full()[:, 0]
    return dict(zip(OUTPUTS, map(float, found), strict=True))


def start(u: dict[str, float]) -> np.ndarray:
    """The states at the start."""
    return model()[2](list(V.x.values()), list(u.values()), list(V.p.values())).full()[:, 0]


def at(x: np.ndarray, name: str) -> float:
    """One state, or one rate."""
    return float(x[STATES.index(name)])
