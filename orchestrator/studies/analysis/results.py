"""What the methods of an analysis start from, the values of an output by sample, and its results as data.

All values are in the unit of the output, or fractions of its variance.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr

from orchestrator.base.errors import Problem
from orchestrator.base.text import DisplayUnit, display_unit
from orchestrator.data.table import Array
from orchestrator.lanes.group import Status
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor, Output, short

# Names of sensitivity measures.
FIRST = "first_order"  # first-order index: fraction of the variance due to the factor alone
TOTAL = "total"  # total-effect index: the same with all interactions of the factor
REGRESSION = "squared_regression"  # squared standardised coefficient of a linear model
MU_STAR = "mu_star"  # mean of the absolute elementary effects, in the unit of the output

# measures and further values, in the order of a table -> head of the column
HEAD = {
    TOTAL: "total",
    FIRST: "first order",
    REGRESSION: "linear model, squared",
    MU_STAR: "μ*",
    "mu": "μ",
    "sigma": "\N{GREEK SMALL LETTER SIGMA}",
    "regression": "coefficient",
}

LONGEST_LABEL = 44  # characters


@dataclass(frozen=True)
class IntervalEstimate:
    """An estimate with its 95 % interval; no interval if nothing was sampled."""

    value: float
    low: float | None = None
    high: float | None = None

    @property
    def floor(self) -> float:
        """Lower end of the interval; the value itself if there is no interval."""
        return self.value if self.low is None else self.low

    @property
    def ceiling(self) -> float:
        """Upper end of the interval; the value itself if there is no interval."""
        return self.value if self.high is None else self.high


@dataclass(frozen=True)
class Effect:
    """Effect of one factor or choice on one output.

    kind        factor or choice
    estimates   sensitivity measure -> estimate
    more        further values of the method, such as sigma of Morris
    direction   Spearman's rank correlation of factor and output, -1..1; None for choices
    options     options of a choice
    """

    name: str
    kind: str
    estimates: Mapping[str, IntervalEstimate]
    more: Mapping[str, float] = field(default_factory=dict)
    direction: float | None = None
    options: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The name, with the options of a choice if they are short."""
        text = f"{self.name} ({' or '.join(map(short, self.options))})"
        return text if self.options and len(text) <= LONGEST_LABEL else self.name


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of an output to factors and choices.

    method    description of the method
    measure   sensitivity measure by which the effects are sorted, the largest first
    samples   number of independent samples
    variance  variance of the output [unit squared], over factors and choices
    quality   goodness of fit of the linear models
    notes     remarks on the estimates
    reliable  whether the effects can be ranked; false if a linear model does not fit
    """

    method: str
    measure: str
    samples: int
    variance: float
    effects: tuple[Effect, ...]
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
    """Analysis of one output.

    spread     distribution over all runs that have the output; None if there is no such run
    by_choice  distribution for each option: "swing" -> "lumped" -> spread
    constant   whether all runs have the same value
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
        """The display unit of all values."""
        largest = max(abs(self.spread.minimum), abs(self.spread.maximum)) if self.spread else math.inf
        return display_unit(self.unit, largest)


@dataclass(frozen=True)
class Failure:
    """Failed runs with one reason; examples are run numbers.

    various   the numbers in the reasons differ; `reason` is that of the first example
    """

    reason: str
    count: int
    examples: tuple[int, ...]
    by_choice: Mapping[str, Mapping[str, int]]
    various: bool = False


@dataclass(frozen=True)
class Analysis:
    """Analysis of a study.

    findings   the analysis of each output; also a key of analysis.json
    """

    title: str
    method: str
    runs: int
    succeeded: int
    failures: tuple[Failure, ...]
    findings: tuple[OutputAnalysis, ...]
    notes: tuple[str, ...] = ()


EXAMPLES = 5  # run numbers shown for each reason
# A number that is not part of a name, such as pump_1_rise.
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def without_numbers(reasons: pd.Series) -> pd.Series:
    """Each reason with # for its numbers: equal ones differ only in their numbers."""
    return reasons.astype(str).map(lambda reason: _NUMBER.sub("#", reason))


def counts(results: Results) -> str:
    """The number of runs of each status, such as `12 runs: 10 ok, 2 failed`."""
    found = results.columns("status")["status"].value_counts()
    words = (Status.OK, Status.NOT_RELIABLE, Status.EARLY, Status.FAILED)
    statuses = ", ".join(f"{found[status]} {status}" for status in words if status in found)
    return f"{found.sum()} runs: {statuses}"


