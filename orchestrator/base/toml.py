"""Reads and checks TOML files with known keys; messages name file, key, expected and actual value.

`read_dataclass` converts a table to a dataclass: its fields are the keys, its type hints are the rules.
`Table` reads single keys, for files whose rules depend on more than their content.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import date
from functools import cache
from math import isfinite
from pathlib import Path
from reprlib import Repr
from sys import float_info
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location

MAX_BYTES = 4 << 20  # a list of 100 000 numbers has 2 MB; tomllib reads 4 MB in some seconds
# a key a.b.c of 32 or more parts: the effort of tomllib grows with the square of their number
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){31}""")
Dataclass = TypeVar("Dataclass")


@dataclass(frozen=True)
class Rule:
    """A condition on a value besides its type: `Annotated[float, Rule("0 or more", lambda v: v >= 0)]`."""

    expected: str
    holds: Callable[[Any], bool]


POSITIVE = Rule("a number above 0", lambda value: value > 0)
NOT_NEGATIVE = Rule("0 or more", lambda value: value >= 0)


@dataclass(frozen=True)
class Table:
    """A table of a TOML file.

    where   file and name of the table, for messages
    data    the content
    """

    where: str
    data: Mapping[str, Any]

    def allow_only(self, keys: Collection[str]) -> Table:
        """This table, which must not have other keys than these."""
        for key in self.data:
            if key not in keys:
                hint = suggest(key, keys) or f"; there are {', '.join(keys)}"
                raise Problem(f"{self.where}: unknown key {key!r}{hint}")
        return self

    def require(self, key: str, expected: str) -> Any:
        """The value of a required key."""
        if key not in self.data:
            raise Problem(f"{self.where}: {key}: expected {expected}, got nothing")
        return self.data[key]

    def problem(self, key: str, expected: str, hint: str = "") -> Problem:
        """The Problem for a wrong value; hint: similar names."""
        return Problem(f"{self.where}: {key}: expected {expected}, got {_repr(self.data.get(key))}{hint}")

    def table(self, key: str) -> Table:
        """The table `key`; an empty one if it is missing."""
        value = self.data.get(key, {})
        if not isinstance(value, dict):
            raise self.problem(key, "a table")
        return Table(f"{self.where}: {key}", value)


def read_file(path: Path, missing: str = "no such file") -> Table:
    """A TOML file as a table; missing: the message for a file that does not exist."""
    if not path.exists():
        raise Problem(f"{path}: {missing}")
    return read(path, Location(path).read(MAX_BYTES))


def read(file: Path | Location, data: bytes) -> Table:
    """The content `data` of a TOML file as a table."""
    if len(data) > MAX_BYTES:
        raise Problem(f"{file}: expected at most {MAX_BYTES >> 20} MiB of TOML, got more")
    text = ""
    try:
        text = data.decode("utf-8-sig")
        if _LONG_KEY.search(text):
            raise RecursionError
        return Table(str(file), tomllib.loads(text))
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        got = "a binary file" if b"\0" in data else f"line {line} that is not UTF-8: save it as UTF-8"
        got = "an archive" if data[:4] == b"PK\3\4" else got
        raise Problem(f"{file}: expected a text (TOML), got {got}") from None
    except ValueError as error:  # also of a whole number with thousands of digits
        raise Problem(f"{file}: expected TOML, got {error}{_key(text, str(error))}") from None
    except RecursionError:
        raise Problem(f"{file}: expected TOML, got lists or tables that are nested too deeply") from None


def _key(text: str, error: str) -> str:
    """The key of a value that is there twice, of which tomllib tells the line."""
    twice = re.search(r"^Cannot (?:overwrite|mutate) .*\(at (?:line (\d+)|end)", error)
    lines = text.splitlines()[: int(twice[1]) if twice[1] else None] if twice else []
    keys = (re.match(r"""[ \t]*((?:[\w.-]|"[^"]*"|'[^']*')+)[ \t]*=""", line) for line in reversed(lines))
    return next((f": key {key[1]}" for key in keys if key), "")


