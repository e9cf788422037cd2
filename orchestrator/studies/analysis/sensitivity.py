"""Sensitivity from a plain sample (Latin hypercube, Sobol' points) and from a full grid.

A linear model of an output: standardised coefficients, the share of each, and how much the model explains.

    y = b_0 + sum b_i x_i + e        S_i = (b_i sd(x_i) / sd(y))^2

holds for independent factors as far as R^2 is near 1. A choice has a coefficient for each option but one.

First order indices by RBD-FAST: Tarantola et al. (2006), Reliability Engineering & System Safety 91, 717-727;
from any sample by Plischke (2010), ibid. 95, 354-360; bias correction by Tissot and Prieur (2012), ibid.
107, 205-213. No linearity is assumed; interactions are not seen. Below 200 samples its 10 harmonics take in
too much noise: then a linear model decides, as far as it explains the output. Its R^2 is always reported.

Main effects on a full grid: means over all else at each value; shares of the variance over the grid.

    S_i = Var(mean over all but x_i) / V        T_i = mean(Var over x_i) / V

Nothing is sampled, so there are no intervals: the numbers hold for the values of the grid, each as likely.
"""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from SALib.analyze import rbd_fast
from scipy.stats import rankdata

from orchestrator.studies.analysis.morris_sobol import (
    SEED,
    Rows,
    intervals,
    of_crossed,
    ordered,
    rank_correlation,
    rank_correlations,
)
from orchestrator.studies.analysis.results import (
    FIRST,
    REGRESSION,
    TOTAL,
    Array,
    Effect,
    IntervalEstimate,
    OutputSamples,
    Sensitivity,
)
from orchestrator.studies.design import problem
from orchestrator.studies.study import Choice

FAST = "first order indices by RBD-FAST, from the sample as it is"
LINEAR = "squared standardised coefficients of a linear model"
GRID = "main effects on a full grid"
ENOUGH = 200  # samples for RBD-FAST
FAST_RESAMPLES = 100  # as SALib: an interval here is from a standard deviation
BLOCK = 8  # neighbours in rank: a 25th of 200 samples, a wave of the 10th harmonic is five times as long
SPARE = 10  # samples that a linear model needs beyond its coefficients
LEAST_FIT = 0.7  # R^2 below which a linear model does not order factors [Saltelli et al. 2004]
NOTHING = IntervalEstimate(0.0, 0.0, 0.0)


# ---- plain samples


def from_sample(samples: OutputSamples) -> Sensitivity | str:
    """First order effects of each factor and choice; a reason if there are too few samples."""
    kept = samples.at(samples.complete)
    count, lost = len(kept.y), len(samples.y) - len(kept.y)
    least = sum(len(d.options) - 1 if isinstance(d, Choice) else 1 for d in samples.dimensions) + 1 + SPARE
    if count < least:
        return f"{count} samples have the output, expected at least {least} for {len(kept.names)} factors"
    fast = count >= ENOUGH
    measure = FIRST if fast else REGRESSION
    crossed = [Effect(e.name, e.kind, {measure: e.estimates[FIRST]}) for e in of_crossed(kept)]
    mean = kept.y.mean(axis=1)
    fits = [linear_model(kept, mean, ranks)[1] if np.ptp(mean) > 0 else 0.0 for ranks in (False, True)]
    reliable = fast or fits[0] >= LEAST_FIT
    values, ranks = (f"{100 * fit:.0f} %" for fit in fits)
    notes = [f"a linear model of the factors explains {values} of the variance, of ranks {ranks}"]
    if fast:
        notes.append("first order only: what factors do together is in none of the shares")
    if lost:
        notes.append(
            f"{lost} of {len(samples.y)} samples are left out, as a run of them failed; the shares hold for"
            " the part of the space where runs succeed"
        )
    if not reliable:
        notes.append("the linear model does not hold: no order of the factors can be told from it")
    return Sensitivity(
        FAST if fast else LINEAR,
        measure,
        count,
        float(kept.y.var()),
        ordered(_effects(kept, fast) + crossed, measure),
        {
            which: ordered(_effects(kept.alone(c), fast), measure)
            for c, which in enumerate(kept.combinations)
            if kept.crossed and np.ptp(kept.y[:, c]) > 0
        },
        {"r_squared": fits[0], "r_squared_of_ranks": fits[1]},
        tuple(notes),
        reliable,
    )


def _effects(samples: OutputSamples, fast: bool) -> list[Effect]:
    """Of the samples' dimensions on the mean over the crossed choices, as shares of all variance."""
    y = samples.y.mean(axis=1)
    part = float(y.var()) / float(samples.y.var())
    constant = part < 1e-12
    first = _rbd_fast(samples, y, part) if fast and not constant else [NOTHING] * len(samples.names)
    slopes, ranks = ({} if constant else linear_model(samples, y, ranked)[0] for ranked in (False, True))
    directions = rank_correlations(samples, y)
    effects = []
    for i, dimension in enumerate(samples.dimensions):
        own = dimension.name
        slope = slopes.get(own, NOTHING)
        low, high = sorted((slope.floor**2, slope.ceiling**2))
        low = 0.0 if slope.floor <= 0 <= slope.ceiling else low
        share = IntervalEstimate(part * slope.value**2, part * low, part * high)
        if isinstance(dimension, Choice):
            first[i] = share = NOTHING if constant else _share_of_groups(samples.x[:, i], y, part)
        estimates = {REGRESSION: share, **({FIRST: first[i]} if fast else {})}
        both = {"regression": slopes, "rank_regression": ranks}
        more = {key: model[own].value for key, model in both.items() if own in model}
        effects.append(Effect(own, dimension.kind, estimates, more, directions[i]))
    return effects


