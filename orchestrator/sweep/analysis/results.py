"""The runs of a study as arrays: factors by sample, outputs by sample and combination of choices."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.sweep.running import OK
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import Choice, Factor, Output

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Samples:
    """One output, sample by sample.

    dimensions   factors and sampled choices
    x            their values, shape (n, k); of a choice the place of the option
    y            the output, shape (n, c): a column per combination of crossed choices; NaN where none
    crossed      the other choices; the product of their options, the last fastest, are the columns of y
    """

    dimensions: tuple[Factor | Choice, ...]
    x: Array
    y: Array
    crossed: tuple[Choice, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the dimensions."""
        return tuple(name(dimension) for dimension in self.dimensions)

    @property
    def combinations(self) -> tuple[str, ...]:
        """A name for each column of y."""
        return tuple(", ".join(found) for found in itertools.product(*(c.options for c in self.crossed)))

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Which samples have the output in every combination, shape (n,)."""
        return np.asarray(np.isfinite(self.y).all(axis=1))

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Samples:
        """Some of the samples."""
        return replace(self, x=self.x[rows], y=self.y[rows])

    def alone(self, column: int) -> Samples:
        """One combination of choices."""
        return replace(self, y=self.y[:, [column]], crossed=())


def done(results: Results) -> pd.DataFrame:
    """The runs that came to their end: only they count, others are told with their reason."""
    return results.table[results.table["status"] == OK]


def name(dimension: Factor | Choice) -> str:
    """What a reader calls it."""
    return dimension.name if isinstance(dimension, Factor) else dimension.what


def kind(dimension: Factor | Choice) -> str:
    """factor or choice."""
    return "factor" if isinstance(dimension, Factor) else "choice"


def samples(results: Results, output: Output) -> Samples:
    """The runs of a study; each sample was run in each combination of crossed choices, in the same order."""
    study, runs = results.study, results.table.sort_values("run", kind="stable")
    values = runs[output.column].where(runs["status"] == OK)
    options = itertools.product(*(choice.options for choice in study.crossed))
    blocks = [runs.index[_chosen(runs, study.crossed, own)] for own in options]
    count = {len(block) for block in blocks}
    if len(count) != 1:
        raise Problem(
            f"results of study {study.title!r}: {min(count)} to {max(count)} runs for each combination of"
            " choices, expected as many for all; is the sweep finished?"
        )
    x = np.empty((count.pop(), len(study.dimensions)))
    for i, dimension in enumerate(study.dimensions):
        x[:, i] = _numbers(runs.loc[blocks[0], dimension.column], dimension)
    y = np.column_stack([values.loc[block].to_numpy(float) for block in blocks])
    return Samples(study.dimensions, x, y, study.crossed)


def _numbers(column: pd.Series, dimension: Factor | Choice) -> Array:
    if isinstance(dimension, Choice):
        places = {option: float(place) for place, option in enumerate(dimension.options)}
        column = column.astype(str).map(places)
    found: Array = column.to_numpy(float)
    return found


def _chosen(runs: pd.DataFrame, crossed: tuple[Choice, ...], options: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which runs have these options."""
    found = np.ones(len(runs), dtype=bool)
    for choice, option in zip(crossed, options, strict=True):
        found &= (runs[choice.column].astype(str) == option).to_numpy()
    return found
