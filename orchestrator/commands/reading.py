"""How the texts of options are read as numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import typer

T = TypeVar("T")


def seconds(text: str) -> float:
    """A time [s] from the text of an option."""
    return _read(text, float, "a number of seconds")


def number(text: str) -> float:
    """A number from the text of an option."""
    return _read(text, float, "a number")


def whole(text: str) -> int:
    """A whole number from the text of an option."""
    return _read(text, int, "a whole number")


def positive(text: str) -> int:
    """A whole number above zero from the text of an option."""
    found = _read(text, int, "a whole number above 0")
    if found < 1:
        raise typer.BadParameter(f"expected a whole number above 0, got {text!r}")
    return found


def _read(text: str, kind: Callable[[str], T], expected: str) -> T:
    try:
        return kind(text)
    except ValueError:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None