def failures(results: Results) -> tuple[Failure, ...]:
    """Failed runs by reason, the most frequent first; reasons that differ only in numbers are merged."""
    runs = results.columns("run", "status", "reason", *(c.column for c in results.study.compared))
    failed = runs[runs["status"] != Status.OK].sort_values("run")
    reasons = failed["reason"].fillna("").astype(str).where(lambda r: r != "", "no reason given")
    groups = []
    for _, group in failed.groupby(without_numbers(reasons), sort=True):
        in_group, counts = reasons[group.index], {}
        for choice in results.study.compared:
            occurrences = group[choice.column].astype(str).value_counts()
            counts[choice.name] = {option: int(occurrences.get(option, 0)) for option in choice.options}
        examples = tuple(int(run) for run in group["run"].head(EXAMPLES))
        groups.append(Failure(str(in_group.iloc[0]), len(group), examples, counts, in_group.nunique() > 1))
    return tuple(sorted(groups, key=lambda failure: (-failure.count, failure.reason)))


@dataclass(frozen=True)
class OutputSamples:
    """Values of one output by sample.

    dimensions   factors and sampled choices
    x            values of the dimensions, shape (n, k); for a choice the index of the option
    y            output, shape (n, c), a column per combination of crossed choices; NaN if it is missing
    crossed      the other choices; the columns of y are the product of their options, the last varies fastest
    """

    dimensions: tuple[Factor | Choice, ...]
    x: Array
    y: Array
    crossed: tuple[Choice, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        return tuple(dimension.name for dimension in self.dimensions)

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Whether each sample has the output in every combination, shape (n,)."""
        return np.asarray(np.isfinite(self.y).all(axis=1))

    def blocks(self, width: int) -> tuple[OutputSamples, int]:
        """The samples of all complete blocks of `width` samples, and the number of all blocks."""
        count = len(self.y) // width
        complete = self.complete[: count * width].reshape(count, width).all(axis=1)
        rows = np.flatnonzero(complete)[:, None] * width + np.arange(width)
        return self.at(rows.ravel()), count

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> OutputSamples:
        """The samples of these rows."""
        return replace(self, x=self.x[rows], y=self.y[rows])


def done(results: Results, *columns: str) -> pd.DataFrame:
    """Columns of the runs that finished; others are left out of all statistics and reported with reasons."""
    runs = results.columns("status", *columns)
    return runs[runs["status"] == Status.OK]


Design = tuple[list[NDArray[np.intp]], Array]


def design(results: Results) -> Design:
    """Rows of the table for each combination of crossed choices, in the order of the samples, and their x.

    Each sample was run in each combination, in the same order. x: as of `OutputSamples`.
    """
    study = results.study
    runs = results.columns("run", *(c.column for c in (*study.crossed, *study.dimensions)))
    blocks = [np.argsort(runs["run"].to_numpy(), kind="stable")]
    for choice in study.crossed:
        option = runs[choice.column].astype(str).to_numpy()
        blocks = [block[option[block] == o] for block in blocks for o in choice.options]
    count = {len(block) for block in blocks}
    if len(count) != 1:
        raise Problem(
            f"results of study {study.title!r}: {min(count)} to {max(count)} runs for each combination of"
            " choices, expected an equal number; is the study finished?"
        )
    x = np.empty((count.pop(), len(study.dimensions)))
    for i, dimension in enumerate(study.dimensions):
        column = runs.pop(dimension.column)
        if isinstance(dimension, Choice):
            column = column.astype(str).map(dimension.options.index)
        x[:, i] = column.to_numpy(float)[blocks[0]]
    return blocks, x


def samples(results: Results, output: Output, of: Design | None = None) -> OutputSamples:
    """Values of an output; `of` saves reading the samples again."""
    rows, x = of or design(results)
    runs = results.columns("status", output.column)
    values = runs[output.column].where(runs["status"] == Status.OK).to_numpy(float)
    y = np.column_stack([values[block] for block in rows])
    return OutputSamples(results.study.dimensions, x, y, results.study.crossed)


def rank_correlations(samples: OutputSamples, y: Array) -> list[float | None]:
    """Rank correlation of each factor with y; None for choices."""
    pairs = zip(samples.dimensions, samples.x.T, strict=True)
    return [rank_correlation(x, y) if isinstance(d, Factor) else None for d, x in pairs]


def rank_correlation(x: Array, y: Array) -> float:
    """Spearman's rank correlation; 0 if x or y is constant."""
    return float(spearmanr(x, y).statistic) if np.ptp(x) > 0 and np.ptp(y) > 0 else 0.0
