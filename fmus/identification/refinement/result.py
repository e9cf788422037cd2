"""What a refinement found.

What has to be said of a refinement: did it end by itself, how far do its intervals hold?
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.known import Estimate
from fmus.identification.refinement.gauss_newton import INTERRUPTED, STUCK, Progress
from fmus.identification.refinement.problem import EstimationProblem, Free
from fmus.identification.refinement.residuals import Traces, Whiteness
from fmus.identification.refinement.statistics import VAGUE, Statistics

Array = NDArray[np.float64]

_OPEN = math.log(1000)  # half width in logarithms: a factor of a thousand either way is no interval


@dataclass(frozen=True)
class Refined:
    """Parameters with what is known about them, and how well they explain the recordings.

    z              of the parameters at the end
    converged, reason   did the search end by itself, and why it ended
    history        one entry per iteration
    unidentified   sentences about parameters that the data leave open
    at_bound       parameters that would have left their bounds
    whiteness      tests per output
    training, held_out   pure simulations of the runs from their starts
    floor          per output: the model's own error as estimated, in standard deviations of the sensor
    starts         per run: the first state, by name
    """

    problem: EstimationProblem
    z: Array
    converged: bool
    reason: str
    history: tuple[Progress, ...]
    statistics: Statistics
    unidentified: tuple[str, ...]
    at_bound: tuple[str, ...]
    whiteness: Mapping[str, Whiteness]
    training: tuple[Traces, ...]
    held_out: tuple[Traces, ...]
    floor: Mapping[str, float]
    starts: tuple[Mapping[str, float], ...]

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return dict(zip(self.problem.names, self.problem.values_of(self.z).tolist(), strict=True))

    @property
    def robust(self) -> bool:
        """Have the residuals a memory or a size that the sensors do not explain?"""
        return not all(w.white for w in self.whiteness.values() if np.isfinite(w.rms))

    def estimates(
        self, robust: bool | None = None, names: Mapping[str, str] | None = None
    ) -> tuple[Estimate, ...]:
        """One estimate per parameter, called as `names` says.

        robust   intervals over segments instead of the plain ones; by default where residuals ask for it
        """
        chosen = self.robust if robust is None else robust
        sd, width = self.statistics.sd(chosen), self.statistics.quantile(chosen)
        how = "errors over segments" if chosen else "errors of independent residuals"
        runs = len(self.problem.training)
        note = f"joint refinement of {len(self.z)} parameters on {runs} recording{'s' * (runs > 1)}, {how}"
        note += "" if self.converged else f"; the search did not converge: {self.reason}"
        bounds = self.problem.bounds()
        found = []
        for j, free in enumerate(self.problem.free):
            z = float(self.z[j])
            low, high = _interval(free, z, float(sd[j]), width, (bounds[0][j], bounds[1][j]))
            found.append(
                Estimate(
                    name=(names or {}).get(free.name, free.name),
                    value=free.value_of(z),
                    unit=free.unit,
                    sd=float(sd[j]) * free.slope(z),
                    low=low,
                    high=high,
                    note=note + "; at its bound" * (free.name in self.at_bound),
                )
            )
        return tuple(found)

    def fit(self) -> dict[str, dict[str, dict[str, float]]]:
        """NRMSE as use -> run -> output -> number; NaN where an output was not measured."""
        return {
            use: {
                t.run.name: dict(zip(self.problem.outputs, t.nrmse().tolist(), strict=True)) for t in traces
            }
            for use, traces in (("train", self.training), ("test", self.held_out))
        }


def _interval(
    free: Free, z: float, sd: float, width: float, bounds: tuple[float, float]
) -> tuple[float, float]:
    """Both ends of a value's interval: a bound if it is nearer; nothing tells where it is hopelessly wide."""
    reach = width * sd
    if sd > VAGUE / 2 or (free.log and reach > _OPEN):
        reach = math.inf
    low, high = max(bounds[0], z - reach), min(bounds[1], z + reach)
    return free.value_of(low), free.value_of(high)


FEW = 10  # segments: a standard deviation from so many is known to a quarter, 1 / sqrt(2 (n - 1))


def advice(refined: Refined) -> tuple[str, ...]:
    """Whole sentences, with what to do; none if all is well."""
    return (*_ended(refined), *_intervals(refined))


def _ended(refined: Refined) -> tuple[str, ...]:
    if refined.converged:
        return ()
    told = f"The search did not converge: {refined.reason}"
    if refined.reason == INTERRUPTED:
        return (f"{told}. Values and intervals are those of the best point so far.",)
    if refined.reason == STUCK:
        return (
            f"{told}, because a parameter hardly acts or something switches there, such as dry friction or a "
            "stop. The values are the best so far. Hold what the data cannot tell (--free names the others), "
            "or begin from other numbers.",
        )
    return (
        f"{told} were not enough. The values are the best so far, the intervals are too narrow. "
        "Look for a signal with a wrong sign or unit, and free fewer parameters (--free).",
    )


def _intervals(refined: Refined) -> tuple[str, ...]:
    found = refined.statistics
    if not refined.robust or found.clusters >= FEW:
        return ()
    if found.clusters == 1:
        return (
            "There is a single segment, so that nothing tells how far residuals with a memory move values: "
            "the intervals are a guess, and wide. Longer recordings help.",
        )
    return (
        f"The intervals rest on the scatter between {found.clusters} segments, fewer than {FEW}: "
        "they are wide, and known roughly. Longer recordings help.",
    )
