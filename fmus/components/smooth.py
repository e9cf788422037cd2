"""Smooth pieces from which the empirical functions are built."""

from __future__ import annotations

import casadi as ca

from fmus.contract import Scalar


def ramp(z: Scalar, width: Scalar) -> Scalar:
    """max(z, 0) rounded over 0 < z < width, twice continuously differentiable, exactly 0 for z <= 0.

    ramp = width (s^3 - s^4/2) + max(z - width, 0),  s = clip(z / width, 0, 1)

    Above `width` it is z - width/2: a straight line of slope 1 that starts half a width later.
    """
    s = ca.fmax(0, ca.fmin(1, z / width))
    return width * (s**3 - s**4 / 2) + ca.fmax(0, z - width)


def positive(z: Scalar, width: Scalar) -> Scalar:
    """(z + sqrt(z^2 + width^2)) / 2: above max(z, 0) by at most width/2, at z = 0; never zero.

    positive(z) - positive(-z) = z exactly.
    """
    return (z + ca.sqrt(z**2 + width**2)) / 2
