"""The controller of a crane's tip: what it knows of the arm, its gains, the starts of paths.

The tip is the end of the driven arm, where the first passive joint is, or the place of the payload. The arm
is what is driven between the slewing joint and the tip: cylinders in one plane, two or more. More than two
can give the tip a velocity in many ways. Of these the one that needs least oil,

    W_i = (A_i J_i)^2        A_i J_i: oil per motion of the joint, the mean of both sides

and it leads each piston to the middle of its stroke: by `centring` times the speed of the tip if it is at an
end, proportional to the distance between, as far as this does not move the tip (`Arm.joint_speeds`).

Gains follow from the lowest mode of the axes (`fmus.crane.check`) as those of the harvester do; see the notes
in fmus/controller/parameters.toml.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.components.chamber import BulkModulus, Liquid
from fmus.components.cylinder import areas
from fmus.components.hose import ReferenceHose
from fmus.components.mechanics import Point
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Quantity, Scalar, Subsystem, column, make_group, nested, quantities
from fmus.controller.arm import Arm, Choice, ControlledAxis, Coordinates, Cylindrical, Pistons
from fmus.controller.harvester import (
    COUNTER,
    cylinder_actuator,
    cylinder_sides,
    line_sides,
    motor_actuator,
    section_flows,
)
from fmus.controller.model import FILE, controller_of, start_pressures
from fmus.controller.valve import Actuator
from fmus.controller.variables import parameters
from fmus.crane.check import check
from fmus.crane.description import CraneDescription, JointDescription
from fmus.crane.manipulator import TEXTS, crane_tip, numbers_of
from fmus.drives import cylinder, motor
from fmus.joints import Mechanics
from fmus.machine.machine import Machine
from fmus.machine.poses import outputs_at_start
from fmus.parameters import Number, numbers, read, values
from fmus.smooth import positive
from orchestrator.base.errors import Problem
from orchestrator.ssp.system import Component

NEEDED = (
    "the controller needs a slewing joint with a motor about z first, then cylinders in the plane of the arm"
)
KINEMATIC = ("at", "base", "pin", "pivot", "link")  # vectors of a joint, and what else the arm's geometry has
LENGTHS = ("closed_length", "rocker", "coupler", "ratio")
NEAR = 0.05  # of a stroke: distance from an end over which a joint grows heavy
STRETCHED = 25  # square of the trace over the determinant that counts as 1: of two equal links, near a line
CENTRING = 0.3  # 1
SLOW = 1e-4  # m/s: rounds the speed of the tip at rest
LEAST_SHARE = 1e-3  # of the weight of a joint in that of all: keeps the quotients finite at a small lever
TURNS = 1e-3  # 1/s2: square of the frequency below which a passive joint turns freely, as a rotator
STEPS, LARGEST_STEP, CLOSE = 500, 0.1, 1e-9  # of the search for a pose; m, m


class Centring(Group):
    """Of an arm with more joints than the plane needs."""

    centring: Scalar = Quantity(
        "1",
        "Speed of a piston at an end of its stroke towards the middle, over that of the tip",
        0.1,
        minimum=0.0,
        group="Reference",
    )


def controlled(crane: CraneDescription) -> tuple[JointDescription, ...]:
    """The joints that the controller moves, the slewing joint first; a Problem if it cannot."""
    way, end = crane.arm
    slew, *others = way
    moved = [j for j in others if not j.follows]
    sideways = {j.name for j in (*way[1:], end) if j and j["at_y"] != 0}
    sideways |= {"payload"} if end is None and crane.numbers["payload"]["tip_y"].value else set()
    rules = {
        f"[{slew.name}] drive {slew.drive}, axis {slew.axis}": (slew.drive, slew.axis) == ("motor", "z"),
        f"{len(moved)} cylinders in the arm": len(moved) > 1,
        f"[{', '.join(sorted(sideways))}] at is not in its plane": not sideways,
    }
    for j in others:
        rules[f"[{j.name}] axis {j.axis}"] = j.axis[-1] in ("y" if j.kind == "revolute" else "xz")
    for found, kept in rules.items():
        if not kept:
            raise Problem(f"{crane.file}: {NEEDED}, got {found}")
    return (slew, *moved)


class CraneArm(Arm):
    """A crane as its controller knows it."""

    def __init__(self, crane: CraneDescription, manipulator: Subsystem) -> None:
        self.of: Mechanics = manipulator.model
        self.crane, self.joints = crane, controlled(crane)
        known = {n: x.value for n, x in numbers(manipulator)["parameters"].items()}
        self.constants = nested(self.of.parameters, known)
        self.axes = tuple(map(_axis, self.joints))
        self.parameters = (Liquid, BulkModulus, ReferenceHose, self._group())

    def _group(self) -> type[Group]:
        """Geometry of all joints up to the tip, actuators and valves of the driven ones, place of the tip."""
        way, end = self.crane.arm
        groups = {}
        for j in (*way, *([end] if end else [])):
            found = _geometry(j, ("at",) if j is end else KINEMATIC)
            if j.drive == "motor" and j in self.joints:
                groups[j.name] = make_group(
                    "Motor", found, motor.MotorSize, line=(motor.VolumeLine, "{} line"), valve=Valve
                )
            elif j in self.joints:
                groups[j.name] = make_group("Cylinder", found, cylinder.VolumeDrive, valve=Valve)
            else:
                groups[j.name] = make_group("Joint", found)
        tip = (
            {}
            if end
            else {n: q for n, q in quantities(self.of.parameters).items() if n.startswith("tip_at_")}
        )
        more = len(self.joints) > 3
        return make_group("Arm", tip, *([Centring] if more else []), **groups)

    def _known(self, p: Any) -> Any:
        """Parameters of the manipulator: the controller's, else those of the description."""
        found = dict(vars(self.constants))
        for name, value in found.items():
            given = getattr(p, name, None)
            if given is not None:
                own = vars(given) if isinstance(value, Group) else None
                found[name] = SimpleNamespace(**{**vars(value), **own}) if own is not None else given
        return SimpleNamespace(**found)

    def _full(self, q: Coordinates) -> ca.SX:
        """Coordinates of all joints, the column and those behind the tip at 0."""
        moved = dict(zip((j.name for j in self.joints[1:]), q[1:], strict=True))
        full: ca.SX = column(*(moved.get(j.name, 0) for j in self.of.free))
        return full

    # ---- what an arm is

    def point(self, q: Coordinates, p: Any) -> Point:
        """Distance of the crane tip from the slewing axis, and its height."""
        known = self._known(p)
        x, _, z = ca.vertsplit(self.of.chain(known).position(self._full(q), *crane_tip(self.crane, known)))
        return x - getattr(getattr(p, self.joints[0].name), "at_x", 0), z

    def columns(self, q: Coordinates, p: Any) -> list[Point]:
        """Of the joints of the arm."""
        known, full, found = self._known(p), self._full(q), list[Point]()
        chain = self.of.chain(known)
        for j in self.joints[1:]:
            unit = ca.SX(len(self.of.free), 1)
            unit[self.of.index(j.name)] = 1
            x, _, z = ca.vertsplit(chain.velocity(full, unit, *crane_tip(self.crane, known)))
            found.append((x, z))
        return found

    def choice(self, columns: Sequence[Point], q: Coordinates, velocity: Cylindrical, p: Any, /) -> Choice:
        """Least oil, and pistons towards the middle of their strokes."""
        pistons, weights = self.pistons(q, p)[1:], list[Scalar]()
        for j, (_, lever) in zip(self.joints[1:], pistons, strict=True):
            weights.append((sum(getattr(p, j.name).areas) / 2 * lever) ** 2)
        whole = sum(weights)
        weights = [w / whole + LEAST_SHARE for w in weights]
        for k, (j, (x, _)) in enumerate(zip(self.joints[1:], pistons, strict=True)):
            stroke = getattr(p, j.name).stroke
            room = positive(ca.fmin(x, stroke - x) - p.stroke_margin, p.stroke_margin / 10)
            weights[k] *= 1 + (NEAR * stroke / room) ** 2
        trace = sum((x**2 + z**2) / w for (x, z), w in zip(columns, weights, strict=True))
        wish = list[Scalar]()
        if len(weights) > 2:
            speed = p.centring * (ca.sqrt(velocity.radius**2 + velocity.height**2 + SLOW**2) - SLOW)
            for j, (x, lever) in zip(self.joints[1:], pistons, strict=True):
                wish.append(speed * (1 - 2 * x / getattr(p, j.name).stroke) / lever)
        return Choice(trace**2 / STRETCHED, weights, wish)

    def pistons(self, q: Coordinates, p: Any) -> Pistons:
        """Angle of the column; pistons."""
        known = self._known(p)
        found = (self.of.transmission(j.name, x, known) for j, x in zip(self.joints[1:], q[1:], strict=True))
        return [(q[0], 1), *((t.position, t.arm) for t in found)]

    def actuators(self, positions: Sequence[Scalar], p: Any) -> dict[str, Actuator]:
        """Motor and cylinders."""
        slew, found = getattr(p, self.joints[0].name), dict[str, Actuator]()
        flow = getattr(p, f"{self.joints[0].name}_section_flow")
        found[self.joints[0].name] = motor_actuator(slew, slew.valve, p.density, flow, p)
        for j, position in zip(self.joints[1:], positions[1:], strict=True):
            own = getattr(p, j.name)
            found[j.name] = cylinder_actuator(own, position, own.valve, p, section_flows(j.name, p))
        return found

    def valve(self, axis: ControlledAxis, p: Any) -> Valve:
        """Its own."""
        found: Valve = getattr(p, axis.name).valve
        return found

    def derive(self, p: Any) -> dict[str, Scalar]:
        """Hoses and lines by the equations of the drives."""
        found = dict[str, Scalar]()
        for j in self.joints:
            of = motor if j.drive == "motor" else cylinder
            found |= {f"{j.name}_{n}": x for n, x in of.derive(getattr(p, j.name), p).items()}
        return found