def read_dataclass(target: type[Dataclass], table: Table) -> Dataclass:
    """Convert a table to a dataclass: keys are its fields, a field without default is a required key.

    A field is a str, float, int, bool, date, Literal, tuple of floats, tuple[..., ...] (a list), another
    dataclass (a table), a Mapping from names to one of these, or a union of them; Annotated adds a `Rule`.
    """
    hints = _hints(target)  # type: ignore[arg-type]
    table.allow_only(hints)
    for field in fields(target):  # type: ignore[arg-type]
        if field.default is MISSING and field.default_factory is MISSING:
            table.require(field.name, _expected(hints[field.name]))
    return target(**{key: _value(hints[key], table, key, f"{table.where}: {key}") for key in table.data})


@cache
def _hints(target: type[Any]) -> dict[str, Any]:
    return get_type_hints(target, include_extras=True)


def _value(hint: Any, table: Table, key: str, where: str, expected: str = "") -> Any:
    """The value of a key, converted to a type hint.

    where      its name in messages if it is a table
    expected   in messages, in place of the description of the type
    """
    value, hint_arguments = table.data[key], get_args(hint)
    if get_origin(hint) is Annotated:
        plain_hint, rule = hint_arguments
        text = rule.expected if len(_choices(plain_hint)) > 1 else ""  # the rule names all types of a union
        converted = _value(plain_hint, table, key, where, text)
        if not rule.holds(converted):
            raise table.problem(key, rule.expected)
        return converted
    choices = _choices(hint)
    if choices != (hint,) and len(choices) == 1:
        return _value(choices[0], table, key, where, expected)
    for choice in choices:
        if isinstance(value, dict) and is_dataclass(choice):
            return read_dataclass(choice, Table(where, value))  # type: ignore[arg-type]
        if isinstance(value, dict) and get_origin(choice) is Mapping:
            inner = Table(where, value)
            return {
                name: _value(get_args(choice)[1], inner, name, f"{where}.{quote_key(name)}") for name in value
            }
        if isinstance(value, list) and get_origin(choice) is tuple and get_args(choice)[-1] is Ellipsis:
            inner = Table(where, {str(number): entry for number, entry in enumerate(value, 1)})
            return tuple(_value(get_args(choice)[0], inner, n, f"{where} {n}") for n in inner.data)
        if _fits(choice, value):
            return float(value) if choice is float else tuple(value) if isinstance(value, list) else value
    similar = suggest(value, get_args(hint)) if get_origin(hint) is Literal and isinstance(value, str) else ""
    raise table.problem(key, expected or _expected(hint), similar)


def _choices(hint: Any) -> tuple[Any, ...]:
    """The types of a union, except None, which does not exist in TOML."""
    choices = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return tuple(choice for choice in choices if choice is not NoneType)


def _fits(hint: Any, value: Any) -> bool:
    """True if a value other than a table has a type."""
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if get_origin(hint) is tuple:
        size = len(get_args(hint))
        return isinstance(value, list) and len(value) == size and all(map(is_number, value))
    if hint is float:
        return is_number(value)
    return isinstance(hint, type) and isinstance(value, hint) and isinstance(value, bool) == (hint is bool)


def _expected(hint: Any) -> str:
    """Description of a type, for messages."""
    descriptions = {
        str: "a text",
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        date: "a date",
    }
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
    return descriptions.get(hint, "a table")


def is_number(value: Any) -> bool:
    """True for a finite number; false for true and false, which are of type int."""
    if isinstance(value, int):  # a whole number in TOML has any size
        return not isinstance(value, bool) and abs(value) <= float_info.max
    return isinstance(value, float) and isfinite(value)


def quote_key(name: str) -> str:
    """A key in TOML syntax, quoted if it contains a dot."""
    return f'"{name}"' if "." in name else name


_SHORT = Repr()  # dotted keys nest tables thousands deep, which repr refuses
_SHORT.maxlist = _SHORT.maxdict = 20
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


def _repr(value: Any) -> str:
    return "nothing" if value is None else _SHORT.repr(value)
