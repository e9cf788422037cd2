"""Parameter and start values of a subsystem: read, check and write its `parameters.toml`.

The file contains one table for each value: `[parameters.NAME]` for every parameter, and `[start.NAME]` for
start values of inputs and states, which are zero by default.

    [parameters.bulk_modulus]
    value = 1.6e9
    unit = "Pa"
    source = "paper"          # paper | derived | literature | assumed | identified
    note = "section 3(c)"     # details of the source, plausible range
    sd = 1e8                  # optional: one standard deviation

A list stands for the parameters NAME_1, NAME_2, ... of its entries and has the name NAMEs; entries at its end
may be missing and are 0 (`Quantity.listed`):

    [parameters.valve_pa_commands]      # valve_pa_command_1, valve_pa_command_2, ...
    value = [0.6, 2.0, 10.0]            # sd, too, is a list

A parameter set for several parts, which identification writes and `harvester build --parameters` reads, has
the same format, with tables `[parameters.NAME]` only. NAME applies to every part that declares this
parameter, because for example the valves are identical; `[parameters."swing.initial_preload"]` applies to one
part.
"""

import difflib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from fmus.contract import G, Quantity, Subsystem, nested, quantities
from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, write_whole
from orchestrator.base.units import factor_and_offset

SOURCES = {
    "paper": "printed in the paper or read from its figures; the only data of the FERIC machine",
    "derived": "follows from such values by a named formula or, for start values, from the model",
    "literature": "published for a comparable machine",
    "assumed": "a free choice",
    "identified": "fitted to measurements",
}


@dataclass(frozen=True)
class _Entry:
    """A table of the file; value and sd of a list are those of one of its entries."""

    value: float
    unit: str
    source: Annotated[str, toml.Rule(f"one of {', '.join(SOURCES)}", SOURCES.__contains__)]
    note: str
    sd: Annotated[float, toml.NOT_NEGATIVE] | None = None


@dataclass(frozen=True)
class Number:
    """A value with its unit and source; `sd` is one standard deviation, if known.

    listed   name of the list in the file of which this is an entry, empty if it has a table of its own
    shipped  the value that a parameter set replaces; None without one
    file     name and SHA-256 of the file of that set
    """

    value: float
    unit: str
    source: str
    note: str
    sd: float | None = None
    listed: str = ""
    shipped: float | None = field(default=None, compare=False)
    file: tuple[str, str] = field(default=("", ""), compare=False)


Tables: TypeAlias = Mapping[str, Mapping[str, Number]]  # "parameters" and "start", each by name


@dataclass(frozen=True)
class Values:
    """Values of a subsystem by name: parameters p, start values of inputs u and of states x."""

    p: Mapping[str, float]
    u: Mapping[str, float]
    x: Mapping[str, float]

    def __repr__(self) -> str:
        return f"Values({len(self.p)} parameters, {len(self.u)} inputs, {len(self.x)} states)"


def read(path: Path, content: bytes | None = None) -> dict[str, dict[str, Number]]:
    """Tables `parameters` and `start` of a file; keys and types of each entry are checked.

    content   of the file; default: what is on disk at `path`
    """
    tables = _parsed(path, content or Location(path).read(toml.MAX_BYTES))
    return {section: dict(entries) for section, entries in tables.items()}


@cache
def _parsed(path: Path, content: bytes) -> dict[str, dict[str, Number]]:
    """The tables of a file; each variant of a part reads the same one."""
    document = toml.read(path, content).data
    unknown = set(document) - {"parameters", "start"}
    if unknown:
        raise Problem(f"{path}: unknown table [{min(unknown)}], expected [parameters.*] and [start.*]")
    for section, entries in document.items():
        if not isinstance(entries, dict):
            raise Problem(f"{path}: {section} = {entries!r}, expected tables [{section}.NAME]")
    return {
        section: {
            own: number
            for name, entry in document.get(section, {}).items()
            for own, number in _entries(path, section, name, entry)
        }
        for section in ("parameters", "start")
    }


def entry_name(listed: str, number: int) -> str:
    """Name of an entry of a list, counted from 1: point_3 of points."""
    return f"{listed[:-1]}_{number}"


def _too_long(path: Path, listed: str, declared: Collection[str]) -> Problem:
    """The problem of a list with an entry that is not declared."""
    count = sum(n.rpartition("_")[0] == listed[:-1] and n[-1].isdigit() for n in declared)
    expected = f"expected at most {count} values" if count else "no part declares such a list"
    return Problem(f"{path}: [parameters.{listed}]: {expected}")


