"""Numbers of a study against the minimum and maximum that an FMU declares of its variables.

What would spoil every run of a study, found before the first one.

STUDY.toml as a study; docs/sweep.md shows a complete one. Mistakes are told in one line.

The systems of the study are opened, so that names can be checked and units converted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import log2
from pathlib import Path

from orchestrator.base import toml
from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Problem
from orchestrator.base.toml import Table, is_number, quoted
from orchestrator.base.units import linear
from orchestrator.engine.time_grid import Grid, free_grid, grid
from orchestrator.ssp.system import Port, System
from orchestrator.studies import cases, design
from orchestrator.studies.cases import Case, Options, driven, fixed
from orchestrator.studies.single_run import nominal, nominals, unit
from orchestrator.studies.study import MEASURES, METHODS, Choice, Factor, Output, Study, factor

ENDS = ("minimum", "maximum", "mean", "values")  # a mode lies between its ends, a deviation is no value
ROUNDING = 1e-12  # of a bound: what the conversion of a unit may cost


def limits(study: Study, system: System) -> None:
    """Problem where a number of a factor, or one that is fixed, lies outside what its variable may be.

    Of a normal and a lognormal factor only the mean is looked at, as they have no ends.
    """
    for varied in study.factors:
        if system.has(varied.name):
            share = nominal(varied, system) if varied.relative else 1.0
            for key, number in _numbers(varied):
                told = f" ({number:g} of {share:g})" if varied.relative else ""
                _inside(system, varied.name, f"factors.{quoted(varied.name)}: {key}", number * share, told)
    for name, value in study.fixed.items():
        if system.has(name):
            _inside(system, name, f"fixed: {name}", value)


def _numbers(factor: Factor) -> Iterator[tuple[str, float]]:
    """Key and number of what lies at the ends of a distribution."""
    for key in ENDS:
        found = factor.numbers.get(key, ())
        yield from ((key, number) for number in (found if isinstance(found, tuple) else (found,)))


def _inside(system: System, name: str, where: str, value: float, told: str = "") -> None:
    """Each variable behind a name may have this value."""
    for port, conversion in system.targets(name):
        variable, own = system.variable(port), conversion(value)
        unit = f" {variable.unit.name}" if variable.unit else ""
        for word, bound, sign in (("least", variable.minimum, 1.0), ("most", variable.maximum, -1.0)):
            if bound is not None and sign * (own - bound) < -ROUNDING * abs(bound):
                raise Problem(f"{where}: expected at {word} {bound:g}{unit}, got {own:g}{unit}{told}")


NEAR = 1e-9  # of a time: rounding of the sum of steps
MOST = 1_000_000  # runs: some gigabytes, when their numbers are put into one table


def check(study: Study, cases: Mapping[Options, Case]) -> None:
    """Problem where no run could do what the study asks for."""
    if (count := design.count(study)) > MOST:
        raise Problem(f"expected at most {MOST:,} runs, got {count:,}")
    for options, case in cases.items():
        _free(study, options, case)
        _once(study, case)
        system = fixed(study, case.system)
        nominals(study, system)
        limits(study, system)
    _windows(study, [_times(study, case) for case in cases.values()])


def _free(study: Study, options: Options, case: Case) -> None:
    """Nothing that a scenario drives is set: it would have no effect."""
    if found := driven(case, [*study.fixed, *(f.name for f in study.factors)]):
        told = f"{', '.join(options)}: the scenario drives {found[0]}"
        raise Problem(f"choices: {told}, expected none that is fixed or a factor")


def _once(study: Study, case: Case) -> None:
    """No variable is set twice, as one of the two would have no effect; a share may be of what is fixed."""
    there = [f for f in study.factors if case.system.has(f.name)]
    absolute = {port for f in there if not f.relative for port, _ in case.system.targets(f.name)}
    seen: dict[Port, str] = {}
    for name in (f.name for f in there):
        for port, _ in case.system.targets(name):
            if port in seen:
                raise Problem(f"factors: expected one that sets {port}, got {seen[port]} and {name}")
            seen[port] = name
    for name in study.fixed:
        for port, _ in case.system.targets(name) if case.system.has(name) else ():
            if port in absolute:
                same = "" if seen[port] == name else f", which sets {port} as factors.{seen[port]} does"
                raise Problem(f"fixed: expected no factor, got {name}{same}")


def _times(study: Study, case: Case) -> Grid:
    """The communication points of the runs of a case, as `run` finds them."""
    coupling = case.system.coupling or Coupling()
    coupling.check(case.system.components)
    given = case.system, case.scenario, study.step, None, study.stop, study.record_step
    return grid(*given) if coupling.adaptive is None else free_grid(*given, ())


def _windows(study: Study, times: list[Grid]) -> None:
    """Each output has a window that some run reaches, and that does not go on when all have ended."""
    begin, end = min(t.start for t in times), max(t.stop for t in times)
    last = max(end + NEAR * abs(end), study.stop or end)  # a run ends at the whole step next to its stop
    for output in study.outputs:
        if output.start is not None and output.start > end:
            raise Problem(f"outputs.{output.name}: start: expected at most {end:g} s, got {output.start:g} s")
        if output.stop is None:
            continue
        where = f"outputs.{output.name}: stop"
        if output.stop < begin:
            raise Problem(f"{where}: expected at least {begin:g} s, got {output.stop:g} s")
        if output.stop > last:
            raise Problem(f"{where}: expected at most {last:g} s, where the runs end, got {output.stop:g} s")


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
    table = toml.read(file, data).only(KEYS)
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
