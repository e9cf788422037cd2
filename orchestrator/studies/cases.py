"""What is run with the samples: one system for each combination of the options of a study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace, read
from orchestrator.engine.scenario import drive
from orchestrator.fmi.description import Value
from orchestrator.ssp.load import load
from orchestrator.ssp.parameters import with_sets
from orchestrator.ssp.system import Port, System
from orchestrator.studies.study import Study

SCENARIO, PARAMETERS = "scenario", "parameters"  # what a choice is of, if not of a component

Options = tuple[str, ...]  # one of each choice, in their order


@dataclass(frozen=True)
class Case:
    """A system with all that does not differ between its samples, and the inputs that it gets over time."""

    system: System
    scenario: Trace | None


def cases(study: Study) -> dict[Options, Case]:
    """Every combination of options; a name that none of them has is a Problem."""
    whole = opened(study)
    found = {o: _case(study, whole, o) for o in product(*(c.options for c in study.choices))}
    systems = {o: case.system for o, case in found.items()}
    for name in (*study.fixed, *(f.name for f in study.factors)):
        known(systems.values(), name)
    return {o: replace(case, system=fixed(study, case.system)) for o, case in found.items()}


def opened(study: Study) -> System:
    """The system of a study, coupled as it says."""
    system = load(Path(study.folder) / study.system)
    if study.master is None:
        return system
    return system.coupled(Coupling(study.master))


def known(systems: Iterable[System], name: str) -> list[System]:
    """The systems that have something of this name to set; Problem where none of them has."""
    every = list(systems)
    found = [system for system in every if system.has(name)]
    for system in found or every[:1]:
        system.targets(name)  # raises where there is none, or where it stands for different units
    return found


def unfed(system: System, name: str) -> None:
    """Problem where a wire feeds what a name sets; it tells what to do in a study, which cuts no wires."""
    wires = {c.target: c for c in system.connections}
    for port, _ in system.targets(name):
        if port in wires:
            fed = f"{name} cannot be set: it is fed by {wires[port]}"
            instead = f"vary what {wires[port].source.component} is set by"
            raise Problem(f"{fed}; {instead}, or drive {port} by a scenario under choices")


def signal(system: System, name: str) -> Port:
    """The variable that a signal is: an output of the system, or component.variable."""
    port = system.outputs[name].source if name in system.outputs else system.port(name)
    variable = system.variable(port)
    if variable.kind == "String" or variable.causality not in ("output", "input", "local"):
        raise Problem(f"{name}: expected a signal, got a {variable.kind} {variable.causality}")
    return port


def values(system: System, name: str) -> dict[Port, Value]:
    """What the variables behind a name are at the start, if nothing else is set, in the units of the FMU."""
    return {port: system.components[port.component].value(port.variable) for port, _ in system.targets(name)}


def driven(case: Case, names: Iterable[str]) -> list[str]:
    """Those of the names whose variables a scenario drives, so that their start value has no effect."""
    if case.scenario is None:
        return []
    columns = drive(case.system, case.scenario).columns
    there = (name for name in names if case.system.has(name))
    return [n for n in there if any(port in columns for port, _ in case.system.targets(n))]


def typed(system: System, name: str, value: float) -> Value:
    """A number as the variables behind a name take it: whole where they are no Real ones."""
    return value if is_real(system, name) else int(value)


def is_real(system: System, name: str) -> bool:
    """Are all variables behind a name Real?"""
    return all(system.variable(port).is_real for port, _ in system.targets(name))


def path(study: Study, option: str) -> Path:
    """A file that a study names."""
    return Path(study.folder) / option


def is_file(what: str, option: str) -> bool:
    """Is this option a file rather than a name in the system?"""
    return what == SCENARIO or option.lower().endswith((".ssv", ".fmu"))


def fixed(study: Study, system: System) -> System:
    """A system with the start values of all runs."""
    given: Mapping[str, Value] = {n: typed(system, n, v) for n, v in study.fixed.items() if system.has(n)}
    return system.with_start(given)


def _case(study: Study, whole: System, options: Options) -> Case:
    chosen = {
        c.what: path(study, o) if is_file(c.what, o) else o
        for c, o in zip(study.choices, options, strict=True)
    }
    scenario = chosen.pop(SCENARIO, None)
    sets = [chosen.pop(PARAMETERS)] if PARAMETERS in chosen else []
    system = with_sets(whole.swapped(chosen), sets)
    trace = None if scenario is None else read(scenario)
    if trace is not None:
        drive(system, trace, str(scenario))
    return Case(system, trace)
