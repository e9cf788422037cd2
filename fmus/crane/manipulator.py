"""The manipulator of a crane: the joints of its description as data for `fmus.joints`.

The payload is a point mass, or a slender bar. Passive joints start at rest, whatever the slope. Numbers of
the description are parameters, except zeros: these are structure, so that a crane in one plane has the
equations of a plane one.

Validity: rigid links, viscous friction, the pins of a cylinder in the plane of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.chain import Link, Payload, Vector, gravity_on_slope
from fmus.components.linkage import Cylinder, Drive, FourBar, Telescope
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, quantities
from fmus.crane.description import INERTIAS, CraneDescription, JointDescription
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
from fmus.parameters import Number, Tables, numbers

NAME = "manipulator"
TIP_FORCE = {
    f"tip_force_{n}": Quantity("N", f"External force on the tip, {text}", 1e3)
    for n, text in (("x", "forward"), ("y", "to the left"), ("z", "upwards"))
}
GROUND = {
    "ground_height": "Height of the ground above the base",
    "ground_stiffness": "Stiffness of the ground under the tip",
    "ground_damping": "Contact damping of the ground (Hunt and Crossley)",
    "ground_friction": "Coefficient of friction of the ground",
}
STOPS = ("stop_stiffness", "stop_damping", "stop_rounding")
SHARED = ("gravity", "payload_grip_time", *STOPS)  # with the values of the paper's machine
SHOWN = (
    *("tip_x", "tip_y", "tip_radius", "tip_height"),
    *("stop_energy", "kinetic_energy", "potential_energy", "dissipated_power", "payload_power"),
)
TEXTS = {  # of the parameters of a joint; "{}" is its name
    **{f"at_{n}": f"Place of the {{}} joint in the frame of its parent, {n}" for n in "xyz"},
    "mass": "Mass of the {}",
    **{f"centre_{n}": f"Centre of mass of the {{}} from its joint, {n}" for n in "xyz"},
    **{f"inertia_{n}": f"Moment of inertia {n} of the {{}} about its centre of mass" for n in INERTIAS},
    "damping": "Viscous friction of the {} joint",
    "stiffness": "Stiffness of the spring in the {} joint, which is without force at 0",
    "stop_at": "Position of the {} joint, to both sides of 0, at which its end stops begin",
    "stop_stiffness": "Stiffness of the end stops of the {} joint",
    "stop_damping": "Contact damping of the end stops of the {} joint (Hunt and Crossley)",
    **{f"base_{n}": f"Base pin of the {{}} cylinder from the joint, {n}" for n in "xz"},
    **{f"pin_{n}": f"Rod pin of the {{}} cylinder from the joint, {n}" for n in "xz"},
    "closed_length": "Pin-to-pin length of the closed {} cylinder",
    "stroke": "Stroke of the {} cylinder",
    "piston_damping": "Viscous friction of the {} cylinder's piston",
    **{f"pivot_{n}": f"Pin of the rocker of the {{}} from the joint, {n}" for n in "xz"},
    "rocker": "Length of the rocker of the {}",
    "coupler": "Length of the coupler of the {}",
    **{f"link_{n}": f"Pin of the coupler on the {{}} from the joint, {n}" for n in "xz"},
    "ratio": "Motion of the {} over that of the joint that it follows",
}
MINIMA = {
    "mass": 0.0,
    "damping": 0.0,
    "stiffness": 0.0,
    "stop_at": 1e-3,
    "stop_stiffness": 1.0,
    "stop_damping": 0.0,
    "piston_damping": 0.0,
    "stroke": 1e-3,
    "rocker": 1e-3,
    "coupler": 1e-3,
}


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


# a number of a joint -> name of its contact, its parameter, its state, the output of its friction
CONTACTS = {
    "coulomb": ("joint", JointContact, JointBristles, "torque", "N.m"),
    "piston_coulomb": ("piston", PistonContact, PistonBristles, "force", "N"),
}


def contacts(joint: JointDescription) -> tuple[str, str]:
    """Names of those with dry friction: of the joint and of its piston, "" without."""
    known = (n in joint.numbers and joint[n] > 0 for n in CONTACTS)
    of_joint, of_piston = (f"{joint.name}_{c[0]}" * k for k, c in zip(known, CONTACTS.values(), strict=True))
    return of_joint, of_piston


def numbers_of(joint: JointDescription) -> dict[str, Number]:
    """Numbers of a joint that are parameters of the manipulator; zeros are structure."""
    some = {n: x for n, x in joint.numbers.items() if n in TEXTS and x.value != 0}
    return some | ({"ratio": joint.ratio} if joint.follows else {})


def joint_model(joints: Sequence[JointDescription], j: JointDescription) -> JointModel:
    """A joint of a description, in a chain of these joints."""
    own, names = numbers_of(j), [joint.name for joint in joints]

    def of(p: Any, *some: str) -> tuple[Scalar, ...]:
        return tuple(getattr(getattr(p, j.name), n) if n in own else 0 for n in some)

    def one(name: str) -> Callable[[Any], Scalar]:
        return lambda p: of(p, name)[0]

    def link(p: Any) -> Link:
        return Link(
            name=j.name,
            joint=j.kind,
            axis=j.axis,
            at=_vector(of(p, "at_x", "at_y", "at_z")),
            parent=names.index(j.parent) if j.parent else None,
            follows=names.index(j.follows) if j.follows else None,
            ratio=one("ratio")(p) if j.follows else 1,
        )

    def body(p: Any) -> dict[str, Any]:
        centre = _vector(of(p, "centre_x", "centre_y", "centre_z"))
        inertia = of(p, *(f"inertia_{n}" for n in INERTIAS))
        return {"mass": one("mass")(p), "centre": centre, "inertia": inertia}

    def drive(p: Any) -> Drive:
        base, pin, pivot, end = (of(p, f"{n}_x", f"{n}_z") for n in ("base", "pin", "pivot", "link"))
        closed, rocker, coupler = of(p, "closed_length", *BARS)
        if j.kind == "prismatic":
            return Telescope()
        if j.drive == "cylinder":
            return Cylinder(base, pin, closed)
        return FourBar(base, closed, pivot, rocker, coupler, end, j.assembly)

    def stop(p: Any) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        at, stiffness, damping = of(p, "stop_at", "stop_stiffness", "stop_damping")
        return at, stiffness, damping, STOP_ROUNDING

    has_cylinder = not j.follows and j.drive in ("cylinder", "four-bar")
    model = JointModel(
        name=j.name,
        coordinate=j.coordinate,
        link=link,
        body=body,
        damping=one("damping"),
        stiffness=one("stiffness") if "stiffness" in own else None,
        motor=j.drive == "motor",
        drive=drive if has_cylinder else None,
        piston=(lambda p: (one("stroke")(p), one("piston_damping")(p))) if has_cylinder else None,
        stop=stop if "stop_at" in own else None,
        stop_shown=f"{j.name}_stop_torque",
        contacts=contacts(j),
        follows=bool(j.follows),
        rests=not j.follows and j.drive == "none" and (j.kind == "revolute" or "stiffness" in own),
    )
    if not has_cylinder:
        return model
    at_start = drive(SimpleNamespace(**{j.name: SimpleNamespace(**{n: x.value for n, x in own.items()})}))
    return replace(model, lever=-1.0 if float(at_start.at(j.start.value).arm) < 0 else 1.0)


def _vector(values: Sequence[Scalar]) -> Vector:
    x, y, z = values
    return x, y, z


def crane_tip(crane: CraneDescription, p: Any) -> Vector:
    """Place of the crane tip in the frame of the last link before it."""
    way, end = crane.arm
    return joint_model((*way, end), end).link(p).at if end else (p.tip_at_x, p.tip_at_y, p.tip_at_z)


def mechanics(
    crane: CraneDescription, parameters: type[Any], states: type[Any], inputs: type[Any], outputs: type[Any]
) -> Mechanics:
    """The functions of the subsystem with these groups."""
    names, (way, _) = [j.name for j in crane.joints], crane.arm
    slew = next((j for j in way if j.drive != "none"), way[0])

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
        return {
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
    pistons = [j for j in free if j.drive in ("cylinder", "four-bar")]
    motors = [j for j in free if j.drive == "motor"]
    states, units = dict[str, Quantity](), {"revolute": "rad", "prismatic": "m"}
    coordinates = {
        j.coordinate: Quantity(
            units[j.kind], f"{j.coordinate.partition('_')[2].capitalize()} of the {j.name}"
        )
        for j in crane.joints
    }
    for j in free:
        states[j.coordinate] = coordinates[j.coordinate]
        states[f"{j.name}_speed"] = Quantity(f"{units[j.kind]}/s", f"Speed of the {j.name} joint")
    held = _of(ManipulatorState, "held_mass", "payload_flow")
    rubbing = [
        (j, name, c) for j in free for name, c in zip(contacts(j), CONTACTS.values(), strict=True) if name
    ]
    bristles = {name: (c[2], f"{j.name} {c[0]}") for j, name, c in rubbing}
    state = make_group("State", {**states, **held}, **bristles)
    inputs = make_group(
        "Inputs",
        _of(ManipulatorInputs, "payload_mass") | TIP_FORCE,
        **{j.name: CylinderInputs for j in pistons},
        **{j.name: MotorInputs for j in motors},
    )
    accelerations = {f"{j.name}_acceleration": ports.rate_output(f"{j.name}_speed", "rad/s2") for j in motors}
    accelerations |= {
        f"{j.name}_holding_torque": Quantity("N.m", f"Torque that holds the {j.name} against gravity", 1e4)
        for j in motors
    }
    shown = {j.coordinate: coordinates[j.coordinate] for j in crane.joints if j.follows}
    shown |= {
        f"{j.name}_{bar}_angle": Quantity("rad", f"Angle of the {bar} of the {j.name} in its parent's frame")
        for j in pistons
        if j.drive == "four-bar"
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
            "N.m" if j.kind == "revolute" else "N",
            f"Effort of the end stops of the {j.name} joint: zero except at the ends of its range",
            1e4,
            warn_above=1.0,
        )
        for j in free
        if "stop_at" in j.numbers
    }
    shown["tip_force_power"] = Quantity("W", "Power of the external force on the tip", 1e3)
    shown["crane_tip_radius"] = Quantity(
        "m", "Distance of the crane tip, the end of the driven arm, from the slewing joint, seen from above"
    )
    shown["crane_tip_height"] = Quantity("m", "Height of the crane tip above the base")
    shown["elastic_energy"] = Quantity(
        "J",
        "Elastic energy of springs and friction, of the ground, and of the stops of joints without a drive",
        1e3,
    )
    if crane.ground:
        shown["ground_force"] = Quantity("N", "Normal force of the ground on the tip", 1e4)
    outputs = make_group(
        "Outputs",
        {**states, **held, **accelerations, **shown, **_of(ManipulatorOutputs, *SHOWN)},
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
    for table, key, text in (
        ("base", "base_pitch", "Slope of the base: the front is lower by this angle"),
        ("base", "base_roll", "Slope of the base: the right side is lower by this angle"),
        *(
            ("payload", f"tip_at_{n}", f"Tip, where the payload is, from the joint of its link, {n}")
            for n in "xyz"
        ),
        ("payload", "load_length", "Length of the payload, a slender bar; 0: a point mass"),
        *(("ground", n, text) for n, text in GROUND.items() if crane.ground),
    ):
        found[key] = crane.numbers[table][key.replace("tip_at", "tip")]
        members[key] = Quantity(found[key].unit, text, group=table.capitalize())
    for j in crane.joints:
        if not j.follows:
            name = f"initial_{j.coordinate}"
            found[name] = j.start
            members[name] = Quantity(j.start.unit, f"{j.coordinate} at the start", group="Start pose")
    groups = dict[str, Any]()
    for j in crane.joints:
        own = numbers_of(j)
        declared = {
            n: Quantity(x.unit, TEXTS[n], max(abs(x.value), 1e-3), MINIMA.get(n), group="{}")
            for n, x in own.items()
        }
        groups[j.name] = make_group("Joint", declared)
        found |= {f"{j.name}_{n}": x for n, x in own.items()}
    bases: list[type[Group]] = []
    for j in crane.joints:
        for name, (n, c) in zip(contacts(j), CONTACTS.items(), strict=True):
            if name:
                groups[name] = (c[1], f"{j.name} {c[0]}")
                found[f"{name}_coulomb"], bases = j.numbers[n], [Dry]
    if bases:
        rubbing = numbers(VARIANTS["friction"])["parameters"]
        found |= {n: rubbing[n.removeprefix("dry_")] for n in quantities(Dry)}
    return make_group("Parameters", members, *bases, **groups), {"parameters": found, "start": {}}
