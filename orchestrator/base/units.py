"""Units: read a unit string, convert values, choose the unit that a reader is shown.

    value in SI = factor * value + offset

Grammar: symbols with an integer power, joined by "." or a space; "/" and one divisor, or several in brackets
or one after the other: "N.m.s/rad", "m3/(s.Pa)", "m s-1", "L/min". "1" has no dimension. Degree signs,
superscripts and other spellings of loggers are read, too.

The radian counts as a base unit: a frequency [Hz] is no angular speed [rad/s]. FMI has the radian among its
base units, but many tools leave it out, so `conversion` passes a difference in the radian with a note.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite, pi
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
MAX_LENGTH = 200  # characters of a unit; brackets inside brackets have an end


@dataclass(frozen=True)
class Unit:
    """A unit in base units, with one exponent for each of `BASES`."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    def times(self, other: Unit, power: int = 1) -> Unit:
        """This unit times a power of the other one; the zero of a temperature has no meaning in a product."""
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(exponents, self.factor * other.factor**power)

    def base(self) -> dict[str, int]:
        """The exponents that are not zero, by base unit."""
        return {name: n for name, n in zip(BASES, self.exponents, strict=True) if n}


ONE = Unit((0,) * len(BASES))

# NIST SP 811, appendix B: pound and inch by definition, standard gravity, US gallon; hp of 550 ft.lbf/s
_POUND, _GRAVITY, _INCH, _GALLON = 0.45359237, 9.80665, 0.0254, 3.785411784e-3
# Derived units of the SI, by their definition.
_DERIVED = {
    "Hz": "1/s", "N": "kg.m/s2", "Pa": "kg/(m.s2)", "J": "kg.m2/s2", "W": "kg.m2/s3", "C": "A.s",
    "V": "kg.m2/(s3.A)", "Ohm": "kg.m2/(s3.A2)",
}  # fmt: skip
# Others: how many of which SI unit.
_OTHER: Mapping[str, tuple[float, str]] = {
    "g": (1e-3, "kg"), "t": (1e3, "kg"), "lb": (_POUND, "kg"),
    "L": (1e-3, "m3"), "l": (1e-3, "m3"), "gal": (_GALLON, "m3"),
    "lpm": (1e-3 / 60, "m3/s"), "gpm": (_GALLON / 60, "m3/s"),
    "bar": (1e5, "Pa"), "psi": (_POUND * _GRAVITY / _INCH**2, "Pa"),
    "min": (60.0, "s"), "h": (3600.0, "s"),
    "deg": (pi / 180, "rad"), "rev": (2 * pi, "rad"), "rpm": (pi / 30, "rad/s"),
    "in": (_INCH, "m"), "ft": (12 * _INCH, "m"),
    "lbf": (_POUND * _GRAVITY, "N"), "hp": (550 * 12 * _INCH * _POUND * _GRAVITY, "W"),
    "%": (0.01, "1"), "1": (1.0, "1"), "-": (1.0, "1"), "": (1.0, "1"),
    "degC": (1.0, "K"), "degF": (5 / 9, "K"),
}  # fmt: skip
_OFFSETS = {"degC": 273.15, "degF": 273.15 - 32 * 5 / 9}  # K; only of a temperature by itself
PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
# Prefixes go with these: "kN", not "kpsi".
_PREFIXED = frozenset(
    ["g", "m", "s", "A", "N", "Pa", "bar", "J", "W", "V", "C", "Hz", "rad", "L", "l", "Ohm", "mol"]
)

# The unit that a reader is shown in place of one of the SI.
DISPLAY: Mapping[str, str] = MappingProxyType(
    {
        "Pa": "bar", "Pa/s": "bar/s", "Pa.s/m3": "bar.min/L", "Pa.s2/m6": "bar.min2/L2",
        "m3/s": "L/min", "m3": "L", "m3/rad": "cm3/rev", "m3/Pa": "cm3/bar", "m3/(s.Pa)": "L/(min.bar)",
        "m2": "mm2",
        "rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2",
        "N": "kN", "N/s": "kN/s", "N/m": "kN/mm", "N.m": "kN.m", "N.m/s": "kN.m/s", "J": "kJ", "W": "kW",
    }
)  # fmt: skip

_SPELLING = str.maketrans({"²": "2", "³": "3", "·": ".", "*": ".", "µ": "u", "μ": "u", "^": None})
# a name with a power, or 1; then what joins two of them: a product, a quotient, or brackets
_TOKEN = re.compile(r"(?P<name>[A-Za-z%]+)(?:(?P<power>-?\d{1,2})(?!\d))?|1(?!\d)|[./()]")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class _UnknownUnit(Exception):
    """The text is no unit that is known."""


