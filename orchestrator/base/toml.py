"""TOML files with known keys: messages name the file, the key, what was expected and what was got.

`fill` makes a dataclass of a table: its fields are the keys, its types and rules say what they may be.
A `Table` reads one key at a time, where what is right depends on more than the file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import date
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from orchestrator.base.errors import Problem, suggest

Word = TypeVar("Word", bound=str)
Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Table:
    """A table of a file; each method gives the value of a key, None where it is optional and missing."""

    where: str
    data: Mapping[str, Any]

    def allow_only(self, keys: Collection[str]) -> Table:
        """This table, if it has no other keys."""
        for key in self.data:
            if key not in keys:
                near = suggest(key, keys) or f"; there are {', '.join(keys)}"
                raise Problem(f"{self.where}: unknown key {key!r}{near}")
        return self

    def require(self, key: str, expected: str) -> Any:
        """The value of a key that has to be there."""
        if key not in self.data:
            raise Problem(f"{self.where}: {key}: expected {expected}, got nothing")
        return self.data[key]

    def problem(self, key: str, expected: str) -> Problem:
        """What to raise for a value that does not do."""
        return Problem(f"{self.where}: {key}: expected {expected}, got {_repr(self.data.get(key))}")

    def text(self, key: str) -> str | None:
        """A text that is not empty."""
        value = self.data.get(key)
        if value is not None and not (isinstance(value, str) and value):
            raise self.problem(key, "a text")
        return value

    def one_of(self, key: str, known: Iterable[Word]) -> Word:
        """One of some words."""
        names = list(known)
        expected = f"one of {', '.join(names)}"
        value = self.require(key, expected)
        if value not in names:
            near = suggest(value, names) if isinstance(value, str) else ""
            raise Problem(f"{self.problem(key, expected)}{near}")
        return names[names.index(value)]

    def number(self, key: str, positive: bool = False) -> float | None:
        """A finite number."""
        value = self.data.get(key)
        if value is None:
            return None
        expected = "a positive number" if positive else "a number"
        if not is_number(value) or (positive and not value > 0):
            raise self.problem(key, expected)
        return float(value)

    def integer(self, key: str, least: int) -> int | None:
        """A whole number of at least `least`."""
        value = self.data.get(key)
        if value is None:
            return None
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise self.problem(key, f"a whole number of at least {least}")
        return value

    def boolean(self, key: str) -> bool:
        """True or false; false if it is missing."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self.problem(key, "true or false")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A text, or a list of different ones."""
        value = self.data[key]
        found = [value] if isinstance(value, str) else value
        if not isinstance(found, list) or not found or not all(isinstance(v, str) and v for v in found):
            raise self.problem(key, "a text or a list of texts")
        if len(set(found)) < len(found):
            raise self.problem(key, "different texts")
        return tuple(found)

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers."""
        value = self.require(key, "a list of numbers")
        if not isinstance(value, list) or not value or not all(is_number(v) for v in value):
            raise self.problem(key, "a list of numbers")
        return tuple(float(v) for v in value)

    def tables(self, key: str) -> dict[str, Table]:
        """The tables inside a table."""
        inner = self.table(key)
        for name, value in inner.data.items():
            if not isinstance(value, dict):
                raise inner.problem(name, "a table")
        return {name: Table(f"{inner.where}.{quote_key(name)}", value) for name, value in inner.data.items()}

    def table(self, key: str) -> Table:
        """The table of a key; an empty one if it is missing."""
        value = self.data.get(key, {})
        if not isinstance(value, dict):
            raise self.problem(key, "a table")
        return Table(f"{self.where}: {key}", value)


def read(file: Path, data: bytes) -> Table:
    """The tables of a TOML file with these bytes."""
    try:
        return Table(str(file), tomllib.loads(data.decode("utf-8-sig")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{file}: expected TOML, got {error}") from None


@dataclass(frozen=True)
class Rule:
    """What a value has to meet beyond its type: `Annotated[float, Rule("0 or more", lambda v: v >= 0)]`."""

    expected: str
    holds: Callable[[Any], bool]


POSITIVE = Rule("a number above 0", lambda value: value > 0)
NOT_NEGATIVE = Rule("0 or more", lambda value: value >= 0)


def read_dataclass(kind: type[Kind], table: Table) -> Kind:
    """A dataclass from a table with its fields as keys; a field without default is a required key.

    A field is a str, float, int, bool, date, Literal, tuple of floats, tuple[..., ...] (a list), another
    dataclass (a table), a Mapping from names to one of these, or a union of them; Annotated adds a `Rule`.
    """
    hints = get_type_hints(kind, include_extras=True)
    table.allow_only(hints)
    for field in fields(kind):  # type: ignore[arg-type]
        if field.default is MISSING and field.default_factory is MISSING:
            table.require(field.name, _expected(hints[field.name]))
    return kind(**{key: _value(hints[key], table, key, f"{table.where}: {key}") for key in table.data})


def _value(hint: Any, table: Table, key: str, where: str) -> Any:
    """The value of a key as its type hint wants it; `where` names it, should it be a table."""
    value, kinds = table.data[key], get_args(hint)
    if get_origin(hint) is Annotated:
        found = _value(kinds[0], table, key, where)
        if not kinds[1].holds(found):
            raise table.problem(key, kinds[1].expected)
        return found
    choices = _choices(hint)
    if choices != (hint,) and len(choices) == 1:
        return _value(choices[0], table, key, where)
    for choice in choices:
        if isinstance(value, dict) and is_dataclass(choice):
            return read_dataclass(choice, Table(where, value))  # type: ignore[arg-type]
        if isinstance(value, dict) and get_origin(choice) is Mapping:
            inner = Table(where, value)
            return {
                name: _value(get_args(choice)[1], inner, name, f"{where}.{quote_key(name)}") for name in value
            }
        if isinstance(value, list) and get_origin(choice) is tuple and get_args(choice)[-1] is Ellipsis:
            inner = Table(where, {str(place): entry for place, entry in enumerate(value, 1)})
            return tuple(_value(get_args(choice)[0], inner, n, f"{where} {n}") for n in inner.data)
        if _fits(choice, value):
            return float(value) if choice is float else tuple(value) if isinstance(value, list) else value
    raise table.problem(key, _expected(hint))


def _choices(hint: Any) -> tuple[Any, ...]:
    """The types of a union but None, which TOML does not have."""
    choices = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return tuple(choice for choice in choices if choice is not NoneType)


def _fits(hint: Any, value: Any) -> bool:
    """Whether a value that is no table is of a type."""
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if get_origin(hint) is tuple:
        size = len(get_args(hint))
        return isinstance(value, list) and len(value) == size and all(map(is_number, value))
    if hint is float:
        return is_number(value)
    return isinstance(hint, type) and isinstance(value, hint) and isinstance(value, bool) == (hint is bool)


def _expected(hint: Any) -> str:
    """What a type wants, in words."""
    words = {str: "a text", float: "a number", int: "a whole number", bool: "true or false", date: "a date"}
    if get_origin(hint) is Annotated:
        return str(get_args(hint)[1].expected)
    if get_origin(hint) is Literal:
        names = get_args(hint)
        return f"one of {', '.join(names)}" if len(names) > 1 else repr(names[0])
    if is_dataclass(hint):
        return f"a table of {', '.join(f.name for f in fields(hint))}"
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(_expected(choice) for choice in _choices(hint))
    if get_origin(hint) is tuple:
        return "a list" if get_args(hint)[-1] is Ellipsis else f"{len(get_args(hint))} numbers"
    return words.get(hint, "a table")


def is_number(value: Any) -> bool:
    """A finite number, and not true or false."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)


def quote_key(name: str) -> str:
    """A key as TOML writes it."""
    return f'"{name}"' if "." in name else name


def _repr(value: Any) -> str:
    return "nothing" if value is None else repr(value)
