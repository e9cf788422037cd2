"""Numbers of a subsystem: read, check and write its `parameters.toml`.

The file holds one table per scalar, under `[parameters.NAME]` for every parameter and
`[start.NAME]` for start values of inputs and states (zero where the file is silent):

    [parameters.bulk_modulus]
    value = 1.6e9
    unit = "Pa"
    source = "paper"          # paper | derived | literature | assumed | identified
    note = "section 3(c)"     # where the number comes from, plausible range
    sd = 1e8                  # optional: one standard deviation

A set of numbers for several parts, which identification writes and `harvester build --parameters` reads, has
the same format, with tables `[parameters.NAME]` only. A NAME holds for every part that declares it, as the
valves are identical; `[parameters."swing.initial_preload"]` for that part alone.
"""

from __future__ import annotations

import difflib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

from fmus.contract import Quantity, Subsystem, quantities
from orchestrator.base.errors import Problem

SOURCES = {
    "paper": "printed in the paper or read from it, as the note says: the only FERIC data",
    "derived": "follows by a named formula from such numbers or, for start values, from the model",
    "literature": "published for a comparable machine",
    "assumed": "a free choice",
    "identified": "fitted to measurements",
}
KEYS = {"value": (int, float), "unit": str, "source": str, "note": str, "sd": (int, float)}


@dataclass(frozen=True)
class Number:
    """One value with its unit and provenance; `sd` is one standard deviation, if known."""

    value: float
    unit: str
    source: str
    note: str
    sd: float | None = None


Tables: TypeAlias = Mapping[str, Mapping[str, Number]]  # "parameters" and "start", each by name


@dataclass(frozen=True)
class Values:
    """Numbers of a subsystem by name: parameters p, start values of inputs u and of states x."""

    p: Mapping[str, float]
    u: Mapping[str, float]
    x: Mapping[str, float]