def parse(text: str, where: str = "unit") -> Unit:
    """The unit written as `text`, such as `N.m.s/rad`, `m3/(s.Pa)`, `m s-1`, `kN` or `L/min`."""
    plain = normalised(text)
    try:
        found = _symbol_unit(plain) if plain in _OTHER else _product(_factors(plain))
        if not (found.factor and isfinite(found.factor)):
            raise _UnknownUnit
    except (_UnknownUnit, OverflowError):  # OverflowError: a factor to a power that no number holds
        raise Problem(
            f"{where}: unit {text!r} is unknown, expected one like bar, psi, L/min, deg/s, kN or mm"
        ) from None
    return Unit(found.exponents, found.factor, _OFFSETS.get(plain, 0.0))


def si_unit(text: str) -> str:
    """The SI unit of the same quantity: "bar.min/L" gives "Pa.s/m3", "kN.m" gives "N.m"."""
    parse(text)
    plain = normalised(text)
    powers: dict[str, int] = {}
    for name, power in [(plain, 1)] if plain in _OTHER else _factors(plain):
        symbol = name if _is_symbol(name) else name[1:]
        for part, n in _factors(_OTHER[symbol][1]) if symbol in _OTHER else [(symbol, 1)]:
            powers[part] = powers.get(part, 0) + n * power
    above = [_powered(name, n) for name, n in powers.items() if n > 0]
    below = [_powered(name, -n) for name, n in powers.items() if n < 0]
    divisor = ".".join(below) if len(below) < 2 else f"({'.'.join(below)})"
    return (".".join(above) or "1") + (divisor and f"/{divisor}")


def normalised(text: str) -> str:
    """The unit in characters of the grammar, from what loggers write: "°C", "m³/s", "N·m"; no unit is "1"."""
    plain = text.replace("°C", "degC").replace("°F", "degF").replace("°", "deg").replace("**", "")
    plain = re.sub(r"\s*([./()])\s*", r"\1", plain.translate(_SPELLING).strip())
    return re.sub(r"\s+", ".", plain) if plain not in ("", "-") else "1"


def per_second(unit: str) -> str:
    """The unit of the time derivative: "rad/s" gives "rad/s2", "Pa" gives "Pa/s"."""
    numerator, *divisors = unit.split("/")
    for i, divisor in enumerate(divisors):
        if match := re.fullmatch(r"s(\d*)", divisor):
            divisors[i] = f"s{int(match[1] or 1) + 1}"
            return "/".join([numerator, *divisors])
    return f"{unit}/s"


def factor_and_offset(source: str, target: str, where: str) -> tuple[float, float]:
    """(factor, offset) so that value in `target` = factor * value in `source` + offset."""
    if source == target:
        return 1.0, 0.0
    a, b = parse(source, where), parse(target, where)
    if a.exponents != b.exponents:
        raise Problem(f"{where}: unit {source!r} cannot be converted, expected a unit like {target!r}")
    return a.factor / b.factor, (a.offset - b.offset) / b.factor


def convert(values: NDArray[np.float64], source: str, target: str, where: str) -> NDArray[np.float64]:
    """Values in unit `source`, any shape, converted to unit `target`."""
    factor, offset = factor_and_offset(source, target, where)
    return factor * values + offset


def reader_unit(unit: str) -> str:
    """The unit in which values of `unit` are shown to a reader: bar for Pa, L/min, deg, deg/s, kN, kW."""
    try:
        return DISPLAY.get(si_unit(unit), unit)
    except Problem:
        return unit


def display_conversion(unit: str) -> tuple[str, float] | None:
    """The unit to show values of `unit` in and its factor (shown = factor * value), if there is one."""
    if unit not in DISPLAY:
        return None
    return DISPLAY[unit], parse(unit).factor / parse(DISPLAY[unit]).factor


def pretty(unit: str) -> str:
    """A unit as print has it: m³/(s·Pa), N·m; nothing for pure numbers."""
    if unit in ("", "1", "-"):
        return ""
    powers = re.sub(r"(?<=[A-Za-z])\^?(-?\d)(?!\d|\.\d)", lambda m: superscript(m[1]), unit)
    return re.sub(r"\.(?!\d)", "·", powers)


def superscript(digits: str) -> str:
    """Digits as an exponent."""
    return digits.translate(_RAISED)


def _is_symbol(name: str) -> bool:
    return name in BASES or name in _DERIVED or name in _OTHER


def _symbol_unit(name: str) -> Unit:
    """The unit of one symbol, perhaps with a prefix."""
    if name in BASES:
        return Unit(tuple(int(name == base) for base in BASES))
    if name in _DERIVED:
        return _product(_factors(_DERIVED[name]))
    if name in _OTHER:
        count, of = _OTHER[name]
        found = _product(_factors(of))
        return Unit(found.exponents, count * found.factor)
    if name[:1] in PREFIXES and name[1:] in _PREFIXED:
        found = _symbol_unit(name[1:])
        return Unit(found.exponents, PREFIXES[name[0]] * found.factor)
    raise _UnknownUnit


def _product(factors: list[tuple[str, int]]) -> Unit:
    found = ONE
    for name, power in factors:
        found = found.times(_symbol_unit(name), power)
    return found


