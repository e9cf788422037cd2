"""The manipulator of a crane: the joints of its description as data for `fmus.joints`.

The payload is a point mass, or a slender bar. Passive joints start at rest, whatever the slope. Numbers of
the description are parameters, except zeros: these are structure, so that a crane in one plane has the
equations of a plane one.

Validity: rigid links, viscous friction, the pins of a cylinder in the plane of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.chain import Link, Payload, Vector, gravity_on_slope
from fmus.components.linkage import Cylinder, Drive, FourBar, Telescope, direction, length
from fmus.components.mechanics import Point
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, nested, quantities
from fmus.crane.description import (
    INERTIA,
    OF_JOINT,
    TABLES,
    UNITS,
    CraneDescription,
    JointDescription,
)
from fmus.diagnosis.unknowns import masses_of
from fmus.joints import BARS, JointModel, Mechanics
from fmus.manipulator import MANIPULATOR, VARIANTS
from fmus.manipulator.friction import (
    FrictionParameters,
    JointBristles,
    JointContact,
    JointLaw,
    PistonBristles,
    PistonContact,
    PistonLaw,
    resist,
)
from fmus.manipulator.pendulum import STOP_ROUNDING
from fmus.manipulator.variables import (
    CylinderInputs,
    CylinderOutputs,
    ManipulatorInputs,
    ManipulatorOutputs,
    ManipulatorParameters,
    ManipulatorState,
)
from fmus.parameters import Number, Tables, complete, numbers
from fmus.smooth import lowest, ramp

NAME = "manipulator"
TIP_FORCE = {
    f"tip_force_{n}": Quantity("N", f"External force on the tip, {text}", 1e3)
    for n, text in (("x", "forward"), ("y", "to the left"), ("z", "upwards"))
}
SHARED = (  # with the values of the paper's machine
    *("gravity", "payload_grip_time", "stop_stiffness", "stop_damping", "stop_rounding"),
)
SHOWN = (
    *("tip_x", "tip_y", "tip_radius", "tip_height"),
    *("stop_energy", "kinetic_energy", "potential_energy", "dissipated_power", "payload_power"),
)


class MotorInputs(Group):
    """Torque of a motor; the rate input carries its exact time derivative."""

    torque: Scalar = Quantity("N.m", "Torque of the drive on the {}", 1e4, rate="torque_rate")
    torque_rate: Scalar = ports.rate_input("{}_torque", "N.m/s", 1e5)


def _of(group: type[Any], *names: str) -> dict[str, Quantity]:
    declared = quantities(group)
    return {n: declared[n] for n in names}


class Dry(
    Group,
    joint=(JointLaw, "joints", "dry_joint_{}".format),
    piston=(PistonLaw, "pistons", "dry_piston_{}".format),
):
    """Shape of the dry friction of all joints and pistons that have some."""

    bristle_damping_time: Scalar = quantities(FrictionParameters)["bristle_damping_time"]


# kind of a joint -> number -> name of its contact, its parameter, its state, the output of its friction
PISTON = ("piston", PistonContact, PistonBristles, "force", "N")
CONTACTS: Mapping[str, Mapping[str, tuple[str, type[Group], type[Group], str, str]]] = {
    "revolute": {
        "coulomb": ("joint", JointContact, JointBristles, "torque", "N.m"),
        "piston_coulomb": PISTON,
    },
    "prismatic": {
        "coulomb": ("joint", PistonContact, PistonBristles, "joint_force", "N"),
        "piston_coulomb": PISTON,
    },
}
SOFT = 0.02  # m or rad, over which a stage in a sequence begins and ends its motion
MASSES = ("barrel_mass", "rod_mass", "rocker_mass", "coupler_mass")


def contacts(joint: JointDescription) -> tuple[str, str]:
    """Names of those with dry friction: of the joint and of its piston, "" without."""
    rubs = (n in joint.numbers and joint[n] > 0 for n in CONTACTS[joint.kind])
    names = (f"{joint.name}_{c[0]}" for c in CONTACTS[joint.kind].values())
    of_joint, of_piston = (name * yes for name, yes in zip(names, rubs, strict=True))
    return of_joint, of_piston


TEXTS = {n: q.text for n, q in OF_JOINT["revolute"].items()}


def numbers_of(joint: JointDescription) -> dict[str, Number]:
    """Numbers of a joint that are parameters of the manipulator; zeros are structure."""
    others = {*CONTACTS[joint.kind]} | ({"ratio"} if not joint.follows else set())
    known = OF_JOINT[joint.kind].keys() - others
    return {n: x for n, x in joint.numbers.items() if n in known and x.value != 0}


def joint_model(joints: Sequence[JointDescription], j: JointDescription) -> JointModel:
    """A joint of a description, in a chain of these joints."""
    own, names = numbers_of(j), [joint.name for joint in joints]
    nothing = dict.fromkeys(OF_JOINT[j.kind], 0)

    def of(p: Any) -> Any:
        """Its parameters, 0 where it has none; a controller has the geometry only."""
        given = vars(getattr(p, j.name))
        return SimpleNamespace(**{**nothing, **{n: given[n] for n in own if n in given}})

    def moved(o: Any, q: Scalar) -> Scalar:
        """The way of the joint that it follows, from and up to where a stage in a sequence moves with it."""
        way = lowest(q, o.follows_to, SOFT) if "follows_to" in j.numbers else q
        return ramp(way - o.follows_from + SOFT / 2, SOFT) if "follows_from" in j.numbers else way

    def link(p: Any) -> Link:
        o = of(p)
        return Link(
            name=j.name,
            joint=j.kind,
            axis=j.axis,
            at=(o.at_x, o.at_y, o.at_z),
            parent=names.index(j.parent) if j.parent else None,
            follows=names.index(j.follows) if j.follows else None,
            law=(lambda q: o.ratio * moved(o, q) + o.offset) if j.follows else (lambda q: q),
        )

    def body(p: Any) -> dict[str, Any]:
        o = of(p)
        centre = o.centre_x, o.centre_y, o.centre_z
        return {"mass": o.mass, "centre": centre, "inertia": [getattr(o, n) for n in INERTIA]}

    u, v, side = j.plane

    def linkage(p: Any) -> Cylinder | FourBar:
        o = of(p)

        def pin(name: str) -> Point:
            x, y = getattr(o, f"{name}_{u}"), getattr(o, f"{name}_{v}")
            return x, y if side > 0 else -y

        if j.four_bar:
            rod = (o.rod_x, o.rod_z) if {"rod_x", "rod_z"} & own.keys() else None
            lengths = (o.rocker, o.coupler, pin("link"), j.assembly, rod)
            return FourBar(pin("base"), o.closed_length, pin("pivot"), *lengths)
        return Cylinder(pin("base"), pin("pin"), o.closed_length)

    def drive(p: Any) -> Drive:
        return linkage(p) if j.revolute else Telescope()

    def carried(p: Any, first: int) -> list[Link]:
        """Barrel and rod, rocker and coupler, as far as they have masses: slender bars from pin to pin."""
        links, o, of_joint = list[Link](), of(p), names.index(j.name)
        if not own.keys() & {*MASSES}:
            return links
        cylinder, carrier = linkage(p), names.index(j.parent) if j.parent else None

        def vector(along: Scalar, across: Scalar) -> Vector:
            in_plane: dict[str, Scalar] = {u: along, v: across if side > 0 else -across}
            x, y, z = (in_plane.get(n, 0) for n in "xyz")
            return x, y, z

        def bar(
            name: str,
            pin: Point,
            mass: Scalar,
            long: Scalar,
            law: Callable[[Scalar], Scalar],
            on: int | None = None,
            slides: bool = False,
        ) -> None:
            """One bar; on: the bar that carries it; None: the link that carries the joint."""
            joint = (0, 0, 0) if on is not None else (o.at_x, o.at_y, o.at_z)
            x, y, z = (a + b for a, b in zip(joint, vector(*pin), strict=True))
            link = Link(
                name=f"{j.name}_{name}",
                joint="prismatic" if slides else "revolute",
                axis=u if slides else j.axis,
                at=(x, y, z),
                parent=carrier if on is None else on,
                mass=mass,
                centre=vector(long / 2, 0),
                inertia="bar",
                follows=of_joint,
                law=law,
            )
            links.append(link)

        if {"barrel_mass", "rod_mass"} & own.keys():
            bar("barrel", cylinder.base, o.barrel_mass, o.closed_length, partial(direction, cylinder))
            bar("rod", (0, 0), o.rod_mass, -o.closed_length, partial(length, cylinder), on=first, slides=True)
        if {"rocker_mass", "coupler_mass"} & own.keys() and isinstance(cylinder, FourBar):
            bars, parent = cylinder, first + len(links)
            bar("rocker", bars.pivot, o.rocker_mass, o.rocker, lambda q: bars.angles(q)[0])

            def fold(q: Scalar) -> Scalar:
                rocker, coupler = bars.angles(q)
                return coupler - rocker

            bar("coupler", (o.rocker, 0), o.coupler_mass, o.coupler, fold, on=parent)
        return links

    def stop(p: Any) -> tuple[Scalar, ...]:
        o = of(p)
        low = o.stop_from if "stop_from" in j.numbers else -o.stop_at
        return low, o.stop_at, o.stop_stiffness, o.stop_damping, STOP_ROUNDING

    model = JointModel(
        name=j.name,
        coordinate=j.coordinate,
        link=link,
        body=body,
        damping=lambda p: of(p).damping,
        stiffness=(lambda p: of(p).stiffness) if "stiffness" in own else None,
        motor=j.motor,
        drive=drive if j.cylinder else None,
        piston=(lambda p: (of(p).stroke, of(p).piston_damping)) if j.cylinder else None,
        stop=stop if "stop_at" in j.numbers else None,
        stop_shown=f"{j.name}_stop_torque",
        contacts=contacts(j),
        rubs=("torque" if j.revolute else "joint_force", "force"),
        bars=carried,
        follows=bool(j.follows),
        rests=not j.follows and not j.driven and (j.revolute or "stiffness" in own),
    )
    if not j.cylinder:
        return model
    at_start = drive(SimpleNamespace(**{j.name: SimpleNamespace(**{n: x.value for n, x in own.items()})}))
    return replace(model, lever=-1.0 if float(at_start.at(j.start.value).arm) < 0 else 1.0)


def crane_tip(crane: CraneDescription, p: Any) -> Vector:
    """Place of the crane tip in the frame of the last link before it."""
    way, end = crane.arm
    return joint_model((*way, end), end).link(p).at if end else (p.tip_at_x, p.tip_at_y, p.tip_at_z)


def _slew(crane: CraneDescription) -> JointDescription:
    """The first driven joint of the arm, or its first joint."""
    return next((j for j in crane.arm[0] if j.driven), crane.arm[0][0])


def mechanics(
    crane: CraneDescription, parameters: type[Any], states: type[Any], inputs: type[Any], outputs: type[Any]
) -> Mechanics:
    """The functions of the subsystem with these groups."""
    names, (way, _), slew = [j.name for j in crane.joints], crane.arm, _slew(crane)

    def payload(mass: Scalar, p: Any) -> Payload:
        across = [(n != crane.along) * p.load_length**2 / 12 for n in "xyz"]
        place = (p.tip_at_x, p.tip_at_y, p.tip_at_z)
        return Payload(names.index(crane.payload_on), place, mass, (*across, 0, 0, 0))

    def ground(p: Any) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        return p.ground_height, p.ground_stiffness, p.ground_damping, p.ground_friction

    def views(of: Mechanics, q: ca.SX, _w: ca.SX, _x: Any, p: Any) -> dict[str, Scalar]:
        chain, load = of.chain(p), payload(0, p)
        tip = chain.position(q, load.link, load.at)
        end = chain.position(q, names.index(way[-1].name), crane_tip(crane, p))
        across = (end - chain.position(q, names.index(slew.name)))[:2]
        turned = dict[str, Scalar]()
        if slew.axis == "z":
            k, still = names.index(slew.name), ca.SX(q)
            still[k] = 0
            arm = chain.position(still, names.index(way[-1].name), crane_tip(crane, p))
            x, y = ca.vertsplit((arm - chain.position(still, k))[:2])
            turned["crane_tip_angle"] = q[k] if y.is_zero() else q[k] + ca.atan2(y, x)
        return {
            **turned,
            **{f"tip_{n}": tip[k] for k, n in enumerate("xy")},
            "tip_radius": ca.sqrt(tip[0] ** 2 + tip[1] ** 2),
            "tip_height": tip[2],
            "crane_tip_radius": ca.sqrt(ca.sumsqr(across)),
            "crane_tip_height": end[2],
        }

    return Mechanics(
        joints=tuple(joint_model(crane.joints, j) for j in crane.joints),
        parameters=parameters,
        states=states,
        inputs=inputs,
        outputs=outputs,
        gravity=lambda p: gravity_on_slope(p.gravity, p.base_pitch, p.base_roll),
        payload=payload,
        views=views,
        ground=ground if crane.ground else None,
        stored="elastic_energy",
        dry=resist if any(any(contacts(j)) for j in crane.joints) else None,
        external=True,
    )


def manipulator(crane: CraneDescription) -> Subsystem:
    """The subsystem of a crane."""
    parameters, tables = _parameters(crane)
    free = [j for j in crane.joints if not j.follows]
    pistons, motors = [j for j in free if j.cylinder], [j for j in free if j.motor]
    coordinates = {
        j.coordinate: Quantity(j.start.unit, f"{j.coordinate.partition('_')[2].capitalize()} of the {j.name}")
        for j in crane.joints
    }
    states = dict[str, Quantity]()
    for j in free:
        states[j.coordinate] = coordinates[j.coordinate]
        states[f"{j.name}_speed"] = Quantity(f"{j.start.unit}/s", f"Speed of the {j.name} joint")
    held = _of(ManipulatorState, "held_mass", "payload_flow")
    rubbing = [
        (j, name, c)
        for j in free
        for name, c in zip(contacts(j), CONTACTS[j.kind].values(), strict=True)
        if name
    ]
    bristles = {name: (c[2], f"{j.name} {c[0]}") for j, name, c in rubbing}
    state = make_group("State", {**states, **held}, **bristles)
    inputs = make_group(
        "Inputs",
        _of(ManipulatorInputs, "payload_mass") | TIP_FORCE,
        **{j.name: CylinderInputs for j in pistons},
        **{j.name: MotorInputs for j in motors},
    )
    shown = {f"{j.name}_acceleration": ports.rate_output(f"{j.name}_speed", "rad/s2") for j in motors}
    shown |= {
        f"{j.name}_holding_torque": Quantity("N.m", f"Torque that holds the {j.name} against gravity", 1e4)
        for j in motors
    }
    shown |= {n: q for n, q in coordinates.items() if n not in states}
    shown |= {
        f"{j.name}_{bar}_angle": Quantity("rad", f"Angle of the {bar} of the {j.name} in its parent's frame")
        for j in pistons
        if j.four_bar
        for bar in BARS
    }
    shown |= {
        f"{j.name}_friction_{c[3]}": Quantity(
            c[4], f"Friction of the {j.name} {c[0]}, against its motion", 1e3
        )
        for j, _, c in rubbing
    }
    shown |= {
        f"{j.name}_stop_torque": Quantity(
            UNITS[j.kind][1],
            f"Effort of the end stops of the {j.name} joint: zero except at the ends of its range",
            1e4,
            warn_above=1.0,
            meaning=f"{j.name} reaches the end of its range",
        )
        for j in free
        if "stop_at" in j.numbers
    }
    shown["tip_force_power"] = Quantity("W", "Power of the external force on the tip", 1e3)
    shown["crane_tip_radius"] = Quantity(
        "m", "Distance of the crane tip, the end of the driven arm, from the slewing joint, seen from above"
    )
    shown["crane_tip_height"] = Quantity("m", "Height of the crane tip above the base")
    if _slew(crane).axis == "z":
        shown["crane_tip_angle"] = Quantity(
            "rad", "Angle of the crane tip about the slewing joint, counter-clockwise from above"
        )
    shown["elastic_energy"] = Quantity(
        "J",
        "Elastic energy of springs and friction, of the ground, and of the stops of joints without a drive",
        1e3,
    )
    if crane.ground:
        shown["ground_force"] = Quantity("N", "Normal force of the ground on the tip", 1e4)
    outputs = make_group(
        "Outputs",
        {**states, **held, **shown, **_of(ManipulatorOutputs, *SHOWN)},
        **{j.name: CylinderOutputs for j in pistons},
    )
    of = mechanics(crane, parameters, state, inputs, outputs)
    terminals = (
        *(ports.shaft(j.name, False, "holding_torque") for j in motors),
        *(ports.rod(j.name, drives=False) for j in pistons),
        ports.grip(),
    )
    return Subsystem(
        **of.declared,
        name=NAME,
        text=f"Crane: {crane.title}",
        validity=f"rigid links, {'dry' if rubbing else 'viscous'} friction",
        numbers=tables,
        terminals=terminals,
        stiff=bool(rubbing),
    )


def _parameters(crane: CraneDescription) -> tuple[type[Any], Tables]:
    """The group of the parameters, and their values."""
    shipped = numbers(MANIPULATOR)["parameters"]
    found = {n: shipped[n] for n in SHARED}
    members = _of(ManipulatorParameters, *SHARED)
    for table in ("base", "payload", "ground"):
        declared = {n: q for key in TABLES[table].values() for n, q in key.items() if n != "payload_mass"}
        for n in (n for n in crane.numbers[table] if n in declared):
            name = n.replace("tip_", "tip_at_")
            found[name] = crane.numbers[table][n]
            members[name] = replace(declared[n], group=table.capitalize(), value=None)
    for j in crane.joints:
        if not j.follows:
            name = f"initial_{j.coordinate}"
            found[name] = j.start
            members[name] = Quantity(j.start.unit, f"{j.coordinate} at the start", group="Start pose")
    groups = dict[str, Any]()
    for j in crane.joints:
        own = numbers_of(j)
        declared = {
            n: replace(
                OF_JOINT[j.kind][n], unit=x.unit, nominal=max(abs(x.value), 1e-3), value=None, group="{}"
            )
            for n, x in own.items()
        }
        groups[j.name] = make_group("Joint", declared)
        found |= {f"{j.name}_{n}": x for n, x in own.items()}
    bases: list[type[Group]] = []
    for j in crane.joints:
        for name, (n, c) in zip(contacts(j), CONTACTS[j.kind].items(), strict=True):
            if name:
                groups[name] = (c[1], f"{j.name} {c[0]}")
                found[f"{name}_coulomb"], bases = j.numbers[n], [Dry]
    if bases:
        rubbing = numbers(VARIANTS["friction"])["parameters"]
        found |= {n: rubbing[n.removeprefix("dry_")] for n in quantities(Dry)}
    return make_group("Parameters", members, *bases, **groups), {"parameters": found, "start": {}}


def resting(manipulator: Subsystem) -> tuple[ca.Function, list[str]]:
    """(q) -> q with passive joints in balance, torques of the weight per mass; names of the masses.

    q are coordinates of all joints that follow none, of passive ones a guess. The torques dG/dm have the
    shape (joints, masses), in N.m/kg and N/kg. Nothing is held.
    """
    mechanics: Mechanics = manipulator.model
    known = {n: ca.SX(x.value) for n, x in complete(manipulator)["parameters"].items()}
    names = [n for n in masses_of(manipulator) if not known[n].is_zero()]
    count = len(mechanics.free)
    m, q, s = (ca.SX.sym(n, size) for n, size in (("m", len(names)), ("q", count), ("s", count)))
    p = nested(manipulator.parameters, known)
    own = nested(manipulator.parameters, known | dict(zip(names, ca.vertsplit(m), strict=True)))
    potential = mechanics.chain(own).potential(s, mechanics.payload(ca.SX(0), own))
    at_rest = mechanics.at_rest(q, ca.SX(0), p)
    torques = ca.substitute(ca.jacobian(ca.gradient(potential, s), m), s, at_rest)
    return ca.Function("resting", [q], [ca.densify(at_rest), ca.densify(torques)]), names
