"""Start values and ranges: numbers that can be true."""

from __future__ import annotations

import math
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, warning
from orchestrator.check.model import NATURAL, WHOLE, Variable
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject
from orchestrator.files.xml import children

RULES = Table()


def number(v: Variable, text: str | None) -> float | None:
    """An attribute of a numeric variable; None when there is none or it is no number of its type."""
    if text is None:
        return None
    try:
        if v.is_float:
            return float(text)
        return int(text) if v.type in WHOLE or v.type in NATURAL or v.type == "Enumeration" else None
    except ValueError:
        return None


def _fits(v: Variable, text: str) -> bool:
    """True when a start value is a value of the type."""
    value = number(v, text)
    if v.is_float:
        return value is not None
    if v.type in WHOLE:
        return value is not None and -(2 ** (WHOLE[v.type] - 1)) <= value < 2 ** (WHOLE[v.type] - 1)
    if v.type in NATURAL:
        return value is not None and 0 <= value < 2 ** NATURAL[v.type]
    if v.type == "Boolean":
        return text in ("true", "false", "1", "0")
    return True


@RULES.rule("value.start", "Start values are finite values of their type")
def start(subject: Subject) -> Iterator[Finding]:
    for v in subject.model.variables:
        for text in v.starts or ():
            if not _fits(v, text):
                yield error(f"{v}: start value {text!r} is no {v.type}")
            elif v.is_float and not math.isfinite(float(text)):
                yield warning(f"{v}: start value is {text}, expected a finite number")


@RULES.rule("value.range", "Start values lie within min and max, and min below max")
def range_(subject: Subject) -> Iterator[Finding]:
    for v in subject.model.variables:
        low, high = number(v, v.said.get("min")), number(v, v.said.get("max"))
        if low is not None and high is not None and low > high:
            yield error(f"{v}: min {low:g} is above max {high:g}")
            continue
        for value in (number(v, s) for s in v.starts or ()):
            if value is not None and not (low if low is not None else value) <= value <= (
                high if high is not None else value
            ):
                yield error(f"{v}: start value {value:g} lies outside of {_interval(low, high)}")


def _interval(low: float | None, high: float | None) -> str:
    return f"{'-inf' if low is None else f'{low:g}'} ... {'inf' if high is None else f'{high:g}'}"


@RULES.rule("value.nominal", "Nominal values are positive; solvers scale tolerances with them")
def nominal(subject: Subject) -> Iterator[Finding]:
    for v in subject.model.variables:
        value = number(v, v.said.get("nominal"))
        if value is not None and not (math.isfinite(value) and value > 0):
            yield warning(f"{v}: nominal {value:g}, expected a positive number")


@RULES.rule("value.enumeration", "Enumerations have distinct items, and start at one of them")
def enumeration(subject: Subject) -> Iterator[Finding]:
    model = subject.model
    for name, element in model.types.items():
        values = [i.get("value") for i in children(element, "Item")]
        if len(set(values)) < len(values):
            yield error(
                f"modelDescription.xml line {element.sourceline}: type {name} has two items with one value"
            )
    for v in model.variables:
        declared = model.types.get(v.said.get("declaredType", ""))
        if v.type != "Enumeration" or declared is None:
            continue
        items = [i.get("value") for i in children(declared, "Item")]
        wrong = [s for s in v.starts or () if s not in items]
        if wrong:
            yield error(
                f"{v}: start value {wrong[0]} is no item, expected one of {', '.join(map(str, items[:8]))}"
            )
