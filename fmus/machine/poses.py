"""Poses to start from: joint angles, and what every FMU needs to know to stand still there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities, symbolic
from fmus.controller import geometry
from fmus.controller.paths import PATHS, Route, start
from fmus.controller.values import start_pressures
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values

JOINTS = ("boom", "stick")


@dataclass(frozen=True)
class Pose:
    """Joint angles [rad], as the manipulator counts them."""

    boom: float
    stick: float
    swing: float = 0.0


# joint angles [rad] between which the arm works; the strokes reach a little further
WORK_SPACE: Mapping[str, tuple[float, float]] = {"boom_angle": (-0.45, 1.0), "stick_angle": (-2.15, -0.6)}


def pose_grid(count: int = 9) -> Iterator[tuple[float, float]]:
    """A grid of count x count poses (boom angle, stick angle) [rad] over the work space."""
    for boom in np.linspace(*WORK_SPACE["boom_angle"], count):
        for stick in np.linspace(*WORK_SPACE["stick_angle"], count):
            yield float(boom), float(stick)


def parameter(joint: str) -> str:
    """The manipulator's parameter that holds the angle of a joint at the start."""
    return f"initial_{joint}_angle"


_OWN = values(MANIPULATOR).p
NOMINAL = "nominal"
POSES: Mapping[str, Pose] = {
    NOMINAL: Pose(*(_OWN[parameter(joint)] for joint in (*JOINTS, "swing"))),
    "reach": Pose(0.05, -0.65),  # arm out, head near the ground at 5.8 m
    "folded": Pose(0.7, -2.1),  # stick under the raised boom, head 2.8 m out: to drive between trees
    "close": Pose(-0.2, -2.0),  # head near the ground, 1.7 m beside the column
    "raised": Pose(0.95, -1.0),  # boom up, head 4.3 m high
}


def pose_set(pose: Pose, manipulator: Subsystem = MANIPULATOR) -> dict[str, float]:
    """The parameters of a pose, and inputs for tools that pass nothing on at initialisation.

    Piston positions are x(q) and holding forces G(q) / J, by the manipulator's own equations.
    """
    model, own = symbolic(manipulator), values(manipulator)
    angles = {"swing": pose.swing, "boom": pose.boom, "stick": pose.stick}
    p = {**own.p, **{parameter(joint): angle for joint, angle in angles.items()}}
    x, *known = (list(group.values()) for group in (own.x, own.u, p))
    outputs = model.function()(model.initial()(x, *known), *known)[1].full()[:, 0]
    y = dict(zip(quantities(manipulator.outputs), map(float, outputs), strict=True))
    found = {f"manipulator.{parameter(joint)}": angle for joint, angle in angles.items()}
    for joint in JOINTS:
        force = y[f"{joint}_holding_force"]
        found |= {
            f"manipulator.{joint}_force": force,
            f"boom_stick.{joint}_position": y[f"{joint}_position"],
            f"boom_stick.{joint}_holding_force": force,
        }
    return found


def path_pose(path: Route, manipulator: Subsystem = MANIPULATOR) -> Pose:
    """The pose whose tip is the first point of a path."""
    radius, height, swing = start(path)
    return Pose(*geometry.arm_angles(radius, height, values(manipulator).p), swing)


def controlled_poses(manipulator: Subsystem = MANIPULATOR) -> dict[str, Pose]:
    """The poses by name, and the one at the start of each path."""
    return {**POSES, **{name: path_pose(path, manipulator) for name, path in PATHS.items()}}


def controller_set(
    pose: Pose, manipulator: Subsystem = MANIPULATOR, boom_stick: Subsystem = BOOM_STICK
) -> dict[str, float]:
    """A pose with what the controller measures in it, for tools that pass nothing on at initialisation."""
    found = pose_set(pose, manipulator)
    known = {n.partition(".")[2]: v for n, v in found.items() if n.startswith(f"{boom_stick.component}.")}
    measured = {"swing_angle": pose.swing, "boom_angle": pose.boom, "stick_angle": pose.stick}
    measured |= start_pressures(boom_stick, known)
    return found | {f"controller.{n}": value for n, value in measured.items()}
