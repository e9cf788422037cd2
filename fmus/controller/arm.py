"""What the controller knows of a machine: its axes, and the kinematics of its arm.

The first axis turns the column with a motor. The others have cylinders and move the tip in the plane of the
arm. Coordinates q are in the order of the axes; the columns of the Jacobian of the tip are those of the arm,
without the column's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import casadi as ca

from fmus.components.mechanics import Point
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Scalar
from fmus.controller.valve import Actuator

GRAVITY = 9.81  # m/s2
LARGEST_MASS = 1e5  # kg, at the tip
LEAST_ARM = 0.1  # m: keeps the mass at the tip finite for an arm that stands upright
LEAST_LEVER = 0.05  # m or 1: a fifth of what cylinders have; keeps inertia and force finite at a dead centre
Coordinates = Sequence[Scalar]  # of the axes [rad or m]
Pistons = list[tuple[Scalar, Scalar]]  # (position x [m], lever dx/dq [m or 1]) of each axis; column: (q, 1)


@dataclass(frozen=True)
class ControlledAxis:
    """An axis, and what its variables mean.

    name         of the axis
    kind         of its joint: "column", "revolute" or "prismatic"
    lever        what a positive command does
    coordinate   name and description of its coordinate; its speed likewise
    sides        names of both pressures, head side (A) first, with their descriptions
    valve        begin of the names of its valve's parameters
    """

    name: str
    kind: str
    lever: str
    coordinate: tuple[str, str]
    speed: tuple[str, str]
    sides: tuple[tuple[str, str], tuple[str, str]]
    valve: str

    @property
    def turns(self) -> bool:
        """Whether it is the column."""
        return self.kind == "column"

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


@dataclass(frozen=True)
class Choice:
    """How the joints of the arm share the velocity of the tip.

    largest   square of the determinant of the columns, weighted, in the pose farthest from a singular one
    weights   what the squares of their speeds count
    wish      speeds that they are to have as far as the tip leaves it open; (): as small as possible
    """

    largest: Scalar
    weights: Sequence[Scalar]
    wish: Sequence[Scalar] = ()


class Arm(ABC):
    """A machine as its controller knows it, from parameters p of the group that it declares."""

    axes: tuple[ControlledAxis, ...]
    parameters: tuple[type[Group], ...]

    @abstractmethod
    def point(self, q: Coordinates, p: Any) -> Point:
        """Radius and height of the tip [m]."""

    @abstractmethod
    def columns(self, q: Coordinates, p: Any) -> list[Point]:
        """Of the Jacobian of the tip: d(radius, height)/dq of each joint of the arm."""

    @abstractmethod
    def choice(self, columns: Sequence[Point], q: Coordinates, velocity: Cylindrical, p: Any, /) -> Choice:
        """Of the joint speeds that give the tip this velocity."""

    @abstractmethod
    def pistons(self, q: Coordinates, p: Any) -> Pistons:
        """Positions and levers of the actuators."""

    @abstractmethod
    def actuators(self, positions: Sequence[Scalar], p: Any) -> dict[str, Actuator]:
        """Each axis with its actuator at this position."""

    @abstractmethod
    def valve(self, axis: ControlledAxis, p: Any) -> Valve:
        """The valve of an axis."""

    @abstractmethod
    def derive(self, p: Any) -> dict[str, Scalar]:
        """Derived parameters."""

    # ---- what follows

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
        return Cylindrical(*self.point(q, p), q[0])

    def tip_velocity(self, q: Coordinates, speeds: Coordinates, p: Any) -> Cylindrical:
        """Velocity of the tip."""
        moved = [(s * r, s * h) for s, (r, h) in zip(speeds[1:], self.columns(q, p), strict=True)]
        return Cylindrical(sum(r for r, _ in moved), sum(h for _, h in moved), speeds[0])

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
        choice = self.choice(columns, q, velocity, p)
        weights, wish = choice.weights, choice.wish or [0] * len(columns)
        square: Scalar = 0
        for (c, w), (d, v) in combinations(zip(columns, weights, strict=True), 2):
            square += (c[0] * d[1] - d[0] * c[1]) ** 2 / (w * v)
        sine_square = square / choice.largest
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
        found = (z + (c[0] * y1 + c[1] * y2) / w for z, c, w in zip(wish, columns, weights, strict=True))
        return (velocity.angle, *found)


def distance(a: Cylindrical, b: Cylindrical) -> Scalar:
    """Distance [m] of two positions, smoothed near zero so that it is differentiable; error below 1 um."""
    square = (a.radius - b.radius) ** 2 + (a.height - b.height) ** 2
    square += 4 * a.radius * b.radius * ca.sin((a.angle - b.angle) / 2) ** 2
    smoothing = 1e-6
    return ca.sqrt(square + smoothing**2) - smoothing
