"""Fits of the filtered equations of a hose: each group on its own, and all together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.hose_dynamics.weak_form import Equation
from fmus.identification.procedures.shared.regression import SURE, UNLIKELY, Guess, Regression, differ, fit

Array = NDArray[np.float64]

TELLS = 0.25  # largest relative standard deviation of what the data tell
LEAST = 20  # windows of a group: with fewer its five unknowns say little

Start = Mapping[str, Guess]


@dataclass(frozen=True)
class Fits:
    """Of one quantity, "I" or "C": the fit of all groups and those of each.

    differ   probability of the groups' scatter if all have the same value
    """

    name: str
    equations: tuple[Equation, ...]
    groups: tuple[Regression, ...]
    pooled: Regression
    differ: float

    @property
    def told(self) -> bool:
        """Do the data tell the quantity at all?"""
        return self.pooled.sd(self.name) < TELLS * self.pooled[self.name]


def inertance_start(guess: float, resistance: float, flow: float) -> dict[str, Guess]:
    """Where the fit of `hose_equations.inertance` starts, and the magnitudes of its parameters."""
    drop = resistance * flow**2
    return {
        "I": Guess(guess),
        "C_R": Guess(resistance),
        "R": Guess(0.0, drop / flow),
        "s": Guess(0.0, 1.0),
        "p_0": Guess(0.0, drop),
    }


def capacitance_start(guess: float, flow: float) -> dict[str, Guess]:
    """Where the fit of `hose_equations.capacitance` starts."""
    return {"C": Guess(guess), "s": Guess(0.0, 1.0), "q_0": Guess(0.0, flow)}


def fits(name: str, equations: Sequence[Equation], start: Start, files: Sequence[str]) -> Fits:
    """All groups together and each; the pooled interval is widened to the groups' scatter if they differ."""
    for equation, file in zip(equations, files, strict=True):
        if equation.y.size < LEAST:
            raise ModelError(
                f"{file}: {equation.y.size} windows without a bad sample (gap, clipped, dead zone), "
                f"expected at least {LEAST}"
            )
    each = tuple(_fit(name, [equation], start) for equation in equations)
    values, sds = [one[name] for one in each], [one.sd(name) for one in each]
    probability = differ(values, sds) if len(each) > 1 else 1.0
    pooled = _fit(name, equations, start)
    if pooled[name] < -SURE * pooled.sd(name):
        raise ModelError(
            f"{', '.join(files)}: {name} is {pooled[name]:.3g}, expected positive: turn the sign of the "
            "flows or the order of the pressures"
        )
    if probability < UNLIKELY:
        scatter = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        pooled = _widened(pooled, max(1.0, scatter / pooled.sd(name)))
    return Fits(name, tuple(equations), each, pooled, probability)


def _fit(name: str, equations: Sequence[Equation], start: Start) -> Regression:
    return fit(partial(_residual, equations), start, f"hose_dynamics, {name}")


def _residual(equations: Sequence[Equation], theta: Mapping[str, float]) -> Array:
    return np.concatenate([equation.weighted(theta) for equation in equations])


def _widened(found: Regression, ratio: float) -> Regression:
    return replace(found, covariance=found.covariance * ratio**2)
