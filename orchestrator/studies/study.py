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
from typing import Any, ClassVar, Literal, get_args

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import SYSTEMS, find, require
from orchestrator.base.options import checked, declarations, seconds
from orchestrator.base.text import brief
from orchestrator.base.toml import Rule, Table, is_number, quote_key
from orchestrator.base.units import number_and_unit
from orchestrator.engine.arguments import CoupledArguments, RunArguments
from orchestrator.ssp.coupling import CouplingArguments, take_coupling

Method = Literal["latin", "sobol", "grid", "saltelli", "morris"]
Measure = Literal["maximum", "minimum", "mean", "rms", "range", "final", "integral", "time_of_maximum"]
METHODS: tuple[Method, ...] = get_args(Method)
MEASURES: tuple[Measure, ...] = get_args(Measure)
BALANCED = ("sobol", "saltelli")  # methods whose samples are balanced only if their number is a power of two
START = "start:"  # prefix of the columns with start values
MOST_RUNS = 1_000_000  # the table of all runs then takes some gigabytes
# [s] for one run: far more than runs of a study take. Without a limit, an FMU that hangs holds up its core.
# A multiple of the duration of other runs would depend on the load of the machine.
TIME_LIMIT = 3600.0
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
        Table(self.key, {"distribution": self.distribution}).one_of("distribution", DISTRIBUTIONS)
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
    if distribution == "values" and len(set(n["values"])) < len(n["values"]):
        return "values", "different numbers"
    return None


@dataclass(frozen=True)
class Choice:
    """A scenario, a parameter set or a variant of a component that differs from run to run.

    name     "scenario", "parameters", or the name of a component
    options  files or names; each is run with every sample of the factors
    sampled  the choice is a dimension of the samples instead; all options have the same probability
    """

    name: str
    options: tuple[str, ...]
    sampled: bool = False
    kind: ClassVar[str] = "choice"

    def __post_init__(self) -> None:
        object.__setattr__(self, "options", tuple(self.options))

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

    start, stop  default: from the beginning, to the end of the run
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
        object.__setattr__(self, "options", checked(CoupledArguments, self.options, "Study"))
        given = checked(RunArguments, {name: getattr(self, name) for name in RUN}, "Study")
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
    def coupling(self) -> dict[str, Any]:
        """The choices about the coupling, by the names of the fields of `Coupling`."""
        return take_coupling({"master": self.master, **self.options} if self.master else {**self.options})

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
        if self.accuracy is not None and (self.step is not None or self.coupling):
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
            where = f"outputs.{quote_key(output.name)}"
            Table(where, vars(output)).one_of("measure", MEASURES)
            if output.start is not None and output.stop is not None and not output.start <= output.stop:
                expected = f"at least the start {output.start:g} s"
                raise Problem(f"{where}: stop: expected {expected}, got {output.stop:g} s")
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
OPTIONS = tuple(sorted({"cut", *declarations(CouplingArguments)} - {"master", "factors"}))
TABLES = ("factors", "choices", "outputs", "fixed")
KEYS = ("title", "system", "method", "runs", "seed", *RUN, "band_step", *OPTIONS, *TABLES)


TEXT = Rule("a text", lambda v: isinstance(v, str) and v != "")
NUMBER = Rule("a number", is_number)
TRUTH = Rule("true or false", lambda v: isinstance(v, bool))
TEXTS = Rule("a text or a list of texts", lambda v: TEXT.holds(v) or _is_list(v, TEXT))
NUMBERS = Rule("a list of numbers", lambda v: _is_list(v, NUMBER))
COUNT = Rule("a whole number of at least 1", lambda v: type(v) is int and v >= 1)
SEED = Rule("a whole number of at least 0", lambda v: type(v) is int and v >= 0)


def _is_list(value: Any, rule: Rule) -> bool:
    """True for a list that is not empty, if a rule holds for each item."""
    return isinstance(value, list) and value != [] and all(map(rule.holds, value))


