"""The manipulator of a crane as a subsystem: a chain of links with drives, passive joints and a payload.

    M(q) q'' + V(q, q') + G(q) = tau + tau_pick-up
    tau_i = J_i (F_i - R_i x_i' + F_stop,i) - b_i q_i'     with a cylinder: force F, piston friction R
    tau_i = torque_i - b_i q_i'                            with a motor
    tau_i = -b_i q_i' - k_i q_i                            of a passive joint, with a spring

and J^T f of an external force and of the ground on the tip, from the chain (`fmus.components.chain`) and the
drives (`fmus.components.linkage`). The payload is a point mass, or a slender bar, that comes and goes by
lags, as in `fmus.manipulator.model`. Passive joints start at rest, whatever the slope. The ground pushes as
an end stop does (`fmus.components.cylinder`), with the friction mu N against the velocity along it, rounded
over 1 cm/s.

Numbers of the description are parameters, except zeros: these are structure, so that a crane in one plane has
the equations of a plane one.

Validity: rigid links, viscous friction, the pins of a cylinder in the plane of its joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components import cylinder
from fmus.components.chain import Chain, Link, Payload, Vector, gravity_on_slope
from fmus.components.cylinder import Stop
from fmus.components.linkage import Cylinder, FourBar, Telescope, Transmission
from fmus.contract import Group, Quantity, Scalar, Subsystem, column, make_group, nested, quantities
from fmus.crane.description import INERTIAS, CraneDescription, JointDescription
from fmus.manipulator.variables import (
    CylinderInputs,
    CylinderOutputs,
    ManipulatorInputs,
    ManipulatorOutputs,
    ManipulatorParameters,
    ManipulatorState,
)
from fmus.parameters import Number, Tables

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
BARS = ("rocker", "coupler")
STOPS = ("stop_stiffness", "stop_damping", "stop_rounding")
SHARED = ("gravity", "payload_grip_time", *STOPS)  # with the values of the paper's machine
SHOWN = (
    *("tip_x", "tip_y", "tip_radius", "tip_height"),
    *("stop_energy", "kinetic_energy", "potential_energy", "dissipated_power", "payload_power"),
)
PIN_MARGIN = 0.05  # strokes by which a piston may be beyond an end: an end stop in use
TEXTS = {  # of the parameters of a joint; "{}" is its name
    **{f"at_{n}": f"Place of the {{}} joint in the frame of its parent, {n}" for n in "xyz"},
    "mass": "Mass of the {}",
    **{f"centre_{n}": f"Centre of mass of the {{}} from its joint, {n}" for n in "xyz"},
    **{f"inertia_{n}": f"Moment of inertia {n} of the {{}} about its centre of mass" for n in INERTIAS},
    "damping": "Viscous friction of the {} joint",
    "stiffness": "Stiffness of the spring in the {} joint, which is without force at 0",
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
SLIDING = 0.01  # m/s, over which the friction on the ground is rounded
HIGH = 1e4  # m above the ground, where no stop is
MINIMA = {
    "mass": 0.0,
    "damping": 0.0,
    "stiffness": 0.0,
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


def numbers_of(joint: JointDescription) -> dict[str, Number]:
    """Numbers of a joint that are parameters of the manipulator; zeros are structure."""
    some = {n: x for n, x in joint.numbers.items() if n in TEXTS and x.value != 0}
    return some | ({"ratio": joint.ratio} if joint.follows else {})


@dataclass(frozen=True)
class CraneManipulator:
    """The functions of the subsystem of a crane's manipulator."""

    crane: CraneDescription
    parameters: type[Any]
    states: type[Any]
    outputs: type[Any]

    # ---- geometry at one instant

    def _number(self, joint: JointDescription, name: str, p: Any) -> Scalar:
        return getattr(getattr(p, joint.name), name) if name in numbers_of(joint) else 0

    def _link(self, joint: JointDescription, p: Any) -> Link:
        names, of = [j.name for j in self.crane.joints], partial(self._number, joint, p=p)
        return Link(
            name=joint.name,
            joint=joint.kind,
            axis=joint.axis,
            at=(of("at_x"), of("at_y"), of("at_z")),
            parent=names.index(joint.parent) if joint.parent else None,
            mass=of("mass"),
            centre=(of("centre_x"), of("centre_y"), of("centre_z")),
            inertia=[of(f"inertia_{n}") for n in INERTIAS],
            follows=names.index(joint.follows) if joint.follows else None,
            ratio=of("ratio") if joint.follows else 1,
        )

    def chain(self, p: Any) -> Chain:
        """The links under gravity on the slope of the base."""
        slope = gravity_on_slope(p.gravity, p.base_pitch, p.base_roll)
        return Chain(tuple(self._link(j, p) for j in self.crane.joints), slope)

    def payload(self, mass: Scalar, p: Any) -> Payload:
        """The payload at the tip."""
        across = [(n != self.crane.along) * p.load_length**2 / 12 for n in "xyz"]
        return Payload(self._tip, (p.tip_at_x, p.tip_at_y, p.tip_at_z), mass, (*across, 0, 0, 0))

    def crane_tip(self, p: Any) -> tuple[int, Vector]:
        """Link and place of the crane tip."""
        way, end = self.crane.arm
        if end is None:
            return self._tip, (p.tip_at_x, p.tip_at_y, p.tip_at_z)
        place = (self._number(end, f"at_{n}", p) for n in "xyz")
        return [j.name for j in self.crane.joints].index(way[-1].name), tuple(place)

    def ground(self, x: Any, p: Any) -> tuple[Stop, ca.SX, ca.SX]:
        """Normal force of the ground, its force on the tip (3, 1), velocity of the tip (3, 1)."""
        (q, w), chain, load = self._motion(x), self.chain(p), self.payload(x.held_mass, p)
        velocity = chain.velocity(q, w, load.link, load.at)
        height = chain.position(q, load.link, load.at)[2] - p.ground_height
        law = (p.ground_stiffness, p.ground_damping, p.stop_rounding)
        stop = cylinder.stop(height, velocity[2], HIGH, *law)
        along = velocity[:2] / ca.sqrt(ca.sumsqr(velocity[:2]) + SLIDING**2)
        return stop, ca.vertcat(-p.ground_friction * stop.force * along, stop.force), velocity

    def _springs(self, p: Any) -> dict[int, Scalar]:
        """Link -> stiffness of its joint."""
        joints = enumerate(self.crane.joints)
        return {k: self._number(j, "stiffness", p) for k, j in joints if "stiffness" in numbers_of(j)}

    @cached_property
    def signs(self) -> dict[str, float]:
        """Sign of the lever of each cylinder at the start pose of the description."""
        flat = _parameters(self.crane)[1]["parameters"]
        p = nested(self.parameters, {n: x.value for n, x in flat.items()})
        joints = [j for j in self._free if j.drive in ("cylinder", "four-bar")]
        arms = {j.name: float(self.transmission(j, j.start.value, p).arm) for j in joints}
        return {n: -1.0 if arm < 0 else 1.0 for n, arm in arms.items()}

    def at_rest(self, q: ca.SX, mass: Scalar, p: Any) -> ca.SX:
        """Coordinates with the passive joints in balance, under a payload [kg]."""
        springs, names = self._springs(p), [j.name for j in self.crane.joints]
        passive = [
            names.index(j.name)
            for j in self._free
            if j.drive == "none" and (j.kind == "revolute" or names.index(j.name) in springs)
        ]
        return self.chain(p).at_rest(q, passive, self.payload(mass, p), springs) if passive else q

    def _elastic(self, x: Any, p: Any) -> Scalar:
        """Energy of springs and ground [J]."""
        springs = (
            k * getattr(x, self.crane.joints[i].coordinate) ** 2 / 2 for i, k in self._springs(p).items()
        )
        return sum(springs, self.ground(x, p)[0].stored if self.crane.ground else ca.SX(0))

    @property
    def _tip(self) -> int:
        return [j.name for j in self.crane.joints].index(self.crane.payload_on)

    @property
    def _free(self) -> list[JointDescription]:
        return [j for j in self.crane.joints if not j.follows]

    def transmission(self, joint: JointDescription, q: Scalar, p: Any) -> Transmission:
        """The cylinder of a joint at a coordinate."""
        of = partial(self._number, joint, p=p)
        if joint.kind == "prismatic":
            return Telescope().at(q)
        base, pin = ((of(f"{n}_x"), of(f"{n}_z")) for n in ("base", "pin"))
        if joint.drive == "cylinder":
            return Cylinder(base, pin, of("closed_length")).at(q)
        return self.four_bar(joint, p).at(q)

    def four_bar(self, joint: JointDescription, p: Any) -> FourBar:
        """The linkage of a joint."""
        of = partial(self._number, joint, p=p)
        base, pivot, link = ((of(f"{n}_x"), of(f"{n}_z")) for n in ("base", "pivot", "link"))
        bars = of("rocker"), of("coupler")
        return FourBar(base, of("closed_length"), pivot, *bars, link, joint.assembly)

    def _cylinders(self, x: Any, p: Any) -> dict[str, tuple[Transmission, Stop]]:
        found = {}
        for j in self._free:
            if j.drive in ("cylinder", "four-bar"):
                t = self.transmission(j, getattr(x, j.coordinate), p)
                law = tuple(getattr(p, n) for n in STOPS)
                velocity = t.velocity(getattr(x, f"{j.name}_speed"))
                found[j.name] = t, cylinder.stop(t.position, velocity, getattr(p, j.name).stroke, *law)
        return found

    def _motion(self, x: Any) -> tuple[ca.SX, ca.SX]:
        coordinates = (getattr(x, j.coordinate) for j in self._free)
        return column(*coordinates), column(*(getattr(x, f"{j.name}_speed") for j in self._free))

    # ---- functions of the subsystem

    def _forces(self, x: Any, u: Any, p: Any) -> tuple[ca.SX, Scalar]:
        """tau, shape (n, 1), and the power that friction and stops dissipate."""
        cylinders, tau, heat = self._cylinders(x, p), list[Scalar](), 0
        for j in self._free:
            speed = getattr(x, f"{j.name}_speed")
            loss = self._number(j, "damping", p) * speed
            heat += loss * speed
            own = -self._number(j, "stiffness", p) * getattr(x, j.coordinate)
            if j.drive == "motor":
                own = getattr(u, j.name).torque
            elif j.name in cylinders:
                t, stop = cylinders[j.name]
                friction = self._number(j, "piston_damping", p) * t.velocity(speed)
                heat += friction * t.velocity(speed) + stop.heat
                own = t.effort(getattr(u, j.name).force - friction + stop.force)
            tau.append(own - loss)
        force = column(u.tip_force_x, u.tip_force_y, u.tip_force_z)
        if self.crane.ground:
            stop, push, velocity = self.ground(x, p)
            force += push
            heat += stop.heat - ca.dot(push[:2], velocity[:2])
        q, chain, load = self._motion(x)[0], self.chain(p), self.payload(0, p)
        return column(*tau) + chain.generalised_force(q, force, load.link, load.at), heat

    def dynamics(self, x: Any, u: Any, p: Any) -> Any:
        """Time derivative of the state."""
        motion = self.chain(p).equations(*self._motion(x), self.payload(x.held_mass, p))
        tau, _ = self._forces(x, u, p)
        acceleration = motion.acceleration(tau + motion.per_kilogram.drag(x.payload_flow))
        time = p.payload_grip_time
        rates = {"held_mass": x.payload_flow}
        rates["payload_flow"] = 4.5 * ((u.payload_mass - x.held_mass) / time - x.payload_flow) / time
        for k, j in enumerate(self._free):
            rates[j.coordinate] = getattr(x, f"{j.name}_speed")
            rates[f"{j.name}_speed"] = acceleration[k]
        return nested(self.states, rates)

    def observe(self, x: Any, u: Any, p: Any) -> Any:
        """Outputs; only accelerations and the torques of the cylinders depend on the inputs."""
        (q, w), chain, dx = self._motion(x), self.chain(p), self.dynamics(x, u, p)
        load = self.payload(x.held_mass, p)
        motion, (_, heat) = chain.equations(q, w, load), self._forces(x, u, p)
        tip = chain.position(q, load.link, load.at)
        cylinders = self._cylinders(x, p)
        known = {n: getattr(x, n) for n in quantities(self.states)}
        for k, j in enumerate(self._free):
            speed, acceleration = (getattr(at, f"{j.name}_speed") for at in (x, dx))
            if j.drive == "motor":
                known[f"{j.name}_acceleration"] = acceleration
                known[f"{j.name}_holding_torque"] = motion.gravity[k]
            elif j.name in cylinders:
                t, stop = cylinders[j.name]
                known |= {
                    f"{j.name}_{n}": value
                    for n, value in {
                        "position": t.position,
                        "velocity": t.velocity(speed),
                        "acceleration": t.acceleration(speed, acceleration),
                        "holding_force": motion.gravity[k] / t.arm,
                        "torque": t.effort(getattr(u, j.name).force),
                        "stop_force": stop.force,
                    }.items()
                }
            if j.drive == "four-bar":
                angles = self.four_bar(j, p).angles(getattr(x, j.coordinate))
                known |= {f"{j.name}_{n}_angle": a for n, a in zip(BARS, angles, strict=True)}
        force = column(u.tip_force_x, u.tip_force_y, u.tip_force_z)
        shown = {"tip_force_power": ca.dot(force, chain.velocity(q, w, load.link, load.at))}
        shown["elastic_energy"] = self._elastic(x, p)
        end = chain.position(q, *self.crane_tip(p))
        way = self.crane.arm[0]
        slew = next((j for j in way if j.drive != "none"), way[0])
        across = (end - chain.position(q, self.crane.joints.index(slew)))[:2]
        shown["crane_tip_radius"], shown["crane_tip_height"] = ca.sqrt(ca.sumsqr(across)), end[2]
        if self.crane.ground:
            shown["ground_force"] = self.ground(x, p)[0].force
        for j in self.crane.joints:
            if j.follows:
                leader = self.crane.joint(j.follows)
                known[j.coordinate] = self._number(j, "ratio", p) * getattr(x, leader.coordinate)
        return nested(
            self.outputs,
            known
            | {
                "tip_x": tip[0],
                "tip_y": tip[1],
                "tip_radius": ca.sqrt(tip[0] ** 2 + tip[1] ** 2),
                "tip_height": tip[2],
                **shown,
                "stop_energy": sum((stop.stored for _, stop in cylinders.values()), ca.SX(0)),
                "kinetic_energy": motion.kinetic,
                "potential_energy": motion.potential,
                "dissipated_power": heat + motion.per_kilogram.heat(x.payload_flow),
                "payload_power": motion.per_kilogram.inflow(x.payload_flow),
            },
        )

    def initial(self, _: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """The start pose; passive joints are at rest in it."""
        q = column(*(getattr(p, f"initial_{j.coordinate}") for j in self._free))
        q = self.at_rest(q, u.payload_mass, p)
        return {"held_mass": u.payload_mass, **{j.coordinate: q[k] for k, j in enumerate(self._free)}}

    def require(self, x: Any, _: Any, p: Any) -> dict[str, Scalar]:
        """Pistons within their strokes, linkages that close."""
        found = {}
        for name, (t, _) in self._cylinders(x, p).items():
            joint, stroke = self.crane.joint(name), getattr(p, name).stroke
            at = f"{joint.coordinate}, at the start initial_{joint.coordinate},"
            found[f"{at} keeps the {name} piston above its closed end"] = t.position + PIN_MARGIN * stroke
            found[f"{at} keeps the {name} piston below its open end"] = (1 + PIN_MARGIN) * stroke - t.position
            if joint.kind == "revolute":
                lever = self.signs[name] * t.arm
                found[f"{joint.coordinate} keeps the {name} cylinder off its dead point"] = lever
            if joint.drive == "four-bar":
                margin = self.four_bar(joint, p).margin(getattr(x, joint.coordinate))
                found[f"{at} keeps the linkage of the {name} closed"] = margin
        return found


def manipulator(crane: CraneDescription) -> Subsystem:
    """The subsystem of a crane."""
    parameters, numbers = _parameters(crane)
    free = [j for j in crane.joints if not j.follows]
    pistons = [j for j in free if j.drive in ("cylinder", "four-bar")]
    motors = [j for j in free if j.drive == "motor"]
    states, units = dict[str, Quantity](), {"revolute": ("rad", "rad/s"), "prismatic": ("m", "m/s")}
    for j in free:
        unit, rate = units[j.kind]
        states[j.coordinate] = Quantity(
            unit, f"{j.coordinate.partition('_')[2].capitalize()} of the {j.name}"
        )
        states[f"{j.name}_speed"] = Quantity(rate, f"Speed of the {j.name} joint")
    held = _of(ManipulatorState, "held_mass", "payload_flow")
    state = make_group("State", {**states, **held})
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
    shown = {
        j.coordinate: Quantity(
            units[j.kind][0], f"{j.coordinate.partition('_')[2].capitalize()} of the {j.name}"
        )
        for j in crane.joints
        if j.follows
    }
    shown |= {
        f"{j.name}_{bar}_angle": Quantity("rad", f"Angle of the {bar} of the {j.name} in its parent's frame")
        for j in pistons
        if j.drive == "four-bar"
        for bar in BARS
    }
    shown["tip_force_power"] = Quantity("W", "Power of the external force on the tip", 1e3)
    shown["crane_tip_radius"] = Quantity(
        "m", "Distance of the crane tip, the end of the driven arm, from the slewing joint, seen from above"
    )
    shown["crane_tip_height"] = Quantity("m", "Height of the crane tip above the base")
    shown["elastic_energy"] = Quantity("J", "Elastic energy of springs in joints and of the ground", 1e3)
    if crane.ground:
        shown["ground_force"] = Quantity("N", "Normal force of the ground on the tip", 1e4)
    outputs = make_group(
        "Outputs",
        {**states, **held, **accelerations, **shown, **_of(ManipulatorOutputs, *SHOWN)},
        **{j.name: CylinderOutputs for j in pistons},
    )
    of = CraneManipulator(crane, parameters, state, outputs)
    terminals = (
        *(ports.shaft(j.name, False, "holding_torque") for j in motors),
        *(ports.rod(j.name, drives=False) for j in pistons),
        ports.grip(),
    )
    return Subsystem(
        name=NAME,
        text=f"Crane: {crane.title}",
        validity="rigid links, viscous friction",
        parameters=parameters,
        states=state,
        inputs=inputs,
        outputs=outputs,
        dynamics=of.dynamics,
        observe=of.observe,
        initial=of.initial,
        require=of.require,
        numbers=numbers,
        terminals=terminals,
        stiff=False,
    )


def _parameters(crane: CraneDescription) -> tuple[type[Any], Tables]:
    """The group of the parameters, and their values."""
    from fmus.manipulator import MANIPULATOR
    from fmus.parameters import numbers

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
    groups = {}
    for j in crane.joints:
        own = numbers_of(j)
        declared = {
            n: Quantity(x.unit, TEXTS[n], max(abs(x.value), 1e-3), MINIMA.get(n), group="{}")
            for n, x in own.items()
        }
        groups[j.name] = make_group("Joint", declared)
        found |= {f"{j.name}_{n}": x for n, x in own.items()}
    return make_group("Parameters", members, **groups), {"parameters": found, "start": {}}
