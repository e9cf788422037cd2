"""A linear model of an output: standardised coefficients, the share of each, and how much the model explains.

    y = b_0 + sum b_i x_i + e        S_i = (b_i sd(x_i) / sd(y))^2

holds for independent factors as far as R^2 is near 1. A choice has a coefficient for each option but one.

Sensitivity from a plain sample (Latin hypercube, Sobol' points), for which no special design was run.

First order indices by RBD-FAST: Tarantola et al. (2006), Reliability Engineering & System Safety 91, 717-727;
from any sample by Plischke (2010), ibid. 95, 354-360; bias correction by Tissot and Prieur (2012), ibid.
107, 205-213. No linearity is assumed; interactions are not seen. Below 200 samples its 10 harmonics take in
too much noise: then a linear model decides, as far as it explains the output. Its R^2 is told in both cases.

Main effects on a full grid: means over all else at each value; shares of the variance over the grid.

    S_i = Var(mean over all but x_i) / V        T_i = mean(Var over x_i) / V

Nothing is sampled, so there are no intervals: the numbers hold for the values of the grid, each as likely.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from SALib.analyze import rbd_fast
from scipy.stats import rankdata

from orchestrator.studies.analysis.morris_sobol import (
    SEED,
    intervals,
    of_choices,
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
    Estimate,
    Samples,
    Sensitivity,
    kind,
    name,
)
from orchestrator.studies.study import Choice

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
    for dimension, label, x in zip(samples.dimensions, samples.names, samples.x.T, strict=True):
        if isinstance(dimension, Choice):
            added = [(x == option).astype(float) for option in np.unique(x)[1:]]
        else:
            added = [rankdata(x) if ranks else x] if np.ptp(x) > 0 else []
        columns += added
        names += [label if len(added) == 1 else ""] * len(added)
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


FAST = "first order indices by RBD-FAST, from the sample as it is"
LINEAR = "squared standardised coefficients of a linear model"
ENOUGH = 200  # samples for RBD-FAST
SAMPLE_RESAMPLES = 100  # as SALib: an interval here is from a standard deviation
BLOCK = 8  # neighbours in rank: a 25th of 200 samples, a wave of the 10th harmonic is five times as long
SPARE = 10  # samples that a linear model needs beyond its coefficients
LEAST_FIT = 0.7  # R^2 below which a linear model does not order factors [Saltelli et al. 2004]


def from_sample(samples: Samples) -> Sensitivity | str:
    """First order effects of each factor and choice; a reason if there are too few samples."""
    kept = samples.at(samples.complete)
    options = sum(len(d.options) - 1 if isinstance(d, Choice) else 1 for d in samples.dimensions)
    least = options + 1 + SPARE
    if len(kept.y) < least:
        return (
            f"{len(kept.y)} samples have the output, expected at least {least} for {len(kept.names)} factors"
        )
    fast = len(kept.y) >= ENOUGH
    measure = FIRST if fast else REGRESSION
    effects = [*_effects(kept, fast), *(_as(measure, effect) for effect in _of_crossed(kept))]
    mean = kept.y.mean(axis=1)
    fits = [linear(kept, mean, ranks).r_squared if np.ptp(mean) > 0 else 0.0 for ranks in (False, True)]
    columns = [c for c in range(len(kept.combinations)) if kept.crossed and np.ptp(kept.y[:, c]) > 0]
    reliable = fast or fits[0] >= LEAST_FIT
    return Sensitivity(
        FAST if fast else LINEAR,
        measure,
        len(kept.y),
        float(kept.y.var()),
        ordered(effects, measure),
        {kept.combinations[c]: ordered(_effects(kept.alone(c), fast), measure) for c in columns},
        {"r_squared": fits[0], "r_squared_of_ranks": fits[1]},
        tuple(_notes(len(samples.y) - len(kept.y), len(samples.y), fast, fits, reliable)),
        reliable,
    )


def _notes(lost: int, count: int, fast: bool, fits: list[float], reliable: bool) -> list[str]:
    """What to know before the numbers are read."""
    values, ranks = (f"{100 * fit:.0f} %" for fit in fits)
    notes = [f"a linear model of the factors explains {values} of the variance, of ranks {ranks}"]
    if fast:
        notes.append("first order only: what factors do together is in none of the shares")
    if lost:
        notes.append(
            f"{lost} of {count} samples are left out, as a run of them failed; the shares hold for the part"
            " of the space where runs succeed"
        )
    if not reliable:
        notes.append("the linear model does not hold: no order of the factors can be told from it")
    return notes


def _of_crossed(samples: Samples) -> list[Effect]:
    return of_choices(samples) if samples.crossed else []


def _as(measure: str, effect: Effect) -> Effect:
    """A choice among factors measured otherwise: its first order is known for every sample."""
    return Effect(effect.name, effect.kind, {measure: effect.estimates[FIRST]})


def _effects(samples: Samples, fast: bool) -> list[Effect]:
    """Of the samples' dimensions on the mean over the crossed choices, as shares of all variance."""
    y, whole = samples.y.mean(axis=1), float(samples.y.var())
    part = float(y.var()) / whole
    still = part < 1e-12
    first = _fast(samples, y, part) if fast and not still else [NOTHING] * len(samples.names)
    values, ranks = (linear(samples, y, ranked).slopes if not still else {} for ranked in (False, True))
    directions = rank_correlations(samples, y)
    effects = []
    for i, dimension in enumerate(samples.dimensions):
        own = name(dimension)
        shares = share(values.get(own, NOTHING), part)
        if isinstance(dimension, Choice):
            shares = NOTHING if still else share_of_groups(samples.x[:, i], y, part)
            first[i] = shares
        estimates = {REGRESSION: shares, **({FIRST: first[i]} if fast else {})}
        slopes = {"regression": values, "rank_regression": ranks}
        more = {n: found[own].value for n, found in slopes.items() if own in found}
        effects.append(Effect(own, kind(dimension), estimates, more, directions[i]))
    return effects


