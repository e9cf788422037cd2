"""Sensitivity from designs made for it (Morris elementary effects, Sobol' indices), with bootstrap intervals.

Elementary effects of a Morris design, by SALib:

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

import numpy as np
from numpy.typing import NDArray
from SALib.analyze import morris
from SALib.analyze.sobol import first_order, total_order
from scipy.stats import bootstrap, spearmanr

from orchestrator.studies.analysis.results import (
    FIRST,
    MU_STAR,
    TOTAL,
    Array,
    Effect,
    IntervalEstimate,
    OutputSamples,
    Sensitivity,
)
from orchestrator.studies.design import LEVELS, problem
from orchestrator.studies.study import Factor

RESAMPLES = 400  # ends of a 95 % interval to some percent of its width
SEED = 20_01  # equal results give equal intervals
MORRIS = "elementary effects of a Morris design"
SOBOL = "Sobol' indices of a Saltelli design"
LEAST_TRAJECTORIES = 4
LEAST_BASE_SAMPLES = 16  # with fewer an interval says nothing
LOST = 0.1  # share of base samples that may be lost before the design counts as broken
WIDE = 0.4  # interval of a total above which its number says little

Rows = NDArray[np.intp]


# ---- what all methods use


def intervals(estimate: Callable[[Rows], Array], count: int) -> list[IntervalEstimate]:
    """Each number of `estimate` with its 95 % percentile interval [Efron and Tibshirani 1993, chapter 13].

    estimate  numbers, shape (m,), from samples with the given rows
    count     of samples; they are drawn with replacement
    """
    rows = np.arange(count)
    drawn = bootstrap(
        (rows,),
        estimate,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(SEED),
    )
    ends = zip(estimate(rows), *drawn.confidence_interval, strict=True)
    return [IntervalEstimate(float(value), float(low), float(high)) for value, low, high in ends]


def ordered(effects: list[Effect], measure: str) -> tuple[Effect, ...]:
    """The largest first; equal ones by name."""
    return tuple(sorted(effects, key=lambda effect: (-effect.estimates[measure].value, effect.name)))


def rank_correlations(samples: OutputSamples, y: Array) -> list[float | None]:
    """Of each factor with y; none for choices."""
    pairs = zip(samples.dimensions, samples.x.T, strict=True)
    return [rank_correlation(x, y) if isinstance(d, Factor) else None for d, x in pairs]


def rank_correlation(x: Array, y: Array) -> float:
    """Spearman's, 0 where one of them is constant."""
    return float(spearmanr(x, y).statistic) if np.ptp(x) > 0 and np.ptp(y) > 0 else 0.0


def of_crossed(samples: OutputSamples) -> list[Effect]:
    """Shares of the variance that each crossed choice moves by itself and with all others.

    first  Var(mean over all but the choice) / V        total  mean(Var over the choice's options) / V
    """

    def shares(rows: Rows) -> Array:
        y = samples.y[rows].reshape(len(rows), *(len(choice.options) for choice in samples.crossed))
        moments = []
        for axis in range(1, y.ndim):
            others = tuple(a for a in range(y.ndim) if a != axis)
            moments += [y.mean(axis=others).var(), y.var(axis=axis).mean()]
        whole = y.var()
        return np.array(moments) / whole if whole > 0 else np.zeros(len(moments))

    if not samples.crossed:
        return []
    found = intervals(shares, len(samples.y))
    return [
        Effect(choice.name, choice.kind, {FIRST: first, TOTAL: total})
        for choice, first, total in zip(samples.crossed, found[::2], found[1::2], strict=True)
    ]


# ---- Morris


def elementary_effects(samples: OutputSamples) -> Sensitivity | str:
    """mu* and sigma of each factor; of choices the mean change of the output. A reason if nothing is left."""
    width = len(samples.names) + 1
    design, count = samples.blocks(width)
    kept = len(design.y) // width
    if kept < LEAST_TRAJECTORIES:
        expected = f"expected at least {LEAST_TRAJECTORIES}"
        return f"{kept} of {count} trajectories are without a failed run, {expected}"
    apart = {which: _elementary_effects(design.alone(c)) for c, which in enumerate(design.combinations)}
    effects = [_pooled(same) for same in zip(*apart.values(), strict=True)] + _option_effects(design, width)
    notes = ["mu* orders factors by what they change over their whole range; it is no share of a variance"]
    if kept < count:
        notes.append(f"{count - kept} of {count} trajectories are left out, as one of their runs failed")
    return Sensitivity(
        MORRIS,
        MU_STAR,
        kept,
        float(design.y.var()),
        ordered(effects, MU_STAR),
        {which: ordered(own, MU_STAR) for which, own in apart.items()} if samples.crossed else {},
        notes=tuple(notes),
    )


def _elementary_effects(design: OutputSamples) -> list[Effect]:
    """Those of one combination of choices."""
    y, rng = design.y[:, 0], np.random.default_rng(SEED)
    found = morris.analyze(
        problem(design.names), design.x, y, num_levels=LEVELS, num_resamples=RESAMPLES, seed=rng
    )
    columns = np.array([found[key] for key in ("mu_star", "mu_star_conf", "mu", "sigma")], float).T.tolist()
    directions = rank_correlations(design, y)
    return [
        Effect(
            dimension.name,
            dimension.kind,
            {MU_STAR: IntervalEstimate(star, star - half, star + half)},
            {"mu": mu, "sigma": sigma},
            direction,
        )
        for dimension, (star, half, mu, sigma), direction in zip(
            design.dimensions, columns, directions, strict=True
        )
    ]


