"""Main effects on a full grid: means over all else at each value; shares of the variance over the grid.

    S_i = Var(mean over all but x_i) / V        T_i = mean(Var over x_i) / V

Nothing is sampled, so there are no intervals: the numbers hold for the values of the grid, each as likely.
"""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd

from orchestrator.sweep.analysis.outcome import FIRST, TOTAL, Effect, Estimate, Sensitivity
from orchestrator.sweep.analysis.resampling import ordered
from orchestrator.sweep.analysis.results import Samples, kind, name
from orchestrator.sweep.analysis.variance import rank_correlation

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
