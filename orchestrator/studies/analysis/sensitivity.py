"""Sensitivities from a plain sample (Latin hypercube, Sobol' points) and from a full grid.

A linear model of an output: standardised coefficients, their fractions of the variance, and R^2.

    y = b_0 + sum b_i x_i + e        S_i = (b_i sd(x_i) / sd(y))^2

is valid for independent factors if R^2 is near 1. A choice has a coefficient for each option except one.

First-order indices by RBD-FAST: Tarantola et al. (2006), Reliability Engineering & System Safety 91, 717-727;
from any sample by Plischke (2010), ibid. 95, 354-360; bias correction by Tissot and Prieur (2012), ibid.
107, 205-213. No linearity is assumed; interactions are not included. Below 200 samples its 10 harmonics
contain too much noise: then the linear model is used, if it fits. Its R^2 is always reported.

Main effects on a full grid: means over all other factors at each value, as fractions of the variance.

    S_i = Var(mean over all but x_i) / V        T_i = mean(Var over x_i) / V

Nothing is sampled, so there are no intervals: the results hold for the values of the grid, equally weighted.
"""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from SALib.analyze import rbd_fast

from orchestrator.data.table import Array
from orchestrator.studies.analysis.morris_sobol import SEED, Rows, intervals, of_crossed, ordered
from orchestrator.studies.analysis.output_samples import OutputSamples, rank_correlation, rank_correlations
from orchestrator.studies.analysis.results import (
    FIRST,
    REGRESSION,
    TOTAL,
    Effect,
    IntervalEstimate,
    Sensitivity,
)
from orchestrator.studies.design import problem
from orchestrator.studies.study import Choice

FAST = "first-order indices by RBD-FAST"
LINEAR = "squared standardised coefficients of a linear model"
GRID = "main effects on a full grid"
ENOUGH = 200  # samples for RBD-FAST
FAST_RESAMPLES = 100  # default of SALib, whose intervals follow from a standard deviation
BLOCK = 8  # ranks that are shuffled; for 200 samples the 10th harmonic has a wave length of some 40 ranks
DEGREES_OF_FREEDOM = 10  # least number of samples of a linear model beyond its coefficients
LEAST_FIT = 0.7  # R^2 below which a linear model does not rank factors [Saltelli et al. 2004]
ZERO = IntervalEstimate(0.0, 0.0, 0.0)


# ---- plain samples


def from_sample(samples: OutputSamples) -> Sensitivity | str:
    """First-order effects of each factor and choice; a reason if there are too few samples."""
    complete = samples.at(samples.complete)
    count, missing = len(complete.y), len(samples.y) - len(complete.y)
    coefficients = 1 + sum(len(d.options) - 1 if isinstance(d, Choice) else 1 for d in samples.dimensions)
    least = coefficients + DEGREES_OF_FREEDOM
    if count < least:
        factors = len(complete.names)
        return f"expected at least {least} samples with the output for {factors} factors, got {count}"
    fast = count >= ENOUGH
    measure = FIRST if fast else REGRESSION
    crossed = [Effect(e.name, e.kind, {measure: e.estimates[FIRST]}) for e in of_crossed(complete)]
    mean = complete.y.mean(axis=1)
    fit = LinearModel(complete, mean).fit if np.ptp(mean) > 0 else 0.0
    reliable = fast or fit >= LEAST_FIT
    notes = [f"a linear model of the factors explains {100 * fit:.0f} % of the variance"]
    if fast:
        notes.append("first order only: interactions of factors are not included")
    if missing:
        notes.append(
            f"{missing} of {len(samples.y)} samples are left out, as one of their runs failed; the estimates"
            " hold for the part of the space where runs succeed"
        )
    if not reliable:
        notes.append("the linear model does not fit: it cannot rank the factors")
    method, variance = FAST if fast else LINEAR, float(complete.y.var())
    effects = ordered(_effects(complete, fast) + crossed, measure)
    quality = {"r_squared": fit}
    return Sensitivity(method, measure, count, variance, effects, quality, tuple(notes), reliable)


def _effects(samples: OutputSamples, fast: bool) -> list[Effect]:
    """Effects of the dimensions on the mean over the crossed choices, as fractions of the whole variance."""
    y = samples.y.mean(axis=1)
    fraction = float(y.var()) / float(samples.y.var())
    constant = fraction < 1e-12
    first = _rbd_fast(samples, y, fraction) if fast and not constant else [ZERO] * len(samples.names)
    linear = None if constant else LinearModel(samples, y)
    values = linear.values if linear else {}
    coefficients = linear.intervals() if linear else {}
    directions = rank_correlations(samples, y)
    effects = []
    for i, dimension in enumerate(samples.dimensions):
        name = dimension.name
        b = coefficients.get(name, ZERO)
        low, high = sorted((b.floor**2, b.ceiling**2))
        low = 0.0 if b.floor <= 0 <= b.ceiling else low
        squared = IntervalEstimate(fraction * b.value**2, fraction * low, fraction * high)
        if isinstance(dimension, Choice):
            first[i] = squared = ZERO if constant else _epsilon_squared(samples.x[:, i], y, fraction)
        estimates = {REGRESSION: squared, **({FIRST: first[i]} if fast else {})}
        more = {"regression": values[name]} if name in values else {}
        effects.append(Effect(name, dimension.kind, estimates, more, directions[i]))
    return effects


