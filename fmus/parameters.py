"""Parameter and start values of a subsystem: read, check and write its `parameters.toml`.

The file contains one table for each value: `[parameters.NAME]` for every parameter, and `[start.NAME]` for
start values of inputs and states, which are zero by default.

    [parameters.bulk_modulus]
    value = 1.6e9
    unit = "Pa"
    source = "paper"          # paper | derived | literature | assumed | identified
    note = "section 3(c)"     # details of the source, plausible range
    sd = 1e8                  # optional: one standard deviation

A parameter set for several parts, which identification writes and `harvester build --parameters` reads, has
the same format, with tables `[parameters.NAME]` only. NAME applies to every part that declares this
parameter, because for example the valves are identical; `[parameters."swing.initial_preload"]` applies to one
part.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

from fmus.contract import Quantity, Subsystem, quantities
from orchestrator.base import toml
from orchestrator.base.errors import Problem

SOURCES = {
    "paper": "printed in the paper or read from its figures; the only data of the FERIC machine",
    "derived": "follows from such values by a named formula or, for start values, from the model",
    "literature": "published for a comparable machine",
    "assumed": "a free choice",
    "identified": "fitted to measurements",
}
KEYS = {"value": (int, float), "unit": str, "source": str, "note": str, "sd": (int, float)}


@dataclass(frozen=True)
class Number:
    """A value with its unit and source; `sd` is one standard deviation, if known."""

    value: float
    unit: str
    source: str
    note: str
    sd: float | None = None


Tables: TypeAlias = Mapping[str, Mapping[str, Number]]  # "parameters" and "start", each by name


@dataclass(frozen=True)
class Values:
    """Values of a subsystem by name: parameters p, start values of inputs u and of states x."""

    p: Mapping[str, float]
    u: Mapping[str, float]
    x: Mapping[str, float]


def read(path: Path) -> dict[str, dict[str, Number]]:
    """Tables `parameters` and `start` of a file; keys and types of each entry are checked."""
    try:
        document = toml.read(path, path.read_bytes()).data
    except OSError as error:
        raise Problem(f"{path}: expected a TOML file, got {error.strerror}") from None
    unknown = set(document) - {"parameters", "start"}
    if unknown:
        raise Problem(f"{path}: unknown table [{min(unknown)}], expected [parameters.*] and [start.*]")
    for section, entries in document.items():
        if not isinstance(entries, dict):
            raise Problem(f"{path}: {section} = {entries!r}, expected tables [{section}.NAME]")
    return {
        section: {
            name: _number(path, section, name, entry) for name, entry in document.get(section, {}).items()
        }
        for section in ("parameters", "start")
    }


def _number(path: Path, section: str, name: str, entry: Any) -> Number:
    where = f"{path}: [{section}.{name}]"
    if not isinstance(entry, dict):
        raise Problem(f"{where} is {entry!r}, expected a table with value, unit, source, note")
    for key, value in entry.items():
        if key not in KEYS:
            raise Problem(f"{where} has unknown key {key!r}, expected {', '.join(KEYS)}")
        if not isinstance(value, KEYS[key]) or isinstance(value, bool):  # type: ignore[arg-type]
            raise Problem(
                f"{where} {key} is {value!r}, expected {'a number' if key in ('value', 'sd') else 'text'}"
            )
    missing = [key for key in ("value", "unit", "source", "note") if key not in entry]
    if missing:
        raise Problem(f"{where} lacks {', '.join(missing)}")
    if entry["source"] not in SOURCES:
        raise Problem(f"{where} source is {entry['source']!r}, expected one of {', '.join(SOURCES)}")
    if not toml.is_number(entry["value"]):
        raise Problem(f"{where} value is {entry['value']}, expected a finite number")
    if not 0 <= entry.get("sd", 0) < math.inf:
        raise Problem(f"{where} sd is {entry['sd']}, expected 0 or more")
    return Number(float(entry["value"]), entry["unit"], entry["source"], entry["note"], entry.get("sd"))


def numbers(sub: Subsystem, path: Path | None = None) -> Tables:
    """Tables of a subsystem; names, units and bounds are checked against its declaration.

    Its file may also contain parameters of other variants of the same part.
    """
    tables: Tables | None = sub.numbers if path is None else None
    path = path or sub.values
    if path is None:
        path, tables = Path(sub.name), tables or _declared(sub)
    tables = read(path) if tables is None else tables
    parameters = quantities(sub.parameters)
    inputs_and_states = quantities(sub.inputs) | quantities(sub.states)
    missing = set(parameters) - set(tables["parameters"])
    if missing:
        raise Problem(f"{path}: parameter {min(missing)} of {sub.name} is missing")
    checked: dict[str, dict[str, Number]] = {"parameters": {}, "start": {}}
    for section, declared in (("parameters", parameters), ("start", inputs_and_states)):
        for name, number in tables[section].items():
            if name in declared:
                check(path, f"[{section}.{name}]", declared[name], number)
                checked[section][name] = number
            elif name not in sub.names_of_variants:
                raise Problem(f"{path}: [{section}.{name}] is not declared by {sub.name}")
    return checked


def _declared(sub: Subsystem) -> Tables:
    """Tables of the values in the declaration."""

    def entries(*groups: type[Any]) -> dict[str, Number]:
        return {
            name: Number(q.value, q.unit, "assumed", "stated in the code")
            for group in groups
            for name, q in quantities(group).items()
            if q.value is not None
        }

    return {"parameters": entries(sub.parameters), "start": entries(sub.inputs, sub.states)}


def check(path: Path, where: str, quantity: Quantity, number: Number) -> None:
    """Raise Problem if the unit is not the declared one or the value is out of bounds."""
    if number.unit != quantity.unit:
        raise Problem(f"{path}: {where} is in {number.unit}, declared {quantity.unit}")
    low, high = quantity.minimum, quantity.maximum
    if (low is not None and number.value < low) or (high is not None and number.value > high):
        raise Problem(f"{path}: {where} is {number.value:g} {number.unit}, expected {low} to {high}")


def derived(sub: Subsystem, path: Path | None = None) -> dict[str, Number]:
    """Derived parameters: those that are 0 in the file and follow from others, with their values."""
    table = numbers(sub, path)["parameters"]
    formulas = sub.derive(SimpleNamespace(**{name: number.value for name, number in table.items()}))
    return {n: replace(table[n], value=float(v)) for n, v in formulas.items() if table[n].value == 0}


def complete(sub: Subsystem) -> Tables:
    """Tables of a subsystem, with the values of derived parameters."""
    tables = numbers(sub)
    return {**tables, "parameters": {**tables["parameters"], **derived(sub)}}


def values(sub: Subsystem, path: Path | None = None, derive: bool = True) -> Values:
    """Parameter and start values of a subsystem; start values that are not in the file are zero.

    derive   whether derived parameters have their value; otherwise 0
    """
    tables = numbers(sub, path)
    start = tables["start"]
    parameters = {**tables["parameters"], **(derived(sub, path) if derive else {})}
    return Values(
        p={name: parameters[name].value for name in quantities(sub.parameters)},
        u={name: start[name].value if name in start else 0.0 for name in quantities(sub.inputs)},
        x={name: start[name].value if name in start else 0.0 for name in quantities(sub.states)},
    )


def write(path: Path, tables: Tables) -> None:
    """Write tables `parameters` and `start`; `read` returns the same values."""
    path.write_text(document(tables), encoding="utf-8")


def document(tables: Tables) -> str:
    """Content of a file with these tables."""
    lines: list[str] = []
    for section, entries in tables.items():
        for name, n in entries.items():
            lines += [f"[{section}.{name}]", f"value = {n.value!r}", f"unit = {json.dumps(n.unit)}"]
            lines += [f"source = {json.dumps(n.source)}", f"note = {json.dumps(n.note, ensure_ascii=False)}"]
            lines += [f"sd = {n.sd!r}"] if n.sd is not None else []
            lines.append("")
    return "\n".join(lines)


ParameterSet: TypeAlias = Mapping[str, Number]  # parameters by name, or by "part.name"


def read_parameter_set(path: Path, subs: Iterable[Subsystem]) -> ParameterSet:
    """Parameters of a file, each checked against the parts that declare it, at least one."""
    tables = read(path)
    if tables["start"]:
        raise Problem(f"{path}: [start.{min(tables['start'])}]: expected tables [parameters.NAME] only")
    if not tables["parameters"]:
        raise Problem(f"{path}: no table [parameters.NAME], expected at least one")
    declared = {
        (sub.component, name): quantity
        for sub in subs
        for name, quantity in quantities(sub.parameters).items()
    }
    for name, number in tables["parameters"].items():
        declarations = [q for (part, local), q in declared.items() if name in (local, f"{part}.{local}")]
        if not declarations:
            names = {local for _, local in declared} | {f"{part}.{local}" for part, local in declared}
            similar = difflib.get_close_matches(name, names, 1) or ["a name in `harvester parameters`"]
            raise Problem(f"{path}: [parameters.{name}] is not declared by any part, expected {similar[0]}")
        for quantity in declarations:
            check(path, f"[parameters.{name}]", quantity, number)
    return tables["parameters"]


def with_parameters(
    sub: Subsystem, parameters: ParameterSet, start: Mapping[str, float] | None = None
) -> Subsystem:
    """The subsystem with the values of a parameter set; parameters that it does not declare are ignored.

    start   start values by `component.variable` that follow from the parameters
    """
    tables, part = numbers(sub), sub.component
    replaced = {
        n: parameters.get(f"{part}.{n}", parameters.get(n, old)) for n, old in tables["parameters"].items()
    }
    started = {
        n: replace(old, value=(start or {}).get(f"{part}.{n}", old.value))
        for n, old in tables["start"].items()
    }
    return replace(sub, numbers={"parameters": replaced, "start": started})
