"""Sensitivities from designs of Morris and Saltelli, a plain sample (Latin hypercube, Sobol' points), a grid.

SALib estimates, from complete trajectories or base samples. It has no crossed choices: mu* and mu are means
over their combinations, sigma is that of all effects, total indices are of the samples of all combinations,
first-order indices of the mean over them. Intervals, but for RBD-FAST, are percentiles of resamples in which
a trajectory or base sample with all its combinations is one draw; SALib's follow from standard deviations.

Elementary effects of a Morris design:

    d_i = (y(x with x_i moved by delta) - y(x)) / delta        mu* = mean |d_i|        sigma = sd of d_i

delta is a fraction of the factor's range (in probability): mu* is the change of the output over the whole
range, in its unit. It ranks factors; it is not a fraction of a variance. Morris (1991), Technometrics 33,
161-174; mu*: Campolongo et al. (2007), Environmental Modelling & Software 22, 1509-1518.

Sobol' indices of a Saltelli design: rows A, A with one column of B after the other, B, per base sample.

    S_i = Var(E(y | x_i)) / V        T_i = E(Var(y | all but x_i)) / V

Estimators of Saltelli et al. (2010), Computer Physics Communications 181, 259-270, table 2 (b) and (f). V is
over factors and choices, in S_i too, where SALib has the variance of the mean over the combinations.

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

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from SALib.analyze import morris, rbd_fast
from SALib.analyze.sobol import first_order, total_order
from scipy.stats import bootstrap, rankdata

from orchestrator.data.table import Array
from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Effect,
    IntervalEstimate,
    OutputSamples,
    Sensitivity,
    rank_correlations,
)
from orchestrator.studies.design import LEVELS, problem
from orchestrator.studies.study import Choice

RESAMPLES = 400  # of the bootstrap: ends of a 95 % interval are accurate to some percent of its width
DRAWN = 2**20  # numbers of samples that the bootstrap draws at once
SEED = 20_01  # fixed, so that equal results give equal intervals
MORRIS = "elementary effects of a Morris design"
SOBOL = "Sobol' indices of a Saltelli design"
LEAST_TRAJECTORIES = 4
STEP = LEVELS / (2 * (LEVELS - 1))  # of a dimension in a trajectory, over its range [Morris 1991, 3]
LEAST_BASE_SAMPLES = 16  # for an interval
MOST_MISSING = 0.1  # fraction of base samples without output up to which the design is used
WIDE = 0.4  # width of the interval of a total index above which a note says so
FAST = "first-order indices by RBD-FAST"
LINEAR = "squared standardised coefficients of a linear model"
GRID = "main effects on a full grid"
ENOUGH = 200  # samples for RBD-FAST
FAST_RESAMPLES = 100  # default of SALib, whose intervals follow from a standard deviation
FEWEST_RESAMPLES, FAST_DRAWN = 25, 10**7  # of more than 1e5 samples fewer: a width is then accurate to 14 %
BLOCK = 8  # ranks that are shuffled; for 200 samples the 10th harmonic has a wave length of some 40 ranks
DEGREES_OF_FREEDOM = 10  # least number of samples of a linear model beyond its coefficients
PART = 2**13  # rows of a table that are in the cache of a core
CONSTANT = 1e-7  # standard deviation of a column of a resample, over that of all samples, below which it is 0
LEAST_FIT = 0.7  # R^2 below which a linear model does not rank factors [Saltelli et al. 2004]
ZERO = IntervalEstimate(0.0, 0.0, 0.0)

Rows = NDArray[np.intp]


# ---- common to all methods


def intervals(estimate: Callable[[Rows], Array], count: int) -> list[IntervalEstimate]:
    """Each value of `estimate` with its 95 % percentile interval [Efron and Tibshirani 1993, chapter 13].

    estimate  function from indices of samples to values, shape (m,)
    count     number of samples; the bootstrap draws them with replacement
    """
    rows, rng = np.arange(count), np.random.default_rng(SEED)
    settings = {"n_resamples": RESAMPLES, "method": "percentile", "vectorized": False}
    result = bootstrap((rows,), estimate, rng=rng, batch=max(1, DRAWN // count), **settings)
    ends = zip(estimate(rows), *result.confidence_interval, strict=True)
    return [IntervalEstimate(float(value), float(low), float(high)) for value, low, high in ends]


def ordered(effects: list[Effect], measure: str) -> tuple[Effect, ...]:
    """Effects sorted by a measure, the largest first; equal ones by name."""
    return tuple(sorted(effects, key=lambda effect: (-effect.estimates[measure].value, effect.name)))


def of_axis(y: Array, axis: int) -> list[float]:
    """First-order and total index of an axis of values on a full grid, any shape; NaN where one is missing.

    first  Var(mean over all other axes) / V, each mean weighted by the number of its values
    total  mean(Var over the axis) / V; NaN if a value is missing

    Both are 0 if all values are equal.
    """
    others, variance = tuple(a for a in range(y.ndim) if a != axis), float(np.nanvar(y))
    if not variance > 0:
        return [0.0, 0.0]
    counts = np.isfinite(y).sum(axis=others)
    means = np.nansum(y, axis=others) / np.maximum(counts, 1)
    first = np.average((means - np.nanmean(y)) ** 2, weights=counts)
    return [float(first) / variance, float(y.var(axis=axis).mean()) / variance]


def of_crossed(samples: OutputSamples) -> list[Effect]:
    """First-order and total indices of the crossed choices, as of an axis of a grid."""
    options = [len(choice.options) for choice in samples.crossed]

    def indices(rows: Rows) -> Array:
        y = samples.y[rows].reshape(len(rows), *options)
        return np.array([index for axis in range(1, y.ndim) for index in of_axis(y, axis)])

    if not options:
        return []
    estimates = intervals(indices, len(samples.y))
    each = zip(samples.crossed, estimates[::2], estimates[1::2], strict=True)
    return [Effect(choice.name, choice.kind, {FIRST: f, TOTAL: t}) for choice, f, t in each]


# ---- Morris


def elementary_effects(samples: OutputSamples) -> Sensitivity | str:
    """mu* and sigma of each factor and choice; a reason if too few trajectories are complete.

    Those of a factor are over the trajectories and the combinations of crossed choices together.
    """
    width = len(samples.names) + 1
    design, count = samples.blocks(width)
    complete = len(design.y) // width
    if complete < LEAST_TRAJECTORIES:
        return f"expected at least {LEAST_TRAJECTORIES} complete trajectories, got {complete} of {count}"
    settings = {"num_levels": LEVELS, "num_resamples": 2, "seed": SEED}  # SALib's intervals are not used
    of_each = [morris.analyze(problem(design.names), design.x, y, **settings) for y in design.y.T]
    star, mu, sigma = (np.array([of[key] for of in of_each], float) for key in ("mu_star", "mu", "sigma"))
    sigmas = np.sqrt((sigma**2).mean(axis=0) + mu.var(axis=0)).tolist()
    columns = star.mean(axis=0).tolist(), mu.mean(axis=0).tolist(), sigmas
    directions = rank_correlations(design, design.y.mean(axis=1))
    each = zip(design.dimensions, _trajectory_intervals(design), *columns, directions, strict=True)
    effects = [
        Effect(d.name, d.kind, {MU_STAR: replace(i, value=v)}, {"mu": mean, "sigma": sd}, direction)
        for d, i, v, mean, sd, direction in each
    ]
    effects += _option_effects(design, width)
    notes = [
        "mu* is the change of the output over the whole range of a factor; it is not a fraction of a variance"
    ]
    if complete < count:
        notes.append(f"{count - complete} of {count} trajectories are left out, as one of their runs failed")
    largest_first = ordered(effects, MU_STAR)
    return Sensitivity(MORRIS, MU_STAR, complete, float(design.y.var()), largest_first, notes=tuple(notes))


def _trajectory_intervals(design: OutputSamples) -> list[IntervalEstimate]:
    """mu* of each factor with its interval."""
    x, y = (v.reshape(-1, len(design.names) + 1, v.shape[1]) for v in (design.x, design.y))
    moved, change = np.diff(x, axis=1) != 0, np.abs(np.diff(y, axis=1)).mean(axis=2)
    magnitudes = np.einsum("tsd,ts->td", moved, change) / STEP
    return intervals(partial(_means, magnitudes), len(magnitudes))


def _means(values: Array, rows: Rows) -> Array:
    """Mean of these rows of values of shape (n, m)."""
    return np.asarray(values.take(rows, axis=0).mean(axis=0))


def _option_effects(design: OutputSamples, width: int) -> list[Effect]:
    """mu* of crossed choices: mean absolute difference between two options, all else equal."""
    y = design.y.reshape(-1, width, *(len(choice.options) for choice in design.crossed))
    effects = []
    for axis, choice in enumerate(design.crossed, start=2):
        options = np.moveaxis(y, axis, -1)
        first, second = np.triu_indices(len(choice.options), 1)
        change = options[..., second] - options[..., first]
        magnitude = np.abs(change).reshape(len(y), -1).mean(axis=1, keepdims=True)
        (star,) = intervals(partial(_means, magnitude), len(y))
        more = {"mu": float(change.mean()), "sigma": float(change.std())}
        effects.append(Effect(choice.name, choice.kind, {MU_STAR: star}, more))
    return effects


# ---- Sobol'


def independent(samples: OutputSamples) -> OutputSamples:
    """The rows A and B of a Saltelli design; the rows between them repeat their columns."""
    width = len(samples.names) + 2
    position = np.arange(len(samples.y)) % width
    return samples.at((position == 0) | (position == width - 1))


def sobol_indices(design: OutputSamples, count: int) -> Sensitivity:
    """First-order and total indices of each factor and choice, from the complete of `count` base samples."""
    width = len(design.names) + 2
    independent_rows, y = independent(design), design.y.reshape(-1, width, design.y.shape[1])
    factors, complete = _sobol_effects(independent_rows, y), len(y)
    notes = []
    if complete < count:
        notes.append(
            f"{count - complete} of {count} base samples are left out, all {width} rows of each, as one of"
            " their runs failed; the indices hold for the part of the space where runs succeed"
        )
    widest = max(e.estimates[TOTAL].ceiling - e.estimates[TOTAL].floor for e in factors)
    if widest > WIDE:
        notes.append(
            f"{complete} base samples are few: an interval is {100 * widest:.0f} percentage points wide"
        )
    effects, variance = ordered(factors + of_crossed(independent_rows), TOTAL), independent_rows.y.var()
    return Sensitivity(SOBOL, TOTAL, complete, float(variance), effects, notes=tuple(notes))


def _sobol_effects(independent_rows: OutputSamples, y: Array) -> list[Effect]:
    """Indices of the factors; y of shape (base samples, rows, combinations)."""
    y, k = (y - y.mean()) / y.std(), len(independent_rows.dimensions)  # as SALib's `analyze` does
    with warnings.catch_warnings():  # SALib's, of a resample in which all values are equal: its indices are 0
        warnings.simplefilter("ignore", UserWarning)
        estimates = intervals(lambda rows: _indices(y.take(rows, axis=0)), len(y))
    directions = rank_correlations(independent_rows, independent_rows.y.mean(axis=1))
    return [
        Effect(d.name, d.kind, {FIRST: estimates[i], TOTAL: estimates[k + i]}, direction=directions[i])
        for i, d in enumerate(independent_rows.dimensions)
    ]


def _indices(y: Array) -> Array:
    """S_1 .. S_k, T_1 .. T_k, shape (2 k,), of base samples of shape (n, k + 2, combinations)."""
    ends, means = y[:, [0, -1]], y.mean(axis=2, keepdims=True)
    # SALib divides S by the variance of the means, which is V without crossed choices
    fraction = means[:, [0, -1]].var() / (ends.var() or np.inf)
    return np.concatenate((fraction * first_order(*_columns(means)), total_order(*_columns(y))))


def _columns(y: Array) -> tuple[Array, ...]:
    """f_A, f_AB and f_B for SALib, each of shape (n combinations, k)."""
    rows = np.moveaxis(y, 2, 1).reshape(-1, y.shape[1])
    return np.broadcast_arrays(rows[:, :1], rows[:, 1:-1], rows[:, -1:])


# ---- plain samples


def from_sample(samples: OutputSamples, sequence: bool) -> Sensitivity | str:
    """First-order effects of factors and choices, or why not; `sequence`: from Sobol' points."""
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
    found, fit = _effects(complete, fast, sequence)
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
    effects = ordered(found + crossed, measure)
    quality = {"r_squared": fit}
    return Sensitivity(method, measure, count, variance, effects, quality, tuple(notes), reliable)