class LinearModel:
    """A linear model of y in the factors that vary and in the options of choices.

    values   standardised coefficients of factors, and of choices between two options, by name
    fit      R^2
    """

    def __init__(self, samples: OutputSamples, y: Array) -> None:
        columns, self._names = list[Array](), list[str]()
        for dimension, label, x in zip(samples.dimensions, samples.names, samples.x.T, strict=True):
            if isinstance(dimension, Choice):
                added = [(x == option).astype(float) for option in np.unique(x)[1:]]
            else:
                added = [x] if np.ptp(x) > 0 else []
            columns += added
            self._names += [label if len(added) == 1 else ""] * len(added)
        self.values, self.fit = dict[str, float](), 0.0
        if not columns:
            return
        self._x = np.column_stack(columns)
        self._y = y
        values = self._coefficients(np.arange(len(self._y)))
        residual = _standard(self._y) - _standard(self._x) @ values
        self.values = {n: float(value) for n, value in zip(self._names, values, strict=True) if n}
        self.fit = 1.0 - float(np.mean(residual**2))

    def _coefficients(self, rows: Rows) -> Array:
        x, y = _standard(self._x[rows]), _standard(self._y[rows])
        return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0])

    def intervals(self) -> dict[str, IntervalEstimate]:
        """Of the values, from the bootstrap: variances differ between samples even without a residual."""
        if not self._names:
            return {}
        estimates = intervals(self._coefficients, len(self._y))
        return {n: estimate for n, estimate in zip(self._names, estimates, strict=True) if n}


def _standard(values: Array) -> Array:
    """Columns scaled to mean 0 and standard deviation 1; constant columns become 0."""
    mean = values.mean(axis=0, keepdims=True)
    deviation = values.std(axis=0, mean=mean)
    return np.asarray((values - mean) / np.where(deviation > 0, deviation, 1.0), np.float64)


def _epsilon_squared(group: Array, y: Array, fraction: float) -> IntervalEstimate:
    """Epsilon squared of a sampled choice: fraction of the variance between options, corrected for bias.

    (SS_between - (m - 1) MS_within) / SS [Kelley 1935, PNAS 21, 554-559]
    """

    def estimate(rows: Rows) -> Array:
        groups, index = np.unique(group[rows], return_inverse=True)
        values = y[rows]
        means = np.bincount(index, values) / np.bincount(index)
        total, within = (float(((values - m) ** 2).sum()) for m in (values.mean(), means[index]))
        freedom = len(values) - len(groups)
        if total <= 0 or freedom < 1:
            return np.zeros(1)
        return np.array([fraction * (total - within - (len(groups) - 1) * within / freedom) / total])

    return intervals(estimate, len(y))[0]


def _rbd_fast(samples: OutputSamples, y: Array, fraction: float) -> list[IntervalEstimate]:
    """First-order indices as fractions of the whole variance; zero for a factor that does not vary."""
    rng = np.random.default_rng(SEED)
    x = np.column_stack([_shuffled_ranks(column, rng) for column in samples.x.T])
    standard = (y - y.mean()) / y.std()
    result = rbd_fast.analyze(problem(samples.names), x, standard, num_resamples=FAST_RESAMPLES, seed=rng)
    indices, halves = (fraction * np.array(result[name], float) for name in ("S1", "S1_conf"))
    rows = np.column_stack([indices, indices - halves, indices + halves]).tolist()
    varied = np.ptp(samples.x, axis=0) > 0
    return [IntervalEstimate(*row) if v else ZERO for row, v in zip(rows, varied, strict=True)]


def _shuffled_ranks(x: Array, rng: np.random.Generator) -> Array:
    """Ranks of a factor, shuffled within blocks of neighbours.

    RBD-FAST treats points of even and of odd rank as neighbours. Sobol' points of even and of odd rank can
    differ in another factor, whose effect would be attributed to this one. Blocks are shorter than the waves
    of all harmonics.
    """
    order, ranks = np.argsort(x, kind="stable"), np.empty(len(x))
    blocks = np.arange(len(x)) // BLOCK
    ranks[order[np.lexsort((rng.random(len(x)), blocks))]] = np.arange(len(x))
    return ranks


# ---- full grids


def main_effects(samples: OutputSamples) -> Sensitivity | str:
    """First-order index of each factor and choice, and the total index if no run failed."""
    table = pd.DataFrame(np.repeat(samples.x, samples.y.shape[1], axis=0), columns=list(samples.names))
    options = list(itertools.product(*(choice.options for choice in samples.crossed)))
    for j, choice in enumerate(samples.crossed):
        table[choice.name] = np.tile([combination[j] for combination in options], len(samples.x))
    table["y"] = samples.y.ravel()
    points = table.dropna()
    if len(points) < 2:
        return f"expected at least 2 runs with the output, got {len(points)}"
    y, complete = points["y"], len(points) == len(table)
    variance = float(y.var(ddof=0))
    kinds = {d.name: d.kind for d in (*samples.dimensions, *samples.crossed)}
    effects = []
    for name, kind in kinds.items():
        # variance of the means at each value, weighted by the number of runs
        means = points.groupby(name)["y"].transform("mean")
        estimates = {FIRST: IntervalEstimate(float(means.var(ddof=0)) / variance)}
        if complete:  # mean variance over one factor, all others fixed
            others = [other for other in kinds if other != name]
            means = points.groupby(others)["y"].transform("mean") if others else y.mean()
            estimates[TOTAL] = IntervalEstimate(float(((y - means) ** 2).mean()) / variance)
        direction = rank_correlation(points[name].to_numpy(), y.to_numpy()) if kind == "factor" else None
        effects.append(Effect(name, kind, estimates, {}, direction))
    notes = ["the results hold for the values of the grid, equally weighted"]
    if not complete:
        notes.append(
            f"{len(table) - len(points)} of {len(table)} points are missing, as their runs failed: means at a"
            " value are over the remaining points, so they contain effects of other factors"
        )
    measure = TOTAL if complete else FIRST
    return Sensitivity(GRID, measure, len(points), variance, ordered(effects, measure), notes=tuple(notes))
