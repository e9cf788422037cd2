"""Drives of joints: the position x of an actuator over the joint coordinate q, and its derivatives.

    J = dx/dq       x' = J q'       x'' = J q'' + J' q'^2 with J' = dJ/dq       tau = J F

x is the position of a piston from the closed end, or the angle of a motor, F the force or torque along x.
tau q' = F x', so a drive stores and loses nothing.

    motor       x = i q                       i ratio of the gear
    cylinder    x = |R(q) r - f| - l          f base pin, r rod pin, l length of the closed cylinder
    four-bar    x = |C(q) - f| - l            C end of the rocker, at the coupler and the rod
    telescope   x = q - l                     l coordinate with the cylinder closed

**Four-bar linkage.** A rocker of length a turns about the pin s of the fixed link. The rod of the cylinder
moves its end C, and from there a coupler of length b moves the pin r of the moving link. With d = R(q) r - s
and D = |d|, C is where two circles meet, a about s and b about R(q) r:

    C = s + u d + w (-d_z, d_x)       u = (D^2 + a^2 - b^2) / (2 D^2)       w = +-sqrt(a^2/D^2 - u^2)

The rod is at C, or beside it, at (e, f) along and across the rocker from its pin.

With the sign +, C is on the left of the line from the rocker's pin to the link's: above it if the line points
forwards. The linkage closes while |a - b| < D < a + b. At these limits rocker and coupler are in line and J
is infinite; beyond them x is not a number.

Signs: points (x, z) are relative to the joint [m], in the plane of the joint, with q counter-clockwise: for a
joint about -y, x forward and z upwards. J > 0 if x increases with q.

Validity: all pins in one plane; rocker, coupler, barrel and rod are without mass here: they are links that
follow the joint (`fmus.crane.manipulator`), or what they weigh belongs to the links at their pins.

References: cylinder, paper eqs. 5 to 7; four-bar, Norton, Design of Machinery, chapter 4 (position analysis).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import casadi as ca

from fmus.components.mechanics import Point, rotate, triangle
from fmus.contract import Scalar


@dataclass(frozen=True)
class Transmission:
    """Position x of an actuator [m or rad], J = dx/dq and dJ/dq at one joint coordinate."""

    position: Scalar
    arm: Scalar
    arm_derivative: Scalar

    def velocity(self, speed: Scalar) -> Scalar:
        """x' at the joint speed q'."""
        return self.arm * speed

    def acceleration(self, speed: Scalar, acceleration: Scalar) -> Scalar:
        """x'' at q' and q''."""
        return self.arm * acceleration + self.arm_derivative * speed**2

    def effort(self, force: Scalar) -> Scalar:
        """Torque or force tau on the joint of a force or torque F of the actuator."""
        return self.arm * force


def direction(of: Cylinder | FourBar, q: Scalar) -> Scalar:
    """Angle of a cylinder from its base pin to its rod pin, in the frame of the fixed link [rad]."""
    x, z = of.rod_end(q)
    return ca.atan2(z - of.base[1], x - of.base[0])


def length(of: Cylinder | FourBar, q: Scalar) -> Scalar:
    """From pin to pin [m]."""
    x, z = of.rod_end(q)
    return ca.sqrt((x - of.base[0]) ** 2 + (z - of.base[1]) ** 2)


class Drive(Protocol):
    """What moves a joint."""

    def at(self, q: Scalar, /) -> Transmission:
        """Its position and derivatives at a joint coordinate."""


@dataclass(frozen=True)
class Motor:
    """A motor with a gear: `ratio` turns of the motor for one of the joint."""

    ratio: Scalar = 1

    def at(self, q: Scalar) -> Transmission:
        """x = i q."""
        return Transmission(self.ratio * q, self.ratio, 0)


@dataclass(frozen=True)
class Telescope:
    """A cylinder along a prismatic joint; `closed`: coordinate at which it is closed [m]."""

    closed: Scalar = 0

    def at(self, q: Scalar) -> Transmission:
        """x = q - l."""
        return Transmission(q - self.closed, 1, 0)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder between a pin of the fixed and a pin of the moving link; `closed`: its closed length [m]."""

    base: Point
    rod: Point
    closed: Scalar

    def rod_end(self, q: Scalar) -> Point:
        """R(q) r."""
        return rotate(ca.cos(q), ca.sin(q), self.rod)

    def at(self, q: Scalar) -> Transmission:
        """The triangle of joint and pins."""
        sides = triangle(q, self.base, self.rod)
        return Transmission(sides.length - self.closed, sides.arm, sides.arm_derivative)


@dataclass(frozen=True)
class FourBar:
    """A cylinder on the rocker of a four-bar linkage.

    base, closed      pin of the cylinder on the fixed link; its closed length [m]
    pivot, rocker     pin of the rocker on the fixed link; its length [m]
    coupler, pin      length of the coupler [m]; its pin on the moving link
    assembly          side of the line from `pivot` to `pin` on which rocker and coupler meet
    rod               pin of the rod, along and across the rocker from its pin [m]; None: at the coupler
    """

    base: Point
    closed: Scalar
    pivot: Point
    rocker: Scalar
    coupler: Scalar
    pin: Point
    assembly: Literal["above", "below"]
    rod: Point | None = None

    def _line(self, q: Scalar) -> Point:
        """d: from the rocker's pin to the link's."""
        x, z = rotate(ca.cos(q), ca.sin(q), self.pin)
        return x - self.pivot[0], z - self.pivot[1]

    def rocker_end(self, q: Scalar) -> Point:
        """C: end of the rocker, at the coupler [m]."""
        x, z = self._line(q)
        square = x**2 + z**2
        along = (square + self.rocker**2 - self.coupler**2) / (2 * square)
        across = ca.sqrt(self.rocker**2 / square - along**2)
        if self.assembly == "below":
            across = -across
        return self.pivot[0] + along * x - across * z, self.pivot[1] + along * z + across * x

    def rod_end(self, q: Scalar) -> Point:
        """C, or the pin beside it."""
        end = self.rocker_end(q)
        if self.rod is None:
            return end
        along = [(end[k] - self.pivot[k]) / self.rocker for k in (0, 1)]
        x, z = rotate(along[0], along[1], self.rod)
        return self.pivot[0] + x, self.pivot[1] + z

    def angles(self, q: Scalar) -> Point:
        """Of rocker and coupler in the frame of the fixed link, upwards [rad]."""
        (x, z), pin = self.rocker_end(q), rotate(ca.cos(q), ca.sin(q), self.pin)
        return ca.atan2(z - self.pivot[1], x - self.pivot[0]), ca.atan2(pin[1] - z, pin[0] - x)

    def at(self, q: Scalar) -> Transmission:
        """Derivatives by differentiation of the closed form."""
        s = ca.SX.sym("q")
        position = length(self, s) - self.closed
        arm = ca.jacobian(position, s)
        terms = [position, arm, ca.jacobian(arm, s)]
        return Transmission(*ca.substitute(terms, [s], [ca.SX(q)]))

    def margin(self, q: Scalar) -> Scalar:
        """Distance of D from the limits within which the linkage closes [m], negative beyond them."""
        x, z = self._line(q)
        distance = ca.sqrt(x**2 + z**2)
        return ca.fmin(self.rocker + self.coupler - distance, distance - ca.fabs(self.rocker - self.coupler))
