"""Morris elementary effects and Sobol' indices, with bootstrap intervals.

Elementary effects of a Morris design, by SALib:

    d_i = (y(x with x_i moved by delta) - y(x)) / delta        mu* = mean |d_i|        sigma = sd of d_i

delta is a fraction of the factor's range (in probability): mu* is the change of the output over the whole
range, in its unit. It ranks factors; it is not a fraction of a variance. Morris (1991), Technometrics 33,
161-174; mu*: Campolongo et al. (2007), Environmental Modelling & Software 22, 1509-1518.

Sobol' indices of a Saltelli design: rows A, A with one column of B after the other, B, per base sample.

    S_i = Var(E(y | x_i)) / V        T_i = E(Var(y | all but x_i)) / V

Estimators of Saltelli et al. (2010), Computer Physics Communications 181, 259-270, table 2 (b) and (f), as
implemented in SALib. V is over factors and choices: y averaged over the choices gives S_i, all of y gives
T_i. Intervals: base samples are resampled; a base sample with all its rows and combinations is one draw.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from SALib.analyze import morris
from SALib.analyze.sobol import first_order, total_order
from scipy.stats import bootstrap

from orchestrator.data.table import Array
from orchestrator.studies.analysis.output_samples import OutputSamples, rank_correlations
from orchestrator.studies.analysis.results import FIRST, MU_STAR, TOTAL, Effect, IntervalEstimate, Sensitivity
from orchestrator.studies.design import LEVELS, problem

RESAMPLES = 400  # of the bootstrap: ends of a 95 % interval are accurate to some percent of its width
SEED = 20_01  # fixed, so that equal results give equal intervals
MORRIS = "elementary effects of a Morris design"
SOBOL = "Sobol' indices of a Saltelli design"
LEAST_TRAJECTORIES = 4
LEAST_BASE_SAMPLES = 16  # for an interval
MOST_MISSING = 0.1  # fraction of base samples without output up to which the design is used
WIDE = 0.4  # width of the interval of a total index above which a note says so

Rows = NDArray[np.intp]


# ---- common to all methods


def intervals(estimate: Callable[[Rows], Array], count: int) -> list[IntervalEstimate]:
    """Each value of `estimate` with its 95 % percentile interval [Efron and Tibshirani 1993, chapter 13].

    estimate  function from indices of samples to values, shape (m,)
    count     number of samples; the bootstrap draws them with replacement
    """
    rows, rng = np.arange(count), np.random.default_rng(SEED)
    settings = {"n_resamples": RESAMPLES, "method": "percentile", "vectorized": False}
    result = bootstrap((rows,), estimate, rng=rng, **settings)
    ends = zip(estimate(rows), *result.confidence_interval, strict=True)
    return [IntervalEstimate(float(value), float(low), float(high)) for value, low, high in ends]


def ordered(effects: list[Effect], measure: str) -> tuple[Effect, ...]:
    """Effects sorted by a measure, the largest first; equal ones by name."""
    return tuple(sorted(effects, key=lambda effect: (-effect.estimates[measure].value, effect.name)))


def of_crossed(samples: OutputSamples) -> list[Effect]:
    """First-order and total indices of the crossed choices.

    first  Var(mean over all but the choice) / V        total  mean(Var over the choice's options) / V
    """

    def indices(rows: Rows) -> Array:
        y = samples.y[rows].reshape(len(rows), *(len(choice.options) for choice in samples.crossed))
        moments = []
        for axis in range(1, y.ndim):
            others = tuple(a for a in range(y.ndim) if a != axis)
            moments += [y.mean(axis=others).var(), y.var(axis=axis).mean()]
        variance = y.var()
        return np.array(moments) / variance if variance > 0 else np.zeros(len(moments))

    if not samples.crossed:
        return []
    estimates = intervals(indices, len(samples.y))
    each = zip(samples.crossed, estimates[::2], estimates[1::2], strict=True)
    return [Effect(choice.name, choice.kind, {FIRST: f, TOTAL: t}) for choice, f, t in each]


# ---- Morris


def elementary_effects(samples: OutputSamples) -> Sensitivity | str:
    """mu* and sigma of each factor and choice; a reason if too few trajectories are complete."""
    width = len(samples.names) + 1
    design, count = samples.blocks(width)
    complete = len(design.y) // width
    if complete < LEAST_TRAJECTORIES:
        return f"expected at least {LEAST_TRAJECTORIES} complete trajectories, got {complete} of {count}"
    apart = [_elementary_effects(design, y) for y in design.y.T]
    effects = [_pooled(effects) for effects in zip(*apart, strict=True)]
    effects += _option_effects(design, width)
    notes = [
        "mu* is the change of the output over the whole range of a factor; it is not a fraction of a variance"
    ]
    if complete < count:
        notes.append(f"{count - complete} of {count} trajectories are left out, as one of their runs failed")
    largest_first = ordered(effects, MU_STAR)
    return Sensitivity(MORRIS, MU_STAR, complete, float(design.y.var()), largest_first, notes=tuple(notes))


def _elementary_effects(design: OutputSamples, y: Array) -> list[Effect]:
    """mu* and sigma of each factor in one combination of choices, with the values y."""
    settings = {"num_levels": LEVELS, "num_resamples": RESAMPLES, "seed": np.random.default_rng(SEED)}
    result = morris.analyze(problem(design.names), design.x, y, **settings)
    columns = np.array([result[key] for key in ("mu_star", "mu_star_conf", "mu", "sigma")], float).T.tolist()
    effects = []
    for d, direction, row in zip(design.dimensions, rank_correlations(design, y), columns, strict=True):
        star, half, mu, sigma = row
        estimate = IntervalEstimate(star, star - half, star + half)
        effects.append(Effect(d.name, d.kind, {MU_STAR: estimate}, {"mu": mu, "sigma": sigma}, direction))
    return effects


def _pooled(effects: tuple[Effect, ...]) -> Effect:
    """Mean effect over the combinations; the mean of the interval widths is an upper bound of its width."""
    stars = [effect.estimates[MU_STAR] for effect in effects]
    value = float(np.mean([s.value for s in stars]))
    half = float(np.mean([s.ceiling - s.value for s in stars]))
    mu = np.array([effect.more["mu"] for effect in effects])
    sigma = np.sqrt(np.mean([effect.more["sigma"] ** 2 for effect in effects]) + mu.var())
    directions = [effect.direction for effect in effects if effect.direction is not None]
    estimate = IntervalEstimate(value, value - half, value + half)
    more = {"mu": float(mu.mean()), "sigma": float(sigma)}
    direction = float(np.mean(directions)) if directions else None
    return Effect(effects[0].name, effects[0].kind, {MU_STAR: estimate}, more, direction)


def _option_effects(design: OutputSamples, width: int) -> list[Effect]:
    """mu* of crossed choices: mean absolute difference between two options, all else equal."""
    y = design.y.reshape(-1, width, *(len(choice.options) for choice in design.crossed))
    effects = []
    for axis, choice in enumerate(design.crossed, start=2):
        options = np.moveaxis(y, axis, -1)
        first, second = np.triu_indices(len(choice.options), 1)
        change = options[..., second] - options[..., first]
        magnitude = np.abs(change).reshape(len(y), -1).mean(axis=1)
        star = intervals(lambda rows, m=magnitude: np.array([m[rows].mean()]), len(y))[0]  # type: ignore[misc]
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
    estimates, k = intervals(lambda rows: _indices(y, rows), len(y)), len(independent_rows.dimensions)
    directions = rank_correlations(independent_rows, independent_rows.y.mean(axis=1))
    return [
        Effect(d.name, d.kind, {FIRST: estimates[i], TOTAL: estimates[k + i]}, direction=directions[i])
        for i, d in enumerate(independent_rows.dimensions)
    ]


def _indices(y: Array, rows: Rows) -> Array:
    """S_1 .. S_k, T_1 .. T_k, shape (2 k,), for some of the base samples."""
    standard = (y[rows] - y.mean()) / (y.std() or 1.0)
    a, between, b = standard[:, 0], np.moveaxis(standard[:, 1:-1], 1, 0), standard[:, -1]
    variance = np.concatenate((a, b)).var()
    if variance <= 0:
        return np.zeros(2 * len(between))
    mean_a, mean_b = a.mean(axis=1), b.mean(axis=1)
    fraction = np.concatenate((mean_a, mean_b)).var() / variance
    first = [
        fraction * first_order(mean_a, ab.mean(axis=1), mean_b) if fraction > 1e-12 else 0.0 for ab in between
    ]
    total = [total_order(a.ravel(), ab.ravel(), b.ravel()) for ab in between]
    return np.array(first + total, float)
