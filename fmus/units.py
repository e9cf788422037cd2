"""SI unit strings such as "N.m.s/rad": their base units, display units and time derivatives.

Grammar: factors joined by ".", then "/" and one divisor, or several as "/(a.b)" or "/a/b";
a factor is a symbol with an optional integer power, "m3" or "s-1". "1" has no dimension.
Units in use beside the SI are read too, such as psi or gpm; degC and degF only by themselves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

from fmus.contract import ModelError
from fmus.symbols import BASE, IN_SI, ONE, PREFIXED, PREFIXES, SYMBOLS, WITH_ZERO, Unit

__all__ = ["BASE", "DISPLAY", "Unit", "display", "in_si", "parse", "per_second", "spelled"]

_FACTOR = re.compile(r"([A-Za-z]+|%|1)(-?\d+)?")
_SPELLING = str.maketrans({"²": "2", "³": "3", "·": ".", "*": ".", "µ": "u", "^": None, " ": None})
DISPLAY: Mapping[str, str] = MappingProxyType(
    {
        "Pa": "bar",
        "Pa/s": "bar/s",
        "Pa.s/m3": "bar.min/L",
        "Pa.s2/m6": "bar.min2/L2",
        "m3/s": "L/min",
        "m3": "L",
        "m3/rad": "cm3/rev",
        "m3/Pa": "cm3/bar",
        "m3/(s.Pa)": "L/(min.bar)",
        "m2": "mm2",
        "rad": "deg",
        "rad/s": "deg/s",
        "rad/s2": "deg/s2",
        "N": "kN",
        "N/s": "kN/s",
        "N/m": "kN/mm",
        "N.m": "kN.m",
        "N.m/s": "kN.m/s",
        "J": "kJ",
        "W": "kW",
    }
)


def parse(text: str) -> Unit:
    """The unit in base units; refuses what the grammar above does not allow."""
    if text in WITH_ZERO:
        return WITH_ZERO[text]
    result = ONE
    for symbol, power in _factors(text):
        result = result.times(_symbol(text, symbol), power)
    return result


def in_si(text: str) -> str:
    """The SI unit of the same quantity: "bar.min/L" gives "Pa.s/m3", "kN.m" gives "N.m".

    Values of it are factor * value + offset of `parse(text)`.
    """
    if text in WITH_ZERO:
        return "K"
    powers: dict[str, int] = {}
    for symbol, power in _factors(text):
        _symbol(text, symbol)
        name = symbol if symbol in SYMBOLS else symbol[1:]
        for part, n in IN_SI.get(name, {name: 1}).items():
            powers[part] = powers.get(part, 0) + n * power
    above = [_written(name, n) for name, n in powers.items() if n > 0]
    below = [_written(name, -n) for name, n in powers.items() if n < 0]
    if not below:
        return ".".join(above) or "1"
    divisor = below[0] if len(below) == 1 else f"({'.'.join(below)})"
    return f"{'.'.join(above) or '1'}/{divisor}"


def _written(name: str, power: int) -> str:
    return name if power == 1 else f"{name}{power}"


def spelled(text: str) -> str:
    """The unit as the grammar has it, from what loggers write: "°C", "m³/s", "N·m"; no unit is "1"."""
    plain = text.replace("°C", "degC").replace("°F", "degF").replace("°", "deg").translate(_SPELLING)
    return "1" if plain in ("", "-") else plain


def _factors(text: str) -> list[tuple[str, int]]:
    """Symbols and powers of "a.b2/(c.d)"."""
    numerator, *divisors = text.split("/")
    result = _product(text, numerator, 1)
    for divisor in divisors:
        grouped = divisor.startswith("(") and divisor.endswith(")")
        if "." in divisor and not grouped:
            raise ModelError(f'unit "{text}": "/{divisor}" is ambiguous, expected "/({divisor})"')
        result += _product(text, divisor[1:-1] if grouped else divisor, -1)
    return result


def _product(text: str, factors: str, sign: int) -> list[tuple[str, int]]:
    """Symbol and power of each factor of "a.b2", the powers times `sign`."""
    result = []
    for factor in factors.split("."):
        match = _FACTOR.fullmatch(factor)
        if not match:
            raise ModelError(f'unit "{text}": "{factor}" is not a symbol with an integer power')
        result.append((match[1], sign * int(match[2] or 1)))
    return result


def _symbol(text: str, symbol: str) -> Unit:
    if symbol in SYMBOLS:
        return SYMBOLS[symbol]
    if symbol[0] in PREFIXES and symbol[1:] in PREFIXED:
        return ONE.times(SYMBOLS[symbol[1:]], 1).times(Unit(ONE.exponents, PREFIXES[symbol[0]]), 1)
    known = ", ".join([*SYMBOLS, *WITH_ZERO])
    raise ModelError(f'unit "{text}": symbol "{symbol}" is unknown, expected one of {known}')


def display(unit: str) -> tuple[str, float] | None:
    """The unit to show values of `unit` in and its factor (shown = factor * value), if there is one."""
    if unit not in DISPLAY:
        return None
    return DISPLAY[unit], parse(unit).factor / parse(DISPLAY[unit]).factor


def per_second(unit: str) -> str:
    """The unit of the time derivative: "rad/s" gives "rad/s2", "Pa" gives "Pa/s"."""
    numerator, *divisors = unit.split("/")
    for i, divisor in enumerate(divisors):
        match = re.fullmatch(r"s(\d*)", divisor)
        if match:
            divisors[i] = f"s{int(match[1] or 1) + 1}"
            return "/".join([numerator, *divisors])
    return f"{unit}/s"
