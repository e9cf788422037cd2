"""One stroke of a lever: a trapezoid over time, as a joystick amplifier ramps its valve current.

    command |    ______
            |   /      \\
          0 |__/        \\____     start, then rise, hold and fall
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from fmus.contract import Scalar

AHEAD = 5e-7  # s, see `sample`


@dataclass(frozen=True)
class Stroke:
    """Begin [s], command at the top [V], durations of ramp up, top and ramp back [s]."""

    start: Scalar
    command: Scalar
    rise: Scalar
    hold: Scalar
    fall: Scalar


def sample(stroke: Stroke, time: Scalar) -> tuple[Scalar, Scalar]:
    """Command [V] and its rate [V/s] at `time` [s]; at a corner the rate to the right of it.

    It is looked for 0.5 us ahead: a clock that adds up steps may be short of a corner by rounding (measured:
    0.3 us after an hour in steps of 1 ms), and the rate of the left side would hold for one step more.
    """
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    end = down + s.fall
    rising, falling = s.command / _not_zero(s.rise), -s.command / _not_zero(s.fall)
    pieces = (
        (s.start, 0, 0),
        (up, rising * (time - s.start), rising),
        (down, s.command, 0),
        (end, falling * (time - end), falling),
    )
    value: Scalar = 0
    rate: Scalar = 0
    for corner, value_before, rate_before in reversed(pieces):
        before = time + AHEAD < corner
        value = ca.if_else(before, value_before, value)
        rate = ca.if_else(before, rate_before, rate)
    return value, rate


def wait(stroke: Stroke, time: Scalar) -> Scalar:
    """Seconds from `time` to the next corner, as `sample` sees it; infinite for none."""
    s = stroke
    up = s.start + s.rise
    down = up + s.hold
    found: Scalar = math.inf
    for corner in (down + s.fall, down, up, s.start):
        found = ca.if_else(time + AHEAD < corner, corner - time, found)
    return ca.if_else(s.command == 0, math.inf, found)


def _not_zero(duration: Scalar) -> Scalar:
    """The duration; 1 for none, whose piece is never looked at but must not divide by zero."""
    return ca.if_else(duration > 0, duration, 1)
