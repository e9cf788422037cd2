"""An input over one communication step, as a cubic polynomial of the time since its beginning.

    u(s) = c0 + c1 s + c2 s^2 + c3 s^3,   0 <= s <= h                                   s, h in [s]

What a source did is known by value and slope at communication points; here is what follows from that for
the step to come (`predicted`) and, once the source has been there, for the step itself (`interpolated`).
An FMU that cannot follow a cubic gets the straight line, or the constant, with the same mean (and, the line,
the same first moment) over the step: to what is linear in its input it does the same up to the order h^4
(line) or h^2 (constant) of the cubic itself. docs/coupling.md has the derivation and measured orders.
"""

from __future__ import annotations

Cubic = tuple[float, float, float, float]


def predicted(order: int, value: float, slope: float, before: float, chord: float, step: float) -> Cubic:
    """The polynomial of degree `order`, 0 to 3, that continues a source.

    value, slope    at the beginning of the step
    before, chord   over the step before, of length `step` [s]: slope at its beginning, mean slope
    """
    if order == 0:
        return value, 0.0, 0.0, 0.0
    if order == 1:
        return value, slope, 0.0, 0.0
    if order == 2:
        return value, slope, (slope - before) / (2.0 * step), 0.0
    bend = (slope + before - 2.0 * chord) / (step * step)
    return value, slope, (2.0 * slope + before - 3.0 * chord) / step, bend


def interpolated(degree: int, value: float, slope: float, value1: float, slope1: float, h: float) -> Cubic:
    """The polynomial of degree 1, 2 or 3 between values, and slopes, at both ends of a step of length h."""
    chord = (value1 - value) / h
    if degree == 1:
        return value, chord, 0.0, 0.0
    if degree == 2:
        return value, slope, (chord - slope) / h, 0.0
    return value, slope, (3.0 * chord - 2.0 * slope - slope1) / h, (slope + slope1 - 2.0 * chord) / (h * h)


def through_thirds(value: float, v1: float, v2: float, v3: float, h: float) -> Cubic:
    """The polynomial that changes from `value` by v1, v2 and v3 up to h/3, 2h/3 and h."""
    return (
        value,
        (18.0 * v1 - 9.0 * v2 + 2.0 * v3) / (2.0 * h),
        (-45.0 * v1 + 36.0 * v2 - 9.0 * v3) / (2.0 * h * h),
        (27.0 * v1 - 27.0 * v2 + 9.0 * v3) / (2.0 * h * h * h),
    )


def shifted(c: Cubic, by: float) -> Cubic:
    """The same polynomial with its time counted from `by`."""
    c0, c1, c2, c3 = c
    return (
        c0 + by * (c1 + by * (c2 + by * c3)),
        c1 + by * (2.0 * c2 + by * (3.0 * c3)),
        c2 + by * (3.0 * c3),
        c3,
    )


def line(c: Cubic, h: float) -> Cubic:
    """The straight line nearest to a polynomial over a step of length h (least squares)."""
    c0, c1, c2, c3 = c
    if c2 == 0.0 and c3 == 0.0:
        return c
    return c0 - h * h * (c2 / 6.0 + h * c3 / 5.0), c1 + h * (c2 + 0.9 * h * c3), 0.0, 0.0


def constant(c: Cubic, h: float) -> Cubic:
    """The constant nearest to a polynomial over a step of length h."""
    return mean(c, h), 0.0, 0.0, 0.0


def projected(c: Cubic, degree: int, h: float) -> Cubic:
    """The polynomial in the degree that an FMU can follow: 0, 1 or 3."""
    return c if degree == 3 else line(c, h) if degree == 1 else constant(c, h)


def mean(c: Cubic, h: float) -> float:
    """The mean over a step of length h."""
    c0, c1, c2, c3 = c
    return c0 + h * (c1 / 2.0 + h * (c2 / 3.0 + h * c3 / 4.0))


def at(c: Cubic, s: float) -> float:
    """The value at the time s."""
    c0, c1, c2, c3 = c
    return c0 + s * (c1 + s * (c2 + s * c3))


def slope_at(c: Cubic, s: float) -> float:
    """The slope at the time s."""
    _, c1, c2, c3 = c
    return c1 + s * (2.0 * c2 + s * (3.0 * c3))
