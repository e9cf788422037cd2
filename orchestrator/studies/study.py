"""A study as data: what is varied, what is run, what is kept of each run.

The columns of the results, and of `design.table`, are named by what they hold: `factor:swing.gear_ratio` is a
sample of a factor, `choice:boom_stick` an option, `start:swing.gear_ratio` a number as the run used it, in
the unit of the FMU, `output:peak` an output.

Factors from their tables: which numbers a distribution needs, what they have to be, in which unit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from orchestrator.base.errors import Problem
from orchestrator.base.toml import Table
from orchestrator.base.units import linear

Method = Literal["latin", "sobol", "grid", "saltelli", "morris"]
Measure = Literal["maximum", "minimum", "mean", "rms", "range", "final", "integral", "time_of_maximum"]
METHODS: tuple[Method, ...] = get_args(Method)
MEASURES: tuple[Measure, ...] = get_args(Measure)
START = "start:"  # of a column with the start value of a component.variable


@dataclass(frozen=True)
class Factor:
    """A number that differs from run to run.

    name           as of `run(set=...)`
    distribution   uniform (minimum, maximum), normal (mean, sd), lognormal (mean, sd), triangular (minimum,
                   mode, maximum), values (a list, each as likely)
    numbers        of the distribution, in `unit`; of a grid, `values`. Mean and sd of a lognormal factor are
                   its own, not those of its logarithm
    relative       the numbers are shares of the value that the FMU or the system has
    unit           the unit of the FMU
    """

    name: str
    distribution: str
    numbers: Mapping[str, float | tuple[float, ...]]
    relative: bool = False
    unit: str = ""

    @property
    def column(self) -> str:
        """Of the samples; of a relative factor they are shares."""
        return f"factor:{self.name}"


@dataclass(frozen=True)
class Choice:
    """A scenario, a parameter set or a variant of a component that differs from run to run.

    what      "scenario", "parameters", or the name of a component
    options   files or names; each is run with every sample of the factors
    sampled   no: it is a factor of the samples itself, each option as likely
    """

    what: str
    options: tuple[str, ...]
    sampled: bool = False

    @property
    def column(self) -> str:
        """Of the options."""
        return f"choice:{self.what}"


@dataclass(frozen=True)
class Output:
    """One number per run: a measure of a signal over a window of time [s]; with `band` the signal is kept.

    start, stop   None: from the beginning, to the end of the run
    unit          of the number
    signal_unit   of the signal
    """

    name: str
    signal: str
    measure: Measure
    start: float | None = None
    stop: float | None = None
    band: bool = False
    unit: str = ""
    signal_unit: str = ""

    @property
    def column(self) -> str:
        """Of the numbers."""
        return f"output:{self.name}"


@dataclass(frozen=True)
class Study:
    """Everything that determines the results: equal studies have equal results, to the last bit.

    system       path of an .ssp, .ssd or .fmu file
    runs         samples of the factors; of a grid it follows (0); of saltelli the N of N (k + 2); of morris
                 the trajectories, N (k + 1) runs
    stop         of each run [s]
    record_step  interval at which the measures see a signal [s]; default: every communication point
    fixed        start values of all runs
    folder       paths are relative to it; it does not count when studies are compared
    """

    title: str
    system: str
    method: Method
    runs: int
    seed: int
    stop: float | None
    step: float | None
    master: str | None
    factors: tuple[Factor, ...]
    choices: tuple[Choice, ...]
    outputs: tuple[Output, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    band_step: float = 0.05
    record_step: float | None = None
    folder: str = field(default=".", compare=False)

    @property
    def dimensions(self) -> tuple[Factor | Choice, ...]:
        """What the samples have a column for: the factors, then the sampled choices."""
        return (*self.factors, *(c for c in self.compared if c.sampled))

    @property
    def compared(self) -> tuple[Choice, ...]:
        """The choices that differ from run to run; one option alone says what all runs have."""
        return tuple(c for c in self.choices if len(c.options) > 1)

    @property
    def crossed(self) -> tuple[Choice, ...]:
        """The choices whose options are run with every sample."""
        return tuple(c for c in self.compared if not c.sampled)

    @property
    def settled(self) -> tuple[Choice, ...]:
        """The choices of one option."""
        return tuple(c for c in self.choices if len(c.options) == 1)

    @property
    def bands(self) -> tuple[str, ...]:
        """The signals that are kept, once each."""
        return tuple(dict.fromkeys(o.signal for o in self.outputs if o.band))


NUMBERS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("minimum", "maximum"),
    "normal": ("mean", "sd"),
    "lognormal": ("mean", "sd"),
    "triangular": ("minimum", "mode", "maximum"),
    "values": ("values",),
}
SPREADS = ("sd",)  # differences: an offset between units does not count

Rule = tuple[Callable[[Mapping[str, Any]], bool], str, str]
RULES: Mapping[str, tuple[Rule, ...]] = {
    "uniform": ((lambda n: n["minimum"] < n["maximum"], "maximum", "more than the minimum {minimum:g}"),),
    "normal": ((lambda n: n["sd"] > 0, "sd", "a positive number"),),
    "lognormal": (
        (lambda n: n["mean"] > 0, "mean", "a positive number"),
        (lambda n: n["sd"] > 0, "sd", "a positive number"),
    ),
    "triangular": (
        (lambda n: n["minimum"] < n["maximum"], "maximum", "more than the minimum {minimum:g}"),
        (
            lambda n: n["minimum"] <= n["mode"] <= n["maximum"],
            "mode",
            "a number from {minimum:g} to {maximum:g}",
        ),
    ),
    "values": ((lambda n: len(set(n["values"])) == len(n["values"]), "values", "different numbers"),),
}


def factor(name: str, table: Table, unit: str, method: str) -> Factor:
    """A factor; unit: the one of the FMU, to which numbers in the unit of the table are converted."""
    kind = table.one_of("distribution", NUMBERS)
    table.only(("distribution", "relative", "unit", *NUMBERS[kind]))
    if method == "grid" and kind != "values":
        raise table.wrong("distribution", "values, as the method is grid")
    relative, given = table.truth("relative"), table.text("unit")
    if relative and given:
        raise Problem(f"{table.where}: unit: expected none, as the numbers are shares, got {given!r}")
    numbers = {key: _number(table, key) for key in NUMBERS[kind]}
    for holds, key, expected in RULES[kind]:
        if not holds(numbers):
            raise table.wrong(key, expected.format(**numbers))
    if given:
        factor, offset = linear(given, unit, f"{table.where}: unit")
        numbers = {k: _converted(v, factor, 0.0 if k in SPREADS else offset) for k, v in numbers.items()}
    return Factor(name, kind, numbers, relative, unit)


def _number(table: Table, key: str) -> Any:
    if key == "values":
        return table.numbers(key)
    table.need(key, "a number")
    return table.number(key)


def _converted(value: Any, factor: float, offset: float) -> Any:
    if isinstance(value, tuple):
        return tuple(factor * v + offset for v in value)
    return factor * value + offset