def _entries(path: Path, section: str, name: str, entry: Any) -> Iterator[tuple[str, Number]]:
    """The parameters of a table in the file: one, or those of a list; of an empty one the first, 0."""
    where = f"{path}: [{section}.{name}]"
    if not isinstance(entry, dict) or not isinstance(entry.get("value"), list):
        yield name, _number(path, section, name, entry)
        return
    if section != "parameters" or not name.endswith("s"):
        raise Problem(f"{where} value is a list, expected a number; a list is a parameter named like points")
    values = entry["value"] or [0.0]
    deviations = entry.get("sd", [None] * len(values))
    if not isinstance(deviations, list) or len(deviations) != len(values):
        raise Problem(f"{where} sd is {deviations!r}, expected a list of {len(values)} numbers")
    for i, (value, sd) in enumerate(zip(values, deviations, strict=True), 1):
        single = {**entry, "value": value} | ({} if sd is None else {"sd": sd})
        yield entry_name(name, i), replace(_number(path, section, name, single), listed=name)


def padded(entries: Mapping[str, Number], declared: Collection[str]) -> dict[str, Number]:
    """The entries, and the declared entries of lists that are missing at the end of a list, as zeros."""
    result = dict(entries)
    for listed in dict.fromkeys(n.listed for n in entries.values() if n.listed):
        first = entries.get(entry_name(listed, 1))
        if first is None:  # a single entry of a list, or one that was renamed
            continue
        names = [n for n in declared if n.rpartition("_")[0] == listed[:-1] and n not in entries]
        result |= {n: replace(first, value=0.0, sd=None) for n in names if n.rpartition("_")[2].isdigit()}
    return result


def parameters(sub: Subsystem) -> Any:
    """The group of the parameters with their values; derived ones included."""
    return nested(sub.parameters, values(sub).p)


def group_of(path: Path, group: type[G]) -> G:
    """A group of parameters with the values of a file."""
    table = padded(read(path)["parameters"], quantities(group))
    return nested(group, {name: number.value for name, number in table.items()})


def _number(path: Path, section: str, name: str, entry: Any) -> Number:
    where = f"{path}: [{section}.{name}]"
    if not isinstance(entry, dict):
        raise Problem(f"{where} is {entry!r}, expected a table with value, unit, source, note")
    e = toml.read_dataclass(_Entry, toml.Table(where, entry))
    return Number(e.value, e.unit, e.source, e.note, e.sd)


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
    stated = _declared(sub)["parameters"]  # of additions, which the file need not have
    tables = {**tables, "parameters": {**stated, **padded(tables["parameters"], parameters)}}
    inputs_and_states = quantities(sub.inputs) | quantities(sub.states)
    missing = set(parameters) - set(tables["parameters"])
    if missing:
        raise Problem(f"{path}: parameter {min(missing)} of {sub.name} is missing")
    checked: dict[str, dict[str, Number]] = {"parameters": {}, "start": {}}
    for section, declared in (("parameters", parameters), ("start", inputs_and_states)):
        for name, number in tables[section].items():
            if name in declared:
                check(path, f"[{section}.{name}]", declared[name], number)
                listed = f"{name.rpartition('_')[0]}s" if declared[name].listed else ""
                same = number.listed == listed
                checked[section][name] = number if same else replace(number, listed=listed)
            elif name not in sub.names_of_variants and number.listed:
                raise _too_long(path, number.listed, declared)
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
    formulas = sub.derive(nested(sub.parameters, {name: number.value for name, number in table.items()}))
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
    write_whole(path, document(tables))


def document(tables: Tables) -> str:
    """Content of a file with these tables."""
    lines: list[str] = []
    for section, entries in tables.items():
        for name, group in rows(entries).items():
            n, values, deviations = group[0], [n.value for n in group], [n.sd for n in group]
            is_list = name == n.listed
            lines += [f"[{section}.{name}]", f"value = {values if is_list else n.value!r}"]
            lines += [f"unit = {json.dumps(n.unit)}", f"source = {json.dumps(n.source)}"]
            lines += [f"note = {json.dumps(n.note, ensure_ascii=False)}"]
            if n.sd is not None:
                lines.append(f"sd = {deviations if is_list else n.sd!r}")
            lines.append("")
    return "\n".join(lines)


