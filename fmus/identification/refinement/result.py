"""What a refinement found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Estimate
from fmus.identification.refinement.problem import Problem
from fmus.identification.refinement.residuals import Traces, Whiteness
from fmus.identification.refinement.solver import Progress
from fmus.identification.refinement.statistics import Statistics

Array = NDArray[np.float64]


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

    problem: Problem
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
        bounds = self.problem.bounds()
        found = []
        for j, free in enumerate(self.problem.free):
            z = float(self.z[j])
            ends = [max(bounds[0][j], z - width * sd[j]), min(bounds[1][j], z + width * sd[j])]
            found.append(
                Estimate(
                    name=(names or {}).get(free.name, free.name),
                    value=free.value_of(z),
                    unit=free.unit,
                    sd=float(sd[j]) * free.slope(z),
                    low=free.value_of(min(float(ends[0]), 700.0)),
                    high=free.value_of(min(float(ends[1]), 700.0)),
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
