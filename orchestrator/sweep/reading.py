"""STUDY.toml as a study; docs/sweep.md shows a complete one. Mistakes are told in one line.

The systems of the study are opened, so that names can be checked and units converted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import log2
from pathlib import Path

from orchestrator.errors import Problem
from orchestrator.sweep import cases, fields
from orchestrator.sweep.checks import check
from orchestrator.sweep.distributions import factor
from orchestrator.sweep.fields import Table, is_number
from orchestrator.sweep.measures import unit
from orchestrator.sweep.study import MEASURES, METHODS, Choice, Factor, Output, Study
from orchestrator.symbols import linear
from orchestrator.system.system import System

KEYS = (
    *("title", "system", "method", "runs", "seed", "stop", "step", "master", "record_step", "band_step"),
    *("factors", "choices", "outputs", "fixed"),
)
OUTPUT = ("signal", "measure", "start", "stop", "band")
POWERS = ("sobol", "saltelli")  # methods whose samples are balanced for powers of two only


def read(file: Path) -> Study:
    """The study in a file; what it names lies relative to it."""
    try:
        data = file.read_bytes()
    except OSError as error:
        raise Problem(f"{file}: cannot be read: {error.strerror}") from None
    table = fields.read(file, data).only(KEYS)
    study = _frame(table, file)
    try:
        made = cases.cases(study)
    except Problem as problem:
        raise Problem(f"{file}: {str(problem).removeprefix(f'{file}: ')}") from None
    systems = [case.system for case in made.values()]
    study = replace(study, fixed=_fixed(table, systems))
    factors = tuple(_factor(name, t, systems, study.method) for name, t in table.tables("factors").items())
    outputs = tuple(_output(name, t, systems) for name, t in table.tables("outputs").items())
    if not outputs:
        raise Problem(f"{file}: outputs: expected at least one, got none")
    study = replace(study, factors=factors, outputs=outputs)
    if not study.dimensions and not study.crossed:
        raise Problem(f"{file}: expected factors, or choices of two options and more, got neither")
    study = _counted(table, study)
    try:
        check(study, made)
    except Problem as problem:
        raise Problem(f"{file}: {problem}") from None
    return study


def _frame(table: Table, file: Path) -> Study:
    """The study without what takes its systems to understand."""
    table.need("system", "an .ssp, .ssd or .fmu file")
    method = table.one_of("method", METHODS)
    return Study(
        title=table.text("title") or file.stem,
        system=table.text("system") or "",
        method=method,
        runs=_runs(table, method),
        seed=table.whole("seed", 0) or 0,
        stop=table.number("stop"),
        step=table.number("step", positive=True),
        master=table.text("master"),
        factors=(),
        choices=tuple(_choice(table.inside("choices"), what) for what in table.inside("choices").data),
        outputs=(),
        band_step=table.number("band_step", positive=True) or Study.band_step,
        record_step=table.number("record_step", positive=True),
        folder=str(file.parent),
    )


def _runs(table: Table, method: str) -> int:
    if method == "grid":
        if "runs" in table.data:
            raise table.wrong("runs", "none, as those of a grid follow from its values")
        return 0
    table.need("runs", "a whole number")
    runs = table.whole("runs", 1)
    assert runs is not None
    if method in POWERS and runs & (runs - 1):
        near = 2 ** int(log2(runs))
        raise table.wrong("runs", f"a power of two, such as {near} or {2 * near}, as the method is {method}")
    return runs


def _choice(table: Table, what: str) -> Choice:
    """options, or a table of options and sampled."""
    if not isinstance(table.data[what], dict):
        return Choice(what, table.texts(what))
    inner = Table(f"{table.where}.{what}", table.data[what])
    inner.only(("options", "sampled"))
    inner.need("options", "a list of texts")
    return Choice(what, inner.texts("options"), inner.truth("sampled"))


def _fixed(table: Table, systems: list[System]) -> dict[str, float]:
    """Start values of all runs: a number, or a table of value and unit."""
    inner, found = table.inside("fixed"), {}
    for name, value in inner.data.items():
        if isinstance(value, dict):
            one = Table(f"{inner.where}.{name}", value).only(("value", "unit"))
            one.need("value", "a number")
            given, number = one.text("unit"), one.number("value")
            assert number is not None
        else:
            one, given, number = inner, None, value
            if not is_number(value):
                raise inner.wrong(name, "a number, or a table of value and unit")
        own = _unit(one, systems, name)
        scale, offset = linear(given, own, f"{one.where}: unit") if given else (1.0, 0.0)
        if not (cases.is_real(cases.known(systems, name)[0], name) or float(number).is_integer()):
            raise inner.wrong(name, "a whole number, as it is no Real variable")
        found[name] = scale * number + offset
    return found


def _factor(name: str, table: Table, systems: list[System], method: str) -> Factor:
    found = factor(name, table, _unit(table, systems, name), method)
    if not cases.is_real(cases.known(systems, name)[0], name):
        if found.distribution != "values" or found.relative:
            raise Problem(f"{table.where}: expected values that are no shares, as {name} is no Real variable")
        if not all(v.is_integer() for v in table.numbers("values")):
            raise table.wrong("values", f"whole numbers, as {name} is no Real variable")
    return found


def _unit(table: Table, systems: Iterable[System], name: str) -> str:
    """The unit in which a name is set; Problem if no system has it."""
    try:
        system = cases.known(systems, name)[0]
        cases.unfed(system, name)
        system.with_start({name: cases.typed(system, name, 0.0)})
    except Problem as problem:
        raise Problem(f"{table.where}: {problem}") from None
    given = system.inputs[name].unit if name in system.inputs else system.unit(system.targets(name)[0][0])
    return given.name if given else ""


def _output(name: str, table: Table, systems: Iterable[System]) -> Output:
    table.only(OUTPUT)
    table.need("signal", "the name of a signal")
    signal = table.text("signal") or ""
    measure = table.one_of("measure", MEASURES)
    start, stop = table.number("start"), table.number("stop")
    if start is not None and stop is not None and not start <= stop:
        raise table.wrong("stop", f"at least the start {start:g} s")
    units = set()
    for system in systems:
        try:
            units.add(_signal_unit(system, signal))
        except Problem as problem:
            raise Problem(f"{table.where}: signal: {problem}") from None
    own = units.pop() if len(units) == 1 else ""
    band = table.truth("band")
    return Output(name, signal, measure, start, stop, band, unit(measure, own), own)


def _signal_unit(system: System, name: str) -> str:
    port = cases.signal(system, name)
    unit = system.outputs[name].unit if name in system.outputs else system.variable(port).unit
    return unit.name if unit else ""


def _counted(table: Table, study: Study) -> Study:
    """The study, if its samples can be made."""
    if study.dimensions or study.method == "grid":
        return study
    raise Problem(f"{table.where}: method: expected grid, as nothing is sampled, got {study.method!r}")