def _geometry(joint: JointDescription, vectors: Sequence[str]) -> dict[str, Quantity]:
    """Geometry of a joint that is a parameter of the manipulator."""
    own = numbers_of(joint)
    names = [f"{v}_{n}" for v in vectors for n in "xyz"] + ([*LENGTHS] if len(vectors) > 1 else [])
    return {n: Quantity(own[n].unit, TEXTS[n], group="{}") for n in names if n in own}


def _axis(joint: JointDescription) -> ControlledAxis:
    """A driven joint."""
    name = joint.name
    if joint.drive == "motor":
        angle, speed = (f"{n} of the {name}, {COUNTER}" for n in ("Angle", "Speed"))
        lever, kind, sides = motor.SENSE, "column", line_sides(name)
    else:
        angle, speed = f"Coordinate of the {name} joint", f"Speed of the {name} joint"
        lever, kind, sides = cylinder.SENSE, joint.kind, cylinder_sides(name)
    return ControlledAxis(
        name, kind, lever, (joint.coordinate, angle), (f"{name}_speed", speed), sides, f"{name}_"
    )


# ---- numbers


def gains_of(crane: CraneDescription, arm: CraneArm, pose: Mapping[str, float]) -> dict[str, Number]:
    """Gains as the harvester's, in proportion to the lowest mode w of the axes, and limits of the speeds.

    Pistons: k_p = w/4, g = 2 w/3, k_i = 0.4 k_p^2. Column, of its own mode: k_p = w/4, g = 3 k_p, k_i = 0.2
    k_p^2. The lead is the lag of amplifier and valve.

    pose   outputs of the manipulator at its start
    """
    axes = {a.joint.name: a for a in check(crane, pose)}
    turn, *pistons = (axes[j.name] for j in arm.joints)
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
    """Speed of a motor [rad/s], or of a piston inwards [m/s]: a fully open valve, no load and no friction."""
    pressure, density = crane.numbers["supply"]["pressure_setting"], crane.numbers["oil"]["density"]
    root = values(BOOM_STICK).p["valve_discharge_coefficient"] * joint["valve_area"]
    root *= math.sqrt(2 * pressure.value / density.value)
    if joint.drive == "motor":
        return root / math.sqrt(2) / (joint["motor_displacement"] * joint["gear_ratio"])
    head, rod = map(float, areas(joint["bore"], joint["rod"]))
    return root * math.sqrt(rod / (head**3 + rod**3))


