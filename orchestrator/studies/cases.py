"""What a study means for its systems: one system per combination of options, units, and what is impossible.

The systems are opened before anything runs, so that every mistake is reported at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Problem
from orchestrator.base.toml import quote_key
from orchestrator.base.units import factor_and_offset
from orchestrator.data.trace import Trace, read
from orchestrator.engine.scenario import drive
from orchestrator.engine.time_grid import Grid, free_grid, grid
from orchestrator.fmi.description import Value
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import Port, System
from orchestrator.studies.study import Factor, Output, Study, measure_unit

SCENARIO, PARAMETERS = "scenario", "parameters"  # what a choice is of, if not of a component
NEAR = 1e-9  # of a time: rounding of the sum of steps
ROUNDING = 1e-12  # of a bound: what the conversion of a unit may cost

Options = tuple[str, ...]  # one of each choice, in their order


@dataclass(frozen=True)
class StudyCase:
    """A system with all that does not differ between its samples, and the inputs that it gets over time."""

    system: System
    scenario: Trace | None


def resolve(study: Study) -> tuple[Study, dict[Options, StudyCase]]:
    """The study with all numbers in the units of the FMUs, and a case for each combination of options.

    Raises a Problem where no run could do what the study asks for.
    """
    with study.located():
        study.check()
        cases = opened(study)
        systems = [case.system for case in cases.values()]
        study = replace(
            study,
            fixed={name: _fixed(systems, name, value) for name, value in study.fixed.items()},
            factors=tuple(_factor(systems, factor) for factor in study.factors),
            outputs=tuple(_output(systems, output) for output in study.outputs),
        )
        for options, case in cases.items():
            _check_driven(study, options, case)
            _check_set_once(study, case)
        cases = {o: replace(case, system=_with_fixed(study, case.system)) for o, case in cases.items()}
        for case in cases.values():
            _check_limits(study, case.system)
        _check_windows(study, [_times(study, case) for case in cases.values()])
    return study, cases


def opened(study: Study) -> dict[Options, StudyCase]:
    """Every combination of options, coupled as the study says; start values of all runs are not set yet."""
    system = load(Path(study.folder) / study.system)
    whole = system if study.master is None else system.coupled(Coupling(study.master))
    return {o: _case(study, whole, o) for o in product(*(c.options for c in study.choices))}


def _case(study: Study, whole: System, options: Options) -> StudyCase:
    chosen: dict[str, Any] = {
        c.what: Path(study.folder) / option
        if c.what == SCENARIO or option.lower().endswith((".ssv", ".fmu"))
        else option
        for c, option in zip(study.choices, options, strict=True)
    }
    scenario = chosen.pop(SCENARIO, None)
    sets = [chosen.pop(PARAMETERS)] if PARAMETERS in chosen else []
    system = with_sets(with_swaps(whole, chosen), sets)
    trace = None if scenario is None else read(scenario)
    if trace is not None:
        drive(system, trace, str(scenario))
    return StudyCase(system, trace)


# ---- what names stand for


def signal(system: System, name: str) -> Port:
    """The variable that a signal is: an output of the system, or component.variable."""
    port = system.outputs[name].source if name in system.outputs else system.port(name)
    variable = system.variable(port)
    if variable.kind == "String" or variable.causality not in ("output", "input", "local"):
        raise Problem(f"{name}: expected a signal, got a {variable.kind} {variable.causality}")
    return port


def is_real(system: System, name: str) -> bool:
    """Are all variables behind a name Real?"""
    return all(system.variable(port).is_real for port, _ in system.targets(name))


def nominals(study: Study, system: System) -> dict[str, float]:
    """Factor that the system has -> what its numbers are shares of; 1 where they are values themselves."""
    return {f.name: _nominal(f, system) if f.relative else 1.0 for f in study.factors if system.has(f.name)}


def _nominal(factor: Factor, system: System) -> float:
    """The value that a relative factor is a share of, in the unit in which it is given."""
    values = {}
    for port, unit in system.targets(factor.name):
        own: Any = system.components[port.component].value(port.variable)
        values[port] = (float(own) - unit.offset) / unit.factor
    if len(set(values.values())) > 1:
        each = ", ".join(f"{port} {value:g}" for port, value in values.items())
        raise Problem(f"factors.{factor.name}: a share needs one value, got {each}")
    value = next(iter(values.values()))
    if not isfinite(value) or value == 0.0:
        raise Problem(f"factors.{factor.name}: expected a value to be a share of, got {value:g}")
    return value


def _with_fixed(study: Study, system: System) -> System:
    given: dict[str, Value] = {
        name: value if is_real(system, name) else int(value)
        for name, value in study.fixed.items()
        if system.has(name)
    }
    return system.with_start(given)


# ---- units


def _settable(systems: Sequence[System], name: str, where: str) -> tuple[str, bool]:
    """Unit in which a name is set and whether it is Real; a Problem if no system can set it."""
    try:
        system = next((s for s in systems if s.has(name)), systems[0])
        targets = system.targets(name)
        wires = {c.target: c for c in system.connections}
        for port, _ in targets:
            if port in wires:
                raise Problem(
                    f"{name} cannot be set: it is fed by {wires[port]};"
                    f" vary what {wires[port].source.component} is set by,"
                    f" or drive {port} by a scenario under choices"
                )
        real = is_real(system, name)
        system.with_start({name: 0.0 if real else 0})
        for other in systems:
            if other.has(name):
                other.targets(name)  # raises where it stands for different units
    except Problem as problem:
        raise Problem(f"{where}: {problem}") from None
    unit = system.inputs[name].unit if name in system.inputs else system.unit(targets[0][0])
    return unit.name if unit else "", real


def _fixed(systems: Sequence[System], name: str, value: float | tuple[float, str]) -> float:
    where = f"fixed.{name}"
    own, real = _settable(systems, name, where)
    number, given = value if isinstance(value, tuple) else (value, own)
    if not (real or float(number).is_integer()):
        raise Problem(f"fixed: {name}: expected a whole number, as it is no Real variable, got {number:g}")
    scale, offset = factor_and_offset(given, own, f"{where}: unit")
    return scale * number + offset


def _factor(systems: Sequence[System], factor: Factor) -> Factor:
    own, real = _settable(systems, factor.name, factor.key)
    if not real:
        if factor.distribution != "values" or factor.relative:
            expected = "values that are no shares"
            raise Problem(f"{factor.key}: expected {expected}, as {factor.name} is no Real variable")
        if not all(v.is_integer() for v in factor.numbers["values"]):
            raise factor.wrong("values", f"whole numbers, as {factor.name} is no Real variable")
    given = factor.unit or own
    if factor.relative and given != own:
        raise Problem(f"{factor.key}: unit: expected none, as the numbers are shares, got {given!r}")
    scale, offset = factor_and_offset(given, own, f"{factor.key}: unit")
    numbers = {
        key: tuple(scale * v + offset for v in value)
        if isinstance(value, tuple)
        else scale * value + (0.0 if key == "sd" else offset)
        for key, value in factor.numbers.items()
    }
    return replace(factor, numbers=numbers, unit=own)


def _output(systems: Sequence[System], output: Output) -> Output:
    units = set()
    for system in systems:
        try:
            port = signal(system, output.signal)
        except Problem as problem:
            raise Problem(f"outputs.{quote_key(output.name)}: signal: {problem}") from None
        name = output.signal
        unit = system.outputs[name].unit if name in system.outputs else system.variable(port).unit
        units.add(unit.name if unit else "")
    own = units.pop() if len(units) == 1 else ""
    return replace(output, unit=measure_unit(output.measure, own), signal_unit=own)


# ---- what is impossible


def _check_driven(study: Study, options: Options, case: StudyCase) -> None:
    """Nothing that a scenario drives is set: the start value would have no effect."""
    if case.scenario is None:
        return
    driven = drive(case.system, case.scenario).columns
    for name in (*study.fixed, *(f.name for f in study.factors)):
        if case.system.has(name) and any(port in driven for port, _ in case.system.targets(name)):
            where = f"{', '.join(options)}: the scenario drives {name}"
            raise Problem(f"choices: {where}, expected none that is fixed or a factor")


def _check_set_once(study: Study, case: StudyCase) -> None:
    """No variable is set twice, as one of the two would have no effect; a share may be of what is fixed."""
    factors = [f for f in study.factors if case.system.has(f.name)]
    absolute = {port for f in factors if not f.relative for port, _ in case.system.targets(f.name)}
    seen: dict[Port, str] = {}
    for name in (f.name for f in factors):
        for port, _ in case.system.targets(name):
            if port in seen:
                raise Problem(f"factors: expected one that sets {port}, got {seen[port]} and {name}")
            seen[port] = name
    for name in study.fixed:
        for port, _ in case.system.targets(name) if case.system.has(name) else ():
            if port in absolute:
                same = "" if seen[port] == name else f", which sets {port} as factors.{seen[port]} does"
                raise Problem(f"fixed: expected no factor, got {name}{same}")


def _check_limits(study: Study, system: System) -> None:
    """Numbers lie between the minimum and the maximum that the FMU declares of their variables.

    Of a normal and a lognormal factor only the mean is checked, as they have no ends.
    """
    shares = nominals(study, system)
    for factor in (f for f in study.factors if f.name in shares):
        share = shares[factor.name]
        for key, number in _ends(factor):
            remark = f" ({number:g} of {share:g})" if factor.relative else ""
            _check_inside(system, factor.name, f"{factor.key}: {key}", number * share, remark)
    for name, value in study.fixed.items():
        if system.has(name):
            _check_inside(system, name, f"fixed: {name}", value)


def _ends(factor: Factor) -> Iterator[tuple[str, float]]:
    """Key and number of the ends of a distribution; a mode lies between them."""
    for key in ("minimum", "maximum", "mean", "values"):
        value = factor.numbers.get(key, ())
        yield from ((key, number) for number in (value if isinstance(value, tuple) else (value,)))


def _check_inside(system: System, name: str, where: str, value: float, remark: str = "") -> None:
    for port, conversion in system.targets(name):
        variable, own = system.variable(port), conversion(value)
        unit = f" {variable.unit.name}" if variable.unit else ""
        for word, bound, sign in (("least", variable.minimum, 1.0), ("most", variable.maximum, -1.0)):
            if bound is not None and sign * (own - bound) < -ROUNDING * abs(bound):
                raise Problem(f"{where}: expected at {word} {bound:g}{unit}, got {own:g}{unit}{remark}")


def _times(study: Study, case: StudyCase) -> Grid:
    """The communication points of the runs of a case, as `run` takes them."""
    coupling = case.system.coupling or Coupling()
    coupling.check(case.system.components)
    given = case.system, case.scenario, study.step, None, study.stop, study.record_step
    return grid(*given) if coupling.adaptive is None else free_grid(*given, ())


def _check_windows(study: Study, times: Sequence[Grid]) -> None:
    """Each output has a window that some run reaches, and that ends before all runs have ended."""
    begin, end = min(t.start for t in times), max(t.stop for t in times)
    last = max(end + NEAR * abs(end), study.stop or end)  # a run ends at the whole step next to its stop
    for output in study.outputs:
        where = f"outputs.{quote_key(output.name)}"
        if output.start is not None and output.start > end:
            raise Problem(f"{where}: start: expected at most {end:g} s, got {output.start:g} s")
        if output.stop is not None and output.stop < begin:
            raise Problem(f"{where}: stop: expected at least {begin:g} s, got {output.stop:g} s")
        if output.stop is not None and output.stop > last:
            expected = f"at most {last:g} s, where the runs end"
            raise Problem(f"{where}: stop: expected {expected}, got {output.stop:g} s")
