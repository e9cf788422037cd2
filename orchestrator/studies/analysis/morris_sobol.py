"""Intervals by the bootstrap, and the effects of choices: they are known for every sample.

Elementary effects of a Morris design: mu* and sigma by SALib.

    d_i = (y(x with x_i moved by delta) - y(x)) / delta        mu* = mean |d_i|        sigma = sd of d_i

delta is a share of the factor's range (in probability): mu* is what the output changes over the whole range,
in its unit. Morris (1991), Technometrics 33, 161-174; mu*: Campolongo et al. (2007), Environmental
Modelling & Software 22, 1509-1518. It orders factors; it is no share of a variance.

Sobol' indices of a Saltelli design: rows A, A with one column of B after the other, B, per base sample.

    S_i = Var(E(y | x_i)) / V        T_i = E(Var(y | all but x_i)) / V

Estimators of Saltelli et al. (2010), Computer Physics Communications 181, 259-270, table 2 (b) and (f), as
SALib has them. V is over factors and choices: y averaged over the choices gives S_i, all of y gives T_i.
Intervals: base samples are drawn again; a base sample with all its rows and combinations is one draw.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from SALib.analyze import morris
from SALib.analyze.sobol import first_order, total_order
from scipy.stats import spearmanr

from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    TOTAL,
    Array,
    Effect,
    Estimate,
    Samples,
    Sensitivity,
    kind,
    name,
)
from orchestrator.studies.design import LEVELS
from orchestrator.studies.study import Factor

RESAMPLES = 400  # ends of a 95 % interval to some percent of its width
SEED = 20_01  # equal results give equal intervals


def intervals(estimate: Callable[[NDArray[np.intp]], Array], count: int) -> list[Estimate]:
    """Each number of `estimate` with its 95 % percentile interval [Efron and Tibshirani 1993, chapter 13].

    estimate   numbers, shape (m,), from samples with the given rows
    count      of samples; they are drawn with replacement
    """
    rng = np.random.default_rng(SEED)
    found = np.array([estimate(rng.integers(count, size=count)) for _ in range(RESAMPLES)])
    low, high = np.quantile(found, (0.025, 0.975), axis=0)
    values = estimate(np.arange(count))
    return [Estimate(float(v), float(a), float(b)) for v, a, b in zip(values, low, high, strict=True)]


def of_choices(samples: Samples) -> list[Effect]:
    """Shares of the variance that each crossed choice moves by itself and with all others.

    first  Var(mean over all but the choice) / V        total  mean(Var over the choice's options) / V
    """
    found = intervals(lambda rows: shares_of_choices(samples, rows), len(samples.y))
    return [
        Effect(choice.what, "choice", {FIRST: found[2 * j], TOTAL: found[2 * j + 1]})
        for j, choice in enumerate(samples.crossed)
    ]


def shares_of_choices(samples: Samples, rows: NDArray[np.intp]) -> Array:
    """First and total of each choice one after the other, shape (2 m,)."""
    shape = (len(rows), *(len(choice.options) for choice in samples.crossed))
    y = samples.y[rows].reshape(shape)
    whole = y.var()
    found = []
    for axis in range(1, len(shape)):
        others = tuple(a for a in range(len(shape)) if a != axis)
        found += [y.mean(axis=others).var(), y.var(axis=axis).mean()]
    return np.array(found) / whole if whole > 0 else np.zeros(len(found))


def ordered(effects: list[Effect], measure: str) -> tuple[Effect, ...]:
    """The largest first; equal ones by name."""
    return tuple(sorted(effects, key=lambda effect: (-effect.estimates[measure].value, effect.name)))


MORRIS = "elementary effects of a Morris design"
LEAST_TRAJECTORIES = 4  # trajectories


def elementary_effects(samples: Samples) -> Sensitivity | str:
    """mu* and sigma of each factor; of choices the mean change of the output. A reason if nothing is left."""
    width = len(samples.names) + 1
    count = len(samples.y) // width
    kept = np.flatnonzero(samples.complete[: count * width].reshape(count, width).all(axis=1))
    if len(kept) < LEAST_TRAJECTORIES:
        return f"{len(kept)} of {count} trajectories are without a failed run, expected at least {LEAST_TRAJECTORIES}"
    design = samples.at((kept[:, None] * width + np.arange(width)).ravel())
    apart = {which: _morris_factors(design.alone(c)) for c, which in enumerate(design.combinations)}
    effects = _pooled(list(apart.values())) + _choices(design)
    notes = ["mu* orders factors by what they change over their whole range; it is no share of a variance"]
    if len(kept) < count:
        notes.append(f"{count - len(kept)} of {count} trajectories are left out, as one of their runs failed")
    return Sensitivity(
        MORRIS,
        MU_STAR,
        len(kept),
        float(design.y.var()),
        ordered(effects, MU_STAR),
        {which: ordered(found, MU_STAR) for which, found in apart.items()} if samples.crossed else {},
        notes=tuple(notes),
    )


def _morris_factors(design: Samples) -> list[Effect]:
    """One combination of choices."""
    y = design.y[:, 0]
    problem = {
        "num_vars": len(design.names),
        "names": list(design.names),
        "bounds": [[0.0, 1.0]] * len(design.names),
    }
    found = morris.analyze(
        problem, design.x, y, num_levels=LEVELS, num_resamples=RESAMPLES, seed=np.random.default_rng(SEED)
    )
    directions = rank_correlations(design, y)
    columns = (np.asarray(found[key], dtype=float) for key in ("mu_star", "mu_star_conf", "mu", "sigma"))
    return [
        Effect(
            name(dimension),
            kind(dimension),
            {MU_STAR: Estimate(float(star), float(star - half), float(star + half))},
            {"mu": float(mu), "sigma": float(sigma)},
            direction,
        )
        for dimension, star, half, mu, sigma, direction in zip(
            design.dimensions, *columns, directions, strict=True
        )
    ]


def _pooled(apart: list[list[Effect]]) -> list[Effect]:
    """Mean over the combinations; so is the width of the interval, as if all erred alike: never too small."""
    pooled = []
    for same in zip(*apart, strict=True):
        stars = [effect.estimates[MU_STAR] for effect in same]
        value, half = np.mean([s.value for s in stars]), np.mean([s.ceiling - s.value for s in stars])
        mu = np.array([effect.more["mu"] for effect in same])
        sigma = np.sqrt(np.mean([effect.more["sigma"] ** 2 for effect in same]) + mu.var())
        estimate = Estimate(float(value), float(value - half), float(value + half))
        more = {"mu": float(mu.mean()), "sigma": float(sigma)}
        known = [effect.direction for effect in same if effect.direction is not None]
        direction = float(np.mean(known)) if known else None
        pooled.append(Effect(same[0].name, same[0].kind, {MU_STAR: estimate}, more, direction))
    return pooled


def _mean_size(differences: Array, rows: NDArray[np.intp]) -> Array:
    return np.array([np.abs(differences[rows]).mean()])


def _choices(design: Samples) -> list[Effect]:
    """Crossed choices: mean absolute difference of two options, all else equal."""
    width = len(design.names) + 1
    shape = (len(design.y) // width, width, *(len(choice.options) for choice in design.crossed))
    y = design.y.reshape(shape)
    effects = []
    for axis, choice in enumerate(design.crossed, start=2):
        differences = _pairs(np.moveaxis(y, axis, -1))
        star = intervals(partial(_mean_size, differences), len(y))[0]
        more = {"mu": float(differences.mean()), "sigma": float(differences.std())}
        effects.append(Effect(choice.what, "choice", {MU_STAR: star}, more))
    return effects


def _pairs(y: Array) -> Array:
    """Differences of each two entries along the last axis, later less earlier."""
    first, second = np.triu_indices(y.shape[-1], 1)
    found: Array = y[..., second] - y[..., first]
    return found


SOBOL = "Sobol' indices of a Saltelli design"
LEAST = 16  # base samples: with fewer an interval says nothing
LOST = 0.1  # share of base samples that may be lost before the design counts as broken
WIDE = 0.4  # interval of a total above which its number says little


def usable(samples: Samples) -> tuple[NDArray[np.intp], int]:
    """Base samples of which every row has the output, and how many there are in all."""
    rows = len(samples.names) + 2
    count = len(samples.y) // rows
    complete = samples.complete[: count * rows].reshape(count, rows).all(axis=1)
    return np.flatnonzero(complete), count


def whole_enough(samples: Samples) -> bool:
    """Whether enough base samples are left."""
    kept, count = usable(samples)
    return len(kept) >= max(LEAST, (1 - LOST) * count)


def independent(samples: Samples) -> Samples:
    """The rows A and B only: those between them repeat their columns."""
    rows = len(samples.names) + 2
    places = np.arange(len(samples.y)) % rows
    return samples.at((places == 0) | (places == rows - 1))


def sobol_indices(samples: Samples) -> Sensitivity:
    """First order and total of each factor and choice."""
    kept, count = usable(samples)
    width = len(samples.names) + 2
    design = samples.at((kept[:, None] * width + np.arange(width)).ravel())
    y = design.y.reshape(len(kept), width, -1)
    free = independent(design)
    factors = _factors(free, y)
    notes = []
    if len(kept) < count:
        notes.append(
            f"{count - len(kept)} of {count} base samples are left out, all {width} rows of each, as one of"
            " their runs failed; the indices hold for the part of the space where runs succeed"
        )
    widest = max(e.estimates[TOTAL].ceiling - e.estimates[TOTAL].floor for e in factors)
    if widest > WIDE:
        notes.append(
            f"{len(kept)} base samples are few for this output: an interval is {100 * widest:.0f} points wide"
        )
    effects = factors + (of_choices(free) if samples.crossed else [])
    apart = _apart(design, y) if samples.crossed else {}
    total = float(free.y.var())
    return Sensitivity(SOBOL, TOTAL, len(kept), total, ordered(effects, TOTAL), apart, notes=tuple(notes))


def _apart(design: Samples, y: Array) -> dict[str, tuple[Effect, ...]]:
    """The factors in each combination of choices."""
    free = independent(design)
    return {
        which: ordered(_factors(free.alone(c), y[:, :, [c]]), TOTAL)
        for c, which in enumerate(design.combinations)
        if free.y[:, c].std() > 0
    }


def _factors(free: Samples, y: Array) -> list[Effect]:
    """Factors of a design y of shape (base samples, rows, combinations)."""
    found = intervals(lambda rows: _indices(y, rows), len(y))
    k = len(free.dimensions)
    directions = rank_correlations(free, free.y.mean(axis=1))
    return [
        Effect(name(d), kind(d), {FIRST: found[i], TOTAL: found[k + i]}, direction=directions[i])
        for i, d in enumerate(free.dimensions)
    ]


def _indices(y: Array, rows: NDArray[np.intp]) -> Array:
    """S_1 .. S_k, T_1 .. T_k, shape (2 k,), for some of the base samples."""
    scale = y.std() or 1.0
    drawn = (y[rows] - y.mean()) / scale
    a, between, b = drawn[:, 0], drawn[:, 1:-1], drawn[:, -1]
    whole = np.r_[a, b].var()
    if whole <= 0:
        return np.zeros(2 * between.shape[1])
    mean_a, mean_b = a.mean(axis=1), b.mean(axis=1)
    part = np.r_[mean_a, mean_b].var() / whole
    first = [
        part * float(first_order(mean_a, between[:, i].mean(axis=1), mean_b)) if part > 1e-12 else 0.0
        for i in range(between.shape[1])
    ]
    total = [float(total_order(a.ravel(), between[:, i].ravel(), b.ravel())) for i in range(between.shape[1])]
    return np.array(first + total)


def rank_correlations(samples: Samples, y: Array) -> list[float | None]:
    """Of each factor with y; none for choices."""
    pairs = zip(samples.dimensions, samples.x.T, strict=True)
    return [rank_correlation(x, y) if isinstance(d, Factor) else None for d, x in pairs]


def rank_correlation(x: Array, y: Array) -> float:
    """Spearman's, 0 where one of them is constant."""
    return float(spearmanr(x, y).statistic) if np.ptp(x) > 0 and np.ptp(y) > 0 else 0.0
