"""Intervals by the bootstrap, and the effects of choices: they are known for every sample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orchestrator.sweep.analysis.outcome import FIRST, TOTAL, Effect, Estimate
from orchestrator.sweep.analysis.results import Array, Samples

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
