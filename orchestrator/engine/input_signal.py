"""An input over one communication step, as a cubic polynomial of the time since its beginning.

    u(s) = c0 + c1 s + c2 s^2 + c3 s^3,   0 <= s <= h                                   s, h in [s]

What a source did is known by value and slope at communication points; here is what follows from that for
the step to come (`predicted`) and, once the source has been there, for the step itself (`interpolated`).
An FMU that cannot follow a cubic gets the straight line, or the constant, with the same mean (and, the line,
the same first moment) over the step: to what is linear in its input it does the same up to the order h^4
(line) or h^2 (constant) of the cubic itself. docs/coupling.md has the derivation and measured orders.

A Real input that moves inside a communication step, and what is known of its source.
"""

from __future__ import annotations

from dataclasses import dataclass

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


DRIVEN = -1  # as maker: a scenario
NO_SLOPE = -1  # as slope: the source tells none
CORNER = 1e-6  # of two slopes: what differs by less is the same


@dataclass(slots=True)
class Signal:
    """One input of a component and its polynomial over the current step.

    target, source    places in the bank of Real values; a driven signal has the source -1
    factor, offset    from the source's value to the input's
    maker             number of the component that computes it, or DRIVEN
    slope             place among the slopes that the FMUs tell, or NO_SLOPE: then it follows from values
    degree            what the FMU can follow: 0 (it holds its input), 1 or 3
    wanted            the highest degree of polynomial that the master makes; 0: the input is left alone
    order             at which the source is continued
    free              the source has no inputs: it may have corners, but nothing depends on passes
    tied              the source is in an algebraic loop: its end is known when all components have stepped
    scale             magnitude: the nominal value (1 if none is declared), or the largest seen if larger
    known             how far back the past is known: a source is continued at most at this order
    value, slope0     at the beginning of the step, in the input's unit
    value1, slope1    at its end, as far as it is known
    before, chord     over the step before: slope at its beginning, mean slope
    bend              divided difference of second order over the two steps before
    c                 coefficients over the step
    foreseen          `Foresight` makes the polynomial
    foretold          what the past said of the end of the step, for the estimate of the error
    weight            of the difference to that
    lost              mean of the source less mean of the input as continued, over the last step
    returned          what the input got back of that
    """

    target: int
    source: int
    factor: float
    offset: float
    maker: int
    slope: int
    degree: int
    wanted: int
    order: int = 0
    free: bool = False
    tied: bool = False
    scale: float = 0.0
    known: int = 0
    value: float = 0.0
    slope0: float = 0.0
    value1: float = 0.0
    slope1: float = 0.0
    before: float = 0.0
    chord: float = 0.0
    bend: float = 0.0
    c: Cubic = (0.0, 0.0, 0.0, 0.0)
    foreseen: bool = False
    foretold: float = 0.0
    weight: float = 0.0
    lost: float = 0.0
    returned: float = 0.0

    # ---- before the component steps

    def drive(self, middle: float, value1: float, h: float) -> None:
        """Go straight to the value at the end; what that leaves out shows at the middle."""
        self.value1 = value1
        self.c = interpolated(1, self.value, 0.0, value1, 0.0, h)
        self.foretold, self.weight = value1 + (middle - 0.5 * (self.value + value1)), 1.0

    def predict(self, h: float, step: float) -> None:
        """Continue the source over a step of length h; `step` [s] is the length of the one before."""
        self.c = self._continued(self.order, step)
        self.foretold, self.weight, self.returned = at(self.c, h), 1.0, 0.0

    def foresee(self, v1: float, v2: float, v3: float, h: float) -> None:
        """Take what changes are foretold up to h/3, 2h/3 and h.

        What that misses grows with the third power of time or faster: its mean is a quarter of its end.
        """
        self.c = through_thirds(self.value, v1, v2, v3, h)
        self.foretold, self.weight, self.returned = at(self.c, h), 0.25, 0.0

    def hit(self, h: float) -> None:
        """Let what was foretold end where the source did."""
        c0, c1, c2, c3 = self.c
        self.c = (c0, c1, c2, c3 + (self.value1 - at(self.c, h)) / (h * h * h))

    def interpolate(self, degree: int, h: float, step: float) -> None:
        """Connect both ends of the step.

        The error of a polynomial through both ends is a small part of that of one that continues the past at
        the same degree: 1/4, about 1/16 and 1/64 at equal steps, by their remainders; the weight has some
        safety on top, because the ends of a step have errors too.
        """
        usable = 1 if not self.known or self._straight(h) else degree
        self.c = interpolated(usable, self.value, self.slope0, self.value1, self.slope1, h)
        self.foretold, self.weight = at(self._continued(usable, step), h), 0.25
        for _ in range(1, usable):
            self.weight *= h / (h + step)
        self.returned = 0.0

    def _straight(self, h: float) -> bool:
        """A free source with the slope of its chord at one end went straight; the other end is a corner."""
        if not self.free:
            return False
        chord = (self.value1 - self.value) / h
        room = CORNER * (abs(chord) + abs(self.slope0) + abs(self.slope1))
        return min(abs(chord - self.slope0), abs(chord - self.slope1)) <= room

    def _continued(self, order: int, step: float) -> Cubic:
        usable = min(order, self.known)
        return predicted(usable, self.value, self.slope0, self.before, self.chord, step)

    def give_back(self, h: float, step: float) -> None:
        """Correct the input by what it lost over the step before, `step` [s] long.

        What a source continued at order k loses of its mean goes with the length of the step to the power
        k + 1. That is a correction of the kind of NEPCE (Sadjina and Pedersen 2020, Eng. Comput. 36,
        doi 10.1007/s00366-019-00783-4), of each signal by itself: with the means of effort and flow right,
        so is the energy.
        """
        if step == 0.0:
            return
        share = h / step
        for _ in range(self.order):
            share *= h / step
        self.returned = share * self.lost
        c0, c1, c2, c3 = self.c
        self.c = (c0 + self.returned, c1, c2, c3)

    # ---- after its source has stepped

    def begin(self, value: float, slope: float) -> None:
        """Note the source at the start of the run."""
        self.value, self.slope0 = value, slope
        self.scale = max(self.scale, abs(value))
        self.known = 0 if self.slope == NO_SLOPE else 1
        self.c = (value, slope, 0.0, 0.0)

    def arrive(self, value: float, slope: float, h: float, steps: tuple[float, float]) -> None:
        """Note the source at the end of the step of length h; `steps` [s]: lengths of the two before."""
        self.value1 = value
        self.slope1 = self._backward(h, steps) if self.slope == NO_SLOPE else slope

    def _backward(self, h: float, steps: tuple[float, float]) -> float:
        """The slope at the end from the last four values (three, two), by divided differences."""
        step, older = steps
        first = (self.value1 - self.value) / h
        if step == 0.0:
            return first
        second = (first - self.chord) / (h + step)
        if older == 0.0:
            return first + h * second
        return first + h * (second + (h + step) * (second - self.bend) / (h + step + older))

    def accept(self, h: float, step: float) -> None:
        """The end of this step is the beginning of the next one; `step` [s]: the length of the one before."""
        self.lost = self._true_mean(h) - (mean(self.c, h) - self.returned)
        first = (self.value1 - self.value) / h
        self.bend = (first - self.chord) / (h + step) if step > 0.0 else 0.0
        self.chord = first
        self.before, self.slope0, self.value = self.slope0, self.slope1, self.value1
        self.known = min(self.known + (2 if self.known == 1 else 1), 3)
        self.scale = max(self.scale, abs(self.value))

    # ---- how far off the input was

    def magnitude(self) -> float:
        """What errors are compared with; 0 only while the signal always was 0."""
        return max(self.scale, abs(self.value1))

    def share(self, deviation: float) -> float:
        """A deviation as a share of the magnitude."""
        size = self.magnitude()
        return abs(deviation) / size if size > 0.0 else 0.0

    def miss(self, h: float) -> float:
        """What another pass could change: how far value and slope of the input end beside the source's."""
        off = abs(at(self.c, h) - self.value1)
        if not self.free:
            off = max(off, h * abs(slope_at(self.c, h) - self.slope1))
        return self.share(off)

    def deviation(self, h: float, repeated: bool) -> float:
        """How far the input was from the truth in the step, estimated: what was foretold less what came.

        repeated   there were several passes: where the input ended beside its source counts too
        """
        off = self.weight * (self.foretold - self.value1)
        beside = at(self.c, h) - self.value1
        if repeated and abs(beside) > abs(off):
            off = beside
        return off

    def defect(self, h: float) -> float:
        """How far the mean of the input was from that of the source over the step of length h."""
        return self._true_mean(h) - mean(self.c, h)

    def _true_mean(self, h: float) -> float:
        return 0.5 * (self.value + self.value1) + h * (self.slope0 - self.slope1) / 12.0
