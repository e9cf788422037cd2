"""What errors of the known parameters do to those that are found with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fmus.identification.procedures.balance.motion import PARAMETERS
from fmus.identification.procedures.balance.solution import Solution
from fmus.parameters import Number

MOST = 3  # parameters named
LITTLE = 0.1  # of a standard deviation, and of a variance: what is smaller is not told
EXACT = "manipulator.gravity"  # nobody doubts it


@dataclass(frozen=True)
class Doubt:
    """Of one parameter.

    own      standard deviation by the recordings
    told     what one standard deviation of each known parameter moves it by, where one is told
    untold   what 1 % of each known parameter without a standard deviation moves it by
    """

    own: float
    told: Mapping[str, float]
    untold: Mapping[str, float]

    @property
    def sd(self) -> float:
        """By the standard deviations of the known parameters, taken as independent."""
        return math.sqrt(sum(x**2 for x in self.told.values()))

    @property
    def total(self) -> float:
        """Standard deviation by the recordings and by the known parameters."""
        return math.hypot(self.own, self.sd)

    @property
    def matters(self) -> bool:
        """Do the known parameters widen the interval?"""
        return self.sd > LITTLE * self.own

    def remarks(self, value: float, unit: str) -> list[str]:
        """Sentences without their subject's name; none if nothing matters."""
        found = []
        if self.matters:
            names = _largest({n: x for n, x in self.told.items() if x**2 > LITTLE * self.sd**2})
            found.append(
                f"the standard deviations of the known parameters add {self.sd:.2g} {unit} to its own "
                f"{self.own:.2g}, most of it by {', '.join(names)}."
            )
        moving = {n: x for n, x in self.untold.items() if abs(x) > self.total}
        if moving:
            parts = ", ".join(f"{n} {100 * moving[n] / value:+.2g} %" for n in _largest(moving))
            found.append(
                "the interval takes geometry and masses as exact. An error of 1 % would change the value: "
                f"{parts}."
            )
        return found

    def note(self) -> str:
        """For parameters.toml, where it matters."""
        parts = f"; sd {self.own:.2g} by the recordings, {self.sd:.2g} by the known parameters"
        return parts if self.matters else ""


def doubt(solution: Solution, number: int, known: Mapping[str, Number]) -> Doubt:
    """About the parameter with this number among those found."""
    slopes = dict(zip(PARAMETERS, map(float, solution.sensitivity[number]), strict=True))
    others = {n: known[n] for n in PARAMETERS if n not in solution.theta and n != EXACT}
    return Doubt(
        float(solution.sd[number]),
        {n: slopes[n] * x.sd for n, x in others.items() if x.sd is not None},
        {n: slopes[n] * abs(x.value) / 100 for n, x in others.items() if x.sd is None},
    )


def _largest(moved: Mapping[str, float]) -> list[str]:
    return sorted(moved, key=lambda n: -abs(moved[n]))[:MOST]
