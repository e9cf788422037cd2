"""Factors from their tables: which numbers a distribution needs, what they have to be, in which unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from orchestrator.errors import Problem
from orchestrator.sweep.fields import Table
from orchestrator.sweep.study import Factor
from orchestrator.symbols import linear

NUMBERS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("minimum", "maximum"),
    "normal": ("mean", "sd"),
    "lognormal": ("mean", "sd"),
    "triangular": ("minimum", "mode", "maximum"),
    "values": ("values",),
}
SPREADS = ("sd",)  # differences: an offset between units does not count

Rule = tuple[Callable[[Mapping[str, Any]], bool], str, str]
RULES: Mapping[str, tuple[Rule, ...]] = {
    "uniform": ((lambda n: n["minimum"] < n["maximum"], "maximum", "more than the minimum {minimum:g}"),),
    "normal": ((lambda n: n["sd"] > 0, "sd", "a positive number"),),
    "lognormal": (
        (lambda n: n["mean"] > 0, "mean", "a positive number"),
        (lambda n: n["sd"] > 0, "sd", "a positive number"),
    ),
    "triangular": (
        (lambda n: n["minimum"] < n["maximum"], "maximum", "more than the minimum {minimum:g}"),
        (
            lambda n: n["minimum"] <= n["mode"] <= n["maximum"],
            "mode",
            "a number from {minimum:g} to {maximum:g}",
        ),
    ),
    "values": ((lambda n: len(set(n["values"])) == len(n["values"]), "values", "different numbers"),),
}


def factor(name: str, table: Table, unit: str, method: str) -> Factor:
    """A factor; unit: the one of the FMU, to which numbers in the unit of the table are converted."""
    kind = table.one_of("distribution", NUMBERS)
    table.only(("distribution", "relative", "unit", *NUMBERS[kind]))
    if method == "grid" and kind != "values":
        raise table.wrong("distribution", "values, as the method is grid")
    relative, given = table.truth("relative"), table.text("unit")
    if relative and given:
        raise Problem(f"{table.where}: unit: expected none, as the numbers are shares, got {given!r}")
    numbers = {key: _number(table, key) for key in NUMBERS[kind]}
    for holds, key, expected in RULES[kind]:
        if not holds(numbers):
            raise table.wrong(key, expected.format(**numbers))
    if given:
        factor, offset = linear(given, unit, f"{table.where}: unit")
        numbers = {k: _converted(v, factor, 0.0 if k in SPREADS else offset) for k, v in numbers.items()}
    return Factor(name, kind, numbers, relative, unit)


def _number(table: Table, key: str) -> Any:
    if key == "values":
        return table.numbers(key)
    table.need(key, "a number")
    return table.number(key)


def _converted(value: Any, factor: float, offset: float) -> Any:
    if isinstance(value, tuple):
        return tuple(factor * v + offset for v in value)
    return factor * value + offset