def _effects(samples: OutputSamples, fast: bool, sequence: bool) -> tuple[list[Effect], float]:
    """Effects of the dimensions on the mean over the crossed choices, as fractions of the whole variance.

    Second, R^2 of the linear model.
    """
    y = samples.y.mean(axis=1)
    fraction = float(y.var()) / float(samples.y.var())
    constant = fraction < 1e-12
    estimated = fast and not constant
    first = _rbd_fast(samples, y, fraction, sequence) if estimated else [ZERO] * len(samples.names)
    coefficients, fit = ({}, 0.0) if constant else linear_model(samples, y)
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
        more = {"regression": b.value} if name in coefficients else {}
        effects.append(Effect(name, dimension.kind, estimates, more, directions[i]))
    return effects, fit


def linear_model(samples: OutputSamples, y: Array) -> tuple[dict[str, IntervalEstimate], float]:
    """A linear model of y, shape (n,), in the factors that vary and in the options of choices.

    First, the standardised coefficients of factors, and of choices between two options, by name, with
    intervals of the bootstrap: variances differ between samples even without a residual. Second, R^2.
    """
    columns, names = list[Array](), list[str]()
    for dimension, x in zip(samples.dimensions, samples.x.T, strict=True):
        if isinstance(dimension, Choice):
            added = [(x == option).astype(float) for option in np.unique(x)[1:]]
        else:
            added = [x] if np.ptp(x) > 0 else []
        columns += added
        names += [dimension.name if len(added) == 1 else ""] * len(added)
    if not columns:
        return {}, 0.0
    table = np.column_stack([*columns, y])
    table = np.column_stack([np.ones(len(y)), (table - table.mean(axis=0)) / table.std(axis=0)])
    estimates = intervals(lambda rows: _coefficients(table, rows), len(y))
    residual = table[:, 1:] @ [*(-estimate.value for estimate in estimates), 1.0]
    known = {name: estimate for name, estimate in zip(names, estimates, strict=True) if name}
    return known, 1.0 - float(np.mean(residual**2))


