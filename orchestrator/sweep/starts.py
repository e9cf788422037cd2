"""The full set of start values and parameters of each run, as it used them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from orchestrator.sweep.cases import Case, Options
from orchestrator.sweep.running import Sample
from orchestrator.sweep.study import START, Study
from orchestrator.system.system import Port, System, coerce
from orchestrator.units import Linear

TYPES = {"Real": pa.float64(), "Integer": pa.int64(), "Enumeration": pa.int64(), "Boolean": pa.bool_()}


def starts(study: Study, cases: Mapping[Options, Case], samples: Sequence[Sample]) -> pa.Table:
    """One row per sample; a column `start:component.variable` of each variable that can be set in some case.

    Left out are inputs that a connection or a scenario feeds; null is what a variant does not have.
    """
    places: dict[Options, list[int]] = {options: [] for options in cases}
    for i, sample in enumerate(samples):
        places[sample.options].append(i)
    kinds: dict[Port, pa.DataType] = {}
    columns: dict[Port, list[Any]] = {}
    for options, case in cases.items():
        varied = _varied(study, case.system)
        for port in settable(case):
            variable = case.system.variable(port)
            kinds[port] = TYPES.get(variable.kind, pa.string())
            column = columns.setdefault(port, [None] * len(samples))
            if port in varied:
                name, linear = varied[port]
                for i in places[options]:
                    column[i] = coerce(str(port), variable, samples[i].factors[name], linear)
            else:
                constant = _plain(case.system.components[port.component].value(port.variable))
                for i in places[options]:
                    column[i] = constant
    return pa.table({f"{START}{port}": pa.array(columns[port], kinds[port]) for port in columns})


def settable(case: Case) -> list[Port]:
    """The variables of a case that have a start value of their own."""
    system = case.system
    names = () if case.scenario is None else case.scenario.signals
    fed = {c.target for c in system.connections}
    fed |= {port for name in names if system.has(name) for port, _ in system.targets(name)}
    return [
        Port(c.name, v.name)
        for c in system.components.values()
        for v in c.interface.variables.values()
        if v.settable and Port(c.name, v.name) not in fed
    ]


def units(cases: Mapping[Options, Case]) -> dict[str, str]:
    """Column -> unit, of the FMU."""
    found: dict[str, str] = {}
    for case in cases.values():
        for port in settable(case):
            unit = case.system.variable(port).unit
            found |= {f"{START}{port}": unit.name} if unit else {}
    return found


def _varied(study: Study, system: System) -> dict[Port, tuple[str, Linear]]:
    """Variable -> the factor that sets it, the last that names it, and from its unit to that of the FMU."""
    there = [f.name for f in study.factors if system.has(f.name)]
    return {port: (name, linear) for name in there for port, linear in system.targets(name)}


def _plain(value: Any) -> Any:
    """NaN of an unknown number is no value."""
    return None if isinstance(value, float) and np.isnan(value) else value
