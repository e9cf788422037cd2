"""Mechanics of an arm: joints as data, from which the functions of a subsystem follow.

    M(q) q'' + V(q, q') + G(q) = tau + tau_pick-up                                   paper eq. (4)
    tau_i = J_i (F_i - R_piston,i + F_stop,i) - R_joint,i - k_i q_i + tau_stop,i     cylinder: eqs. (5) to (7)
    tau_i = torque_i - R_joint,i - k_i q_i + tau_stop,i                              motor: eq. (8)

with the friction R of joint and piston, springs k, end stops, and J^T f of an external force and of the
ground on the tip. M, V and G are those of the chain of links (`fmus.components.chain`), J those of the drives
(`fmus.components.linkage`). The ground pushes as an end stop does (`fmus.components.cylinder`), with the
friction mu N against the velocity along it, rounded over 1 cm/s.

The tip holds a payload m_h (`held_mass`), which follows the input m_in = `payload_mass` by lags of 2 T/3 and
T/3 in series, T = `payload_grip_time`, so that its rate (`payload_flow`) is a state and no force jumps. After
a step it is m_in (1 - exp(-1.5 t/T))^2:

    m_h'' = 4.5 ((m_in - m_h)/T - m_h')/T                      from m_h = m_in, m_h' = 0 at the start
    tau_pick-up = -max(m_h', 0) d(M q')/dm_h                   mass comes from rest, leaves with its velocity

The pick-up is inelastic: max(m_h', 0) v^2/2 is heat, v the speed of the payload. With the mass the power
m_h' g z + min(m_h', 0) v^2/2 enters, z its height (`payload_power`). Derivation: `fmus.components.mechanics`.

Validity: rigid links; the pins of a cylinder in the plane of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import casadi as ca

from fmus.components import cylinder
from fmus.components.chain import Chain, Link, Payload, Vector
from fmus.components.cylinder import Stop
from fmus.components.friction import Resistance, viscous
from fmus.components.linkage import Cylinder, Drive, FourBar, Transmission
from fmus.components.mechanics import EquationsOfMotion, equations_of_motion, reach
from fmus.contract import Scalar, column, flat, nested, quantities

SLIDING = 0.01  # m/s, over which the friction on the ground is rounded
HIGH = 1e4  # m above the ground, where no stop is
PIN_MARGIN = 0.05  # strokes by which a piston may be beyond an end: an end stop in use
BARS = ("rocker", "coupler")

Of: TypeAlias = Callable[[Any], Scalar]  # a number by the parameters
# a law of dry friction: (contact, speed, x, p, viscous coefficient) -> resistance
Friction: TypeAlias = Callable[[str, Scalar, Any, Any, Scalar], Resistance]


def _zero(_: Any) -> Scalar:
    return 0


def _nothing(*_: Any) -> dict[str, Scalar]:
    return {}


def kinematics(joints: Sequence[JointModel], p: Any) -> Chain:
    """The links without their masses, from the geometry alone."""
    return Chain(tuple(j.link(p) for j in joints))


@dataclass(frozen=True)
class JointModel:
    """A joint with the link behind it, by functions of the parameters p.

    name        begin of the names of its speed, its drive and its outputs
    coordinate  name of its state, or of its output if it follows another joint
    link        of the chain; for the arm of a controller from the geometry alone
    damping     viscous friction [N.m.s/rad or N.s/m]
    stiffness   of a spring, which is without force at 0 [N.m/rad or N/m]; None: no spring
    motor       whether a torque drives it
    drive       cylinder that drives it; None: none does
    piston      stroke [m] and viscous friction [N.s/m] of that cylinder
    lever       sign of its lever arm J
    stop        end stops: low and high position [rad or m], stiffness, damping, rounding; None: no stops
    stop_shown  output of their torque
    contacts    names of the joint and of its piston in a law of dry friction; "": viscous friction only
    rubs        end of the names of the outputs of both
    follows     whether its link follows another one
    rests       whether it starts at rest under gravity
    body        what the link has besides, as fields of `Link`: mass, centre, inertia
    bars        (p, number of links before them) -> links that follow it: of its cylinder and its linkage
    """

    name: str
    coordinate: str
    link: Callable[[Any], Link]
    damping: Of = _zero
    stiffness: Of | None = None
    motor: bool = False
    drive: Callable[[Any], Drive] | None = None
    piston: Callable[[Any], tuple[Scalar, Scalar]] | None = None
    lever: float = 1.0
    stop: Callable[[Any], tuple[Scalar, ...]] | None = None
    stop_shown: str = ""
    contacts: tuple[str, str] = ("", "")
    rubs: tuple[str, str] = ("torque", "force")
    follows: bool = False
    rests: bool = False
    body: Callable[[Any], Mapping[str, Any]] = _nothing
    bars: Callable[[Any, int], Sequence[Link]] = lambda *_: ()

    @property
    def driven(self) -> bool:
        """Whether a motor or a cylinder drives it."""
        return self.motor or self.drive is not None


@dataclass(frozen=True)
class Piston:
    """Of a cylinder: position and its derivatives, velocity [m/s], end stops."""

    transmission: Transmission
    velocity: Scalar
    stop: Stop


@dataclass(frozen=True)
class Forces:
    """Generalised forces, shape (n, 1), in the coordinates of the states, and what they consist of.

    friction   by contact
    stops      of joints by name
    ground     normal force
    heat       [W], of friction, stops and ground
    stored     elastic energy of friction, of stops of joints that nothing drives, of springs and ground [J]
    """

    tau: ca.SX
    pistons: Mapping[str, Piston]
    friction: Mapping[str, Resistance]
    stops: Mapping[str, Stop]
    ground: Stop | None
    heat: Scalar
    stored: Scalar


@dataclass(frozen=True)
class Mechanics:
    """The functions of a subsystem of joints.

    joints     in the order of the chain
    gravity    (p) -> in the base [m/s2]
    payload    (mass [kg], p) -> what is held, with a mass that is always there
    views      (mechanics, q of the joints, their speeds, x, u, p) -> further outputs
    ground     (p) -> height, stiffness, damping, friction of the ground under the tip; None: no ground
    turn       coordinates of the joints over those of the states, a constant matrix; None: they are the same
    dry        law of friction of the joints and pistons with a contact
    stored     output of the elastic energy beside that of the end stops
    external   whether a force on the tip is an input
    limits     (x, p) -> further requirements of `require`
    """

    joints: tuple[JointModel, ...]
    parameters: type[Any]
    states: type[Any]
    inputs: type[Any]
    outputs: type[Any]
    gravity: Callable[[Any], Vector]
    payload: Callable[[Scalar, Any], Payload]
    views: Callable[..., Mapping[str, Scalar]]
    ground: Callable[[Any], tuple[Scalar, Scalar, Scalar, Scalar]] | None = None
    turn: Sequence[Sequence[float]] | None = None
    dry: Friction | None = None
    stored: str = "stored_energy"
    external: bool = False
    limits: Callable[[Any, Any], Mapping[str, Scalar]] = _nothing

    @property
    def free(self) -> list[JointModel]:
        """The joints that follow no other one: each has a coordinate."""
        return [j for j in self.joints if not j.follows]

    def joint(self, name: str) -> JointModel:
        """The joint with this name."""
        return next(j for j in self.joints if j.name == name)

    def index(self, name: str) -> int:
        """Of the coordinate of a joint."""
        return [j.name for j in self.free].index(name)

    # ---- geometry and motion

    def chain(self, p: Any) -> Chain:
        """The links under gravity: of the joints, then those that follow them."""
        links = [replace(j.link(p), **j.body(p)) for j in self.joints]
        for j in self.joints:
            links += j.bars(p, len(links))
        return Chain(tuple(links), self.gravity(p))

    def start(self, p: Any) -> ca.SX:
        """Coordinates of the states in the start pose, shape (n, 1)."""
        return ca.SX(column(*(getattr(p, f"initial_{j.coordinate}") for j in self.free)))

    def coordinates(self, x: Any) -> ca.SX:
        """Of the states, shape (n, 1)."""
        found: ca.SX = column(*(getattr(x, j.coordinate) for j in self.free))
        return found

    def speeds(self, x: Any) -> ca.SX:
        """Of the states, shape (n, 1)."""
        found: ca.SX = column(*(getattr(x, f"{j.name}_speed") for j in self.free))
        return found

    def of_joints(self, s: ca.SX) -> ca.SX:
        """Coordinates or speeds of the joints from those of the states."""
        return s if self.turn is None else ca.DM(self.turn) @ s

    def motion(self, x: Any, p: Any) -> EquationsOfMotion:
        """M, V and G in the coordinates of the states, with what is held."""
        m, chain = ca.SX.sym("m"), self.chain(p)
        load = self.payload(m, p)
        return equations_of_motion(
            lambda s, w: chain.kinetic(self.of_joints(s), self.of_joints(w), load),
            lambda s: chain.potential(self.of_joints(s), load),
            self.coordinates(x),
            self.speeds(x),
            (m, x.held_mass),
        )

    def at_rest(self, q: ca.SX, mass: Scalar, p: Any, swinging: Sequence[int] = ()) -> ca.SX:
        """Coordinates of the joints with those that rest in balance, under a payload [kg].

        swinging   joints that do not start at rest, but are to be in balance, too
        """
        springs = {k: j.stiffness(p) for k, j in enumerate(self.joints) if j.stiffness}
        resting = [k for k, j in enumerate(self.joints) if j.rests or k in swinging]
        return self.chain(p).at_rest(q, resting, self.payload(mass, p), springs) if resting else q

    def transmission(self, name: str, q: Scalar, p: Any) -> Transmission:
        """The cylinder of a joint at a coordinate."""
        drive = self.joint(name).drive
        assert drive is not None
        return drive(p).at(q)

    def pistons(self, x: Any, p: Any) -> dict[str, Piston]:
        """Of the joints with a cylinder, by name."""
        found = dict[str, Piston]()
        for j in self.free:
            if j.drive and j.piston:
                t, law = j.drive(p).at(getattr(x, j.coordinate)), (p.stop_stiffness, p.stop_damping)
                velocity, stroke = t.velocity(getattr(x, f"{j.name}_speed")), j.piston(p)[0]
                stop = cylinder.stop(t.position, velocity, stroke, *law, p.stop_rounding)
                found[j.name] = Piston(t, velocity, stop)
        return found

    # ---- forces

    def forces(self, x: Any, u: Any, p: Any) -> Forces:
        """All but those of gravity and motion."""
        q, w = self.of_joints(self.coordinates(x)), self.of_joints(self.speeds(x))
        pistons, applied = self.pistons(x, p), flat(u)
        friction, stops, stored, tau = dict[str, Resistance](), dict[str, Stop](), ca.SX(0), list[Scalar]()

        def resistance(contact: str, other: str, speed: Scalar, damping: Scalar) -> Scalar:
            law, name = self.dry if contact else None, contact or other
            friction[name] = law(name, speed, x, p, damping) if law else viscous(speed, damping)
            return friction[name].force

        for k, j in enumerate(self.free):
            own = -resistance(j.contacts[0], f"{j.name}_joint", w[k], j.damping(p))
            if j.motor:
                own += applied[f"{j.name}_torque"]
            if j.piston and (piston := pistons.get(j.name)):
                loss = resistance(j.contacts[1], f"{j.name}_piston", piston.velocity, j.piston(p)[1])
                own += piston.transmission.effort(applied[f"{j.name}_force"] - loss + piston.stop.force)
            if j.stiffness:
                own -= j.stiffness(p) * q[k]
                stored += j.stiffness(p) * q[k] ** 2 / 2
            if j.stop:
                low, high, *law = j.stop(p)
                stops[j.name] = cylinder.stop(q[k] - low, w[k], high - low, *law)
                own += stops[j.name].force
                stored += 0 if j.driven else stops[j.name].stored
            tau.append(own)
        ground, chain, load = None, self.chain(p), self.payload(0, p)
        for k, (j, slope) in enumerate(zip(self.joints, chain.slopes(q), strict=False)):
            if j.follows:
                at = chain.coordinate(k)
                friction[f"{j.name}_joint"] = loss = viscous(slope * w[at], j.damping(p))
                tau[at] -= slope * loss.force
        both: ca.SX = column(*tau) if self.turn is None else ca.DM(self.turn).T @ column(*tau)
        heat = sum((r.heat for r in friction.values()), ca.SX(0))
        heat += sum(s.heat for s in (*stops.values(), *(f.stop for f in pistons.values())))
        stored += sum(r.stored for r in friction.values())
        force = column(*(applied[f"tip_force_{n}"] for n in "xyz")) if self.external else ca.SX(3, 1)
        if self.ground:
            ground, push, velocity = self.ground_force(x, p)
            force += push
            heat += ground.heat - ca.dot(push[:2], velocity[:2])
            stored += ground.stored
        if self.ground or self.external:
            both += chain.generalised_force(q, force, load.link, load.at)
        return Forces(both, pistons, friction, stops, ground, heat, stored)

    def ground_force(self, x: Any, p: Any) -> tuple[Stop, ca.SX, ca.SX]:
        """Normal force of the ground, its force on the tip (3, 1), velocity of the tip (3, 1)."""
        assert self.ground is not None
        (level, stiffness, damping, friction), load = self.ground(p), self.payload(0, p)
        q, w, chain = self.of_joints(self.coordinates(x)), self.of_joints(self.speeds(x)), self.chain(p)
        velocity = chain.velocity(q, w, load.link, load.at)
        height = chain.position(q, load.link, load.at)[2] - level
        stop = cylinder.stop(height, velocity[2], HIGH, stiffness, damping, p.stop_rounding)
        along = velocity[:2] / ca.sqrt(ca.sumsqr(velocity[:2]) + SLIDING**2)
        return stop, ca.vertcat(-friction * stop.force * along, stop.force), velocity

    # ---- functions of the subsystem

    def _rates(self, x: Any, u: Any, p: Any, motion: EquationsOfMotion, forces: Forces) -> dict[str, Scalar]:
        acceleration = motion.acceleration(forces.tau + motion.per_kilogram.drag(x.payload_flow))
        time = p.payload_grip_time
        # lags of 2 T/3 and T/3 in series: the mass held stays between the masses asked for
        flow = 4.5 * ((u.payload_mass - x.held_mass) / time - x.payload_flow) / time
        rates = {"held_mass": x.payload_flow, "payload_flow": flow}
        for k, j in enumerate(self.free):
            rates[j.coordinate] = getattr(x, f"{j.name}_speed")
            rates[f"{j.name}_speed"] = acceleration[k]
        if self.dry:
            rates |= {f"{c}_bristle": r.deflection_rate for c, r in forces.friction.items()}
        return rates

    def dynamics(self, x: Any, u: Any, p: Any) -> Any:
        """Time derivative of the state."""
        return nested(self.states, self._rates(x, u, p, self.motion(x, p), self.forces(x, u, p)))

    def observe(self, x: Any, u: Any, p: Any) -> Any:
        """Outputs; only accelerations and the torques of the cylinders depend on the inputs."""
        motion, forces, load = self.motion(x, p), self.forces(x, u, p), self.payload(0, p)
        rates, applied, chain = self._rates(x, u, p, motion, forces), flat(u), self.chain(p)
        q, w = self.of_joints(self.coordinates(x)), self.of_joints(self.speeds(x))
        found = flat(x)
        for k, j in enumerate(self.free):
            name, speed = j.name, getattr(x, f"{j.name}_speed")
            acceleration = rates[f"{name}_speed"]
            found[f"{name}_acceleration"], found[f"{name}_holding_torque"] = acceleration, motion.gravity[k]
            if piston := forces.pistons.get(name):
                t = piston.transmission
                found[f"{name}_position"], found[f"{name}_velocity"] = t.position, piston.velocity
                found[f"{name}_acceleration"] = t.acceleration(speed, acceleration)
                found[f"{name}_holding_force"] = motion.gravity[k] / t.arm
                found[f"{name}_torque"] = t.effort(applied[f"{name}_force"])
                found[f"{name}_stop_force"] = piston.stop.force
            if j.drive and isinstance(linkage := j.drive(p), FourBar):
                angles = linkage.angles(getattr(x, j.coordinate))
                found |= {f"{name}_{bar}_angle": a for bar, a in zip(BARS, angles, strict=True)}
            for contact, shown in zip(j.contacts, j.rubs, strict=True):
                if contact:
                    found[f"{name}_friction_{shown}"] = forces.friction[contact].force
            if j.stop:
                found[j.stop_shown] = forces.stops[name].force
        at = zip(self.joints, chain.joints(q), strict=False)
        found |= {j.coordinate: value for j, value in at if j.follows}
        if self.external:
            force = column(*(applied[f"tip_force_{n}"] for n in "xyz"))
            found["tip_force_power"] = ca.dot(force, chain.velocity(q, w, load.link, load.at))
        if forces.ground:
            found["ground_force"] = forces.ground.force
        driven = (s for n, s in forces.stops.items() if self.joint(n).driven)
        ends = (*(f.stop for f in forces.pistons.values()), *driven)
        found |= {
            "stop_energy": sum((s.stored for s in ends), ca.SX(0)),
            self.stored: forces.stored,
            "kinetic_energy": motion.kinetic,
            "potential_energy": motion.potential,
            "dissipated_power": forces.heat + motion.per_kilogram.heat(x.payload_flow),
            "payload_power": motion.per_kilogram.inflow(x.payload_flow),
        }
        return nested(self.outputs, found | dict(self.views(self, q, w, x, p)))

    def initial(self, _: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """The start pose from parameters, because not every tool can set the start value of an output.

        A payload that the input has at the start is held from the start.
        """
        q = self.at_rest(self.start(p), u.payload_mass, p)
        return {**{j.coordinate: q[k] for k, j in enumerate(self.free)}, "held_mass": u.payload_mass}

    def require(self, x: Any, _: Any, p: Any) -> dict[str, Scalar]:
        """Cylinders that close over their strokes, pistons within these, levers off their dead points."""
        found, levers, units = dict[str, Scalar](), dict[str, Scalar](), quantities(self.states)
        for name, piston in self.pistons(x, p).items():
            j, t = self.joint(name), piston.transmission
            assert j.drive is not None
            assert j.piston is not None
            drive, (stroke, _) = j.drive(p), j.piston(p)
            if isinstance(drive, Cylinder):
                shortest, longest = reach(drive.base, drive.rod)
                closed = f"{name}_closed_length"
                found[f"{closed} is above the shortest reach of its pins"] = drive.closed - shortest
                found[f"{closed} + {name}_stroke is below the longest reach of its pins"] = (
                    longest - drive.closed - stroke
                )
            at = f"{j.coordinate} [{units[j.coordinate].unit}], at the start initial_{j.coordinate},"
            margin = PIN_MARGIN * stroke
            found[f"{at} keeps the {name} piston above its closed end"] = t.position + margin
            found[f"{at} keeps the {name} piston below its open end"] = stroke + margin - t.position
            if isinstance(drive, FourBar):
                found[f"{at} keeps the linkage of the {name} closed"] = drive.margin(getattr(x, j.coordinate))
            for kind, what in {
                Cylinder: f"the pins of the {name} cylinder out of line",
                FourBar: f"the {name} cylinder off its dead point",
            }.items():
                if isinstance(drive, kind):
                    sign = "<" if j.lever < 0 else ">"
                    levers[f"{j.coordinate} keeps {what} (J {sign} 0)"] = j.lever * t.arm
        return found | levers | dict(self.limits(x, p))

    @property
    def declared(self) -> dict[str, Any]:
        """Groups and functions of the subsystem, as fields of `Subsystem`."""
        names = ("parameters", "states", "inputs", "outputs", "dynamics", "observe", "initial", "require")
        return {n: getattr(self, n) for n in names} | {"model": self}
