"""Results of an analysis as data; all values are in the unit of the output, or fractions of its variance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from orchestrator.base.text import DisplayUnit, display_unit
from orchestrator.studies.study import short

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