def _powered(name: str, power: int) -> str:
    return name if power == 1 else f"{name}{power}"


def _factors(text: str) -> list[tuple[str, int]]:
    """Symbols and powers of "a.b2/(c.d)"; what follows a stroke without brackets is one factor."""
    if len(text) > MAX_LENGTH:
        raise _UnknownUnit
    reader = _Reader(list(_tokens(text)))
    found = reader.product()
    if reader.tokens:
        raise _UnknownUnit
    return found


def _tokens(text: str) -> Iterator[re.Match[str]]:
    at = 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            raise _UnknownUnit
        yield token
        at = token.end()


@dataclass
class _Reader:
    """Reads products, quotients and brackets from the tokens that are left."""

    tokens: list[re.Match[str]]

    def product(self) -> list[tuple[str, int]]:
        """Factors that are joined by points and strokes; a product below a stroke has brackets."""
        found, below = self._factor(), False
        while sign := self._accept(".", "/"):
            if below and sign == ".":
                raise _UnknownUnit  # a/b.c: nobody knows whether c is above or below
            below = sign == "/"
            found += [(name, -power if below else power) for name, power in self._factor()]
        return found

    def _factor(self) -> list[tuple[str, int]]:
        if self._accept("("):
            found = self.product()
            if not self._accept(")"):
                raise _UnknownUnit
            return found
        if not self.tokens or self.tokens[0][0] in "./)":
            raise _UnknownUnit
        token = self.tokens.pop(0)
        return [] if token[0] == "1" else [(token["name"], int(token["power"] or 1))]

    def _accept(self, *signs: str) -> str:
        """The next token, if it is one of these; else nothing is taken."""
        return self.tokens.pop(0)[0] if self.tokens and self.tokens[0][0] in signs else ""


@dataclass(frozen=True)
class LinearTransformation:
    """The map value -> factor * value + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        return self.factor * value + self.offset

    def then(self, after: LinearTransformation) -> LinearTransformation:
        """This map first, `after` on its result."""
        return LinearTransformation(after.factor * self.factor, after.factor * self.offset + after.offset)


IDENTITY = LinearTransformation()


@dataclass(frozen=True)
class DeclaredUnit:
    """A unit of an FMU or an SSP file.

    exponents   in the order of BASES; None where the file does not define the unit

    fault   what is wrong with its definition; the message when a value is to be converted
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


def _with_definition(unit: DeclaredUnit) -> DeclaredUnit:
    """The unit itself; one that no file defines by its symbol, if that is known, such as bar or L/min."""
    if unit.exponents is not None:
        return unit
    try:
        known = parse(unit.name)
    except Problem:
        return unit
    return DeclaredUnit(unit.name, known.exponents, known.factor, known.offset)


def conversion(
    source: DeclaredUnit | None, target: DeclaredUnit | None, where: str
) -> tuple[LinearTransformation, str | None]:
    """The map from `source` to `target`, and a note when it rests on an assumption.

    A side without unit takes the value as it is. Raises Problem, beginning with `where`, when the
    dimensions differ or a definition is wrong.
    """
    if source is None or target is None or source == target:
        return IDENTITY, None
    if source.name == target.name and None in (source.exponents, target.exponents):
        return IDENTITY, None
    for unit in (source, target):
        if wrong := _conversion_problem(unit):
            raise Problem(f"{where}: {wrong}")
    source, target = _with_definition(source), _with_definition(target)
    if source.exponents is None or target.exponents is None:
        return IDENTITY, f"{where}: {source} and {target} are not both defined; the value is passed unchanged"
    if source.dimension != target.dimension:
        raise Problem(
            f"{where}: the units cannot be converted,"
            f" {_with_base_units(source)} and {_with_base_units(target)}"
        )
    linear = LinearTransformation(
        source.factor / target.factor, (source.offset - target.offset) / target.factor
    )
    if not (linear.factor and isfinite(linear.factor) and isfinite(linear.offset)):
        message = f"expected a finite factor other than 0, got {linear.factor:g}"
        raise Problem(f"{where}: {source} and {target} are too far apart: {message}")
    if source.exponents != target.exponents:
        return linear, f"{where}: {source} and {target} differ in the radian only; taken as equal"
    return linear, None


def _conversion_problem(unit: DeclaredUnit) -> str:
    """Why values of a unit cannot be converted; empty if they can."""
    if unit.fault or (unit.factor and isfinite(unit.factor) and isfinite(unit.offset)):
        return unit.fault
    message = f"factor {unit.factor:g} and offset {unit.offset:g}"
    return f"{unit}: expected a finite factor other than 0 and a finite offset, got {message}"


def _with_base_units(unit: DeclaredUnit) -> str:
    """The unit and its base units, for a message: 'bar = kg.m-1.s-2'."""
    parts = [f"{b}{n if n != 1 else ''}" for b, n in zip(BASES, unit.exponents or (), strict=False) if n]
    base = ".".join(parts) or "1"
    return unit.name if unit.name == base else f"{unit.name} = {base}"
