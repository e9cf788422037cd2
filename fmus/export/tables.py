"""What the documentation of an FMU shows of its variables: rows of text, grouped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from fmus.contract import Subsystem
from fmus.export.interface import Interface, Variable
from fmus.parameters import Number, Tables, numbers
from fmus.units import display

_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@dataclass(frozen=True)
class Row:
    """One variable."""

    name: str
    direction: str  # in, out or empty
    text: str
    unit: str
    value: str  # start value, empty where the model calculates it
    display: str  # the unit that tools show it in, if another one
    shown: str  # the value in that unit
    bounds: str
    remarks: Sequence[str]
    number: Number | None  # where the value comes from


@dataclass(frozen=True)
class Group:
    """Rows under a heading."""

    title: str
    rows: Sequence[Row]
    name: str = ""  # of the terminal


def ports(sub: Subsystem, face: Interface) -> list[Group]:
    """Inputs and outputs by terminal, then the rest."""
    found = _provenance(sub)
    table = {v.name: _row(v, found) for v in face.variables if v.kind == "INPUT" or v.output}
    groups = []
    for terminal in sub.terminals:
        members = [table.pop(m.variable) for m in terminal.members if m.variable in table]
        groups.append(Group(terminal.text, members, terminal.name))
    rest = list(table.values())
    for direction, title in (("in", "Other inputs"), ("out", "Other outputs")):
        groups.append(Group(title, [row for row in rest if row.direction == direction]))
    return [group for group in groups if group.rows]


def parameters(sub: Subsystem, face: Interface) -> list[Group]:
    """The parameters under the headings of their declaration."""
    found = _provenance(sub)
    groups: dict[str, list[Row]] = {}
    for v in face.parameters:
        groups.setdefault(v.quantity.group, []).append(_row(v, found))
    return [Group(title, rows) for title, rows in groups.items()]


def start_values(sub: Subsystem, face: Interface) -> list[Group]:
    """States and inputs that start at a number with a source, or may be given one."""
    found = _provenance(sub)
    given = [v for v in (*face.states, *face.inputs) if v.start is not None]
    rows = [_row(v, found) for v in given if v.name in found or v.kind == "STATE"]
    return [Group("", rows)] if rows else []


def hidden(face: Interface) -> list[Row]:
    """States that are no outputs; of the derivatives nobody wants a table."""
    return [_row(v, {}) for v in face.states if not v.output]


def _provenance(sub: Subsystem) -> dict[str, Number]:
    if sub.numbers is None and not sub.values.is_file():
        return {}
    tables: Tables = numbers(sub)
    return {name: n for table in tables.values() for name, n in table.items()}


def _row(v: Variable, found: Mapping[str, Number]) -> Row:
    q = v.quantity
    number = found.get(v.name)
    known = number if number and number.value == v.start else None
    return Row(
        v.name,
        "in" if v.kind == "INPUT" else "out" if v.output else "",
        q.text,
        pretty(q.unit),
        _value(v, known),
        *_shown(v),
        _bounds(q.minimum, q.maximum),
        list(_remarks(v)),
        known,
    )


def _value(v: Variable, number: Number | None) -> str:
    if v.start is None:
        return "calculated" if v.kind == "CALCULATED_STATE" else ""
    return figure(v.start) + (f" ± {figure(number.sd)}" if number and number.sd else "")


def _shown(v: Variable) -> tuple[str, str]:
    """The display unit, and the start value in it."""
    other = display(v.quantity.unit)
    if other is None:
        return "", ""
    unit = pretty(other[0])
    if v.start is None:
        return unit, ""
    rounded = float(f"{v.start * other[1]:.4g}")
    return unit, f"{figure(rounded)} {unit}"


def _remarks(v: Variable) -> Iterable[str]:
    """What the words of the declaration do not say."""
    if v.kind == "TUNABLE":
        yield "tunable"
    if v.quantity.rate:
        yield f"moves with {v.quantity.rate} inside a step"
    if v.quantity.warn_above is not None:
        yield f"warning above {figure(v.quantity.warn_above)} {pretty(v.quantity.unit)}"


def _bounds(low: float | None, high: float | None) -> str:
    if low is not None and high is not None:
        return f"{figure(low)} to {figure(high)}"
    return f"≥ {figure(low)}" if low is not None else f"≤ {figure(high)}" if high is not None else ""


def figure(value: float) -> str:
    """A number as in a data sheet: 1.6e9 for 1600000000.0, with a true minus."""
    text = re.sub(r"e([+-])0*(\d+)", lambda m: f"e{m[1].strip('+')}{m[2]}", f"{value:.6g}")
    return text.replace("-", "\N{MINUS SIGN}")


def pretty(unit: str) -> str:
    """A unit as it is printed: N·m·s/rad, m³/s; nothing for 1."""
    powers = re.sub(r"(?<=[A-Za-z])-?\d+", lambda m: m[0].translate(_SUPERSCRIPTS), unit)
    return "" if unit == "1" else powers.replace(".", "·")
