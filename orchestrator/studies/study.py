"""A parameter study as data: factors, choices, settings of the runs, and outputs of each run.

A study is built in Python or read from a TOML file; docs/sweep.md shows a complete one. This module does not
open the systems: `cases.resolve` does, checks names and limits, and converts values to the units of the FMUs.

The table of runs has columns with these names:

    factor:swing.gear_ratio   sample of a factor
    choice:boom_stick         option of a choice
    start:swing.gear_ratio    value that the run used, in the unit of the FMU
    output:peak               value of an output
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import isfinite, log2, prod
from pathlib import Path, PurePath
from typing import Annotated, Any, ClassVar, Literal, get_args

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import SYSTEMS, find, require
from orchestrator.base.options import checked, chosen, declarations, seconds
from orchestrator.base.text import brief
from orchestrator.base.toml import Rule, Table, quote_key
from orchestrator.base.units import number_and_unit
from orchestrator.engine.options import CoupledOptions, RunOptions
from orchestrator.ssp.coupling import CouplingOptions

Method = Literal["latin", "sobol", "grid", "saltelli", "morris"]
Measure = Literal["maximum", "minimum", "mean", "rms", "range", "final", "integral", "time_of_maximum"]
METHODS: tuple[Method, ...] = get_args(Method)
MEASURES: tuple[Measure, ...] = get_args(Measure)
BALANCED = ("sobol", "saltelli")  # methods whose samples are balanced only if their number is a power of two
START = "start:"  # prefix of the columns with start values
MOST_RUNS = 1_000_000  # the table of all runs then has some gigabytes
# [s] for one run: far more than runs of a study take. Without a limit, an FMU that hangs holds up its core.
# A multiple of the duration of other runs would depend on the load of the machine.
TIME_LIMIT = 3600.0
Distribution = Literal["uniform", "normal", "lognormal", "triangular", "values"]
# Distribution -> names of its parameters.
DISTRIBUTIONS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("minimum", "maximum"),
    "normal": ("mean", "sd"),
    "lognormal": ("mean", "sd"),
    "triangular": ("minimum", "mode", "maximum"),
    "values": ("values",),
}


@dataclass(frozen=True)
class Factor:
    """A start value or parameter value that differs from run to run.

    name          variable, as in `run(set=...)`
    distribution  uniform (minimum, maximum), normal (mean, sd), lognormal (mean, sd), triangular (minimum,
                  mode, maximum), values (a list with equal probabilities)
    numbers       parameters of the distribution, in `unit`; mean and sd of a lognormal factor are those of
                  the factor, not of its logarithm
    relative      the numbers are relative to the value in the FMU or the system
    unit          default: the unit of the FMU
    """

    name: str
    distribution: str
    numbers: Mapping[str, Any]
    relative: bool = False
    unit: str = ""
    kind: ClassVar[str] = "factor"

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            expected = f"expected one of {', '.join(DISTRIBUTIONS)}"
            raise Problem(f"{self.key}: distribution: {expected}, got {self.distribution!r}")
        numbers = Table(self.key, dict(self.numbers)).allow_only(DISTRIBUTIONS[self.distribution])
        floats: dict[str, Any] = {}
        for name in DISTRIBUTIONS[self.distribution]:
            numbers.require(name, "a list of numbers" if name == "values" else "a number")
            value = self.numbers[name]
            floats[name] = tuple(map(float, value)) if name == "values" else float(value)
        object.__setattr__(self, "numbers", floats)
        if impossible := _impossible(self.distribution, floats):
            raise self.wrong(*impossible)

    @property
    def key(self) -> str:
        """The table in the TOML file of a study."""
        return f"factors.{quote_key(self.name)}"

    @property
    def column(self) -> str:
        """Column of the samples; those of a relative factor are relative."""
        return f"factor:{self.name}"

    def wrong(self, name: str, expected: str) -> Problem:
        """The Problem for an impossible distribution parameter."""
        value = self.numbers[name]
        got = f"[{', '.join(f'{v:g}' for v in value)}]" if isinstance(value, tuple) else f"{value:g}"
        return Problem(f"{self.key}: {name}: expected {expected}, got {got}")


def _impossible(distribution: str, n: Mapping[str, Any]) -> tuple[str, str] | None:
    """Name of the first impossible distribution parameter, and what is expected; None if there is none."""
    if distribution in ("uniform", "triangular") and not n["minimum"] < n["maximum"]:
        return "maximum", f"more than the minimum {n['minimum']:g}"
    if distribution == "triangular" and not n["minimum"] <= n["mode"] <= n["maximum"]:
        return "mode", f"a number from {n['minimum']:g} to {n['maximum']:g}"
    if distribution == "lognormal" and not n["mean"] > 0:
        return "mean", "a positive number"
    if "sd" in n and not n["sd"] > 0:
        return "sd", "a positive number"
    if distribution == "values" and len(set(n["values"])) < max(len(n["values"]), 1):
        return "values", "different numbers" if n["values"] else "at least one number"
    return None


@dataclass(frozen=True)
class Choice:
    """A scenario, a parameter set or a variant of a component that differs from run to run.

    name     "scenario", "parameters", or the name of a component
    options  files or names, or one of them; each is run with every sample of the factors
    sampled  the choice is a dimension of the samples instead; all options have the same probability
    """

    name: str
    options: tuple[str, ...]
    sampled: bool = False
    kind: ClassVar[str] = "choice"

    def __post_init__(self) -> None:
        options = (self.options,) if isinstance(self.options, str) else tuple(self.options)
        if not options or "" in options or len(set(options)) < len(options):
            expected = "a text or a list of different texts"
            raise Problem(f"choices: {self.name}: expected {expected}, got {[*options]}")
        object.__setattr__(self, "options", options)

    @property
    def column(self) -> str:
        """Column of the options."""
        return f"choice:{self.name}"


def short(option: str) -> str:
    """An option of a choice for a reader: the stem of a file, or the option itself."""
    return PurePath(option).stem if option.endswith((".csv", ".parquet", ".ssv", ".fmu")) else option


@dataclass(frozen=True)
class Output:
    """One value per run: a measure of a signal over a time window [s].

    start, stop  a number, or a text such as "500ms"; default: from the beginning, to the end of the run
    band         the signal is stored over time, too
    unit         unit of the value; follows from `signal_unit`, the unit in the FMU
    """

    name: str
    signal: str
    measure: Measure
    start: float | None = None
    stop: float | None = None
    band: bool = False
    unit: str = ""
    signal_unit: str = ""

    def __post_init__(self) -> None:
        for end in ("start", "stop"):
            object.__setattr__(self, end, seconds(getattr(self, end), f"{self.key}: {end}"))

    @property
    def key(self) -> str:
        """The table in the TOML file of a study."""
        return f"outputs.{quote_key(self.name)}"

    @property
    def column(self) -> str:
        """Column of the values."""
        return f"output:{self.name}"


@dataclass(frozen=True)
class Study:
    """Everything that determines the results: equal studies have bit-identical results.

    system       path of an .ssp, .ssd or .fmu file
    runs         number of samples; 0 for a grid, where it follows from the values; N of the N (k + 2) runs of
                 saltelli; trajectories of morris, with N (k + 1) runs
    stop, step, master, record_step, options   as of `run`; `options`: those of the coupling, and `cut`
    accuracy     RMS error of the outputs' signals over their range; master and step of all runs follow
                 from it at the start values; default, if nothing chooses master or step: 1e-3
    fixed        start values of all runs: a value in the unit of the FMU, or (value, unit)
    band_step    interval at which signals are stored [s]; measures use the points of `record_step`
    time_limit   wall time after which a run is stopped and counts as failed [s]
    memory_limit memory at which it is stopped and counts as failed [GB]; default: a quarter of the machine's
    folder       paths are relative to this folder
    source       file of the study, for messages

    The last four are ignored if studies are compared.
    """

    title: str = ""
    system: str = ""
    method: Method = "latin"
    runs: int = 0
    seed: int = 0
    stop: float | None = None
    step: float | None = None
    master: str | None = None
    factors: tuple[Factor, ...] = ()
    choices: tuple[Choice, ...] = ()
    outputs: tuple[Output, ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)
    band_step: float = 0.05
    record_step: float | None = None
    accuracy: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    time_limit: float = field(default=TIME_LIMIT, compare=False)
    memory_limit: float | None = field(default=None, compare=False)
    folder: str = field(default=".", compare=False)
    source: str = field(default="", compare=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("factors", "choices", "outputs"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "options", checked(CoupledOptions, self.options, "Study"))
        given = checked(RunOptions, {name: getattr(self, name) for name in RUN}, "Study")
        for name, value in (given | {"band_step": seconds(self.band_step, "band_step")}).items():
            expected = "finite" if name == "stop" else "positive"
            if name != "master" and not (isfinite(value) and (value > 0 or name == "stop")):
                raise Problem(f"{name}: expected a {expected} number, got {value:g}")
            object.__setattr__(self, name, value)

    @property
    def system_file(self) -> Path:
        """The file of the system; if there is none, its path."""
        return find(self.system, SYSTEMS, self.folder)

    @property
    def dimensions(self) -> tuple[Factor | Choice, ...]:
        """The dimensions of the samples: the factors, then the sampled choices."""
        return (*self.factors, *(c for c in self.compared if c.sampled))

    @property
    def chosen(self) -> CoupledOptions:
        """`options` and the master, as a record."""
        master = {"master": self.master} if self.master else {}
        return chosen(CoupledOptions, {**self.options, **master}, "Study")

    @property
    def compared(self) -> tuple[Choice, ...]:
        """The choices with several options, which differ from run to run."""
        return tuple(c for c in self.choices if len(c.options) > 1)

    @property
    def crossed(self) -> tuple[Choice, ...]:
        """The choices whose options are run with every sample."""
        return tuple(c for c in self.compared if not c.sampled)

    @property
    def bands(self) -> tuple[str, ...]:
        """The signals that are stored, without repetitions."""
        return tuple(dict.fromkeys(o.signal for o in self.outputs if o.band))

    @property
    def count(self) -> int:
        """Number of runs."""
        k, options = len(self.dimensions), prod(len(c.options) for c in self.crossed)
        if self.method == "grid" or not k:
            return options * prod(levels(d) for d in self.dimensions)
        return options * self.runs * {"saltelli": k + 2, "morris": k + 1}.get(self.method, 1)

    @contextmanager
    def located(self) -> Iterator[None]:
        """Put the file of the study, or its title, before the message of a Problem."""
        source = self.source or f"study {self.title!r}"
        try:
            yield
        except Problem as problem:
            raise Problem(f"{source}: {str(problem).removeprefix(f'{source}: ')}") from None

    def check(self) -> None:
        """Raise a Problem if the study contradicts itself; its system is not opened."""
        if self.method not in METHODS:
            raise Problem(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if self.accuracy is not None and (self.step is not None or self.chosen.coupling.names):
            raise Problem(f"accuracy {self.accuracy:g}: expected no step and no master, which follow from it")
        if not self.outputs:
            raise Problem("outputs: expected at least one, got none")
        if not self.dimensions and not self.crossed:
            raise Problem("expected factors, or choices of two options and more, got neither")
        if not self.dimensions and self.method != "grid":
            raise Problem(f"method: expected grid, as nothing is sampled, got {self.method!r}")
        if expected := self._expected_runs():
            raise Problem(f"runs: expected {expected}, got {self.runs}")
        for factor in self.factors if self.method == "grid" else ():
            if factor.distribution != "values":
                got = f"got {factor.distribution!r}"
                raise Problem(f"{factor.key}: distribution: expected values, as the method is grid, {got}")
        for output in self.outputs:
            if output.measure not in MEASURES:
                expected = f"expected one of {', '.join(MEASURES)}"
                raise Problem(f"{output.key}: measure: {expected}, got {output.measure!r}")
            if output.start is not None and output.stop is not None and not output.start <= output.stop:
                expected = f"at least the start {output.start:g} s"
                raise Problem(f"{output.key}: stop: expected {expected}, got {output.stop:g} s")
        if self.count > MOST_RUNS:
            raise Problem(f"expected at most {MOST_RUNS:,} runs, got {self.count:,}")

    def _expected_runs(self) -> str:
        """What `runs` should be; empty if it is right."""
        if self.method == "grid":
            return "none, as those of a grid follow from its values" if self.runs else ""
        if self.runs < 1:
            return "a whole number of at least 1"
        if self.method in BALANCED and self.runs & (self.runs - 1):
            lower = 2 ** int(log2(self.runs))
            return f"a power of two, such as {lower} or {2 * lower}, as the method is {self.method}"
        return ""


def levels(dimension: Factor | Choice) -> int:
    """Number of values of a dimension of a grid."""
    return len(dimension.options if isinstance(dimension, Choice) else dimension.numbers["values"])


# ---- the file


RUN = ("stop", "step", "master", "record_step", "accuracy", "time_limit", "memory_limit")  # options of `run`
OPTIONS = tuple(sorted({"cut", *declarations(CouplingOptions)} - {"master", "factors"}))
OF_STUDY = (*RUN, "band_step", *OPTIONS)  # keys whose values `Study` checks itself

Text = Annotated[str, Rule("a text", bool)]
FIXED = 'a number, a text such as "180bar", or a table of value and unit'


@dataclass(frozen=True)
class _Fixed:
    value: float
    unit: Text = ""


_Start = Annotated[float | str | _Fixed, Rule(FIXED, lambda _: True)]


@dataclass(frozen=True)
class _Factor:
    """A table of `factors`; the distribution says which of the numbers it has."""

    distribution: Distribution
    relative: bool = False
    unit: Text = ""
    minimum: float | None = None
    maximum: float | None = None
    mean: float | None = None
    sd: float | None = None
    mode: float | None = None
    values: tuple[float, ...] | None = None


@dataclass(frozen=True)
class _Choice:
    options: str | tuple[str, ...]
    sampled: bool = False


@dataclass(frozen=True)
class _Output:
    signal: Annotated[str, Rule("the name of a signal", bool)]
    measure: Measure
    start: float | str | None = None
    stop: float | str | None = None
    band: bool = False


@dataclass(frozen=True)
class _File:
    """The keys of a file that `Study` does not check."""

    system: Annotated[str, Rule("an .ssp, .ssd or .fmu file", bool)]
    method: Method
    title: Text = ""
    runs: Annotated[int, Rule("a whole number of at least 1", lambda v: v >= 1)] = 0
    seed: Annotated[int, Rule("a whole number of at least 0", lambda v: v >= 0)] = 0
    factors: Mapping[str, _Factor] = field(default_factory=dict)
    choices: Mapping[str, str | tuple[str, ...] | _Choice] = field(default_factory=dict)
    outputs: Mapping[str, _Output] = field(default_factory=dict)
    fixed: Mapping[str, _Start] = field(default_factory=dict)


def read(file: str | Path) -> Study:
    """The study in a TOML file; paths in it are relative to the file."""
    path = require(file, (".toml",))
    table = toml.read_file(path).allow_only((*_File.__dataclass_fields__, *OF_STUDY))
    if table.data.get("method") != "grid":
        table.require("runs", "a whole number")
    own = {name: value for name, value in table.data.items() if name not in OF_STUDY}
    found = toml.read_dataclass(_File, Table(table.where, own))
    with Study(source=str(path)).located():
        given = {name: table.data[name] for name in (*RUN, "band_step") if name in table.data}
        choices = {n: c if isinstance(c, _Choice) else _Choice(c) for n, c in found.choices.items()}
        made = {
            "title": found.title or path.stem,
            "options": {name: table.data[name] for name in OPTIONS if name in table.data},
            "factors": [_factor(name, factor) for name, factor in found.factors.items()],
            "choices": [Choice(name, **vars(choice)) for name, choice in choices.items()],
            "outputs": [Output(name, **vars(output)) for name, output in found.outputs.items()],
            "fixed": {name: _start(name, value) for name, value in found.fixed.items()},
        }
        study = Study(**{**vars(found), **given, **made}, folder=str(path.parent), source=str(path))
        study.check()
    return study


def _factor(name: str, found: _Factor) -> Factor:
    given = {key: value for key, value in vars(found).items() if value is not None}
    own, known = ("distribution", "relative", "unit"), DISTRIBUTIONS[found.distribution]
    Table(f"factors.{quote_key(name)}", given).allow_only((*own, *known))
    numbers = {key: value for key, value in given.items() if key not in own}
    factor = Factor(name, found.distribution, numbers, found.relative, found.unit)
    if factor.relative and factor.unit:
        expected = "expected none, as the numbers are relative"
        raise Problem(f"{factor.key}: unit: {expected}, got {factor.unit!r}")
    return factor


def _start(name: str, value: float | str | _Fixed) -> float | tuple[float, str]:
    """A number, and its unit if there is one."""
    if isinstance(value, _Fixed):
        return (value.value, value.unit) if value.unit else value.value
    if not isinstance(value, str):
        return value
    number, unit = number_and_unit(value)
    if not unit:
        raise Problem(f"fixed: {name}: expected {FIXED}, got {value!r}")
    return float(number), unit