def rows(entries: Mapping[str, Number]) -> dict[str, list[Number]]:
    """Parameters as a table shows them: one row for each, and one for all entries of a list.

    The entries of a list have rows of their own if they differ in source, note or in having a standard
    deviation.
    """
    kinds: dict[str, set[tuple[str, str, bool]]] = {}
    for number in entries.values():
        kinds.setdefault(number.listed, set()).add((number.source, number.note, number.sd is None))
    result: dict[str, list[Number]] = {}
    for name, number in entries.items():
        together = number.listed and len(kinds[number.listed]) == 1
        result.setdefault(number.listed if together else name, []).append(number)
    return result


def row_text(name: str, declared: Mapping[str, Quantity]) -> str:
    """Description of a row of `rows`."""
    return declared[name].text if name in declared else declared[entry_name(name, 1)].listed


def row_value(name: str, row: Sequence[Number], text: Callable[[Number], str]) -> str:
    """Value of a row of `rows`; of a list without the zeros at its end.

    text   the value of one number
    """
    count = len(row)
    if name == row[0].listed:
        count = max((i for i, n in enumerate(row, 1) if n.value), default=0)
    return ", ".join(map(text, row[:count])) or "none"


ParameterSet: TypeAlias = Mapping[str, Number]  # parameters by name, or by "part.name"


def read_parameter_set(path: Path, subs: Iterable[Subsystem]) -> ParameterSet:
    """Parameters of a file, each checked against the parts that declare it, at least one, and in their unit.

    Each has the name and the checksum of the file.
    """
    tables = read(path)
    origin = path.name, Location(path).sha256
    if tables["start"]:
        raise Problem(f"{path}: [start.{min(tables['start'])}]: expected tables [parameters.NAME] only")
    if not tables["parameters"]:
        raise Problem(f"{path}: no table [parameters.NAME], expected at least one")
    declared = {
        (sub.component, name): quantity
        for sub in subs
        for name, quantity in quantities(sub.parameters).items()
    }
    names = {local for _, local in declared} | {f"{part}.{local}" for part, local in declared}
    parameters = padded(tables["parameters"], names)
    for name, number in parameters.items():
        declarations = [q for (part, local), q in declared.items() if name in (local, f"{part}.{local}")]
        if not declarations and number.listed:
            raise _too_long(path, number.listed, names)
        if not declarations:
            similar = difflib.get_close_matches(name, names, 1) or ["a name in `harvester parameters`"]
            raise Problem(f"{path}: [parameters.{name}] is not declared by any part, expected {similar[0]}")
        number = _in_unit(number, declarations[0].unit, f"{path}: [parameters.{name}]")
        for quantity in declarations:
            check(path, f"[parameters.{name}]", quantity, number)
        parameters[name] = replace(number, file=origin)
    return parameters


def _in_unit(number: Number, unit: str, where: str) -> Number:
    """A number in another unit of its quantity."""
    factor, offset = factor_and_offset(number.unit, unit, where)
    sd = None if number.sd is None else factor * number.sd
    return replace(number, value=factor * number.value + offset, unit=unit, sd=sd)


def with_parameters(
    sub: Subsystem, parameters: ParameterSet, start: Mapping[str, float] | None = None
) -> Subsystem:
    """The subsystem with the values of a parameter set; parameters that it does not declare are ignored.

    start   start values by `component.variable` that follow from the parameters
    """
    tables, part = numbers(sub), sub.component
    replaced = {
        n: _replaced(old, parameters.get(f"{part}.{n}", parameters.get(n, old)))
        for n, old in tables["parameters"].items()
    }
    started = {
        n: replace(old, value=(start or {}).get(f"{part}.{n}", old.value))
        for n, old in tables["start"].items()
    }
    return replace(sub, numbers={"parameters": replaced, "start": started})


def _replaced(old: Number, new: Number) -> Number:
    """The new number, with the shipped value that it replaces."""
    return new if new is old else replace(new, shipped=old.value if old.shipped is None else old.shipped)


def not_shipped(sub: Subsystem) -> dict[str, Number]:
    """The parameters of a subsystem whose values differ from the shipped ones."""
    table = numbers(sub)["parameters"]
    return {n: number for n, number in table.items() if number.shipped not in (None, number.value)}