def linear_model(
    samples: OutputSamples, y: Array, ranks: bool = False
) -> tuple[dict[str, IntervalEstimate], float]:
    """Standardised coefficients of the factors that vary, by name, and R^2; of y or of its ranks.

    Intervals are of the bootstrap: variances differ from one set of samples to the next, also where the model
    leaves no residual.
    """
    columns, names = [], []
    for dimension, label, x in zip(samples.dimensions, samples.names, samples.x.T, strict=True):
        if isinstance(dimension, Choice):
            added = [(x == option).astype(float) for option in np.unique(x)[1:]]
        else:
            added = [rankdata(x) if ranks else x] if np.ptp(x) > 0 else []
        columns += added
        names += [label if len(added) == 1 else ""] * len(added)
    if not columns:
        return {}, 0.0
    x = np.column_stack(columns)
    own = np.asarray(rankdata(y) if ranks else y, np.float64)

    def coefficients(rows: Rows) -> Array:
        return np.asarray(np.linalg.lstsq(_standard(x[rows]), _standard(own[rows]), rcond=None)[0])

    found = intervals(coefficients, len(own))
    residual = _standard(own) - _standard(x) @ np.array([e.value for e in found])
    return {n: e for n, e in zip(names, found, strict=True) if n}, 1.0 - float(np.mean(residual**2))


def _standard(values: Array) -> Array:
    """Mean 0 and standard deviation 1 of each column; 0 where it is constant."""
    deviation = values.std(axis=0)
    return np.asarray((values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0), np.float64)


def _share_of_groups(group: Array, y: Array, part: float) -> IntervalEstimate:
    """Share of the variance between options of a sampled choice, less what chance gives (epsilon squared).

    (SS_between - (m - 1) MS_within) / SS [Kelley 1935, PNAS 21, 554-559]
    """

    def estimate(rows: Rows) -> Array:
        groups, places = np.unique(group[rows], return_inverse=True)
        own = y[rows]
        means = np.bincount(places, own) / np.bincount(places)
        whole, within = float(((own - own.mean()) ** 2).sum()), float(((own - means[places]) ** 2).sum())
        spare = len(own) - len(groups)
        if whole <= 0 or spare < 1:
            return np.zeros(1)
        return np.array([part * (whole - within - (len(groups) - 1) * within / spare) / whole])

    return intervals(estimate, len(y))[0]


def _rbd_fast(samples: OutputSamples, y: Array, part: float) -> list[IntervalEstimate]:
    """First order indices as shares of all variance; a factor that does not vary has none."""
    rng = np.random.default_rng(SEED)
    x = np.column_stack([_shuffled_ranks(column, rng) for column in samples.x.T])
    standard = (y - y.mean()) / y.std()
    found = rbd_fast.analyze(problem(samples.names), x, standard, num_resamples=FAST_RESAMPLES, seed=rng)
    return [
        IntervalEstimate(part * s, part * (s - half), part * (s + half)) if np.ptp(column) > 0 else NOTHING
        for s, half, column in zip(
            map(float, found["S1"]), map(float, found["S1_conf"]), samples.x.T, strict=True
        )
    ]


def _shuffled_ranks(x: Array, rng: np.random.Generator) -> Array:
    """Ranks of a factor, at random among neighbours.

    RBD-FAST lays points of even and of odd rank side by side. In Sobol' points these can differ in another
    factor, whose effect would then be taken for this one's. Blocks of ranks are shorter than its waves.
    """
    order, ranks = np.argsort(x, kind="stable"), np.empty(len(x))
    blocks = np.arange(len(x)) // BLOCK
    ranks[order[np.lexsort((rng.random(len(x)), blocks))]] = np.arange(len(x))
    return ranks


# ---- full grids


def main_effects(samples: OutputSamples) -> Sensitivity | str:
    """First order of each factor and choice, total too if no run failed."""
    table = pd.DataFrame(np.repeat(samples.x, samples.y.shape[1], axis=0), columns=list(samples.names))
    options = list(itertools.product(*(choice.options for choice in samples.crossed)))
    for j, choice in enumerate(samples.crossed):
        table[choice.name] = np.tile([own[j] for own in options], len(samples.x))
    table["y"] = samples.y.ravel()
    known = table.dropna()
    if len(known) < 2:
        return f"{len(known)} runs have the output, expected at least 2"
    y, whole, complete = known["y"], float(known["y"].var(ddof=0)), len(known) == len(table)
    kinds = {d.name: d.kind for d in (*samples.dimensions, *samples.crossed)}
    effects = []
    for own, sort in kinds.items():
        # variance of the means at each value, weighted by the runs there
        estimates = {
            FIRST: IntervalEstimate(float(known.groupby(own)["y"].transform("mean").var(ddof=0)) / whole)
        }
        if complete:  # mean variance over one factor, all others fixed
            rest = [other for other in kinds if other != own]
            means = known.groupby(rest)["y"].transform("mean") if rest else y.mean()
            estimates[TOTAL] = IntervalEstimate(float(((y - means) ** 2).mean()) / whole)
        direction = rank_correlation(known[own].to_numpy(), y.to_numpy()) if sort == "factor" else None
        effects.append(Effect(own, sort, estimates, {}, direction))
    notes = ["shares hold for the values of the grid, each as likely"]
    if not complete:
        notes.append(
            f"{len(table) - len(known)} of {len(table)} points are missing, as their runs failed: means at a"
            " value are over the points that are left, so effects of other factors are mixed into them"
        )
    measure = TOTAL if complete else FIRST
    return Sensitivity(GRID, measure, len(known), whole, ordered(effects, measure), notes=tuple(notes))