def _coefficients(table: Array, rows: Rows) -> Array:
    """Standardised coefficients of the last column of these rows in the others; 0 for a constant column.

    table   shape (n, m): a column of ones, then columns with mean 0 and standard deviation 1
    """
    times = np.bincount(rows, minlength=len(table))[:, None].astype(float)
    # in the order of the table, whose rows at random would be slow to read
    parts = (slice(k, k + PART) for k in range(0, len(table), PART))
    moments = np.sum([table[p].T @ (times[p] * table[p]) for p in parts], axis=0) / len(rows)
    covariance = (moments - np.outer(moments[0], moments[0]))[1:, 1:]
    deviation = np.sqrt(covariance.diagonal().clip(0.0))
    scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > CONSTANT)
    correlation = covariance * np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(correlation[:-1, :-1], CONSTANT, hermitian=True) @ correlation[:-1, -1])


def _epsilon_squared(group: Array, y: Array, fraction: float) -> IntervalEstimate:
    """Epsilon squared of a sampled choice: fraction of the variance between options, corrected for bias.

    (SS_between - (m - 1) MS_within) / SS [Kelley 1935, PNAS 21, 554-559]
    """

    option, centred = group.astype(int), y - y.mean()

    def estimate(rows: Rows) -> Array:
        options, values = option[rows], centred[rows]
        counts, sums = np.bincount(options), np.bincount(options, values)
        between = float((sums**2 / np.maximum(counts, 1)).sum()) - len(values) * values.mean() ** 2
        total, groups = len(values) * float(values.var()), np.count_nonzero(counts)
        freedom = len(values) - groups
        if total <= 0 or freedom < 1:
            return np.zeros(1)
        return np.array([fraction * (between - (groups - 1) * (total - between) / freedom) / total])

    return intervals(estimate, len(y))[0]


