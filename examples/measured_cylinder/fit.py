"""Identification: what differs from run to run, then one set of parameters for all runs together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from axis import AXIS
from numpy.typing import NDArray

from fmus.identification.recordings.reading import add
from fmus.identification.refinement.problem import EstimationProblem, RecordingMap, free_parameters
from fmus.identification.refinement.refine import RefinementResult, refine
from fmus.identification.refinement.shooting import Iteration
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]

OUTPUTS = ("position", "head_pressure", "rod_pressure")
AT_REST = ("speed", "spool_speed", "spool_position")
EDGES = ("pa", "at", "pb", "bt")
FREE = (
    *(f"{name}_{edge}" for name in ("area", "dead_band", "resistance") for edge in EDGES),
    "leakage",
    "spool_frequency",
    "air_share",
    "supply_pressure",
    "tank_pressure",
    "head_line_capacitance",
    "rod_line_capacitance",
    "stroke",
    "retracted",
    "mass",
    "load",
    "coulomb_friction",
    "static_ratio",
    "stribeck_speed",
    "viscous_friction",
)
# standard deviations of what only the first moments of a motion show, from classes of seals and rigs
PRIORS = {
    "spool_frequency": 30.0,
    "mass": 1.0,
    "static_ratio": 0.5,
    "stribeck_speed": 2e-3,
    "viscous_friction": 10.0,
}
# m, Pa: error of the model that is expected; the scatter of the residuals replaces it
ERRORS = {"position": 3e-4, "head_pressure": 4e4, "rod_pressure": 4e4}
MIDDLE = (0.05, 0.18)  # m, positions between which the speed is steady in every run
FIRST = 4  # samples, before the command steps
ITERATIONS = 40  # the search creeps in the end, because a stop begins between two samples


@dataclass(frozen=True)
class Scatter:
    """What differs from run to run: the gains of both directions of the valve.

    gains        by recording: flow relative to the mean over the recordings with the same step, shape (2,)
    covariance   of the gains, pooled over the steps, shape (2, 2)
    degrees      degrees of freedom of the covariance
    """

    gains: dict[str, Array]
    covariance: Array
    degrees: int

    def draws(self, count: int, random: np.random.Generator) -> Array:
        """Gains of runs to come, shape (count, 2): Student's t, with the error of the mean that they have."""
        runs = len(self.gains) / (len(self.gains) - self.degrees)  # of a step
        normal = random.multivariate_normal(
            np.zeros(2), (1 + 1 / runs) * self.covariance, count, method="eigh"
        )
        return np.asarray(1 + normal / np.sqrt(random.chisquare(self.degrees, (count, 1)) / self.degrees))


def speeds(recording: Recording) -> Array:
    """Steady speeds [m/s] out and in, shape (2,), by straight lines through the position."""
    position, command = recording["position"], recording["command"]
    middle = np.isfinite(position) & (position > MIDDLE[0]) & (position < MIDDLE[1])
    lines = [
        np.polyfit(recording.time[part], position[part], 1)
        for part in (middle & (command > 0), middle & (command < 0))
    ]
    return np.array([line[0] for line in lines])


def scatter(recordings: Sequence[Recording]) -> Scatter:
    """Gains of the runs from their speeds, which are proportional to the flows."""
    groups: dict[float | str, list[Recording]] = {}
    for recording in recordings:
        groups.setdefault(recording.conditions["step"], []).append(recording)
    gains: dict[str, Array] = {}
    products, degrees = np.zeros((2, 2)), 0
    for group in groups.values():
        found = np.array([speeds(r) for r in group])
        relative = found / found.mean(axis=0)
        gains |= {r.source.stem: g for r, g in zip(group, relative, strict=True)}
        products += (relative - 1).T @ (relative - 1)
        degrees += len(group) - 1
    if degrees < 2:
        raise Problem("expected three recordings or more of one step, to see what differs from run to run")
    return Scatter(gains, products / degrees, degrees)


def with_gains(recording: Recording, gains: Array) -> Recording:
    """The recording with the constant inputs `forward_gain` and `backward_gain`."""
    ones = np.ones(len(recording.time))
    return add(add(recording, "forward_gain", gains[0] * ones, "1"), "backward_gain", gains[1] * ones, "1")


def problem(recordings: Sequence[Recording], found: Scatter) -> EstimationProblem:
    """Output error over all runs, each with its own gains."""
    mapping = RecordingMap(AXIS, OUTPUTS, rest=AT_REST, sd=ERRORS)
    known = values(AXIS).p
    priors = {name: (known[name], PRIORS.get(name)) for name in FREE}
    runs = tuple(mapping.run(with_gains(r, found.gains[r.source.stem])) for r in recordings)
    return EstimationProblem(AXIS, OUTPUTS, free_parameters(AXIS, FREE, priors), runs)


def identify(
    recordings: Sequence[Recording], found: Scatter, progress: Callable[[Iteration], None] | None = None
) -> RefinementResult:
    """One set of parameters from all runs."""
    return refine(problem(recordings, found), horizon=1.0, iterations=ITERATIONS, progress=progress)


def draws(result: RefinementResult, found: Scatter, count: int, seed: int = 0) -> list[dict[str, float]]:
    """Parameter values of runs to come: covariance of the parameters, and scatter of the gains.

    The covariance is corrected for the correlation time of the residuals, which are errors of the model.
    """
    random = np.random.default_rng(seed)
    low, high = result.problem.bounds()
    z = random.multivariate_normal(result.z, result.statistics.covariance, count, method="eigh")
    gains = found.draws(count, random)
    names = ("forward_factor", "backward_factor")
    return [
        result.problem.by_name(np.clip(row, low, high)) | dict(zip(names, pair.tolist(), strict=True))
        for row, pair in zip(z, gains, strict=True)
    ]


def identified_values(result: RefinementResult, recordings: Sequence[Recording]) -> Values:
    """Values for the FMU: the estimates; pressures begin with the mean of their first samples."""
    known = values(AXIS)
    p, x = {**known.p, **result.values}, dict(known.x)
    for name in ("head_pressure", "rod_pressure"):
        x[name] = float(np.mean([r[name][:FIRST] for r in recordings if name in r.signals]))
    return replace(known, p=p, x=x | {"position": p["retracted"]})
