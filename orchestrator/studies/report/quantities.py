"""Numbers with their unit as a reader wants them: bar, L/min, degrees, powers of ten raised."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from orchestrator.base.units import linear, shown
from orchestrator.results.summary import finer

SMALL = 0.1  # [m, m/s] below which all numbers of an output are shown in mm or mm/s
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Seen:
    """A unit, and the one in which a reader sees all numbers of one output or factor."""

    unit: str
    shown: str


Unit = str | Seen  # a plain one is seen in its usual unit, whatever the size


def seen(unit: str, largest: float) -> Seen:
    """How numbers of this size, with this unit, are seen: bar for Pa, mm for small m."""
    return Seen(unit, finer(unit) if abs(largest) < SMALL else shown(unit))


def number(value: float, digits: int = 3) -> str:
    """A few significant digits; very large and small ones as 9.4·10⁻¹³."""
    if not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text and 1e-4 <= abs(value) < 1e6:
        text = f"{value:.0f}"
    mantissa, _, power = text.partition("e")
    if power:
        text = f"{mantissa}·10{str(int(power)).translate(_RAISED)}"
    return text.replace("-", "\N{MINUS SIGN}") if text.startswith("-") else text


def pretty(unit: str) -> str:
    """A unit as print has it: m³/(s·Pa), N·m; nothing for pure numbers."""
    if unit in ("", "1", "-"):
        return ""
    powers = re.sub(r"(?<=[A-Za-z])\^?(-?\d)", lambda m: m[1].translate(_RAISED), unit)
    return powers.replace(".", "·")


def display(unit: Unit) -> str:
    """The unit in which values of `unit` are shown, as print has it."""
    return pretty(_seen(unit).shown)


def factor(unit: Unit) -> float:
    """Value in the display unit = factor * value; offsets do not occur among the units of FMUs here."""
    own = _seen(unit)
    return linear(own.unit, own.shown, "display")[0] if own.shown != own.unit else 1.0


def told(value: float, unit: Unit, named: bool = True) -> str:
    """A value with its display unit, such as `173 bar`."""
    text = number(value * factor(unit))
    return f"{text} {display(unit)}".rstrip() if named else text


def _seen(unit: Unit) -> Seen:
    return unit if isinstance(unit, Seen) else Seen(unit, shown(unit))
