"""Initial poses of the machine: joint angles, and the start values with which all FMUs are at rest."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, Symbolic, quantities, symbolic
from fmus.controller.harvester import ARM
from fmus.controller.model import start_pressures
from fmus.controller.paths import PATHS, start, start_angles
from fmus.manipulator import MANIPULATOR
from fmus.operator_input import OPERATOR
from fmus.operator_input.work_cycle import PROGRAMS, program
from fmus.parameters import values

JOINTS = ("boom", "stick")


@dataclass(frozen=True)
class Pose:
    """Joint angles [rad] with the signs of the manipulator."""

    boom: float
    stick: float
    swing: float = 0.0


# range of joint angles [rad] of the work space; the strokes allow slightly more
WORK_SPACE: Mapping[str, tuple[float, float]] = {"boom_angle": (-0.45, 1.0), "stick_angle": (-2.15, -0.6)}


def pose_grid(count: int = 9) -> Iterator[tuple[float, float]]:
    """A grid of count x count poses (boom angle, stick angle) [rad] over the work space."""
    for boom in np.linspace(*WORK_SPACE["boom_angle"], count):
        for stick in np.linspace(*WORK_SPACE["stick_angle"], count):
            yield float(boom), float(stick)


def parameter(joint: str) -> str:
    """Name of the manipulator's parameter for the initial angle of a joint."""
    return f"initial_{joint}_angle"


_PARAMETERS = values(MANIPULATOR).p
NOMINAL = "nominal"
POSES: Mapping[str, Pose] = {
    NOMINAL: Pose(*(_PARAMETERS[parameter(joint)] for joint in (*JOINTS, "swing"))),
    "reach": Pose(0.05, -0.65),  # arm out, head near the ground at 5.8 m
    "folded": Pose(0.7, -2.1),  # stick under the raised boom, head 2.8 m out: pose for driving between trees
    "close": Pose(-0.2, -2.0),  # head near the ground, 1.7 m from the column
    "raised": Pose(0.95, -1.0),  # boom up, head 4.3 m high
}


def outputs_at_start(
    sub: Subsystem, payload: float = 0.0, known: Symbolic | None = None, **parameters: float
) -> Mapping[str, float]:
    """Outputs of a manipulator at its start pose with a payload [kg], and other values of parameters.

    known   its expressions, if they are
    """
    model, v = known or symbolic(sub), values(sub)
    u, p = list({**v.u, "payload_mass": payload}.values()), list({**v.p, **parameters}.values())
    y = model.function()(model.initial()(list(v.x.values()), u, p), u, p)[1].full()[:, 0]
    return dict(zip(quantities(sub.outputs), map(float, y), strict=True))


def pose_set(pose: Pose, manipulator: Subsystem = MANIPULATOR) -> dict[str, float]:
    """Parameters and start values of a pose by `component.variable`.

    Start values of connected inputs are for tools that do not propagate values at initialisation. Piston
    positions are x(q) and holding forces G(q) / J, from the equations of the manipulator.
    """
    angles = {parameter(joint): getattr(pose, joint) for joint in ("swing", *JOINTS)}
    y = outputs_at_start(manipulator, **angles)
    result = {f"manipulator.{name}": angle for name, angle in angles.items()}
    for joint in JOINTS:
        force = y[f"{joint}_holding_force"]
        result |= {
            f"manipulator.{joint}_force": force,
            f"boom_stick.{joint}_position": y[f"{joint}_position"],
            f"boom_stick.{joint}_holding_force": force,
        }
    return result


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Parameter sets by name, values by "component.variable": poses, programs of the operator."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets


def controlled_poses(manipulator: Subsystem = MANIPULATOR) -> dict[str, Pose]:
    """Poses by name, and the pose at the start of each path by its name."""
    p, found = values(manipulator).p, dict(POSES)
    for name, path in PATHS.items():
        at = start_angles(name, start(path), p)
        found[name] = Pose(*(at[f"manipulator.{parameter(joint)}"] for joint in (*JOINTS, "swing")))
    return found


def controller_set(
    pose: Pose, manipulator: Subsystem = MANIPULATOR, boom_stick: Subsystem = BOOM_STICK
) -> dict[str, float]:
    """`pose_set` and the start values of the controller's measured inputs."""
    result = pose_set(pose, manipulator)
    inputs = {n.partition(".")[2]: v for n, v in result.items() if n.startswith(f"{boom_stick.component}.")}
    measured = {"swing_angle": pose.swing, "boom_angle": pose.boom, "stick_angle": pose.stick}
    measured |= start_pressures(ARM, boom_stick, inputs)
    return result | {f"controller.{n}": value for n, value in measured.items()}
