"""Units by their symbols: read a unit string, convert values, choose what to show.

A unit is a product of powers of kg, m, s, A, K and rad: value in SI = factor * value + offset.
The angle counts as a base unit of its own, so that Hz and rad/s are never mixed up.

Units as an FMU or an SSP file declares them, and the conversion between two of them.

A value v in a unit means `factor * v + offset` in SI base units. Two units can be converted into each other
when their base exponents agree; the radian is a base unit in FMI, but many tools leave it out. A unit that no
file defines is read by its symbol.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem

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

LONGEST = 200  # characters; longer ones are no units, and brackets inside brackets have an end
_SPELLING = str.maketrans({"²": "2", "³": "3", "·": ".", "*": ".", "µ": "u", "μ": "u"})
# a name with a power, or 1; then what joins two of them: a product, a quotient, or brackets
_TOKEN = re.compile(r"(?P<name>[A-Za-z%]+)(?:\^?(?P<power>-?\d{1,2})(?!\d))?|1(?!\d)|[./()]")

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


class _Unknown(Exception):
    """The text is no unit that is known."""


def _named(name: str, power: int) -> Unit:
    """The unit of one name, perhaps with a prefix, to a power.

    The zero of a temperature has no meaning in a power of it or in a product.
    """
    base, scale = _PLAIN.get(name) or _PREFIXED.get(name), 1.0
    if base is None and name[:1] in _PREFIX:
        base, scale = _PREFIXED.get(name[1:]), _PREFIX[name[0]]
    if base is None:
        raise _Unknown
    return base if power == 1 and scale == 1.0 else _raised(Unit(scale * base.factor, base.exponents), power)


def _raised(unit: Unit, power: int) -> Unit:
    k, m, s, a, t, r = unit.exponents
    return Unit(unit.factor**power, (k * power, m * power, s * power, a * power, t * power, r * power))


def _times(one: Unit, other: Unit, sign: int) -> Unit:
    """The product, or, with sign -1, the quotient."""
    k, m, s, a, t, r = (x + sign * y for x, y in zip(one.exponents, other.exponents, strict=True))
    return Unit(one.factor * other.factor**sign, (k, m, s, a, t, r))


class _Reader:
    """Reads products, quotients and brackets; what follows a stroke without brackets is one factor."""

    def __init__(self, text: str) -> None:
        self._tokens = list(_tokens(text))
        self._at = 0

    def whole(self) -> Unit:
        """The unit of the whole text."""
        found = self._product()
        if self._next() is not None:
            raise _Unknown
        return found

    def _next(self) -> re.Match[str] | None:
        return self._tokens[self._at] if self._at < len(self._tokens) else None

    def _taken(self, *signs: str) -> str:
        """The next token, if it is one of these; else nothing is taken."""
        token = self._next()
        if token is None or token[0] not in signs:
            return ""
        self._at += 1
        return token[0]

    def _product(self) -> Unit:
        """Factors that are joined by points and strokes; a product below a stroke has brackets."""
        found, below = self._factor(), False
        while sign := self._taken(".", "/"):
            if below and sign == ".":
                raise _Unknown  # a/b.c: nobody knows whether c is above or below
            below = sign == "/"
            found = _times(found, self._factor(), -1 if below else 1)
        return found

    def _factor(self) -> Unit:
        if self._taken("("):
            found = self._product()
            if not self._taken(")"):
                raise _Unknown
            return found
        token = self._next()
        if token is None or token[0] in "./)":
            raise _Unknown
        self._at += 1
        return _PLAIN["1"] if token[0] == "1" else _named(token["name"], int(token["power"] or 1))


def _tokens(text: str) -> Iterator[re.Match[str]]:
    at = 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            raise _Unknown
        yield token
        at = token.end()


def _plain(text: str) -> str:
    """In the characters of the grammar: a space between two factors is a product, others are none."""
    plain = text.replace("°C", "degC").replace("°F", "degF").replace("°", "deg").replace("**", "^")
    plain = re.sub(r"\s*([./()])\s*", r"\1", plain.translate(_SPELLING).strip())
    return re.sub(r"\s+", ".", plain)


def parse(text: str, where: str = "unit") -> Unit:
    """The unit written as `text`, such as `N.m.s/rad`, `m3/(s.Pa)`, `m s-1`, `kN` or `L/min`."""
    plain = _plain(text)
    if plain in _PLAIN:
        return _PLAIN[plain]
    try:
        found = _Reader(plain[: LONGEST + 1]).whole()
        if len(plain) > LONGEST or not (found.factor and isfinite(found.factor)):
            raise _Unknown
    except (_Unknown, OverflowError):  # OverflowError: a factor to a power that no number holds
        raise Problem(
            f"{where}: unit {text!r} is unknown, expected one like bar, psi, L/min, deg/s, kN or mm"
        ) from None
    return found


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


BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Linear:
    """The map value -> factor * value + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        return self.factor * value + self.offset

    def then(self, after: Linear) -> Linear:
        """This map first, `after` on its result."""
        return Linear(after.factor * self.factor, after.factor * self.offset + after.offset)


