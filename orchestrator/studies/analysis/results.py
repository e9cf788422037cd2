"""The results of an analysis as data; all numbers are in the unit of the output, or shares of a variance."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePath

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.text import DisplayUnit, display_unit
from orchestrator.studies.single_run import OK
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output

# a number that stands alone: those inside a name, such as swing_1_rise, tell what the name is of
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def alike(reasons: pd.Series) -> pd.Series:
    """Each reason with its numbers masked: equal ones differ by their numbers alone."""
    return reasons.astype(str).map(lambda reason: _NUMBER.sub("#", reason))


# Names of measures: how much an output moves with a factor.
FIRST = "first_order"  # share of the variance that the factor moves by itself, 0..1
TOTAL = "total"  # the same with all it does together with others
REGRESSION = "squared_regression"  # squared standardised coefficient of a linear model, as a share
MU_STAR = "mu_star"  # mean of the absolute elementary effects, in the unit of the output

LONGEST = 44  # characters of a label


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with its 95 % interval; none where nothing was sampled."""

    value: float
    low: float | None = None
    high: float | None = None

    @property
    def floor(self) -> float:
        """Lower end of the interval, the number itself where there is none."""
        return self.value if self.low is None else self.low

    @property
    def ceiling(self) -> float:
        """Upper end of the interval, the number itself where there is none."""
        return self.value if self.high is None else self.high


@dataclass(frozen=True)
class Effect:
    """What one factor or choice does to one output.

    kind        factor or choice
    estimates   by the names of measures above
    more        further numbers of the method, such as sigma of Morris
    direction   Spearman's rank correlation of factor and output, -1..1; none for choices
    options     of a choice
    """

    name: str
    kind: str
    estimates: Mapping[str, IntervalEstimate]
    more: Mapping[str, float] = field(default_factory=dict)
    direction: float | None = None
    options: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The name, of a choice with its options where they are short."""
        text = f"{self.name} ({' or '.join(map(short, self.options))})"
        return text if self.options and len(text) <= LONGEST else self.name


def short(option: str) -> str:
    """An option of a choice as a reader knows it: of a file its name alone."""
    return PurePath(option).stem if option.endswith((".csv", ".parquet", ".ssv", ".fmu")) else option


@dataclass(frozen=True)
class Sensitivity:
    """How an output depends on factors and choices.

    method    in words
    measure   the one that orders the effects; they stand in that order, the largest first
    samples   independent samples that it rests on
    variance  of the output [unit squared], over factors and choices
    reliable  whether the order means anything; false where a linear model does not hold
    apart     effects of the factors in each combination of choices
    notes     what to know before the numbers are read
    """

    method: str
    measure: str
    samples: int
    variance: float
    effects: tuple[Effect, ...]
    apart: Mapping[str, tuple[Effect, ...]] = field(default_factory=dict)
    quality: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    reliable: bool = True


@dataclass(frozen=True)
class Spread:
    """Distribution of an output over runs, in its unit."""

    runs: int
    mean: float
    sd: float
    low: float
    median: float
    high: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class OutputAnalysis:
    """Everything about one output.

    spread     over all runs that have it; none if there is no such run
    by_choice  the same for each option: "swing" -> "lumped" -> spread
    constant   all runs gave the same number
    """

    name: str
    signal: str
    measure: str
    window: tuple[float | None, float | None]
    unit: str
    spread: Spread | None
    by_choice: Mapping[str, Mapping[str, Spread]]
    constant: bool
    sensitivity: Sensitivity | None
    notes: tuple[str, ...] = ()

    @property
    def display(self) -> DisplayUnit:
        """The unit for a reader, of all numbers alike."""
        largest = max(abs(self.spread.minimum), abs(self.spread.maximum)) if self.spread else math.inf
        return display_unit(self.unit, largest)


@dataclass(frozen=True)
class Failure:
    """Failed runs with one reason; examples are numbers of runs.

    various   the numbers in the reason differ: it is that of the first example
    """

    reason: str
    count: int
    examples: tuple[int, ...]
    by_choice: Mapping[str, Mapping[str, int]]
    various: bool = False


@dataclass(frozen=True)
class Analysis:
    """A study's results."""

    title: str
    method: str
    runs: int
    succeeded: int
    failures: tuple[Failure, ...]
    findings: tuple[OutputAnalysis, ...]
    notes: tuple[str, ...] = ()


Array = NDArray[np.float64]


@dataclass(frozen=True)
class OutputSamples:
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
        return tuple(dimension.name for dimension in self.dimensions)

    @property
    def combinations(self) -> tuple[str, ...]:
        """A name for each column of y."""
        return tuple(", ".join(found) for found in itertools.product(*(c.options for c in self.crossed)))

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Which samples have the output in every combination, shape (n,)."""
        return np.asarray(np.isfinite(self.y).all(axis=1))

    def blocks(self, width: int) -> tuple[OutputSamples, int]:
        """The blocks of `width` samples that all have the output, and the number of all blocks."""
        count = len(self.y) // width
        complete = self.complete[: count * width].reshape(count, width).all(axis=1)
        kept = np.flatnonzero(complete)[:, None] * width + np.arange(width)
        return self.at(kept.ravel()), count

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> OutputSamples:
        """Some of the samples."""
        return replace(self, x=self.x[rows], y=self.y[rows])

    def alone(self, column: int) -> OutputSamples:
        """One combination of choices."""
        return replace(self, y=self.y[:, [column]], crossed=())


def done(results: Results) -> pd.DataFrame:
    """The runs that came to their end: only they count, the others are reported with their reasons."""
    return results.table[results.table["status"] == OK]


def samples(results: Results, output: Output) -> OutputSamples:
    """The runs of a study; each sample was run in each combination of crossed choices, in the same order."""
    study, runs = results.study, results.table.sort_values("run", kind="stable")
    values = runs[output.column].where(runs["status"] == OK)
    blocks = [runs.index]
    for choice in study.crossed:
        option = runs[choice.column].astype(str)
        blocks = [block[option[block] == o] for block in blocks for o in choice.options]
    count = {len(block) for block in blocks}
    if len(count) != 1:
        raise Problem(
            f"results of study {study.title!r}: {min(count)} to {max(count)} runs for each combination of"
            " choices, expected as many for all; is the sweep finished?"
        )
    x = np.empty((count.pop(), len(study.dimensions)))
    for i, dimension in enumerate(study.dimensions):
        column = runs.loc[blocks[0], dimension.column]
        if isinstance(dimension, Choice):
            column = column.astype(str).map(dimension.options.index)
        x[:, i] = column.to_numpy(float)
    y = np.column_stack([values.loc[block].to_numpy(float) for block in blocks])
    return OutputSamples(study.dimensions, x, y, study.crossed)