def read(file: str | Path) -> Study:
    """The study in a TOML file; paths in it are relative to the file."""
    file = require(file, (".toml",))
    table = toml.read_file(file).allow_only(KEYS)
    table.require("system", "an .ssp, .ssd or .fmu file")
    method = table.one_of("method", METHODS)
    if method != "grid":
        table.require("runs", "a whole number")
    with Study(source=str(file)).located():
        study = Study(
            title=table.value("title", TEXT) or file.stem,
            system=table.value("system", TEXT),
            method=method,
            runs=table.value("runs", COUNT) or 0,
            seed=table.value("seed", SEED) or 0,
            **{name: table.data[name] for name in (*RUN, "band_step") if name in table.data},
            options={name: table.data[name] for name in OPTIONS if name in table.data},
            factors=tuple(_factor(name, t) for name, t in table.tables("factors").items()),
            choices=tuple(_choice(table.table("choices"), name) for name in table.table("choices").data),
            outputs=tuple(_output(name, t) for name, t in table.tables("outputs").items()),
            fixed={name: _start(table.table("fixed"), name) for name in table.table("fixed").data},
            folder=str(file.parent),
            source=str(file),
        )
        study.check()
    return study


def _factor(name: str, table: Table) -> Factor:
    distribution = table.one_of("distribution", DISTRIBUTIONS)
    table.allow_only(("distribution", "relative", "unit", *DISTRIBUTIONS[distribution]))
    relative, unit = table.value("relative", TRUTH) or False, table.value("unit", TEXT)
    if relative and unit:
        raise table.problem("unit", "none, as the numbers are relative")
    rules = {key: NUMBERS if key == "values" else NUMBER for key in DISTRIBUTIONS[distribution]}
    numbers = {key: table.value(key, rule) for key, rule in rules.items()}
    given = {key: number for key, number in numbers.items() if number is not None}
    return Factor(name, distribution, given, relative, unit or "")


def _choice(table: Table, name: str) -> Choice:
    """Read a list of options, or a table with `options` and `sampled`."""
    if not isinstance(table.data[name], dict):
        return Choice(name, _texts(table, name))
    inner = Table(f"{table.where}.{name}", table.data[name]).allow_only(("options", "sampled"))
    inner.require("options", "a list of texts")
    return Choice(name, _texts(inner, "options"), inner.value("sampled", TRUTH) or False)


def _texts(table: Table, key: str) -> tuple[str, ...]:
    """Read a text or a list of different texts."""
    value = table.value(key, TEXTS)
    texts = [value] if isinstance(value, str) else value
    if len(set(texts)) < len(texts):
        raise table.problem(key, "different texts")
    return tuple(texts)


def _start(table: Table, name: str) -> float | tuple[float, str]:
    """Read a number, a text such as "180bar", or a table with `value` and `unit`."""
    value = table.data[name]
    if isinstance(value, str):
        number_text, unit_text = number_and_unit(value)
        if unit_text:
            return float(number_text), unit_text
    if isinstance(value, dict):
        inner = Table(f"{table.where}.{name}", value).allow_only(("value", "unit"))
        inner.require("value", "a number")
        number, unit = float(inner.value("value", NUMBER)), inner.value("unit", TEXT)
        return (number, unit) if unit else number
    if not is_number(value):
        raise table.problem(name, 'a number, a text such as "180bar", or a table of value and unit')
    return float(value)


def _output(name: str, table: Table) -> Output:
    table.allow_only(("signal", "measure", "start", "stop", "band"))
    table.require("signal", "the name of a signal")
    signal, measure = table.value("signal", TEXT), table.one_of("measure", MEASURES)
    start, stop = (seconds(table.data.get(end), f"{table.where}: {end}") for end in ("start", "stop"))
    return Output(name, signal, measure, start, stop, table.value("band", TRUTH) or False)
