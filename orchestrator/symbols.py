"""Units by their symbols: read a unit string, convert values, choose what to show.

A unit is a product of powers of kg, m, s, A, K and rad: value in SI = factor * value + offset.
The angle counts as a base unit of its own, so that Hz and rad/s are never mixed up.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem

Exponents = tuple[int, int, int, int, int, int]  # of kg, m, s, A, K, rad


@dataclass(frozen=True)
class Unit:
    """Value in SI = factor * value + offset; the exponents say of which quantity."""

    factor: float
    exponents: Exponents
    offset: float = 0.0


_NONE: Exponents = (0, 0, 0, 0, 0, 0)
_MASS: Exponents = (1, 0, 0, 0, 0, 0)
_LENGTH: Exponents = (0, 1, 0, 0, 0, 0)
_VOLUME: Exponents = (0, 3, 0, 0, 0, 0)
_TIME: Exponents = (0, 0, 1, 0, 0, 0)
_TEMPERATURE: Exponents = (0, 0, 0, 0, 1, 0)
_ANGLE: Exponents = (0, 0, 0, 0, 0, 1)
_SPIN: Exponents = (0, 0, -1, 0, 0, 1)
_FORCE: Exponents = (1, 1, -2, 0, 0, 0)
_PRESSURE: Exponents = (1, -1, -2, 0, 0, 0)
_ENERGY: Exponents = (1, 2, -2, 0, 0, 0)
_POWER: Exponents = (1, 2, -3, 0, 0, 0)
_FLOW: Exponents = (0, 3, -1, 0, 0, 0)

_POUND, _GRAVITY, _INCH, _GALLON = 0.45359237, 9.80665, 0.0254, 3.785411784e-3

# Units that take a prefix (kN, MPa, mm) ...
_PREFIXED = {
    "g": Unit(1e-3, _MASS),
    "m": Unit(1.0, _LENGTH),
    "s": Unit(1.0, _TIME),
    "A": Unit(1.0, (0, 0, 0, 1, 0, 0)),
    "N": Unit(1.0, _FORCE),
    "Pa": Unit(1.0, _PRESSURE),
    "bar": Unit(1e5, _PRESSURE),
    "J": Unit(1.0, _ENERGY),
    "W": Unit(1.0, _POWER),
    "V": Unit(1.0, (1, 2, -3, -1, 0, 0)),
    "Hz": Unit(1.0, (0, 0, -1, 0, 0, 0)),
    "rad": Unit(1.0, _ANGLE),
    "L": Unit(1e-3, _VOLUME),
    "l": Unit(1e-3, _VOLUME),
}
_PREFIX = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}

# ... and units that do not.
_PLAIN = {
    "": Unit(1.0, _NONE),
    "1": Unit(1.0, _NONE),
    "-": Unit(1.0, _NONE),
    "%": Unit(0.01, _NONE),
    "K": Unit(1.0, _TEMPERATURE),
    "degC": Unit(1.0, _TEMPERATURE, 273.15),
    "degF": Unit(5 / 9, _TEMPERATURE, 273.15 - 32 * 5 / 9),
    "min": Unit(60.0, _TIME),
    "h": Unit(3600.0, _TIME),
    "deg": Unit(pi / 180, _ANGLE),
    "rev": Unit(2 * pi, _ANGLE),
    "rpm": Unit(pi / 30, _SPIN),
    "t": Unit(1e3, _MASS),
    "lb": Unit(_POUND, _MASS),
    "lbf": Unit(_POUND * _GRAVITY, _FORCE),
    "psi": Unit(_POUND * _GRAVITY / _INCH**2, _PRESSURE),
    "in": Unit(_INCH, _LENGTH),
    "ft": Unit(12 * _INCH, _LENGTH),
    "gal": Unit(_GALLON, _VOLUME),  # US gallon
    "gpm": Unit(_GALLON / 60, _FLOW),
    "lpm": Unit(1e-3 / 60, _FLOW),
    "hp": Unit(745.6998715822702, _POWER),
}

_SPELLING = str.maketrans({"²": "2", "³": "3", "·": ".", "*": ".", "µ": "u", "^": None, " ": None, "(": None})
_ATOM = re.compile(r"([A-Za-z%]*)(-?\d+)?")

# What a reader wants to see instead of the SI unit.
_SHOWN: dict[Exponents, str] = {
    _PRESSURE: "bar",
    _FLOW: "L/min",
    _ANGLE: "deg",
    _SPIN: "deg/s",
    (0, 0, -2, 0, 0, 1): "deg/s2",
    _FORCE: "kN",
    _POWER: "kW",
}


def _atom(text: str, whole: str, where: str) -> Unit:
    """One factor of a product: a name, perhaps with a prefix, and a power."""
    match = _ATOM.fullmatch(text)
    named = match is not None and (match[1] or not match[2])
    name, power = (match[1], int(match[2] or 1)) if match and named else (text, 1)
    base, scale = _PLAIN.get(name) or _PREFIXED.get(name), 1.0
    if base is None and name[:1] in _PREFIX:
        base, scale = _PREFIXED.get(name[1:]), _PREFIX[name[0]]
    if base is None:
        raise Problem(
            f"{where}: unit {whole!r} is unknown, expected one like bar, psi, L/min, deg/s, kN or mm"
        )
    k, m, s, a, t, r = base.exponents
    exponents = (k * power, m * power, s * power, a * power, t * power, r * power)
    return Unit((scale * base.factor) ** power, exponents, base.offset)


def parse(text: str, where: str = "unit") -> Unit:
    """The unit written as `text`, such as `N.m.s/rad`, `m3/(s.Pa)`, `kN` or `L/min`."""
    plain = text.replace("°C", "degC").replace("°", "deg").translate(_SPELLING).replace(")", "")
    over, *under = plain.split("/")
    above = [_atom(part, text, where) for part in over.split(".")]
    below = [_atom(part, text, where) for segment in under for part in segment.split(".")]
    if not below and len(above) == 1:
        return above[0]
    factor, exponents = 1.0, np.zeros(6, dtype=int)
    for unit, sign in [(u, 1) for u in above] + [(u, -1) for u in below]:
        factor *= unit.factor**sign
        exponents += sign * np.array(unit.exponents)
    k, m, s, a, t, r = (int(e) for e in exponents)
    return Unit(factor, (k, m, s, a, t, r))


def linear(source: str, target: str, where: str) -> tuple[float, float]:
    """(factor, offset) so that value in `target` = factor * value in `source` + offset."""
    if source == target:
        return 1.0, 0.0
    a, b = parse(source, where), parse(target, where)
    if a.exponents != b.exponents:
        raise Problem(f"{where}: unit {source!r} cannot be converted, expected a unit like {target!r}")
    return a.factor / b.factor, (a.offset - b.offset) / b.factor


def convert(values: NDArray[np.float64], source: str, target: str, where: str) -> NDArray[np.float64]:
    """Values in unit `source`, any shape, converted to unit `target`."""
    factor, offset = linear(source, target, where)
    return factor * values + offset


def shown(unit: str) -> str:
    """The unit in which values of `unit` are shown to a reader: bar for Pa, L/min, deg, deg/s, kN, kW.

    N.m/s is no power but the rate of a torque.
    """
    try:
        exponents = parse(unit).exponents
        return unit if exponents == _POWER and unit[-1:] != "W" else _SHOWN.get(exponents, unit)
    except Problem:
        return unit
