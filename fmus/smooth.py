"""Smooth approximations of max, min, sign and limits, used by the empirical laws of the components."""

import casadi as ca

from fmus.contract import Scalar

_SHARE = 0.1  # of `lower`


def ramp(z: Scalar, width: Scalar) -> Scalar:
    """max(z, 0) rounded over 0 < z < width, twice continuously differentiable, exactly 0 for z <= 0.

    ramp = width (s^3 - s^4/2) + max(z - width, 0),  s = clip(z / width, 0, 1)

    Above `width` it is z - width/2: a straight line of slope 1 that starts half a width later.
    """
    s = ca.fmax(0, ca.fmin(1, z / width))
    return width * (s**3 - s**4 / 2) + ca.fmax(0, z - width)


def ramp_integral(z: Scalar, width: Scalar) -> Scalar:
    """Integral of `ramp` from 0 to z: the energy of a spring with that force."""
    s, beyond = ca.fmax(0, ca.fmin(1, z / width)), ca.fmax(0, z - width)
    return width**2 * (s**4 / 4 - s**5 / 10) + beyond * (width + beyond) / 2


def positive(z: Scalar, width: Scalar) -> Scalar:
    """(z + sqrt(z^2 + width^2)) / 2: above max(z, 0) by at most width/2, at z = 0; never zero.

    positive(z) - positive(-z) = z exactly.
    """
    return (z + ca.sqrt(z**2 + width**2)) / 2


def capped(z: Scalar, width: Scalar) -> Scalar:
    """min(z, 1), rounded within width/2 of 1, twice continuously differentiable, exact elsewhere."""
    return z - ramp(z - 1 + width / 2, width)


def lowest(a: Scalar, b: Scalar, width: Scalar) -> Scalar:
    """min(a, b), twice continuously differentiable: exact for |a - b| > width/2.

    It is below the minimum by at most 3/32 of the width, at a = b.
    """
    return a - ramp(a - b + width / 2, width)


def ramp_inverse(y: Scalar, width: Scalar) -> Scalar:
    """The z with ramp(z, width) = y, for y > 0, to rounding.

    Below z = width, s^3 - s^4/2 = c with s = z/width, c = y/width: two steps of Halley's method from a
    series.
    """
    c = ca.fmin(y / width, 0.5)
    t = c ** (1 / 3)
    s = t * (1 + t / 6 + 0.19 * t**2)
    for _ in range(2):
        f, f_s, f_ss = s**3 - s**4 / 2 - c, 3 * s**2 - 2 * s**3, 6 * s - 6 * s**2
        s = s - 2 * f * f_s / (2 * f_s**2 - f * f_ss)
    return width * s + ca.fmax(y - width / 2, 0)


def unit_limited(z: Scalar, width: Scalar) -> Scalar:
    """z limited to 0 ... 1, smooth: always above zero, and 1 from 1 + width/2 on.

    Up to 1 - width/2 it is `positive`, above z by less than width^2 / (4 z), and `unit_limited_inverse` is
    its inverse.
    """
    return capped(positive(z, width), width)


def unit_limited_inverse(s: Scalar, width: Scalar) -> Scalar:
    """The z with unit_limited(z) = s, for 0 < s <= 1 - width."""
    return s - width**2 / (4 * s)


def s_curve(z: Scalar) -> Scalar:
    """Step from 0 at z = 0 to 1 at z = 1, twice continuously differentiable."""
    z = ca.fmin(ca.fmax(z, 0), 1)
    return z**3 * (10 - 15 * z + 6 * z**2)


def direction(speed: Scalar, width: Scalar) -> Scalar:
    """Sign of a speed, rounded: speed / sqrt(speed^2 + width^2)."""
    return speed / ca.sqrt(speed**2 + width**2)


def lower(a: Scalar, b: Scalar) -> Scalar:
    """min(a, b) of two positive numbers, rounded where they differ by less than `_SHARE` of their mean.

    a - r(a - b + w/2, w) with w = _SHARE (a + b)/2, r the `ramp`: twice continuously differentiable for
    a + b > 0, increasing in both, homogeneous, exact for |a - b| >= w/2, below the minimum by 1 % at most.
    Exactly a, without rounding, if a is the smaller one.
    """
    width = _SHARE / 2 * (a + b) + 1e-9  # defined at 0, 0
    return a - ramp(a - b + width / 2, width)
