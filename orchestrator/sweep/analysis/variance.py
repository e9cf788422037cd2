"""Sobol' indices of a Saltelli design: rows A, A with one column of B after the other, B, per base sample.

    S_i = Var(E(y | x_i)) / V        T_i = E(Var(y | all but x_i)) / V

Estimators of Saltelli et al. (2010), Computer Physics Communications 181, 259-270, table 2 (b) and (f), as
SALib has them. V is over factors and choices: y averaged over the choices gives S_i, all of y gives T_i.
Intervals: base samples are drawn again; a base sample with all its rows and combinations is one draw.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from SALib.analyze.sobol import first_order, total_order
from scipy.stats import spearmanr

from orchestrator.sweep.analysis.outcome import FIRST, TOTAL, Effect, Sensitivity
from orchestrator.sweep.analysis.resampling import intervals, of_choices, ordered
from orchestrator.sweep.analysis.results import Array, Samples, kind, name
from orchestrator.sweep.study import Factor

METHOD = "Sobol' indices of a Saltelli design"
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
    return Sensitivity(METHOD, TOTAL, len(kept), total, ordered(effects, TOTAL), apart, notes=tuple(notes))


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
