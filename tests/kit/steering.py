"""The controller's equations as functions of numbers, for its tests."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from fmus.contract import quantities, symbolic
from fmus.controller.model import CONTROLLER
from fmus.parameters import values

V = values(CONTROLLER)
STATES, INPUTS = list(quantities(CONTROLLER.states)), list(quantities(CONTROLLER.inputs))


@cache
def model() -> tuple[ca.Function, ca.Function]:
    """(x, u, p) -> dx, y; and the start."""
    whole = symbolic(CONTROLLER)
    return whole.function(), whole.initial()


def measured(boom: float, stick: float, **given: float) -> dict[str, float]:
    """Inputs of a machine at rest in a pose, engaged."""
    return {**V.u, "boom_angle": boom, "stick_angle": stick, "engaged": 1.0, **given}


def rates(x: np.ndarray, u: dict[str, float], **p: float) -> np.ndarray:
    """dx/dt."""
    return model()[0](x, list(u.values()), list((V.p | p).values()))[0].full()[:, 0]


def start(u: dict[str, float]) -> np.ndarray:
    """The states at the start."""
    return model()[1](list(V.x.values()), list(u.values()), list(V.p.values())).full()[:, 0]


def at(x: np.ndarray, name: str) -> float:
    """One state, or one rate."""
    return float(x[STATES.index(name)])