IDENTITY = Linear()


@dataclass(frozen=True)
class DeclaredUnit:
    """A named unit; `exponents` in the order of BASES, None when the file does not define them.

    fault   what is wrong with its definition; told when a value is to be converted
    """

    name: str
    exponents: tuple[int, ...] | None = None
    factor: float = 1.0
    offset: float = 0.0
    fault: str = ""

    @property
    def dimension(self) -> tuple[int, ...] | None:
        """Exponents without the radian."""
        return None if self.exponents is None else self.exponents[:-1]

    def __str__(self) -> str:
        return f"[{self.name}]"


def defined(unit: DeclaredUnit) -> DeclaredUnit:
    """The unit itself; one that no file defines by its symbol, if that is known, such as bar or L/min."""
    if unit.exponents is not None:
        return unit
    try:
        known = parse(unit.name)
    except Problem:
        return unit
    kg, m, s, ampere, kelvin, rad = known.exponents
    return DeclaredUnit(unit.name, (kg, m, s, ampere, kelvin, 0, 0, rad), known.factor, known.offset)


def conversion(
    source: DeclaredUnit | None, target: DeclaredUnit | None, where: str
) -> tuple[Linear, str | None]:
    """The map from `source` to `target`, and a note when it rests on an assumption.

    A side without unit takes the value as it is. Raises Problem, beginning with `where`, when the
    dimensions differ or a definition is wrong.
    """
    if source is None or target is None or source == target:
        return IDENTITY, None
    if source.name == target.name and None in (source.exponents, target.exponents):
        return IDENTITY, None
    for unit in (source, target):
        if wrong := _wrong(unit):
            raise Problem(f"{where}: {wrong}")
    source, target = defined(source), defined(target)
    if source.exponents is None or target.exponents is None:
        return IDENTITY, f"{where}: {source} and {target} are not both defined; the value is passed unchanged"
    if source.dimension != target.dimension:
        raise Problem(f"{where}: the units cannot be converted, {_base(source)} and {_base(target)}")
    linear = Linear(source.factor / target.factor, (source.offset - target.offset) / target.factor)
    if not (linear.factor and isfinite(linear.factor) and isfinite(linear.offset)):
        told = f"expected a finite factor other than 0, got {linear.factor:g}"
        raise Problem(f"{where}: {source} and {target} are too far apart: {told}")
    if source.exponents != target.exponents:
        return linear, f"{where}: {source} and {target} differ in the radian only; taken as equal"
    return linear, None


def _wrong(unit: DeclaredUnit) -> str:
    """Why values of a unit cannot be converted; empty if they can."""
    if unit.fault or (unit.factor and isfinite(unit.factor) and isfinite(unit.offset)):
        return unit.fault
    told = f"factor {unit.factor:g} and offset {unit.offset:g}"
    return f"{unit}: expected a finite factor other than 0 and a finite offset, got {told}"


def _base(unit: DeclaredUnit) -> str:
    """The unit and its base units, for a message: 'bar = kg.m-1.s-2'."""
    parts = [f"{b}{n if n != 1 else ''}" for b, n in zip(BASES, unit.exponents or (), strict=False) if n]
    base = ".".join(parts) or "1"
    return unit.name if unit.name == base else f"{unit.name} = {base}"
