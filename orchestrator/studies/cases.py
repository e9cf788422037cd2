"""A study resolved against its systems: one system per combination of options, units, and all checks.

The systems are opened before anything runs, so mistakes are reported at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import find
from orchestrator.base.units import factor_and_offset
from orchestrator.data.table import READABLE
from orchestrator.data.trace import rounding
from orchestrator.engine.accuracy import decisive_signals, fmu_tolerance
from orchestrator.engine.job import Job
from orchestrator.engine.options import DEFAULT_ACCURACY, RunOptions
from orchestrator.engine.run import chooses_freely, run
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.description import Value
from orchestrator.ssp.coupling import Suggestion
from orchestrator.ssp.load import configured
from orchestrator.ssp.plausible import doubtful
from orchestrator.ssp.system import Port, System, check_bounds, check_settable
from orchestrator.studies.study import Factor, Output, Study

SCENARIO, PARAMETERS = "scenario", "parameters"  # names of choices that are not components
SAFETY = 0.5  # over the accuracy: the error at the start values, because it varies with the samples

Options = tuple[str, ...]  # one option of each choice, in the order of the choices


@dataclass(frozen=True)
class Sample:
    """One run: its number, its options, and the values of the factors that its system has."""

    run: int
    options: Options
    factors: Mapping[str, Value]


Unit = Sequence[Sample]  # samples that are run together: one, or a group in lanes with the same options


def resolve(study: Study) -> tuple[Study, dict[Options, Job]]:
    """The study with all values in the units of the FMUs, and the run of each combination of options.

    Raises a Problem if the study is impossible for its systems.
    """
    with study.located():
        study.check()
        system = configured(study.system_file, cut=study.chosen.cut).coupled(study.chosen.coupling)
        cases = {o: _case(study, system, o) for o in product(*(c.options for c in study.choices))}
        systems = [system for system, _ in cases.values()]
        fixed = {name: _fixed(systems, name, value) for name, value in study.fixed.items()}
        factors = tuple(_factor(systems, factor) for factor in study.factors)
        outputs = tuple(_output(systems, output) for output in study.outputs)
        study = replace(study, fixed=fixed, factors=factors, outputs=outputs)
        for system in systems:
            _check_set_once(study, system)
            for factor in (f for f in study.factors if system.has(f.name)):
                system.check_sets_all(factor.name, factor.key)
            for name, value in fixed.items():
                if system.has(name):
                    _check_inside(system, name, f"fixed: {name}", value)
        for options, (system, scenario) in cases.items():
            known = {name: value for name, value in fixed.items() if system.has(name)}
            start = {name: v if is_real(system, name) else int(v) for name, v in known.items()}
            cases[options] = system.with_start(start), scenario
            _check_limits(study, cases[options][0])
        jobs = {options: _job(study, *case) for options, case in cases.items()}
        for options, job in jobs.items():
            _check_not_driven(study, options, job)
        _check_windows(study, [job.times for job in jobs.values()])
    return study, jobs


def _case(study: Study, system: System, options: Options) -> tuple[System, Path | None]:
    """The system and the scenario of a combination of options, without the fixed values of the study."""
    chosen: dict[str, Any] = {c.name: option for c, option in zip(study.choices, options, strict=True)}
    for name, option in chosen.items():
        if name == SCENARIO or option.lower().endswith((".ssv", ".fmu")):
            chosen[name] = find(option, (*READABLE, ".ssv", ".fmu"), study.folder)
    scenario = chosen.pop(SCENARIO, None)
    sets = [chosen.pop(PARAMETERS)] if PARAMETERS in chosen else []
    return configured(system, swap=chosen, parameters=sets), scenario


def _job(study: Study, system: System, scenario: Path | None) -> Job:
    """The run at the fixed values; coupling, step and tolerance are accurate enough for the study."""
    accuracy, ports = study.accuracy, [str(signal(system, o.signal)) for o in study.outputs]
    tolerance = None
    if accuracy is None and chooses_freely(system, study.step, study.chosen.coupling):
        accuracy = DEFAULT_ACCURACY["sweep"]
    if accuracy is not None:
        decisive = sorted({*decisive_signals(system, ["*"])} & {*ports})
        result = run(
            system,
            scenario,
            accuracy=accuracy * SAFETY,
            accuracy_of=decisive,
            stop=study.stop,
            record_step=study.record_step,
        )
        step = result.card.step if result.coupling.adaptive is None else None
        system = replace(system, suggestion=Suggestion(result.coupling, step))
        tolerance = fmu_tolerance(accuracy * SAFETY)
    record = tuple(dict.fromkeys(ports))
    span = RunOptions(stop=study.stop, step=study.step, record_step=study.record_step)
    return Job.of(system, scenario, replace(span, record=record, tolerance=tolerance))


# ---- names


def signal(system: System, name: str) -> Port:
    """The variable of a signal name: an output of the system, or component.variable."""
    port = system.outputs[name].source if name in system.outputs else system.port(name)
    variable = system.variable(port)
    if not variable.is_number or variable.causality not in ("output", "input", "local"):
        raise Problem(f"{name}: expected a signal, got a {variable.kind} {variable.causality}")
    return port


def ports(system: System, name: str) -> list[Port]:
    """The variables that a name sets; none if the system lacks it."""
    return [port for port, _ in system.targets(name)] if system.has(name) else []


def is_real(system: System, name: str) -> bool:
    """Are all variables that a name sets Real?"""
    return all(system.variable(port).is_real for port in ports(system, name))


def nominals(study: Study, system: System) -> dict[str, float]:
    """Factor that the system has -> value to which its numbers are relative; 1 if they are absolute."""
    return {f.name: _nominal(f, system) if f.relative else 1.0 for f in study.factors if system.has(f.name)}


def _nominal(factor: Factor, system: System) -> float:
    """The value to which the numbers of a relative factor refer, in the unit of its name."""
    values = {}
    for port, unit in system.targets(factor.name):
        value: Any = system.components[port.component].value(port.variable)
        values[port] = (float(value) - unit.offset) / unit.factor
    if len(set(values.values())) > 1:
        each = ", ".join(f"{port} {value:g}" for port, value in values.items())
        raise Problem(f"factors.{factor.name}: a relative factor needs one value, got {each}")
    nominal = next(iter(values.values()))
    if not isfinite(nominal) or nominal == 0.0:
        expected = "expected a start value other than 0"
        raise Problem(f"factors.{factor.name}: relative: {expected}, got {nominal:g}")
    return nominal


# ---- units


def _settable(systems: Sequence[System], name: str, where: str) -> tuple[str, bool]:
    """Unit of a name that can be set, and whether it is Real; a Problem if no system can set it."""
    try:
        system = next((s for s in systems if s.has(name)), systems[0])
        targets = system.targets(name)
        connections = {c.target: c for c in system.connections}
        for port, _ in targets:
            if port in connections:
                raise Problem(
                    f"{name}: expected an unconnected input, got the connection {connections[port]};"
                    f" vary parameters of {connections[port].source.component},"
                    f" or drive {port} by a scenario under choices"
                )
        real = is_real(system, name)
        for port, _ in targets:
            check_settable(port, system.components[port.component].interface)
        for other in systems:
            if other.has(name):
                other.targets(name)  # raises if its variables have different units
    except Problem as problem:
        raise Problem(f"{where}: {problem}") from None
    unit = system.inputs[name].unit if name in system.inputs else system.unit(targets[0][0])
    return unit.name if unit else "", real


def _fixed(systems: Sequence[System], name: str, value: float | tuple[float, str]) -> float:
    where = f"fixed.{name}"
    unit, real = _settable(systems, name, where)
    number, given = value if isinstance(value, tuple) else (value, unit)
    if not (real or float(number).is_integer()):
        raise Problem(f"fixed: {name}: expected a whole number, as it is not a Real variable, got {number:g}")
    scale, offset = factor_and_offset(given, unit, f"{where}: unit")
    return scale * number + offset


def _factor(systems: Sequence[System], factor: Factor) -> Factor:
    unit, real = _settable(systems, factor.name, factor.key)
    if not real:
        if factor.distribution != "values" or factor.relative:
            expected = "the distribution values, not relative"
            raise Problem(f"{factor.key}: expected {expected}, as {factor.name} is not a Real variable")
        if not all(v.is_integer() for v in factor.numbers["values"]):
            raise factor.wrong("values", f"whole numbers, as {factor.name} is not a Real variable")
    given = factor.unit or unit
    if factor.relative and given != unit:
        raise Problem(f"{factor.key}: unit: expected none, as the numbers are relative, got {given!r}")
    scale, offset = factor_and_offset(given, unit, f"{factor.key}: unit")
    numbers: dict[str, Any] = {}
    for key, value in factor.numbers.items():
        shift = 0.0 if key == "sd" else offset
        each = isinstance(value, tuple)
        numbers[key] = tuple(scale * v + shift for v in value) if each else scale * value + shift
    return replace(factor, numbers=numbers, unit=unit)


def _output(systems: Sequence[System], output: Output) -> Output:
    units = set()
    name = output.signal
    for system in systems:
        try:
            port = signal(system, name)
        except Problem as problem:
            raise Problem(f"{output.key}: signal: {problem}") from None
        of = system.outputs[name].unit if name in system.outputs else system.variable(port).unit
        units.add(of.name if of else "")
    common = units.pop() if len(units) == 1 else ""
    integral = f"{common}.s" if common not in ("", "1") else "s"
    unit = {"time_of_maximum": "s", "integral": integral}.get(output.measure, common)
    return replace(output, unit=unit, signal_unit=common)


# ---- checks


def _check_not_driven(study: Study, options: Options, job: Job) -> None:
    """Refuse a fixed value or factor of an input that the scenario drives: it would have no effect."""
    driven = job.scenario.columns if job.scenario else {}
    for name in (*study.fixed, *(f.name for f in study.factors)):
        if any(port in driven for port in ports(job.system, name)):
            where = f"{', '.join(options)}: the scenario drives {name}"
            raise Problem(f"choices: {where}, so this input cannot be fixed or a factor")


def _check_set_once(study: Study, system: System) -> None:
    """Refuse a variable that is set twice; only a relative factor may refer to a fixed value."""
    absolute = {port for f in study.factors if not f.relative for port in ports(system, f.name)}
    seen: dict[Port, str] = {}
    for name in (f.name for f in study.factors):
        for port in ports(system, name):
            if port in seen:
                raise Problem(f"factors: expected one that sets {port}, got {seen[port]} and {name}")
            seen[port] = name
    for name in study.fixed:
        for port in ports(system, name):
            if port in absolute:
                same = "" if seen[port] == name else f", which sets {port} as factors.{seen[port]} does"
                raise Problem(f"fixed: {name}: expected another variable than the factors{same}")


def _check_limits(study: Study, system: System) -> None:
    """Refuse factors outside the minimum and maximum that the FMU declares for a variable.

    For a normal or lognormal factor only the mean is checked, as it has no end points.
    """
    scales = nominals(study, system)
    for factor in (f for f in study.factors if f.name in scales):
        scale = scales[factor.name]
        for key, number in _checked_numbers(factor):
            remark = f" ({number:g} times {scale:g})" if factor.relative else ""
            _check_inside(system, factor.name, f"{factor.key}: {key}", number * scale, remark)


def doubts(study: Study, jobs: Iterable[Job]) -> tuple[str, ...]:
    """Doubtful fixed values, factors and scenarios of a study in the units of its FMUs, each once."""
    told: list[str] = []
    for system in (job.system for job in jobs):
        told += system.warnings
        for factor in (f for f in study.factors if system.has(f.name)):
            scale = nominals(study, system)[factor.name]
            for port, linear in system.targets(factor.name):
                values = [linear(number * scale) for _, number in _checked_numbers(factor)]
                told.append(doubtful(system, port, values, f"{factor.key}: {port}"))
    return tuple(dict.fromkeys(filter(None, told)))


def _checked_numbers(factor: Factor) -> Iterator[tuple[str, float]]:
    """Name and value of the numbers to check; a mode is always between minimum and maximum."""
    for key in ("minimum", "maximum", "mean", "values"):
        value = factor.numbers.get(key, ())
        yield from ((key, number) for number in (value if isinstance(value, tuple) else (value,)))


def _check_inside(system: System, name: str, where: str, value: float, remark: str = "") -> None:
    for port, conversion in system.targets(name):
        check_bounds(where, system.variable(port), conversion(value), remark)


def _check_windows(study: Study, times: Sequence[Grid]) -> None:
    """Refuse a window that starts after the last run has ended, or that ends outside all runs."""
    begin, end = min(t.start for t in times), max(t.stop for t in times)
    margin = max(float(rounding(t.stop, t.step)) for t in times)
    # A run ends at the communication point next to its stop time.
    last = max(end + margin, study.stop or end)
    for output in study.outputs:
        where = output.key
        if output.start is not None and output.start > end + margin:
            raise Problem(f"{where}: start: expected at most {end:g} s, got {output.start:g} s")
        if output.stop is not None and output.stop < begin - margin:
            raise Problem(f"{where}: stop: expected at least {begin:g} s, got {output.stop:g} s")
        if output.stop is not None and output.stop > last:
            expected = f"at most {last:g} s, where the runs end"
            raise Problem(f"{where}: stop: expected {expected}, got {output.stop:g} s")
