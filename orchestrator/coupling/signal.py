"""A Real input that moves inside a communication step, and what is known of its source."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.coupling.polynomial import Cubic, backward, interpolated, predicted

DRIVEN = -1  # as maker: a scenario
NO_SLOPE = -1  # as slope: the source tells none


@dataclass(slots=True)
class Signal:
    """One input of a component and its polynomial over the current step.

    target, source    places in the bank of Real values; a driven signal has the source -1
    factor, offset    from the source's value to the input's
    maker             number of the component that computes it, or DRIVEN
    slope             place among the slopes that the FMUs tell, or NO_SLOPE: then it follows from values
    degree            what the FMU can follow: 0 (it holds its input), 1 or 3
    wanted            the highest degree of polynomial that the master makes
    known             how many slopes of the past are known: at most that many orders are extrapolated
    value, slope0     at the beginning of the step, in the input's unit
    value1, slope1    at its end, as far as it is known
    before, chord     slope at the beginning of the step before, and of its chord
    scale             magnitude that errors and changes are compared with
    c                 coefficients over the step
    """

    target: int
    source: int
    factor: float
    offset: float
    maker: int
    slope: int
    degree: int
    wanted: int
    known: int = 0
    value: float = 0.0
    slope0: float = 0.0
    value1: float = 0.0
    slope1: float = 0.0
    before: float = 0.0
    chord: float = 0.0
    scale: float = 1.0
    c: Cubic = (0.0, 0.0, 0.0, 0.0)

    def predict(self, order: int, step: float) -> None:
        """Continue the source over the step; `step` [s] is the length of the one before."""
        self.c = predicted(min(order, self.known), self.value, self.slope0, self.before, step)

    def interpolate(self, degree: int, h: float) -> None:
        """Connect both ends of the step."""
        usable = degree if self.known else 1
        self.c = interpolated(usable, self.value, self.slope0, self.value1, self.slope1, h)

    def begin(self, value: float, slope: float) -> None:
        """Note the source at the start of the run."""
        self.value, self.slope0 = value, slope
        self.known = 0 if self.slope == NO_SLOPE else 1

    def arrive(self, value: float, slope: float, h: float, step: float) -> float:
        """Note the source at the end of the step of length h; `step` [s] is the length of the one before.

        Returns how far it is from where it was noted last, as a share of `scale`.
        """
        change = abs(value - self.value1) / self.scale
        self.value1 = value
        if self.slope == NO_SLOPE:
            slope = backward(self.value, value, h, self.chord, step)
        self.slope1 = slope
        return change

    def accept(self, h: float) -> None:
        """The end of this step is the beginning of the next one."""
        self.chord = (self.value1 - self.value) / h
        self.before, self.slope0, self.value = self.slope0, self.slope1, self.value1
        self.known = min(self.known + 1, 2)
