"""The controller's equations as functions of numbers, for its tests."""

import math

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


def arm_angles(radius: float, height: float) -> tuple[float, float]:
    """Boom and stick angle [rad] for the tip at a place [m], the elbow above: by the law of cosines."""
    p = V.p
    x, z = radius - p["boom_pivot_x"], height - p["boom_pivot_z"]
    upper, lower, reach = (
        math.hypot(*sides)
        for sides in ((p["stick_pivot_x"], p["stick_pivot_z"]), (p["stick_length"], 0), (x, z))
    )
    pivot = math.acos((upper**2 + reach**2 - lower**2) / (2 * upper * reach))
    elbow = math.acos((reach**2 - upper**2 - lower**2) / (2 * upper * lower))
    offset = math.atan2(p["stick_pivot_z"], p["stick_pivot_x"])  # of the line boom pivot-elbow in the boom
    return math.atan2(z, x) + pivot - offset, offset - elbow


def at(x: np.ndarray, name: str) -> float:
    """One state, or one rate."""
    return float(x[PART.at(name)])