def read(path: Path) -> dict[str, dict[str, Number]]:
    """The tables `parameters` and `start` of a file, each entry checked for its keys and types."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise Problem(f"{path}: expected a TOML file, found {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Problem(f"{path}: cannot be read as TOML: {error}") from None
    unknown = set(document) - {"parameters", "start"}
    if unknown:
        raise Problem(f"{path}: unknown table [{min(unknown)}], expected [parameters.*] and [start.*]")
    for section, entries in document.items():
        if not isinstance(entries, dict):
            raise Problem(f"{path}: {section} is {entries!r}, expected tables [{section}.NAME]")
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
    if not math.isfinite(entry["value"]):
        raise Problem(f"{where} value is {entry['value']}, expected a finite number")
    if not 0 <= entry.get("sd", 0) < math.inf:
        raise Problem(f"{where} sd is {entry['sd']}, expected 0 or more")
    return Number(float(entry["value"]), entry["unit"], entry["source"], entry["note"], entry.get("sd"))


def numbers(sub: Subsystem, path: Path | None = None) -> Tables:
    """The numbers of a subsystem, checked against its declaration: no name, unit or bound may differ.

    Its file may hold numbers of other variants of the same part.
    """
    given: Tables | None = sub.numbers if path is None else None
    path = path or sub.values
    if path is None:
        path, given = Path(sub.name), given or _declared(sub)
    found = read(path) if given is None else given
    parameters = quantities(sub.parameters)
    startable = quantities(sub.inputs) | quantities(sub.states)
    missing = set(parameters) - set(found["parameters"])
    if missing:
        raise Problem(f"{path}: parameter {min(missing)} of {sub.name} is missing")
    own: dict[str, dict[str, Number]] = {}
    for section, declared in (("parameters", parameters), ("start", startable)):
        own[section] = {}
        for name, number in found[section].items():
            if name in declared:
                check(path, f"[{section}.{name}]", declared[name], number)
                own[section][name] = number
            elif name not in sub.names_of_variants:
                raise Problem(f"{path}: [{section}.{name}] is not declared by {sub.name}")
    return own


def _declared(sub: Subsystem) -> Tables:
    """The numbers that stand in the declaration."""

    def stated(*groups: type[Any]) -> dict[str, Number]:
        return {
            name: Number(q.value, q.unit, "assumed", "stated in the code")
            for group in groups
            for name, q in quantities(group).items()
            if q.value is not None
        }

    return {"parameters": stated(sub.parameters), "start": stated(sub.inputs, sub.states)}


def check(path: Path, where: str, quantity: Quantity, number: Number) -> None:
    """Refuse another unit than the declared one, and a value out of bounds."""
    if number.unit != quantity.unit:
        raise Problem(f"{path}: {where} is in {number.unit}, declared {quantity.unit}")
    low, high = quantity.minimum, quantity.maximum
    if (low is not None and number.value < low) or (high is not None and number.value > high):
        raise Problem(f"{path}: {where} is {number.value:g} {number.unit}, expected {low} to {high}")


def derived(sub: Subsystem, path: Path | None = None) -> dict[str, Number]:
    """The parameters that follow from others because their number is 0, with their values."""
    given = numbers(sub, path)["parameters"]
    formulas = sub.derive(SimpleNamespace(**{name: number.value for name, number in given.items()}))
    return {n: replace(given[n], value=float(v)) for n, v in formulas.items() if given[n].value == 0}


def complete(sub: Subsystem) -> Tables:
    """The numbers of a subsystem, with the values of derived parameters."""
    found = numbers(sub)
    return {**found, "parameters": {**found["parameters"], **derived(sub)}}


def values(sub: Subsystem, path: Path | None = None, derive: bool = True) -> Values:
    """Plain numbers for a subsystem; start values not in the file are zero.

    derive   with the values of derived parameters in the place of 0
    """
    found = numbers(sub, path)
    start = found["start"]
    parameters = {**found["parameters"], **(derived(sub, path) if derive else {})}
    return Values(
        p={name: parameters[name].value for name in quantities(sub.parameters)},
        u={name: start[name].value if name in start else 0.0 for name in quantities(sub.inputs)},
        x={name: start[name].value if name in start else 0.0 for name in quantities(sub.states)},
    )


def write(path: Path, found: Tables) -> None:
    """Write tables `parameters` and `start` so that `read` returns the same numbers."""
    path.write_text(document(found), encoding="utf-8")


def document(found: Tables) -> str:
    """The text of a file with these tables."""
    lines: list[str] = []
    for section, entries in found.items():
        for name, n in entries.items():
            lines += [f"[{section}.{name}]", f"value = {n.value!r}", f"unit = {json.dumps(n.unit)}"]
            lines += [f"source = {json.dumps(n.source)}", f"note = {json.dumps(n.note, ensure_ascii=False)}"]
            lines += [f"sd = {n.sd!r}"] if n.sd is not None else []
            lines.append("")
    return "\n".join(lines)


Set: TypeAlias = Mapping[str, Number]


def read_set(path: Path, subs: Iterable[Subsystem]) -> Set:
    """The numbers of a file, each checked against the parts that declare it; there must be one."""
    found = read(path)
    if found["start"]:
        raise Problem(f"{path}: [start.{min(found['start'])}] is no parameter, expected [parameters.*] only")
    if not found["parameters"]:
        raise Problem(f"{path}: no table [parameters.NAME], expected at least one")
    declared = {
        (sub.component, name): quantity
        for sub in subs
        for name, quantity in quantities(sub.parameters).items()
    }
    for name, number in found["parameters"].items():
        meant = [q for (part, own), q in declared.items() if name in (own, f"{part}.{own}")]
        if not meant:
            known = {own for _, own in declared} | {f"{part}.{own}" for part, own in declared}
            near = difflib.get_close_matches(name, known, 1) or ["a name that `harvester parameters` shows"]
            raise Problem(f"{path}: [parameters.{name}] is declared by no part, expected {near[0]}")
        for quantity in meant:
            check(path, f"[parameters.{name}]", quantity, number)
    return found["parameters"]


def with_numbers(sub: Subsystem, given: Set, start: Mapping[str, float] | None = None) -> Subsystem:
    """The subsystem with the numbers of a set in place of its own; what it does not declare is left out.

    start   start values by `component.variable` that follow from them
    """
    tables, part = numbers(sub), sub.component
    own = {n: given.get(f"{part}.{n}", given.get(n, old)) for n, old in tables["parameters"].items()}
    followed = {
        n: replace(old, value=(start or {}).get(f"{part}.{n}", old.value))
        for n, old in tables["start"].items()
    }
    return replace(sub, numbers={"parameters": own, "start": followed})
