"""How long a communication step is, when it follows from an estimate of its error.

The estimate of a step says how far the inputs that the components worked with were from the truth, see
`Signal.deviation`; e is the worst of them over the tolerance. A step with e <= 1 is good. The next one
follows from the last two by a proportional-integral law (Gustafsson 1991, ACM Trans. Math. Softw. 17(4),
533-554),

    h_next = h (1/c)^(0.3/k) (c_before/c)^(0.4/k),      c = e / 0.8^k,

where k is the power of h that the estimate goes with. Where the components can go back, a step with e > 1 is
repeated with a shorter one; where they cannot, it stands, and only the next one is shorter.
"""

from __future__ import annotations

from math import isfinite

INTEGRAL, PROPORTIONAL = 0.3, 0.4  # exponents of the law, over k
SAFETY = 0.8  # of the step at which the error would just do
SHRINK, GROW = 0.2, 2.0  # limits of a change
REPEATED = 0.9  # at most this much of a step that was not good
NEARLY = 1.0 - 1e-9  # of what is left: a step that long is meant to end there
TINY, HUGE = 1e-10, 1e10  # limits of c: no error at all, and none that can be told


class Pace:
    """Chooses the next step and judges the last one.

    power       k
    smallest    a step is not made shorter than this [s]; an error above the tolerance then stands
    largest     nor longer than this [s], but for the rounding of times: a share of 1e-9
    repeats     the components can go back
    """

    def __init__(self, first: float, power: int, smallest: float, largest: float, repeats: bool) -> None:
        self.h, self.power, self.repeats = min(max(first, smallest), largest), power, repeats
        self.smallest, self.largest = smallest, largest
        self.before = 0.0  # c of the step before; 0: none
        self._uncut = 0.0  # what the step would have been without an end to hit; 0: it was not cut

    def length(self, room: float) -> float:
        """The next step [s] when the next time to hit is `room` [s] away."""
        self._uncut = 0.0
        if self.h >= room * NEARLY:
            self._uncut = self.h
            return room
        return room / 2.0 if 2.0 * self.h > room else self.h

    def good(self, e: float, h: float) -> bool:
        """Judge the step of length h [s] with the error e, a share of the tolerance; False: repeat it."""
        c = min(max(e, TINY), HUGE) / SAFETY**self.power if isfinite(e) else HUGE
        k = float(self.power)
        if not e <= 1.0 and self.repeats and h > self.smallest:
            self.h = max(h * min(REPEATED, max(SHRINK, (1.0 / c) ** (1.0 / k))), self.smallest)
            self.before = 0.0
            return False
        if self.before == 0.0:
            change = (1.0 / c) ** (1.0 / k)
        else:
            change = (1.0 / c) ** (INTEGRAL / k) * (self.before / c) ** (PROPORTIONAL / k)
        fresh = h * min(max(change, SHRINK), GROW)
        if e <= 1.0:
            fresh = max(fresh, self._uncut)
        self.h = min(max(fresh, self.smallest), self.largest)
        self.before = c
        return True