def controller(crane: CraneDescription, machine: Machine) -> Subsystem:
    """The controller of a crane."""
    manipulator = machine.subsystems["manipulator"]
    arm, shipped = CraneArm(crane, manipulator), read(FILE)["parameters"]
    slew, pose = arm.joints[0].name, outputs_at_start(manipulator)
    known = dict[str, Number]()
    for sub in (manipulator, *(s for n, s in machine.subsystems.items() if n != "manipulator")):
        known |= numbers(sub)["parameters"]
    assumed = {n.replace("swing_", f"{slew}_", 1): x for n, x in shipped.items()}
    assumed |= gains_of(crane, arm, pose)
    assumed["nominal_supply_pressure"] = crane.numbers["supply"]["pressure_setting"]
    assumed["centring"] = Number(CENTRING, "1", "assumed", "a third of the speed of the tip at most")
    zero = Number(0.0, "m3/s", "derived", "the valves of the default machine have no compensators")
    found = dict[str, Number]()
    for n in quantities(parameters(arm)):
        if n.startswith("nominal_") and n.endswith("_force"):
            force = pose[n.removeprefix("nominal_")]
            found[n] = Number(force, "N", "derived", "of the manipulator at the start")
        else:
            found[n] = zero if n.endswith("_section_flow") else known.get(n) or assumed[n]
    start = {j.coordinate: known[f"initial_{j.coordinate}"] for j in arm.joints}
    start["supply_pressure"] = crane.numbers["supply"]["pressure_setting"]
    for name, sub in machine.subsystems.items():
        if name != "manipulator":
            at_rest = start_pressures(sub, arm=arm)
            start |= {n: Number(x, "Pa", "derived", "at rest at the start") for n, x in at_rest.items()}
    return controller_of(arm, {"parameters": found, "start": start})


