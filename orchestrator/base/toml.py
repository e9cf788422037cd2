"""A TOML file as tables whose keys are known, with messages that name file, key, expected and found."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.base.errors import Problem, suggest

Word = TypeVar("Word", bound=str)


@dataclass(frozen=True)
class Table:
    """A table of a file; each method gives the value of a key, None where it is optional and missing."""

    where: str
    data: Mapping[str, Any]

    def only(self, keys: Collection[str]) -> Table:
        """This table, if it has no other keys."""
        for key in self.data:
            if key not in keys:
                near = suggest(key, keys) or f"; there are {', '.join(keys)}"
                raise Problem(f"{self.where}: unknown key {key!r}{near}")
        return self

    def need(self, key: str, expected: str) -> Any:
        """The value of a key that has to be there."""
        if key not in self.data:
            raise Problem(f"{self.where}: {key}: expected {expected}, got nothing")
        return self.data[key]

    def wrong(self, key: str, expected: str) -> Problem:
        """What to raise for a value that does not do."""
        return Problem(f"{self.where}: {key}: expected {expected}, got {_shown(self.data.get(key))}")

    def text(self, key: str) -> str | None:
        """A text that is not empty."""
        value = self.data.get(key)
        if value is not None and not (isinstance(value, str) and value):
            raise self.wrong(key, "a text")
        return value

    def one_of(self, key: str, known: Iterable[Word]) -> Word:
        """One of some words."""
        names = list(known)
        expected = f"one of {', '.join(names)}"
        value = self.need(key, expected)
        if value not in names:
            near = suggest(value, names) if isinstance(value, str) else ""
            raise Problem(f"{self.wrong(key, expected)}{near}")
        return names[names.index(value)]

    def number(self, key: str, positive: bool = False) -> float | None:
        """A finite number."""
        value = self.data.get(key)
        if value is None:
            return None
        expected = "a positive number" if positive else "a number"
        if not is_number(value) or (positive and not value > 0):
            raise self.wrong(key, expected)
        return float(value)

    def whole(self, key: str, least: int) -> int | None:
        """A whole number of at least `least`."""
        value = self.data.get(key)
        if value is None:
            return None
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise self.wrong(key, f"a whole number of at least {least}")
        return value

    def truth(self, key: str) -> bool:
        """True or false; false if it is missing."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A text, or a list of different ones."""
        value = self.data[key]
        found = [value] if isinstance(value, str) else value
        if not isinstance(found, list) or not found or not all(isinstance(v, str) and v for v in found):
            raise self.wrong(key, "a text or a list of texts")
        if len(set(found)) < len(found):
            raise self.wrong(key, "different texts")
        return tuple(found)

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers."""
        value = self.need(key, "a list of numbers")
        if not isinstance(value, list) or not value or not all(is_number(v) for v in value):
            raise self.wrong(key, "a list of numbers")
        return tuple(float(v) for v in value)

    def tables(self, key: str) -> dict[str, Table]:
        """The tables inside a table."""
        inner = self.inside(key)
        for name, value in inner.data.items():
            if not isinstance(value, dict):
                raise inner.wrong(name, "a table")
        return {name: Table(f"{inner.where}.{quoted(name)}", value) for name, value in inner.data.items()}

    def inside(self, key: str) -> Table:
        """The table of a key; an empty one if it is missing."""
        value = self.data.get(key, {})
        if not isinstance(value, dict):
            raise self.wrong(key, "a table")
        return Table(f"{self.where}: {key}", value)


def read(file: Path, data: bytes) -> Table:
    """The tables of a TOML file with these bytes."""
    try:
        return Table(str(file), tomllib.loads(data.decode("utf-8-sig")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{file}: expected TOML, got {error}") from None


def is_number(value: Any) -> bool:
    """A finite number, and not true or false."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)


def quoted(name: str) -> str:
    """A key as TOML writes it."""
    return f'"{name}"' if "." in name else name


def _shown(value: Any) -> str:
    return "nothing" if value is None else repr(value)
