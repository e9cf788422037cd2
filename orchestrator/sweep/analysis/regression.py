"""A linear model of an output: standardised coefficients, the share of each, and how much the model explains.

    y = b_0 + sum b_i x_i + e        S_i = (b_i sd(x_i) / sd(y))^2

holds for independent factors as far as R^2 is near 1. A choice has a coefficient for each option but one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from orchestrator.sweep.analysis.outcome import Estimate
from orchestrator.sweep.analysis.resampling import intervals
from orchestrator.sweep.analysis.results import Array, Samples
from orchestrator.sweep.study import Choice

NOTHING = Estimate(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Linear:
    """Coefficients of the factors that vary, by name, and R^2."""

    slopes: dict[str, Estimate]
    r_squared: float


def linear(samples: Samples, y: Array, ranks: bool = False) -> Linear:
    """The model of y, or of its ranks.

    Intervals are of the bootstrap: variances differ from one set of samples to the next, also where the model
    leaves no residual.
    """
    columns, names = [], []
    for dimension, name, x in zip(samples.dimensions, samples.names, samples.x.T, strict=True):
        if isinstance(dimension, Choice):
            added = [(x == option).astype(float) for option in np.unique(x)[1:]]
        else:
            added = [rankdata(x) if ranks else x] if np.ptp(x) > 0 else []
        columns += added
        names += [name if len(added) == 1 else ""] * len(added)
    if not columns:
        return Linear({}, 0.0)
    x = np.column_stack(columns)
    own: Array = np.asarray(rankdata(y) if ranks else y, np.float64)

    def estimate(rows: NDArray[np.intp]) -> Array:
        return _slopes(x[rows], own[rows])

    found = intervals(estimate, len(own))
    residual = _standard(own) - _standard(x) @ np.array([e.value for e in found])
    slopes = {n: e for n, e in zip(names, found, strict=True) if n}
    return Linear(slopes, 1.0 - float(np.mean(residual**2)))


def _slopes(x: Array, y: Array) -> Array:
    """Standardised coefficients by least squares."""
    return np.asarray(np.linalg.lstsq(_standard(x), _standard(y), rcond=None)[0], np.float64)


def share(slope: Estimate, part: float) -> Estimate:
    """A coefficient as a share of the variance; `part` of all of it is that of y."""
    ends = sorted((slope.floor**2, slope.ceiling**2))
    low = 0.0 if slope.floor <= 0 <= slope.ceiling else ends[0]
    return Estimate(part * slope.value**2, part * low, part * ends[1])


def share_of_groups(group: Array, y: Array, part: float) -> Estimate:
    """Share of the variance between options of a sampled choice, less what chance gives (epsilon squared).

    (SS_between - (m - 1) MS_within) / SS [Kelley 1935, PNAS 21, 554-559]
    """

    def estimate(rows: NDArray[np.intp]) -> Array:
        groups, places = np.unique(group[rows], return_inverse=True)
        own = y[rows]
        means = np.bincount(places, own) / np.bincount(places)
        whole, within = float(((own - own.mean()) ** 2).sum()), float(((own - means[places]) ** 2).sum())
        spare = len(own) - len(groups)
        if whole <= 0 or spare < 1:
            return np.zeros(1)
        return np.array([part * (whole - within - (len(groups) - 1) * within / spare) / whole])

    return intervals(estimate, len(y))[0]


def _standard(values: Array) -> Array:
    """Mean 0 and standard deviation 1 of each column."""
    deviation = values.std(axis=0)
    found = (values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0)
    return np.asarray(found, np.float64)
