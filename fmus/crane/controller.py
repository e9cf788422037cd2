"""The controller of a crane's tip: what it knows of the arm, and its gains.

The tip is the end of the driven arm, where the first passive joint is, or the place of the payload. The arm
is what is driven between the slewing joint and the tip: cylinders in one plane, two or more.

Gains follow from the lowest mode of the axes (`fmus.crane.check`) as those of the harvester do; see the notes
in fmus/controller/parameters.toml.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from fmus.boom_stick import BOOM_STICK
from fmus.components.chamber import BulkModulus, Liquid
from fmus.components.cylinder import areas
from fmus.components.hose import ReferenceHose
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, quantities
from fmus.controller.arm import COUNTER, Arm, Centring, ControlledAxis
from fmus.controller.model import FILE, controller_of, controller_tables
from fmus.crane.axes import axes_of
from fmus.crane.description import CraneDescription, JointDescription
from fmus.crane.manipulator import TEXTS, crane_tip, joint_model, numbers_of
from fmus.drives import cylinder, motor
from fmus.machine.machine import Machine
from fmus.machine.poses import outputs_at_start
from fmus.parameters import Number, read, values
from orchestrator.base.errors import Problem

NEEDED = (
    "the controller needs a slewing joint with a motor about z first, then cylinders in the plane of the arm"
)
PLACE = ("at_x", "at_y", "at_z")
GEOMETRY = (  # numbers of a joint that place the tip and the pistons
    *PLACE,
    *(f"{pin}_{n}" for pin in ("base", "pin", "pivot", "link") for n in "xz"),
    *("closed_length", "rocker", "coupler", "ratio", "offset", "follows_from", "follows_to"),
)
CENTRING = 0.3  # 1


def controlled(crane: CraneDescription) -> tuple[JointDescription, ...]:
    """The joints that the controller moves, the slewing joint first; a Problem if it cannot."""
    slew, *others = crane.arm[0]
    moved = [j for j in others if not j.follows]
    rules = {
        f"[{slew.name}] drive {slew.drive}, axis {slew.axis}": (slew.drive, slew.axis) == ("motor", "z"),
        f"{len(moved)} cylinders in the arm": len(moved) > 1,
    }
    for j in others:
        rules[f"[{j.name}] axis {j.axis}"] = j.axis[-1] in ("y" if j.kind == "revolute" else "xz")
        rules[f"[{j.name}] follows {j.follows}"] = j.follows in ("", *(other.name for other in moved))
    for found, kept in rules.items():
        if not kept:
            raise Problem(f"{crane.file}: {NEEDED}, got {found}")
    return (slew, *moved)


def crane_arm(crane: CraneDescription, manipulator: Subsystem) -> Arm:
    """A crane as its controller knows it; a Problem if it cannot control it."""
    joints, (way, _) = controlled(crane), crane.arm
    return Arm(
        tuple(map(_axis, joints)),
        (Liquid, BulkModulus, ReferenceHose, _group(crane, joints, manipulator)),
        tuple(joint_model(way, j) for j in way),
        partial(crane_tip, crane),
        _hydraulics,
    )


def _hydraulics(axis: str, p: Any) -> tuple[Valve, Scalar]:
    """Each axis has a valve of its own; density of the oil."""
    return getattr(p, axis).valve, p.density


def _group(
    crane: CraneDescription, joints: Sequence[JointDescription], manipulator: Subsystem
) -> type[Group]:
    """Geometry of all joints up to the tip, actuators and valves of the driven ones, place of the tip."""
    (way, end), groups = crane.arm, dict[str, Any]()
    for j in way:
        found = _geometry(j, GEOMETRY)
        if j not in joints:
            groups[j.name] = make_group("Joint", found)
        elif j.motor:
            line = (motor.VolumeLine, "{} line")
            groups[j.name] = make_group("Motor", found, motor.MotorSize, line=line, valve=Valve)
        else:
            groups[j.name] = make_group("Cylinder", found, cylinder.VolumeDrive, valve=Valve)
    tip = dict[str, Quantity]()
    if end:
        groups[end.name] = make_group("Joint", _geometry(end, PLACE))
    else:
        declared = quantities(manipulator.parameters)
        tip = {n: declared[n] for n in ("tip_at_x", "tip_at_y", "tip_at_z")}
    return make_group("Arm", tip, *([Centring] if len(joints) > 3 else []), **groups)


def _geometry(joint: JointDescription, names: Sequence[str]) -> dict[str, Quantity]:
    """Geometry of a joint that is a parameter of the manipulator."""
    own = numbers_of(joint)
    return {n: Quantity(own[n].unit, TEXTS[n], group="{}") for n in names if n in own}


def _axis(joint: JointDescription) -> ControlledAxis:
    """A driven joint."""
    name, kind, lever = joint.name, str(joint.kind), cylinder.SENSE
    angle, speed = f"Coordinate of the {name} joint", f"Speed of the {name} joint"
    if joint.motor:
        kind, lever = "column", motor.SENSE
        angle, speed = (f"{n} of the {name}, {COUNTER}" for n in ("Angle", "Speed"))
    return ControlledAxis(name, kind, lever, (joint.coordinate, angle), (f"{name}_speed", speed))


# ---- numbers


def gains_of(crane: CraneDescription, arm: Arm, pose: Mapping[str, float]) -> dict[str, Number]:
    """Gains as the harvester's, in proportion to the lowest mode w of the axes, and limits of the speeds.

    Pistons: k_p = w/4, g = 2 w/3, k_i = 0.4 k_p^2. Column, of its own mode: k_p = w/4, g = 3 k_p, k_i = 0.2
    k_p^2. The lead is the lag of amplifier and valve.

    pose   outputs of the manipulator at its start
    """
    axes = {a.joint.name: a for a in axes_of(crane, pose)}
    turn, *pistons = (axes[a.name] for a in arm.axes)
    low, own = (2 * math.pi * f for f in (min(a.mode for a in pistons), turn.mode))
    name, k, of_column = turn.joint.name, low / 4, own / 4
    found = {
        "piston_position_gain": (k, "1/s"),
        "piston_integral_gain": (0.4 * k**2, "1/s2"),
        "piston_damping_rate": (2 / 3 * low, "1/s"),
        f"{name}_position_gain": (of_column, "1/s"),
        f"{name}_integral_gain": (0.2 * of_column**2, "1/s2"),
        f"{name}_damping_rate": (3 * of_column, "1/s"),
        f"{name}_speed_limit": (_unloaded(crane, turn.joint) / 2, "rad/s"),
    }
    for a in pistons:
        found[f"{a.joint.name}_speed_limit"] = (_unloaded(crane, a.joint) / 2, "m/s")
    note = "of the modes and the speeds of the axes, as those of the harvester"
    return {n: Number(x, unit, "derived", note) for n, (x, unit) in found.items()}


def _unloaded(crane: CraneDescription, joint: JointDescription) -> float:
    """Speed of a motor [rad/s], or the lower one of a piston [m/s]: open valve, no load and no friction.

    v^2 (in^3/a_in^2 + out^3/a_out^2) = C^2 2 p/rho in: areas of the side that is filled, of the one that is
    emptied, and a of their edges.
    """
    pressure, density = crane.numbers["supply"]["pressure_setting"], crane.numbers["oil"]["density"]
    jet = values(BOOM_STICK).p["valve_discharge_coefficient"] * math.sqrt(2 * pressure.value / density.value)
    if joint.motor:
        turn = joint["motor_displacement"] * joint["gear_ratio"]
        return jet * joint["valve_area"] / math.sqrt(2) / turn
    head, rod = map(float, areas(joint["bore"], joint["rod"]))
    a = {edge: x.value for edge, x in joint.edges.items()}
    ways = ((rod, a["pb"], head, a["at"]), (head, a["pa"], rod, a["bt"]))
    return jet * min(math.sqrt(i / (i**3 / a_in**2 + o**3 / a_out**2)) for i, a_in, o, a_out in ways)


def controller(crane: CraneDescription, machine: Machine) -> Subsystem:
    """The controller of a crane."""
    manipulator = machine.subsystems["manipulator"]
    arm, pose = crane_arm(crane, manipulator), outputs_at_start(manipulator)
    turn, *pistons = (a.name for a in arm.axes)
    own = {n.replace("swing_", f"{turn}_", 1): x for n, x in read(FILE)["parameters"].items()}
    own |= gains_of(crane, arm, pose)
    own["centring"] = Number(CENTRING, "1", "assumed", "a third of the speed of the tip at most")
    none = Number(0.0, "m3/s", "derived", "the valves of the default machine have no compensators")
    own |= {f"{n}_section_flow": none for n in (turn, *pistons, *(f"{n}_rod" for n in pistons))}
    for n in (f"{n}_holding_force" for n in pistons):
        own[f"nominal_{n}"] = Number(pose[n], "N", "derived", "of the manipulator at the start")
    drives = (s for n, s in machine.subsystems.items() if n != "manipulator")
    return controller_of(arm, controller_tables(arm, (manipulator, *drives), own))
