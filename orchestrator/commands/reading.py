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


def _read(text: str, kind: Callable[[str], T], expected: str) -> T:
    try:
        return kind(text)
    except ValueError:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None