# ---- the start of a path


def start_pose(
    sub: Subsystem, tip: tuple[float, float, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Start values of the manipulator with the crane tip at a place; a Problem if it does not reach there.

    The search begins at the start pose and moves the tip straight to the place, as the controller would.

    sub     controller of the crane
    tip     radius [m], height [m], slewing angle [rad]
    given   parameters of the manipulator that replace those of the description
    """
    arm, v = sub.model.arm, values(sub)
    p = nested(sub.parameters, {**v.p, **given})
    q, want = ca.SX.sym("q", len(arm.axes)), ca.SX.sym("v", 2)
    each = ca.vertsplit(q)
    speeds = arm.joint_speeds(each, Cylindrical(want[0], want[1], 0), p)
    of = ca.Function("of", [q, want], [column(*arm.point(each, p)), column(*speeds)])
    lengths = ca.Function("lengths", [q], [column(*(x for x, _ in arm.pistons(each, p)[1:]))])
    names = [a.coordinate[0] for a in arm.axes]
    at, target = np.array([given.get(f"initial_{n}", v.u[n]) for n in names]), np.array(tip[:2])
    for _ in range(STEPS):
        away = target - of(at, [0, 0])[0].full()[:, 0]
        if math.hypot(*away) < CLOSE:
            break
        at = at + of(at, away * min(1.0, LARGEST_STEP / math.hypot(*away)))[1].full()[:, 0]
    strokes = np.array([getattr(p, j.name).stroke for j in arm.joints[1:]], float)
    room = np.minimum(pistons := lengths(at).full()[:, 0], strokes - pistons)
    place = f"tip at radius {tip[0]:g} m, height {tip[1]:g} m"
    if not math.hypot(*away) < CLOSE:
        raise Problem(f"{place}: out of reach, the search ended {math.hypot(*away):.2g} m away")
    if ended := [j.name for j, r in zip(arm.joints[1:], room, strict=True) if not r > 0]:
        raise Problem(f"{place}: the stroke of {', '.join(ended)} ends before")
    return {f"manipulator.initial_{n}": float(x) for n, x in zip(names, (tip[2], *at[1:]), strict=True)}


def hanging_sway(sub: Subsystem, component: Component) -> tuple[float, float] | None:
    """Mean period [s] and damping ratio of the passive joints at rest in the start pose; None: none swings.

    sub         manipulator of the crane
    component   it in a system, with its parameters and payload
    """
    of: Mechanics = sub.model
    own, v, free = component.real_parameters(), values(sub), of.free
    p = nested(of.parameters, {n: own.get(n, x) for n, x in v.p.items()})
    hanging = [k for k, j in enumerate(free) if j.rests and j.link(p).joint == "revolute"]
    if not hanging:
        return None
    held = float(component.value("payload_mass"))
    q, at = ca.SX.sym("q", len(free)), [getattr(p, f"initial_{j.coordinate}") for j in free]
    motion = of.chain(p).equations(q, ca.SX.zeros(len(free)), of.payload(held, p))
    terms = ca.Function("terms", [q], [motion.mass, ca.jacobian(motion.gravity, q)])
    rest = ca.Function("rest", [q], [of.at_rest(q, held, p)])(at)
    mass, stiffness = (m.full()[np.ix_(hanging, hanging)] for m in terms(rest))
    joints = [vars(getattr(p, free[k].name)) for k in hanging]
    springs, losses = (np.diag([j.get(n, 0.0) for j in joints]) for n in ("stiffness", "damping"))
    squares, modes = np.linalg.eig(np.linalg.solve(mass, stiffness + springs))
    found = [
        (2 * math.pi / math.sqrt(w), m @ losses @ m / (2 * math.sqrt(w) * (m @ mass @ m)))
        for w, m in zip(squares, modes.T, strict=True)
        if w > TURNS
    ]
    period, ratio = np.mean(found or [(0.0, 1.0)], axis=0)
    return (float(period), float(ratio)) if ratio < 1 else None
