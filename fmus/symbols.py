"""The symbols of units: what each is in base units, which take a prefix, what each is written as in SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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