def _pooled(same: tuple[Effect, ...]) -> Effect:
    """Mean over the combinations; so is the width of the interval, as if all erred alike: never too small."""
    stars = [effect.estimates[MU_STAR] for effect in same]
    value = float(np.mean([s.value for s in stars]))
    half = float(np.mean([s.ceiling - s.value for s in stars]))
    mu = np.array([effect.more["mu"] for effect in same])
    sigma = np.sqrt(np.mean([effect.more["sigma"] ** 2 for effect in same]) + mu.var())
    known = [effect.direction for effect in same if effect.direction is not None]
    return Effect(
        same[0].name,
        same[0].kind,
        {MU_STAR: IntervalEstimate(value, value - half, value + half)},
        {"mu": float(mu.mean()), "sigma": float(sigma)},
        float(np.mean(known)) if known else None,
    )


def _option_effects(design: OutputSamples, width: int) -> list[Effect]:
    """Crossed choices: mean absolute difference of two options, all else equal."""
    y = design.y.reshape(-1, width, *(len(choice.options) for choice in design.crossed))
    effects = []
    for axis, choice in enumerate(design.crossed, start=2):
        options = np.moveaxis(y, axis, -1)
        first, second = np.triu_indices(len(choice.options), 1)
        change = options[..., second] - options[..., first]
        size = np.abs(change).reshape(len(y), -1).mean(axis=1)
        star = intervals(lambda rows, size=size: np.array([size[rows].mean()]), len(y))[0]  # type: ignore[misc]
        more = {"mu": float(change.mean()), "sigma": float(change.std())}
        effects.append(Effect(choice.name, choice.kind, {MU_STAR: star}, more))
    return effects


# ---- Sobol'


def whole_enough(samples: OutputSamples) -> bool:
    """Are enough base samples of a Saltelli design left?"""
    width = len(samples.names) + 2
    design, count = samples.blocks(width)
    return len(design.y) // width >= max(LEAST_BASE_SAMPLES, (1 - LOST) * count)


def independent(samples: OutputSamples) -> OutputSamples:
    """The rows A and B of a Saltelli design: those between them repeat their columns."""
    width = len(samples.names) + 2
    places = np.arange(len(samples.y)) % width
    return samples.at((places == 0) | (places == width - 1))


def sobol_indices(samples: OutputSamples) -> Sensitivity:
    """First order and total of each factor and choice."""
    width = len(samples.names) + 2
    design, count = samples.blocks(width)
    free, y = independent(design), design.y.reshape(-1, width, design.y.shape[1])
    factors, kept = _sobol_effects(free, y), len(y)
    notes = []
    if kept < count:
        notes.append(
            f"{count - kept} of {count} base samples are left out, all {width} rows of each, as one of"
            " their runs failed; the indices hold for the part of the space where runs succeed"
        )
    widest = max(e.estimates[TOTAL].ceiling - e.estimates[TOTAL].floor for e in factors)
    if widest > WIDE:
        notes.append(
            f"{kept} base samples are few for this output: an interval is {100 * widest:.0f} points wide"
        )
    apart = {
        which: ordered(_sobol_effects(free.alone(c), y[:, :, [c]]), TOTAL)
        for c, which in enumerate(design.combinations)
        if samples.crossed and free.y[:, c].std() > 0
    }
    effects = ordered(factors + of_crossed(free), TOTAL)
    return Sensitivity(SOBOL, TOTAL, kept, float(free.y.var()), effects, apart, notes=tuple(notes))


def _sobol_effects(free: OutputSamples, y: Array) -> list[Effect]:
    """Factors of a design y of shape (base samples, rows, combinations)."""
    found, k = intervals(lambda rows: _indices(y, rows), len(y)), len(free.dimensions)
    directions = rank_correlations(free, free.y.mean(axis=1))
    return [
        Effect(d.name, d.kind, {FIRST: found[i], TOTAL: found[k + i]}, direction=directions[i])
        for i, d in enumerate(free.dimensions)
    ]


def _indices(y: Array, rows: Rows) -> Array:
    """S_1 .. S_k, T_1 .. T_k, shape (2 k,), for some of the base samples."""
    drawn = (y[rows] - y.mean()) / (y.std() or 1.0)
    a, between, b = drawn[:, 0], np.moveaxis(drawn[:, 1:-1], 1, 0), drawn[:, -1]
    whole = np.r_[a, b].var()
    if whole <= 0:
        return np.zeros(2 * len(between))
    mean_a, mean_b = a.mean(axis=1), b.mean(axis=1)
    part = np.r_[mean_a, mean_b].var() / whole
    first = [part * first_order(mean_a, ab.mean(axis=1), mean_b) if part > 1e-12 else 0.0 for ab in between]
    total = [total_order(a.ravel(), ab.ravel(), b.ravel()) for ab in between]
    return np.array(first + total, float)
