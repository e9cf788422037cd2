"""The symbols of units: what each is in base units, which take a prefix, what each is written as in SI.

SI unit strings such as "N.m.s/rad": their base units, display units and time derivatives.

Grammar: factors joined by ".", then "/" and one divisor, or several as "/(a.b)" or "/a/b";
a factor is a symbol with an optional integer power, "m3" or "s-1". "1" has no dimension.
Units in use beside the SI are read too, such as psi or gpm; degC and degF only by themselves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from fmus.contract import ModelError

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Unit:
    """A unit in base units: value_SI = factor * value + offset, with one exponent for each of `BASE`."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    def times(self, other: Unit, power: int) -> Unit:
        """This unit times the other one to an integer power; a product has no offset."""
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(exponents, self.factor * other.factor**power)

    def base(self) -> Mapping[str, int]:
        """The exponents that are not zero, by base unit."""
        return {name: n for name, n in zip(BASE, self.exponents, strict=True) if n}


ONE = Unit((0,) * len(BASE))


def _unit(factor: float = 1.0, **exponents: int) -> Unit:
    return Unit(tuple(exponents.get(name, 0) for name in BASE), factor)


# NIST SP 811, appendix B: pound and inch by definition, standard gravity, US gallon; hp of 550 ft.lbf/s
_POUND, _GRAVITY, _INCH, _GALLON = 0.45359237, 9.80665, 0.0254, 3.785411784e-3
SYMBOLS: Mapping[str, Unit] = MappingProxyType(
    {name: _unit(1.0, **{name: 1}) for name in BASE}
    | {
        "1": ONE,
        "Hz": _unit(s=-1),
        "N": _unit(kg=1, m=1, s=-2),
        "Pa": _unit(kg=1, m=-1, s=-2),
        "J": _unit(kg=1, m=2, s=-2),
        "W": _unit(kg=1, m=2, s=-3),
        "C": _unit(A=1, s=1),
        "V": _unit(kg=1, m=2, s=-3, A=-1),
        "Ohm": _unit(kg=1, m=2, s=-3, A=-2),
        "g": _unit(1e-3, kg=1),
        "t": _unit(1e3, kg=1),
        "L": _unit(1e-3, m=3),
        "bar": _unit(1e5, kg=1, m=-1, s=-2),
        "min": _unit(60.0, s=1),
        "h": _unit(3600.0, s=1),
        "deg": _unit(math.pi / 180, rad=1),
        "rev": _unit(2 * math.pi, rad=1),
        "rpm": _unit(2 * math.pi / 60, rad=1, s=-1),
        "%": _unit(0.01),
        "l": _unit(1e-3, m=3),
        "lpm": _unit(1e-3 / 60, m=3, s=-1),
        "gal": _unit(_GALLON, m=3),
        "gpm": _unit(_GALLON / 60, m=3, s=-1),
        "in": _unit(_INCH, m=1),
        "ft": _unit(12 * _INCH, m=1),
        "lb": _unit(_POUND, kg=1),
        "lbf": _unit(_POUND * _GRAVITY, kg=1, m=1, s=-2),
        "psi": _unit(_POUND * _GRAVITY / _INCH**2, kg=1, m=-1, s=-2),
        "hp": _unit(550 * 12 * _INCH * _POUND * _GRAVITY, kg=1, m=2, s=-3),
    }
)
# Temperatures with a zero of their own: only alone, a product with them has no meaning.
WITH_ZERO: Mapping[str, Unit] = MappingProxyType(
    {
        "degC": Unit(SYMBOLS["K"].exponents, 1.0, 273.15),
        "degF": Unit(SYMBOLS["K"].exponents, 5 / 9, 273.15 - 32 * 5 / 9),
    }
)
# What the symbols beside the SI are written as in SI; all others stand for themselves.
IN_SI: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        "g": {"kg": 1},
        "t": {"kg": 1},
        "lb": {"kg": 1},
        "L": {"m": 3},
        "l": {"m": 3},
        "gal": {"m": 3},
        "lpm": {"m": 3, "s": -1},
        "gpm": {"m": 3, "s": -1},
        "bar": {"Pa": 1},
        "psi": {"Pa": 1},
        "min": {"s": 1},
        "h": {"s": 1},
        "deg": {"rad": 1},
        "rev": {"rad": 1},
        "rpm": {"rad": 1, "s": -1},
        "in": {"m": 1},
        "ft": {"m": 1},
        "lbf": {"N": 1},
        "hp": {"W": 1},
        "%": {},
        "1": {},
    }
)
PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
# Prefixes go with these: "kN", not "kpsi".
PREFIXED = frozenset(
    {"g", "m", "s", "A", "N", "Pa", "bar", "J", "W", "V", "C", "Hz", "rad", "L", "l", "Ohm", "mol"}
)

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