def _stirred(x: Array, rng: np.random.Generator) -> Array:
    """Ranks of a factor, at random among neighbours.

    RBD-FAST lays points of even and of odd rank side by side. In Sobol' points these can differ in another
    factor, whose effect would then be taken for this one's. Blocks of ranks are short beside its waves.
    """
    order, ranks = np.argsort(x, kind="stable"), np.empty(len(x))
    blocks = np.arange(len(x)) // BLOCK
    ranks[order[np.lexsort((rng.random(len(x)), blocks))]] = np.arange(len(x))
    return ranks


def _fast(samples: Samples, y: Array, part: float) -> list[Estimate]:
    """First order indices; a factor that does not vary has none."""
    problem = {"num_vars": len(samples.names), "names": list(samples.names)}
    seed = np.random.default_rng(SEED)
    x = np.column_stack([_stirred(column, seed) for column in samples.x.T])
    found = rbd_fast.analyze(problem, x, (y - y.mean()) / y.std(), num_resamples=SAMPLE_RESAMPLES, seed=seed)
    pairs = zip(found["S1"], found["S1_conf"], np.ptp(samples.x, axis=0) > 0, strict=True)
    return [
        Estimate(part * float(s), part * float(s - half), part * float(s + half)) if moves else NOTHING
        for s, half, moves in pairs
    ]


METHOD = "main effects on a full grid"


def main_effects(samples: Samples) -> Sensitivity | str:
    """First order of each factor and choice, total too if no run failed."""
    table = _table(samples)
    known = table.dropna()
    if len(known) < 2:
        return f"{len(known)} runs have the output, expected at least 2"
    whole, complete = float(known["y"].var(ddof=0)), len(known) == len(table)
    kinds = {name(d): kind(d) for d in (*samples.dimensions, *samples.crossed)}
    y = known["y"].to_numpy()
    measure = TOTAL if complete else FIRST
    effects = []
    for own, sort in kinds.items():
        estimates = {FIRST: Estimate(_first(known, own) / whole)}
        if complete:
            rest = [other for other in kinds if other != own]
            estimates[TOTAL] = Estimate(_total(known, rest) / whole)
        direction = rank_correlation(known[own].to_numpy(), y) if sort == "factor" else None
        effects.append(Effect(own, sort, estimates, {}, direction))
    notes = ["shares hold for the values of the grid, each as likely"]
    if not complete:
        notes.append(
            f"{len(table) - len(known)} of {len(table)} points are missing, as their runs failed: means at a"
            " value are over the points that are left, so effects of other factors are mixed into them"
        )
    return Sensitivity(METHOD, measure, len(known), whole, ordered(effects, measure), notes=tuple(notes))


def _table(samples: Samples) -> pd.DataFrame:
    """A row per run: factors, choices, y."""
    table = pd.DataFrame(np.repeat(samples.x, samples.y.shape[1], axis=0), columns=list(samples.names))
    options = list(itertools.product(*(choice.options for choice in samples.crossed)))
    for j, choice in enumerate(samples.crossed):
        table[choice.what] = np.tile([own[j] for own in options], len(samples.x))
    table["y"] = samples.y.ravel()
    return table


def _first(known: pd.DataFrame, name: str) -> float:
    """Variance of the means at each value, weighted by the runs there."""
    return float(known.groupby(name)["y"].transform("mean").var(ddof=0))


def _total(known: pd.DataFrame, rest: list[str]) -> float:
    """Mean variance over one factor, all others fixed."""
    if not rest:
        return float(known["y"].var(ddof=0))
    means = known.groupby(rest)["y"].transform("mean")
    return float(((known["y"] - means) ** 2).mean())
