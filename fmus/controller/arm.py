"""What the controller knows of a machine: its axes, and the kinematics of its arm.

The first axis turns the column with a motor. The others have cylinders and move the tip in the plane of the
arm, two or more; it may lie beside the axis of the column. Coordinates q are in the order of the axes;
the columns of the Jacobian of the tip are those of the arm, without the column's.

Two revolute joints give the tip a velocity in one way. Other arms can do it in many ways, or have joints of
different kinds: of these ways the one that needs least oil,

    W_i = (A_i J_i)^2        A_i J_i: oil per motion of the joint, the mean of both sides

and with more than two joints it leads each piston to the middle of its stroke: by `centring` times the speed
of the tip if it is at an end, proportional to the distance between, as far as this does not move the tip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from fmus.components.chain import Vector
from fmus.components.mechanics import Point
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Quantity, Scalar, column, flat, nested, quantities
from fmus.controller.valve import Actuator
from fmus.drives import cylinder, motor
from fmus.joints import JointModel, kinematics
from fmus.smooth import positive
from orchestrator.base.errors import Problem

GRAVITY = 9.81  # m/s2
LARGEST_MASS = 1e5  # kg, at the tip
LEAST_ARM = 0.1  # m: keeps the mass at the tip finite for an arm that stands upright
LEAST_LEVER = 0.05  # m or 1: a fifth of what cylinders have; keeps inertia and force finite at a dead centre
NEAR = 0.05  # of a stroke: distance from an end over which a joint grows heavy
STRETCHED = 25  # square of the trace over the determinant that counts as 1: of two equal links, near a line
SLOW = 1e-4  # m/s: rounds the speed of the tip at rest
LEAST_SHARE = 1e-3  # of the weight of a joint in that of all: keeps the quotients finite at a small lever
STEPS, LARGEST_STEP, CLOSE = 500, 0.1, 1e-10  # of the search for a pose; m, m
COUNTER = "counter-clockwise from above"
Coordinates = Sequence[Scalar]  # of the axes [rad or m]
Pistons = list[tuple[Scalar, Scalar]]  # (position x [m], lever dx/dq [m or 1]) of each axis; column: (q, 1)


@dataclass(frozen=True)
class ControlledAxis:
    """An axis, and what its variables mean.

    name         of the axis
    kind         of its joint: "column", "revolute" or "prismatic"
    lever        what a positive command does
    coordinate   name and description of its coordinate; its speed likewise
    """

    name: str
    kind: str
    lever: str
    coordinate: tuple[str, str]
    speed: tuple[str, str]

    @property
    def turns(self) -> bool:
        """Whether it is the column."""
        return self.kind == "column"

    @property
    def sides(self) -> list[tuple[str, str]]:
        """Names of both pressures, head side (A) first, with their descriptions."""
        n = self.name
        if self.turns:
            return [(f"{n}_pressure_{side.lower()}", f"Pressure of {n} line {side}") for side in "AB"]
        at = "Pressure at the {} side of the {} cylinder"
        return [(f"{n}_{side}_pressure", at.format(side, n)) for side in ("head", "rod")]

    @property
    def loop(self) -> str:
        """Begin of the names of its gains."""
        return self.name if self.turns else "piston"

    @property
    def units(self) -> tuple[str, str]:
        """Of coordinate and speed."""
        return ("m", "m/s") if self.kind == "prismatic" else ("rad", "rad/s")


@dataclass(frozen=True)
class Cylindrical:
    """Position [m, m, rad] or velocity [m/s, m/s, rad/s] in cylindrical coordinates about the column."""

    radius: Scalar
    height: Scalar
    angle: Scalar


class Centring(Group):
    """Of an arm with more joints than the plane needs."""

    centring: Scalar = Quantity(
        "1",
        "Speed of a piston at an end of its stroke towards the middle, over that of the tip",
        0.1,
        minimum=0.0,
        group="Reference",
    )


@dataclass(frozen=True)
class Arm:
    """A machine as its controller knows it, from parameters p of the groups that it declares.

    axes         the column first
    parameters   groups of its subsystems' parameters
    joints       from the base to the tip: those of the axes in their order, and joints that follow them
    tip_at       (p) -> place of the tip in the frame of the last link
    hydraulics   (name of an axis, p) -> its valve, density of its oil
    """

    axes: tuple[ControlledAxis, ...]
    parameters: tuple[type[Group], ...]
    joints: tuple[JointModel, ...]
    tip_at: Callable[[Any], Vector]
    hydraulics: Callable[[str, Any], tuple[Valve, Scalar]]

    # ---- geometry

    def _place(self, q: ca.SX, p: Any) -> ca.SX:
        """Of the tip, about the axis of the column at 0: radius, height [m], angle [rad]; q: of the arm.

        The angle is that of an arm beside the axis, atan(y/x); else 0.
        """
        at = kinematics(self.joints, p).position(ca.vertcat(0, q), len(self.joints) - 1, self.tip_at(p))
        x, y = (at[k] - self.joints[0].link(p).at[k] for k in (0, 1))
        if y.is_zero():
            return ca.vertcat(x, at[2], 0)
        return ca.vertcat(ca.sqrt(x**2 + y**2), at[2], ca.atan2(y, x))

    def point(self, q: Coordinates, p: Any) -> Point:
        """Radius and height of the tip [m]."""
        radius, height, _ = ca.vertsplit(self._place(ca.SX(column(*q[1:])), p))
        return radius, height

    def _jacobian(self, q: Coordinates, p: Any) -> list[list[ca.SX]]:
        """Rows: d(radius, height, angle)/dq of the joints of the arm."""
        s = ca.SX.sym("q", len(q) - 1)
        found = ca.substitute(ca.jacobian(self._place(s, p), s), s, ca.SX(column(*q[1:])))
        return [[found[i, k] for k in range(len(q) - 1)] for i in range(3)]

    def columns(self, q: Coordinates, p: Any) -> list[Point]:
        """Of the Jacobian of the tip: d(radius, height)/dq of each joint of the arm."""
        return [*zip(*self._jacobian(q, p)[:2], strict=True)]

    def _turned(self, q: Coordinates, speeds: Coordinates, p: Any) -> Scalar:
        """Speed at which the joints of the arm turn the tip about the axis of the column [rad/s]."""
        return sum(r * s for r, s in zip(self._jacobian(q, p)[2], speeds, strict=True))

    def pistons(self, q: Coordinates, p: Any) -> Pistons:
        """Positions and levers of the actuators."""
        driven = [j.drive(p) for j in self.joints if j.drive]
        found = [drive.at(x) for drive, x in zip(driven, q[1:], strict=True)]
        return [(q[0], 1), *((t.position, t.arm) for t in found)]

    def choice(
        self, columns: Sequence[Point], q: Coordinates, velocity: Cylindrical, p: Any
    ) -> tuple[Scalar, Sequence[Scalar], Sequence[Scalar]]:
        """How the joints of the arm share this velocity of the tip.

        The square of the determinant of the columns, weighted, in the pose farthest from a singular one; what
        the squares of their speeds count; speeds that they are to have as far as the tip leaves it open.
        """
        if [j.link(p).joint for j in self.joints[1:]] == ["revolute"] * 2:
            # the largest determinant is |upper| |lower|, of links at a right angle: the first column is
            # perpendicular to the sum of both links, the other to the lower one
            (a, c), (b, d) = columns
            return ((a - b) ** 2 + (c - d) ** 2) * (b**2 + d**2), (1, 1), (0, 0)
        own, pistons = [getattr(p, a.name) for a in self.axes[1:]], self.pistons(q, p)[1:]
        oil = [(sum(o.areas) / 2 * lever) ** 2 for o, (_, lever) in zip(own, pistons, strict=True)]
        weights = [w / sum(oil) + LEAST_SHARE for w in oil]
        for k, (o, (x, _)) in enumerate(zip(own, pistons, strict=True)):
            room = positive(ca.fmin(x, o.stroke - x) - p.stroke_margin, p.stroke_margin / 10)
            weights[k] *= 1 + (NEAR * o.stroke / room) ** 2
        trace = sum((x**2 + z**2) / w for (x, z), w in zip(columns, weights, strict=True))
        wish: list[Scalar] = [0] * len(weights)
        if len(weights) > 2:
            speed = p.centring * (ca.sqrt(velocity.radius**2 + velocity.height**2 + SLOW**2) - SLOW)
            wish = [
                speed * (1 - 2 * x / o.stroke) / lever for o, (x, lever) in zip(own, pistons, strict=True)
            ]
        return trace**2 / STRETCHED, weights, wish

    def search(self, p: Any) -> tuple[ca.Function, ca.Function]:
        """(q, place) -> q with the tip nearer to the place, by Newton's method; (q, place) -> distance."""
        q, place = ca.SX.sym("q", len(self.axes)), ca.SX.sym("place", 3)
        at = ca.vertsplit(q)
        tip = self.tip(at, p)
        away = [a - b for a, b in zip(ca.vertsplit(place), (tip.radius, tip.height, tip.angle), strict=True)]
        length = ca.sqrt(away[0] ** 2 + away[1] ** 2 + (tip.radius * away[2]) ** 2)
        share = LARGEST_STEP / ca.fmax(length, LARGEST_STEP)
        speeds = self.joint_speeds(at, Cylindrical(*(share * x for x in away)), p)
        nearer = ca.Function("nearer", [q, place], [q + column(*speeds)])
        return nearer, ca.Function("distance", [q, place], [length])

    def pose(self, tip: Sequence[float], start: Sequence[float], p: Any, ends: bool = True) -> list[float]:
        """Coordinates with the tip at a place; a Problem if the arm does not reach there.

        The search moves the tip from a start pose straight to the place, as the controller would.

        tip    radius [m], height [m], angle [rad]
        p      numbers
        ends   whether the strokes have to reach there, or the links alone
        """
        (nearer, distance_of), now = self.search(p), [tip[2], *start[1:]]
        for _ in range(STEPS):
            after = nearer(now, tip).full()[:, 0].tolist()
            if distance_of(now, tip) < CLOSE or not np.isfinite(after).all():  # a linkage that does not close
                break
            now = after
        asked = f"tip at radius {tip[0]:g} m, height {tip[1]:g} m"
        if not distance_of(now, tip) < CLOSE:
            radius, height = map(float, self.point(now, p))
            raise Problem(
                f"{asked}: out of reach, the arm comes to radius {radius:.3g} m, height {height:.3g} m"
            )
        for a, (x, _) in zip(self.axes[1:], self.pistons(now, p)[1:], strict=True):
            stroke = getattr(p, a.name).stroke
            if ends and not 0 < float(x) < stroke:
                place = f"the piston of {a.name} would be at {float(x):.3f} m"
                raise Problem(f"{asked}: {place}, expected 0 to {stroke:.3f} m")
        return now

    # ---- hydraulics

    def actuators(self, positions: Sequence[Scalar], p: Any) -> dict[str, Actuator]:
        """Each axis with its actuator at this position."""
        found = dict[str, Actuator]()
        for a, position in zip(self.axes, positions, strict=True):
            own, (valve, density) = getattr(p, a.name), self.hydraulics(a.name, p)
            flow = getattr(p, f"{a.name}_section_flow")
            if a.turns:
                d, c = own.displacement, own.line.capacitance
                found[a.name] = Actuator(d, d, c, c, own.line.friction(p), valve, density, (flow, flow))
            else:
                c_head, c_rod = (own.hose.capacitance + v / p.bulk_modulus for v in own.volumes(position))
                (head, rod), friction = own.areas, own.hose.friction(p)
                flows = flow, getattr(p, f"{a.name}_rod_section_flow")
                found[a.name] = Actuator(head, rod, c_head, c_rod, friction, valve, density, flows)
        return found

    def valve(self, axis: ControlledAxis, p: Any) -> Valve:
        """The valve of an axis."""
        return self.hydraulics(axis.name, p)[0]

    def derive(self, p: Any) -> dict[str, Scalar]:
        """Hoses and lines by the equations of the drives."""
        found = dict[str, Scalar]()
        for a in self.axes:
            of, full = (motor if a.turns else cylinder), flat(getattr(names_in(p), a.name))
            found |= {full[n]: x for n, x in of.derive(getattr(p, a.name), p).items()}
        return found

    # ---- variables and motion

    def coordinates(self, values: Any, pattern: str = "") -> Coordinates:
        """From variables of the machine, or with a pattern of their names."""
        names = [pattern.format(a.name) if pattern else a.coordinate[0] for a in self.axes]
        return tuple(getattr(values, n) for n in names)

    def speeds(self, u: Any) -> Coordinates:
        """Measured speeds."""
        return tuple(getattr(u, a.speed[0]) for a in self.axes)

    def pressures(self, u: Any) -> dict[str, tuple[Scalar, Scalar]]:
        """Measured pressures [Pa] of each axis: head side (A), rod side (B)."""
        return {a.name: (getattr(u, a.sides[0][0]), getattr(u, a.sides[1][0])) for a in self.axes}

    def tip(self, q: Coordinates, p: Any) -> Cylindrical:
        """Position of the tip."""
        radius, height, angle = ca.vertsplit(self._place(ca.SX(column(*q[1:])), p))
        return Cylindrical(radius, height, q[0] + angle)

    def tip_velocity(self, q: Coordinates, speeds: Coordinates, p: Any) -> Cylindrical:
        """Velocity of the tip."""
        moved = [(s * r, s * h) for s, (r, h) in zip(speeds[1:], self.columns(q, p), strict=True)]
        angle = speeds[0] + self._turned(q, speeds[1:], p)
        return Cylindrical(sum(r for r, _ in moved), sum(h for _, h in moved), angle)

    def carried(
        self,
        q: Coordinates,
        pistons: Pistons,
        speeds: Coordinates,
        rates: Coordinates,
        loads: Coordinates,
        p: Any,
    ) -> list[tuple[Scalar, Scalar]]:
        """Of each axis: the inertia that it moves, and the force for it, with a point mass at the tip.

            M = sum_i T_i h_i/(g sum_i h_i^2)        m = M |c_i|^2/lever_i^2        F = M c_i . a/lever_i
            a = (sum_i c_i q_i'' - r w^2, r w' + 2 r' w)        of the column m = M r^2, F = M r a_3

        T_i = lever_i F_i is the torque [N.m or N] of the steady load of an axis, c_i = (r_i, h_i) its column
        of the Jacobian, a the acceleration of the tip without that of a Jacobian that changes, w the speed of
        the column. The least squares over all axes does not fail where one of them carries nothing. The arm's
        own mass counts by its weight at the tip, which is more than its inertia. M is between 0 and
        `LARGEST_MASS`, a below g in each direction. Near a dead centre, which a broken angle sensor may read,
        lever_i in m is at least `LEAST_LEVER`, and F falls to 0 there.

        speeds, rates   of the joints, and their time derivatives
        loads           F_i [N, N.m]
        """
        columns, radius = self.columns(q, p), self.point(q, p)[0]
        levers = [lever for _, lever in pistons[1:]]
        weight = sum(f * lever * h for f, lever, (_, h) in zip(loads[1:], levers, columns, strict=True))
        mass = weight / (GRAVITY * (sum(h**2 for _, h in columns) + LEAST_ARM**2))
        mass = ca.fmin(ca.fmax(0, mass), LARGEST_MASS)

        def along(k: int, of: Coordinates) -> Scalar:
            return sum(c[k] * w for c, w in zip(columns, of[1:], strict=True))

        outwards, upwards, sideways = (
            ca.fmin(ca.fmax(-GRAVITY, a), GRAVITY)
            for a in (
                along(0, rates) - radius * speeds[0] ** 2,
                along(1, rates),
                radius * rates[0] + 2 * along(0, speeds) * speeds[0],
            )
        )
        found = [(mass * radius**2, mass * radius * sideways)]
        for lever, (r, h) in zip(levers, columns, strict=True):
            torque, square = mass * (r * outwards + h * upwards), ca.fmax(lever**2, LEAST_LEVER**2)
            found.append((mass * (r**2 + h**2) / square, torque * lever / square))
        return found

    def joint_speeds(self, q: Coordinates, velocity: Cylindrical, p: Any) -> Coordinates:
        """Speeds of the axes that give the tip a velocity; the arm's by damped least squares.

            q' = z + W^-1 J^T (J W^-1 J^T + l^2 I)^-1 (v - J z)        z: the wish

        (Nakamura and Hanafusa 1986), with the weights W; of two joints J^-1 v. The damping l is 0 if the sine
        of the angle between the links exceeds `singular_share`; below, l rises continuously to
        `singular_damping` in the singular position, with collinear links.
        """
        columns = self.columns(q, p)
        largest, weights, wish = self.choice(columns, q, velocity, p)
        square: Scalar = 0
        for (c, w), (d, v) in combinations(zip(columns, weights, strict=True), 2):
            square += (c[0] * d[1] - d[0] * c[1]) ** 2 / (w * v)
        sine_square = square / largest
        singularity = ca.fmax(0, 1 - sine_square / (p.singular_share**2 + 1e-12))
        damping_square = p.singular_damping**2 * singularity**2
        # (J W^-1 J^T + l^2 I) y = v - J z by Cramer's rule
        m11, m12, m22 = (
            sum(c[i] * c[j] / w for c, w in zip(columns, weights, strict=True))
            for i, j in ((0, 0), (0, 1), (1, 1))
        )
        determinant = square + damping_square * (m11 + m22) + damping_square**2
        m11, m22 = m11 + damping_square, m22 + damping_square
        radius = velocity.radius - sum(z * c[0] for z, c in zip(wish, columns, strict=True))
        height = velocity.height - sum(z * c[1] for z, c in zip(wish, columns, strict=True))
        y1 = (m22 * radius - m12 * height) / determinant
        y2 = (m11 * height - m12 * radius) / determinant
        found = [z + (c[0] * y1 + c[1] * y2) / w for z, c, w in zip(wish, columns, weights, strict=True)]
        return (velocity.angle - self._turned(q, found, p), *found)


def names_in(p: Any) -> Any:
    """A group like p with the names of its variables."""
    return nested(type(p), {n: n for n in quantities(type(p))})


def distance(a: Cylindrical, b: Cylindrical) -> Scalar:
    """Distance [m] of two positions, smoothed near zero so that it is differentiable; error below 1 um."""
    square = (a.radius - b.radius) ** 2 + (a.height - b.height) ** 2
    square += 4 * a.radius * b.radius * ca.sin((a.angle - b.angle) / 2) ** 2
    smoothing = 1e-6
    return ca.sqrt(square + smoothing**2) - smoothing