def _rbd_fast(samples: OutputSamples, y: Array, fraction: float, sequence: bool) -> list[IntervalEstimate]:
    """First-order indices as fractions of the whole variance; zero for a factor that does not vary."""
    rng = np.random.default_rng(SEED)
    # ranks, because the order of equal values is then that of the samples on all computers
    x = rankdata(samples.x, "ordinal", axis=0)
    if sequence:
        x = np.column_stack([_shuffled_ranks(column, rng) for column in samples.x.T])
    standard = (y - y.mean()) / y.std()
    resamples = min(FAST_RESAMPLES, max(FEWEST_RESAMPLES, FAST_DRAWN // len(y)))
    result = rbd_fast.analyze(problem(samples.names), x, standard, num_resamples=resamples, seed=rng)
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
    """First-order index of each factor and choice, and the total index if no run failed.

    The values of a factor are those of the samples: tables of several grids can be put together.
    """
    dimensions = (*samples.dimensions, *samples.crossed)
    places = [np.unique(column, return_inverse=True) for column in samples.x.T]
    levels = [len(values) for values, _ in places]
    y = np.full([*levels, samples.y.shape[1]], np.nan)
    y[tuple(index for _, index in places)] = samples.y
    y = y.reshape([*levels, *(len(choice.options) for choice in samples.crossed)])
    count = int(np.isfinite(y).sum())
    complete, known = count == y.size, np.isfinite(samples.y)
    if count < 2:
        return f"expected at least 2 runs with the output, got {count}"
    x = np.repeat(samples.x, samples.y.shape[1], axis=0)[known.ravel()]
    directions = rank_correlations(replace(samples, x=x), samples.y[known]) + [None] * len(samples.crossed)
    effects = []
    for axis, (dimension, direction) in enumerate(zip(dimensions, directions, strict=True)):
        first, total = of_axis(y, axis)
        estimates = {FIRST: IntervalEstimate(first)} | ({TOTAL: IntervalEstimate(total)} if complete else {})
        effects.append(Effect(dimension.name, dimension.kind, estimates, {}, direction))
    notes = ["the results hold for the values of the grid, equally weighted"]
    if not complete:
        notes.append(
            f"{y.size - count} of {y.size} points are missing, as their runs failed: means at a"
            " value are over the remaining points, so they contain effects of other factors"
        )
    measure, variance = TOTAL if complete else FIRST, float(np.nanvar(y))
    return Sensitivity(GRID, measure, count, variance, ordered(effects, measure), notes=tuple(notes))
