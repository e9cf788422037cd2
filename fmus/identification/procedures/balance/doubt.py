"""What errors of the known parameters do to those that are found with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fmus.identification.procedures.balance.motion import PARAMETERS
from fmus.identification.procedures.balance.solution import Solution
from fmus.parameters import Number

MOST = 3  # parameters named


@dataclass(frozen=True)
class Doubt:
    """Of one parameter.

    sd      by the standard deviations of the known parameters, taken as independent; 0 if none is told
    moved   d theta / d parameter times its sd, or, if none is told, times 1 % of each
    """

    sd: float
    moved: Mapping[str, float]

    @property
    def most(self) -> list[str]:
        """The parameters that move it most."""
        return sorted(self.moved, key=lambda n: -abs(self.moved[n]))[:MOST]

    def remark(self, value: float, unit: str) -> str:
        """A sentence without its subject's name."""
        if self.sd:
            names = ", ".join(f"{n} by {abs(self.moved[n]):.2g}" for n in self.most)
            return (
                f"the doubt about the known parameters moves it by {self.sd:.3g} {unit} (one standard "
                f"deviation; most of all {names}), which the interval includes."
            )
        names = ", ".join(f"{n} moves it by {100 * self.moved[n] / value:+.2g} %" for n in self.most)
        return f"errors of what is taken as known go into it and are not in its interval: 1 % of {names}."


def doubt(solution: Solution, number: int, known: Mapping[str, Number]) -> Doubt:
    """About the parameter with this number among those found."""
    others = {n: known[n] for n in PARAMETERS if n not in solution.theta}
    told = {n: x.sd for n, x in others.items() if x.sd is not None}
    spreads = told or {n: abs(x.value) / 100 for n, x in others.items()}
    slopes = dict(zip(PARAMETERS, solution.sensitivity[number], strict=True))
    moved = {n: float(slopes[n] * spread) for n, spread in spreads.items()}
    return Doubt(math.sqrt(sum(x**2 for x in moved.values())) if told else 0.0, moved)
