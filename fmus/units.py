"""SI unit strings such as "N.m.s/rad": their base units, display units and time derivatives.

Grammar: factors joined by ".", then "/" and one divisor, or several as "/(a.b)" or "/a/b";
a factor is a symbol with an optional integer power, "m3" or "s-1". "1" has no dimension.
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
    """A unit in base units: value_SI = factor * value, with one exponent for each of `BASE`."""

    exponents: tuple[int, ...]
    factor: float = 1.0

    def times(self, other: Unit, power: int) -> Unit:
        """This unit times the other one to an integer power."""
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(exponents, self.factor * other.factor**power)

    def base(self) -> Mapping[str, int]:
        """The exponents that are not zero, by base unit."""
        return {name: n for name, n in zip(BASE, self.exponents, strict=True) if n}


ONE = Unit((0,) * len(BASE))


def _unit(factor: float = 1.0, **exponents: int) -> Unit:
    return Unit(tuple(exponents.get(name, 0) for name in BASE), factor)


_SYMBOLS: Mapping[str, Unit] = MappingProxyType(
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
    }
)
_PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?")
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
    numerator, *divisors = text.split("/")
    result = _product(text, numerator, 1, ONE)
    for divisor in divisors:
        grouped = divisor.startswith("(") and divisor.endswith(")")
        if "." in divisor and not grouped:
            raise ModelError(f'unit "{text}": "/{divisor}" is ambiguous, expected "/({divisor})"')
        result = _product(text, divisor[1:-1] if grouped else divisor, -1, result)
    return result


def _product(text: str, factors: str, sign: int, start: Unit) -> Unit:
    """`start` times each factor of "a.b2" to the power `sign`."""
    for factor in factors.split("."):
        match = _FACTOR.fullmatch(factor)
        if not match:
            raise ModelError(f'unit "{text}": "{factor}" is not a symbol with an integer power')
        start = start.times(_symbol(text, match[1]), sign * int(match[2] or 1))
    return start


def _symbol(text: str, symbol: str) -> Unit:
    if symbol in _SYMBOLS:
        return _SYMBOLS[symbol]
    if symbol[0] in _PREFIXES and symbol[1:] in _SYMBOLS:
        return ONE.times(_SYMBOLS[symbol[1:]], 1).times(Unit(ONE.exponents, _PREFIXES[symbol[0]]), 1)
    raise ModelError(f'unit "{text}": symbol "{symbol}" is unknown, expected one of {", ".join(_SYMBOLS)}')


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
