"""The controller's equations as functions of numbers, for its tests."""

import numpy as np

from fmus.controller.model import CONTROLLER
from fmus.parameters import values
from kit.equations import Part

# valves without hysteresis, and a controller that knows it
IDEAL = {"valve_actuation.hysteresis": 0.0, "controller.hysteresis": 0.0}
V, PART = values(CONTROLLER), Part(CONTROLLER)
STATES, INPUTS, OUTPUTS = PART.states, PART.inputs, PART.outputs


def measured(boom: float, stick: float, **given: float) -> dict[str, float]:
    """Inputs of a machine at rest in a pose, engaged."""
    return {**V.u, "boom_angle": boom, "stick_angle": stick, "engaged": 1.0, **given}


def rates(x: np.ndarray, u: dict[str, float], **p: float) -> np.ndarray:
    """dx/dt."""
    return PART.function(x, list(u.values()), list((V.p | p).values()))[0].full()[:, 0]


def at(x: np.ndarray, name: str) -> float:
    """One state, or one rate."""
    return float(x[PART.at(name)])
