"""Sensitivity from a plain sample (Latin hypercube, Sobol' points), for which no special design was run.

First order indices by RBD-FAST: Tarantola et al. (2006), Reliability Engineering & System Safety 91, 717-727;
from any sample by Plischke (2010), ibid. 95, 354-360; bias correction by Tissot and Prieur (2012), ibid.
107, 205-213. No linearity is assumed; interactions are not seen. Below 200 samples its 10 harmonics take in
too much noise: then a linear model decides, as far as it explains the output. Its R^2 is told in both cases.
"""

from __future__ import annotations

import numpy as np
from SALib.analyze import rbd_fast

from orchestrator.sweep.analysis.outcome import FIRST, REGRESSION, Effect, Estimate, Sensitivity
from orchestrator.sweep.analysis.regression import NOTHING, linear, share, share_of_groups
from orchestrator.sweep.analysis.resampling import SEED, of_choices, ordered
from orchestrator.sweep.analysis.results import Array, Samples, kind, name
from orchestrator.sweep.analysis.variance import rank_correlations
from orchestrator.sweep.study import Choice

FAST = "first order indices by RBD-FAST, from the sample as it is"
LINEAR = "squared standardised coefficients of a linear model"
ENOUGH = 200  # samples for RBD-FAST
RESAMPLES = 100  # as SALib: an interval here is from a standard deviation
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
    found = rbd_fast.analyze(problem, x, (y - y.mean()) / y.std(), num_resamples=RESAMPLES, seed=seed)
    pairs = zip(found["S1"], found["S1_conf"], np.ptp(samples.x, axis=0) > 0, strict=True)
    return [
        Estimate(part * float(s), part * float(s - half), part * float(s + half)) if moves else NOTHING
        for s, half, moves in pairs
    ]
