"""Open chains of rigid links: kinematics, energies, equations of motion and static balance of a tree.

A joint connects each link to its parent, or to the base. The frame of a link has its origin in the joint and,
at q = 0, the axes of the parent. With the rotation R and the axis a of the joint, its place d in the parent
(`at`, plus a q of a prismatic joint), the angular velocity w and the velocity v of the origin, in the axes of
the link:

    u = v_p + w_p x d                                   of the parent p at the joint
    w = R^T w_p + a q'          v = R^T u               revolute
    w = w_p                     v = u + a q'            prismatic

A link has the mass m, the first moment h = m c of its centre of mass c, and moments of inertia I about its
origin; r is the place of the origin in the base:

    T = sum m v^2/2 + h . (v x w) + w . I w/2           U = - sum g . (m r + R h)

v^2 is u^2 in a revolute joint and u^2 + 2 q' a . u + q'^2 in a prismatic one. u^2 belongs to a point of the
parent, so the mass of a link counts as a point mass of its parent at d, from the tips to the base ("augmented
bodies", Wittenburg). M, V and G follow from T and U (`fmus.components.mechanics`).

Axes, parents, kinds of joint and numbers that are plain zeros are structure: what they make zero is in no
expression. All other numbers may be symbols.

Signs: x forward, y to the left, z upwards in the base. A revolute joint turns counter-clockwise about its
axis, a prismatic joint moves its link along its axis.

Validity: rigid links without closed loops; joints without friction, which is the user's generalised force.

References: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 2 and 4 (spatial velocity, kinematic
trees); Wittenburg, Dynamics of Systems of Rigid Bodies, 1977 (augmented bodies).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import casadi as ca

from fmus.components.mechanics import EquationsOfMotion, equations_of_motion
from fmus.contract import Scalar, column
from orchestrator.base.errors import Problem

Vector: TypeAlias = tuple[Scalar, Scalar, Scalar]
Joint: TypeAlias = Literal["revolute", "prismatic"]
Twist: TypeAlias = tuple[ca.SX, ca.SX]  # angular and linear velocity, in the axes of the link
Axis: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]
_SWEEPS, _NEWTON_STEPS = 10, 4  # of `Chain.at_rest`
# added to the stiffness there, as share of its trace and in N.m/rad: a joint that gravity does not turn stays
_SHIFT, _LEAST = 1e-9, 1e-30


@dataclass(frozen=True)
class Link:
    """A rigid body, and the joint that connects it to its parent.

    axis      of the joint, in the axes of the parent
    at        place of the joint in the frame of the parent [m]
    parent    index of a link before this one; None: the base
    mass      [kg]
    centre    of mass, in the frame of the link [m]
    inertia   xx, yy, zz, xy, xz, yz of the inertia matrix about the centre of mass, in the axes of the link
              [kg.m2]; "bar": a slender bar from the joint to twice the centre
    follows   index of the link whose coordinate gives that of this one by `law`, such as the first of two
              stages that a chain couples; None: the link has a coordinate of its own
    law       differentiable
    """

    name: str
    joint: Joint
    axis: Axis
    at: Vector = (0, 0, 0)
    parent: int | None = None
    mass: Scalar = 0
    centre: Vector = (0, 0, 0)
    inertia: Sequence[Scalar] | Literal["bar"] = (0, 0, 0, 0, 0, 0)
    follows: int | None = None
    law: Callable[[Scalar], Scalar] = lambda q: q

    @property
    def direction(self) -> ca.SX:
        """a, shape (3, 1)."""
        unit = ca.SX(3, 1)
        unit["xyz".index(self.axis[-1])] = -1 if self.axis[0] == "-" else 1
        return unit

    def angle(self, q: Scalar) -> Scalar:
        """Of the link about the positive axis [rad]."""
        return 0 if self.joint == "prismatic" else -q if self.axis[0] == "-" else q

    def rotation(self, q: Scalar) -> ca.SX:
        """R, shape (3, 3)."""
        return _Turn(None, self.axis[-1], self.angle(q)).matrix

    def place(self, q: Scalar) -> ca.SX:
        """d [m], shape (3, 1)."""
        at = ca.SX(column(*self.at))
        return at if self.joint == "revolute" else at + self.direction * q

    @property
    def body(self) -> Body:
        """Mass and moments about the origin of the link."""
        point = point_mass(self.mass, self.centre)
        if self.inertia == "bar":  # a third of that of the point about the centre, so 4/3 about the joint
            return replace(point, inertia=point.inertia * 4 / 3)
        return replace(point, inertia=point.inertia + column(*self.inertia))


@dataclass(frozen=True)
class Body:
    """Mass [kg], first moment [kg.m], shape (3, 1), and moments of inertia about the origin, shape (6, 1)."""

    mass: Scalar
    moment: ca.SX
    inertia: ca.SX

    def __add__(self, other: Body) -> Body:
        return Body(self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia)

    def kinetic(self, angular: ca.SX, linear: ca.SX) -> Scalar:
        """T without m v^2/2."""
        x, y, z = ca.vertsplit(angular)
        products = column(x**2 / 2, y**2 / 2, z**2 / 2, x * y, x * z, y * z)
        return ca.dot(self.moment, ca.cross(linear, angular)) + ca.dot(self.inertia, products)


def point_mass(mass: Scalar, at: Vector) -> Body:
    """A point mass at a place [m]."""
    x, y, z = at
    inertia = column(y**2 + z**2, x**2 + z**2, x**2 + y**2, -x * y, -x * z, -y * z)
    return Body(mass, ca.SX(mass * column(*at)), ca.SX(mass * inertia))


@dataclass(frozen=True)
class Payload:
    """A body that comes and goes: its mass [kg], at a place in the frame of a link [m].

    inertia   about its centre, of each kilogram [m2]: xx, yy, zz, xy, xz, yz; zeros: a point mass
    """

    link: int
    at: Vector
    mass: Scalar
    inertia: Sequence[Scalar] = (0, 0, 0, 0, 0, 0)

    @property
    def body(self) -> Body:
        """Mass and moments about the origin of the link."""
        point = point_mass(self.mass, self.at)
        return replace(point, inertia=point.inertia + self.mass * column(*self.inertia))


@dataclass(frozen=True)
class Frame:
    """Frame of a link in the base: its axes as columns, shape (3, 3), and its origin [m], shape (3, 1)."""

    rotation: ca.SX
    origin: ca.SX


@dataclass(frozen=True)
class _Turn:
    """Orientation of a link: rotation about one axis of the link `since`, or of the base [rad]."""

    since: int | None
    axis: str
    angle: Scalar

    @property
    def matrix(self) -> ca.SX:
        """Shape (3, 3)."""
        turn, i = ca.SX.eye(3), "xyz".index(self.axis)
        j, k, sin = (i + 1) % 3, (i + 2) % 3, ca.sin(self.angle)
        turn[j, j] = turn[k, k] = ca.cos(self.angle)
        turn[k, j], turn[j, k] = sin, -sin
        return turn


def gravity_on_slope(gravity: Scalar, pitch: Scalar = 0, roll: Scalar = 0) -> Vector:
    """Gravity in the axes of a base that is first turned by `pitch` about y, then by `roll` about its own x.

    As in ISO 8855, positive angles lower the front (pitch) and the right side (roll) [rad].
    """
    down = gravity * ca.cos(pitch)
    return gravity * ca.sin(pitch), -down * ca.sin(roll), -down * ca.cos(roll)


@dataclass(frozen=True)
class Chain:
    """A tree of links under gravity [m/s2], a vector in the base.

    Columns q and speed have an entry for each link that follows no other, in the order of the links.
    """

    links: tuple[Link, ...]
    gravity: Vector = (0, 0, -9.81)

    def __post_init__(self) -> None:
        for i, link in enumerate(self.links):
            rules = {
                f"joint: expected {' or '.join(get_args(Joint))}": link.joint in get_args(Joint),
                f"axis: expected one of {', '.join(get_args(Axis))}": link.axis in get_args(Axis),
                f"parent: expected None or an index below {i}": link.parent is None or 0 <= link.parent < i,
                f"follows: expected None or one of {self._free}": link.follows in (None, *self._free),
                'inertia: expected "bar" or six numbers': link.inertia == "bar" or len(link.inertia) == 6,
            }
            for rule in (rule for rule, kept in rules.items() if not kept):
                raise Problem(f"{link.name}: {rule}, found {getattr(link, rule.partition(':')[0])!r}")

    @property
    def _free(self) -> list[int]:
        return [i for i, link in enumerate(self.links) if link.follows is None]

    def coordinate(self, link: int) -> int:
        """Where the coordinate of a link is in q; of one that follows, the coordinate that it follows."""
        follows = self.links[link].follows
        return self._free.index(link if follows is None else follows)

    def joints(self, q: ca.SX) -> list[Scalar]:
        """Coordinate of each joint."""
        own = [q[self.coordinate(i)] for i in range(len(self.links))]
        return [x if link.follows is None else link.law(x) for link, x in zip(self.links, own, strict=True)]

    def slopes(self, q: ca.SX) -> list[Scalar]:
        """Speed of each joint over that of its coordinate in q: of one that follows, the slope of its law."""
        slopes, s = list[Scalar](), ca.SX.sym("s")
        for i, link in enumerate(self.links):
            slope = 1 if link.follows is None else ca.jacobian(ca.SX(link.law(s)), s)
            slopes.append(slope if link.follows is None else ca.substitute(slope, s, q[self.coordinate(i)]))
        return slopes

    def _rates(self, q: ca.SX, speed: ca.SX) -> list[Scalar]:
        """Speed of each joint."""
        return [slope * speed[self.coordinate(i)] for i, slope in enumerate(self.slopes(q))]

    # ---- kinematics

    def frames(self, q: ca.SX) -> list[Frame]:
        """Forward kinematics: the frame of each link."""
        frames, joints, base = list[Frame](), self.joints(q), Frame(ca.SX.eye(3), ca.SX(3, 1))
        for link, turn, x in zip(self.links, self._turns(joints), joints, strict=True):
            before, since = (base if k is None else frames[k] for k in (link.parent, turn.since))
            origin = before.origin + before.rotation @ link.place(x)
            frames.append(Frame(since.rotation @ turn.matrix, origin))
        return frames

    def position(self, q: ca.SX, link: int, at: Vector = (0, 0, 0)) -> ca.SX:
        """Place of a point of a link in the base [m], shape (3, 1)."""
        frame = self.frames(q)[link]
        return ca.SX(frame.origin + frame.rotation @ column(*at))

    def velocity(self, q: ca.SX, speed: ca.SX, link: int, at: Vector = (0, 0, 0)) -> ca.SX:
        """Velocity of a point of a link [m/s], shape (3, 1)."""
        s = ca.SX.sym("q", q.shape[0])
        return ca.substitute(ca.jtimes(self.position(s, link, at), s, speed), s, q)

    def generalised_force(self, q: ca.SX, force: ca.SX, link: int, at: Vector = (0, 0, 0)) -> ca.SX:
        """J^T f of a force [N] on a point of a link, in the axes of the base; J is d(position)/dq."""
        s = ca.SX.sym("q", q.shape[0])
        return ca.substitute(ca.jtimes(self.position(s, link, at), s, force, True), s, q)

    # ---- energies and motion

    def _augmented(self, joints: Sequence[Scalar], payload: Payload | None) -> list[Body]:
        """Each link with the masses of all links beyond it, as points in their joints."""
        bodies = [link.body for link in self.links]
        if payload:
            bodies[payload.link] += payload.body
        for i, link in reversed([*enumerate(self.links)]):
            if link.parent is not None:
                x, y, z = ca.vertsplit(link.place(joints[i]))
                bodies[link.parent] += point_mass(bodies[i].mass, (x, y, z))
        return bodies

    def _turns(self, joints: Sequence[Scalar]) -> list[_Turn]:
        """Orientation of each link. Angles about parallel axes add up, for smaller terms."""
        turns: list[_Turn] = []
        for link, x in zip(self.links, joints, strict=True):
            before = _Turn(None, "z", 0) if link.parent is None else turns[link.parent]
            if link.joint == "revolute":
                angle, parallel = link.angle(x), link.axis[-1] == before.axis
                before = (
                    replace(before, angle=before.angle + angle)
                    if parallel
                    else (_Turn(link.parent, link.axis[-1], angle))
                )
            turns.append(before)
        return turns

    def kinetic(self, q: ca.SX, speed: ca.SX, payload: Payload | None = None) -> Scalar:
        """Kinetic energy [J]."""
        joints, rates, twists, spins = self.joints(q), self._rates(q, speed), list[Twist](), list[ca.SX]()
        energy: Scalar = 0
        turns, bodies = self._turns(joints), self._augmented(joints, payload)
        for i, (link, turn, body) in enumerate(zip(self.links, turns, bodies, strict=True)):
            w, v = (ca.SX(3, 1), ca.SX(3, 1)) if link.parent is None else twists[link.parent]
            u, motion = v + ca.cross(w, link.place(joints[i])), link.direction * rates[i]
            # its angular velocity in the axes of turn.since
            spin = w if link.parent in (None, turn.since) else spins[link.parent]
            if link.joint == "revolute":
                spin = spin + motion
                w, v = turn.matrix.T @ spin, link.rotation(joints[i]).T @ u
            else:
                v = u + motion
                energy += body.mass * (ca.dot(motion, u) + rates[i] ** 2 / 2)
            energy += body.kinetic(w, v)
            twists.append((w, v))
            spins.append(spin)
        return energy

    def potential(self, q: ca.SX, payload: Payload | None = None) -> Scalar:
        """Potential energy of gravity [J], zero at the origin of the base."""
        joints, directions = self.joints(q), list[ca.SX]()
        down, energy = ca.SX(column(*self.gravity)), ca.SX(0)
        bodies, turns = self._augmented(joints, payload), self._turns(joints)
        for link, turn, body, x in zip(self.links, turns, bodies, joints, strict=True):
            if link.parent is None:
                energy -= body.mass * ca.dot(down, link.place(x))
            directions.append(turn.matrix.T @ (down if turn.since is None else directions[turn.since]))
            energy -= ca.dot(directions[-1], body.moment)
        return energy

    def equations(self, q: ca.SX, speed: ca.SX, payload: Payload | None = None) -> EquationsOfMotion:
        """M, V, G, the energies, and what a kilogram of the payload adds."""
        m = ca.SX.sym("payload_mass")
        load = payload and replace(payload, mass=m)
        energies = (lambda s, w: self.kinetic(s, w, load)), (lambda s: self.potential(s, load))
        return equations_of_motion(*energies, q, speed, (m, payload.mass) if payload else None)

    def at_rest(
        self,
        q: ca.SX,
        passive: Sequence[int],
        payload: Payload | None = None,
        springs: Mapping[int, Scalar] | None = None,
    ) -> ca.SX:
        """Static balance: q with the angles at which the passive links hang at rest; other joints are held.

        q holds a guess of these angles. Over one angle alone U is a sinusoid, with its minimum at
        q - atan2(U', U''). Sweeps over the joints with this rule come near a minimum, Newton's method finds
        it to rounding. Their number is fixed, so that the result is an expression. For the two axes of a
        hanging head any guess will do, for three passive joints one within 0.5 rad of their rest.

        springs   link -> stiffness of its joint, which is without force at 0
        """
        springs = springs or {}
        for link in (
            self.links[i] for i in passive if self.links[i].joint != "revolute" and i not in springs
        ):
            raise Problem(f"{link.name}: expected a revolute joint at rest, found a {link.joint} one")
        q, s = ca.densify(ca.SX(q)), ca.SX.sym("q", q.shape[0])
        at = [self.coordinate(link) for link in passive]
        elastic = sum((k * s[self.coordinate(i)] ** 2 / 2 for i, k in springs.items()), ca.SX(0))
        slopes = ca.gradient(self.potential(s, payload) + elastic, s)[at]
        terms = [slopes, ca.jacobian(slopes, s[at])]
        for k, i in [*enumerate(at)] * _SWEEPS:
            slope, stiffness = ca.substitute(terms, [s], [ca.densify(q)])
            newton, ratio = passive[k] in springs, slope[k] / stiffness[k, k]
            q[i] -= ratio if newton else ca.atan2(slope[k], stiffness[k, k])
        for _ in range(_NEWTON_STEPS if at else 0):
            slope, stiffness = ca.substitute(terms, [s], [ca.densify(q)])
            shift = _SHIFT * ca.trace(stiffness) + _LEAST
            q[at] -= ca.ldl_solve(slope, *ca.ldl(stiffness + shift * ca.SX.eye(len(at))))
        return q
