"""The results of an analysis as data; all numbers in the unit of the output or shares of a variance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePath

from orchestrator.sweep.units import Seen, seen

# Names of measures: how much an output moves with a factor.
FIRST = "first_order"  # share of the variance that the factor moves by itself, 0..1
TOTAL = "total"  # the same with all it does together with others
REGRESSION = "squared_regression"  # squared standardised coefficient of a linear model, as a share
MU_STAR = "mu_star"  # mean of the absolute elementary effects, in the unit of the output

LONGEST = 44  # characters of a label


@dataclass(frozen=True)
class Estimate:
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
    estimates: Mapping[str, Estimate]
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
    """How an output moves with factors and choices.

    method    in words
    measure   the one that orders the effects; they stand in that order, the largest first
    samples   independent samples that it rests on
    variance  of the output [unit squared], over factors and choices
    reliable  whether the order may be told; false where a linear model does not hold
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
class Finding:
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
    def seen(self) -> Seen:
        """The unit for a reader, of all numbers alike."""
        largest = max(abs(self.spread.minimum), abs(self.spread.maximum)) if self.spread else math.inf
        return seen(self.unit, largest)


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
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()
