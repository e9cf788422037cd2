"""Units of measurement: parse unit strings, convert values, choose display units.

    value in SI = factor * value + offset

Grammar: symbols with an integer power, joined by "." or a space. "/" is followed by one divisor, by several
in brackets, or by further "/": "N.m.s/rad", "m3/(s.Pa)", "m s-1", "L/min". "1" is the dimensionless unit.
Degree signs, superscripts and other spellings of data loggers are accepted.

The radian is a base unit, as in FMI, so that a frequency [Hz] differs from an angular speed [rad/s]. Many
tools omit the radian from base units. `conversion` therefore accepts a difference in the radian with a note.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isfinite, pi
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest

Numbers = TypeVar("Numbers", float, NDArray[np.float64])
BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
MAX_LENGTH = 200  # characters of a unit string


@dataclass(frozen=True)
class Unit:
    """A unit as a product of powers of base units; one exponent for each of `BASES`."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    def times(self, other: Unit, power: int = 1) -> Unit:
        """The product of this unit and a power of another one; offsets of temperatures are dropped."""
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(exponents, self.factor * other.factor**power)

    def base(self) -> dict[str, int]:
        """The exponents other than zero, by base unit."""
        return {name: n for name, n in zip(BASES, self.exponents, strict=True) if n}


ONE = Unit((0,) * len(BASES))

# NIST SP 811, appendix B: pound and inch by definition, standard gravity, US gallon; hp of 550 ft.lbf/s
_POUND, _GRAVITY, _INCH, _GALLON = 0.45359237, 9.80665, 0.0254, 3.785411784e-3
# Derived SI units and their definitions.
_DERIVED = {
    "Hz": "1/s", "N": "kg.m/s2", "Pa": "kg/(m.s2)", "J": "kg.m2/s2", "W": "kg.m2/s3", "C": "A.s",
    "V": "kg.m2/(s3.A)", "Ohm": "kg.m2/(s3.A2)",
}  # fmt: skip
# Other units: symbol -> (factor, SI unit).
_OTHER: Mapping[str, tuple[float, str]] = {
    "g": (1e-3, "kg"), "t": (1e3, "kg"), "lb": (_POUND, "kg"),
    "L": (1e-3, "m3"), "l": (1e-3, "m3"), "gal": (_GALLON, "m3"),
    "lpm": (1e-3 / 60, "m3/s"), "gpm": (_GALLON / 60, "m3/s"),
    "bar": (1e5, "Pa"), "psi": (_POUND * _GRAVITY / _INCH**2, "Pa"),
    "min": (60.0, "s"), "h": (3600.0, "s"), "d": (86400.0, "s"),
    "deg": (pi / 180, "rad"), "rev": (2 * pi, "rad"), "rpm": (pi / 30, "rad/s"),
    "in": (_INCH, "m"), "ft": (12 * _INCH, "m"),
    "lbf": (_POUND * _GRAVITY, "N"), "hp": (550 * 12 * _INCH * _POUND * _GRAVITY, "W"),
    "%": (0.01, "1"), "1": (1.0, "1"), "-": (1.0, "1"), "": (1.0, "1"),
    "degC": (1.0, "K"), "degF": (5 / 9, "K"),
}  # fmt: skip
_OFFSETS = {"degC": 273.15, "degF": 273.15 - 32 * 5 / 9}  # [K], for the symbol alone, not in products
PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
# Symbols that can have a prefix: "kN", but not "kpsi".
_PREFIXED = frozenset(
    ["g", "m", "s", "A", "N", "Pa", "bar", "J", "W", "V", "C", "Hz", "rad", "L", "l", "Ohm", "mol"]
)
_ONLY_SMALL = "mun"  # prefixes of the radian: "Grad" is a degree in German
_WORDS = {"volt": "V", "volts": "V", "sec": "s", "seconds": "s", "hr": "h", "liter": "L"}

# SI unit -> display unit.
DISPLAY: Mapping[str, str] = MappingProxyType(
    {
        "Pa": "bar", "Pa/s": "bar/s", "Pa.s/m3": "bar.min/L", "Pa.s2/m6": "bar.min2/L2",
        "m3/s": "L/min", "m3": "L", "m3/rad": "cm3/rev", "m3/Pa": "cm3/bar", "m3/(s.Pa)": "L/(min.bar)",
        "m2": "mm2",
        "rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2",
        "N": "kN", "N/s": "kN/s", "N/m": "kN/mm", "N.m": "kN.m", "N.m/s": "kN.m/s", "J": "kJ", "W": "kW",
    }
)  # fmt: skip

# Quantity -> its SI unit.
QUANTITIES = {
    "speed": "rad/s", "angle": "rad", "pressure": "Pa", "velocity": "m/s", "position": "m",
    "acceleration": "m/s2", "angular acceleration": "rad/s2", "force": "N", "torque": "N.m",
    "flow": "m3/s", "power": "W", "voltage": "V", "mass": "kg", "mass flow": "kg/s", "volume": "m3",
    "force rate": "N/s", "pressure rate": "Pa/s", "voltage rate": "V/s",
}  # fmt: skip

_SPELLING = str.maketrans({"²": "2", "³": "3", "·": ".", "*": ".", "µ": "u", "μ": "u", "^": None})
_FACTOR = re.compile(r"(?P<name>[A-Za-z%]+)(?P<power>-?\d{1,2})?|1")  # a symbol with its power, or 1
_BRACKETS = re.compile(r"\(([^()]*)\)")  # the innermost ones
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class _UnknownUnit(Exception):
    """The text is not a known unit."""


def parse_unit(text: str, where: str = "unit") -> Unit:
    """Parse a unit string such as `N.m.s/rad`, `m3/(s.Pa)`, `m s-1`, `kN` or `L/min`.

    where   beginning of the message for an unknown unit

    Raises Problem for an unknown unit.
    """
    plain = normalised(text)
    try:
        return _parsed(plain)
    except (_UnknownUnit, OverflowError):  # OverflowError: a power of the factor exceeds the range of floats
        known = {**DISPLAY, **_DERIVED, **_OTHER, **dict.fromkeys(DISPLAY.values())}
        meant = "deg" if plain.lower() == "grad" else ""  # gon in English
        near = f"; did you mean {meant}?" if meant else suggest(plain, known)
        expected = "expected one like bar, psi, L/min, deg/s, kN or mm"
        raise Problem(f"{where}: unit {text!r} is unknown, {expected}{near}") from None


def is_unit(text: str) -> bool:
    """Is this a known unit?"""
    with suppress(_UnknownUnit, OverflowError):
        return bool(_parsed(normalised(text)))
    return False


@lru_cache(maxsize=1024)
def _parsed(plain: str) -> Unit:
    """The unit of a text in the grammar above."""
    unit = _symbol_unit(plain) if plain in _OTHER else _product(_factors(plain))
    if not (unit.factor and isfinite(unit.factor)):
        raise _UnknownUnit
    return Unit(unit.exponents, unit.factor, _OFFSETS.get(plain, 0.0))


def si_unit(text: str) -> str:
    """The SI unit of the same quantity: "bar.min/L" gives "Pa.s/m3", "kN.m" gives "N.m"."""
    parse_unit(text)
    plain = normalised(text)
    powers: dict[str, int] = {}
    for name, power in [(plain, 1)] if plain in _OTHER else _factors(plain):
        symbol = name if name in BASES or name in _DERIVED or name in _OTHER else name[1:]
        for part, n in _factors(_OTHER[symbol][1]) if symbol in _OTHER else [(symbol, 1)]:
            powers[part] = powers.get(part, 0) + n * power
    numerator = [_powered(name, n) for name, n in powers.items() if n > 0]
    denominator = [_powered(name, -n) for name, n in powers.items() if n < 0]
    divisor = ".".join(denominator) if len(denominator) < 2 else f"({'.'.join(denominator)})"
    return (".".join(numerator) or "1") + (divisor and f"/{divisor}")


def normalised(text: str) -> str:
    """Rewrite a unit of a data logger ("°C", "m³/s", "N·m") in the grammar above; an empty unit is "1"."""
    plain = text.replace("°C", "degC").replace("°F", "degF").replace("°", "deg").replace("**", "")
    plain = re.sub(r"\s*([./()])\s*", r"\1", plain.translate(_SPELLING).strip())
    plain = _WORDS.get(plain.lower(), plain)
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
    """(factor, offset) of the conversion: value in `target` = factor * value in `source` + offset."""
    if source == target:
        return 1.0, 0.0
    a, b = parse_unit(source, where), parse_unit(target, where)
    if a.exponents != b.exponents:
        raise Problem(f"{where}: unit {source!r} cannot be converted, expected a unit like {target!r}")
    return a.factor / b.factor, (a.offset - b.offset) / b.factor


def convert(values: NDArray[np.float64], source: str, target: str, where: str) -> NDArray[np.float64]:
    """Values in unit `source`, any shape, converted to unit `target`."""
    factor, offset = factor_and_offset(source, target, where)
    return factor * values + offset


def reader_unit(unit: str) -> str:
    """The display unit of a quantity in `unit`, such as bar for Pa; `unit` itself if there is none."""
    try:
        return DISPLAY.get(si_unit(unit), unit)
    except Problem:
        return unit


def in_reader_unit(value: Numbers, unit: str) -> Numbers:
    """A number or an array in the unit that `reader_unit` gives; unchanged if the unit is unknown."""
    factor, offset = factor_and_offset(unit, reader_unit(unit), "value")
    return factor * value + offset


def display_conversion(unit: str) -> tuple[str, float] | None:
    """The display unit of an SI unit and its factor (displayed = factor * value); None if there is none."""
    if unit not in DISPLAY:
        return None
    return DISPLAY[unit], parse_unit(unit).factor / parse_unit(DISPLAY[unit]).factor


def quantity(unit: str) -> str:
    """The quantity of a unit; the unit in brackets if it has no name here."""
    names: dict[tuple[int, ...], str] = {parse_unit(u).exponents: name for name, u in QUANTITIES.items()}
    try:
        name = names.get(parse_unit(unit).exponents, "")
    except Problem:
        name = ""
    if name == "torque" and unit.endswith("J"):
        return "energy"
    if name == "power" and not unit.endswith("W"):
        name = "torque rate" if unit.endswith("N.m/s") else ""
    return name or (f"[{unit}]" if unit else "without unit")


# ---- doubtful magnitudes: a value in another unit than its name says ---------------------------------------

# A value FAR times above or below its usual magnitude is doubtful, or LIKELY times if it would be usual in
# another common unit. NEAR: factor between usual magnitudes of one quantity.
FAR, NEAR = 1000.0, 5.0
LIKELY = FAR / NEAR**2
JOINT = 0.1  # [rad], least usual angle of a joint: any angle up to half a turn is near in deg
COMMON = (
    *("bar", "MPa", "kPa", "GPa", "psi", "Pa", "mm", "cm", "m", "km", "mm2", "cm2", "L", "cm3"),
    *("L/min", "L/s", "cm3/rev", "g", "kg", "t", "kg/L", "ms", "s", "deg", "mrad", "deg/s", "rpm"),
    *("kN", "N", "kN.m", "mV", "V", "mm/s"),
)  # fmt: skip


def doubt(name: str, value: float, unit: str, usual: Iterable[float]) -> str:
    """Why a value is doubtful, with the unit that may be meant; empty if it is not. Zero never is.

    usual   magnitudes such as nominal value and default, in the same unit; without them nothing is doubtful
    """
    sizes, size = [abs(u) for u in usual if u and isfinite(u)], abs(value)
    if not sizes or not size or not isfinite(size):
        return ""
    low, high = min(sizes), max(sizes)
    ratio = max(size / high, low / size) * (1 + 1e-9)  # a factor of 1000 may be rounded
    meant = _meant(size, unit, low, high) if ratio >= LIKELY else ""
    turns = unit == "rad" and size > 2 * pi >= 2 * high
    if ratio < FAR and not meant and not turns:
        return ""
    expected = (high if size > high else low) * factor_and_offset(unit, meant or unit, name)[0]
    unit, usually = ("" if u in ("1", "-") else f" {u}" for u in (unit, meant or unit))
    hint = f"did you mean {value:.6g} {meant}?" if meant else "is the unit right?"
    return f"{name} = {value:.6g}{unit}, usually about {expected:.3g}{usually}; {hint}"


def doubts(peaks: Iterable[tuple[str, float, str, Sequence[float]]]) -> Iterator[str]:
    """The doubtful ones of signals: name, largest magnitude, unit, and usual magnitudes as of `doubt`.

    A signal may hardly move: one that is too small counts only if all signals of its unit are.
    """
    told: dict[str, list[tuple[str, bool]]] = {}
    for name, peak, unit, usual in peaks:
        if sizes := [abs(u) for u in usual if u and peak]:
            told.setdefault(unit, []).append((doubt(name, peak, unit, sizes), peak < min(sizes)))
    for group in told.values():
        yield from (text for text, small in group if text and (not small or all(t for t, _ in group)))


def _meant(size: float, unit: str, low: float, high: float) -> str:
    """The unit in which a magnitude is the nearest to the usual ones; empty if it is near in none.

    Half a turn is as near as any other angle of a joint.
    """
    distances: dict[str, float] = {}
    for other in dict.fromkeys([reader_unit(unit), *COMMON]):
        try:
            there = size * factor_and_offset(other, unit, "")[0]
        except Problem:
            continue
        if (unit, other) == ("rad", "deg") and high >= JOINT and low / NEAR <= there <= pi:
            distances[other] = 1.0
        elif other != unit and low / NEAR <= there <= high * NEAR:
            distances[other] = max(1.0, there / high, low / there)
    return min(distances, key=distances.__getitem__, default="")


def pretty(unit: str) -> str:
    """A unit, typeset: m³/(s·Pa), N·m; empty for the dimensionless unit."""
    if unit in ("", "1", "-"):
        return ""
    powers = re.sub(r"(?<=[A-Za-z])\^?(-?\d)(?!\d|\.\d)", lambda m: superscript(m[1]), unit)
    return re.sub(r"\.(?!\d)", "·", powers)


def superscript(digits: str) -> str:
    """Digits as superscripts."""
    return digits.translate(_RAISED)


def _symbol_unit(name: str) -> Unit:
    """The unit of one symbol with or without a prefix."""
    if name in BASES:
        return Unit(tuple(int(name == base) for base in BASES))
    if name in _DERIVED:
        return _product(_factors(_DERIVED[name]))
    if name in _OTHER:
        factor, si = _OTHER[name]
        unit = _product(_factors(si))
        return Unit(unit.exponents, factor * unit.factor)
    if name[:1] in PREFIXES and name[1:] in _PREFIXED and (name[1:] != "rad" or name[0] in _ONLY_SMALL):
        unit = _symbol_unit(name[1:])
        return Unit(unit.exponents, PREFIXES[name[0]] * unit.factor)
    raise _UnknownUnit


def _product(factors: list[tuple[str, int]]) -> Unit:
    product = ONE
    for name, power in factors:
        product = product.times(_symbol_unit(name), power)
    return product


def _powered(name: str, power: int) -> str:
    return name if power == 1 else f"{name}{power}"


def _factors(text: str) -> list[tuple[str, int]]:
    """Symbols and powers of "a.b2/(c.d)"; a divisor without brackets is a single factor."""
    if len(text) > MAX_LENGTH or "#" in text:
        raise _UnknownUnit
    inner: dict[str, list[tuple[str, int]]] = {}  # name in place of brackets -> their factors
    while brackets := _BRACKETS.search(text):
        name = f"#{len(inner)}#"
        inner[name] = _joined(brackets[1], inner)
        text = f"{text[: brackets.start()]}{name}{text[brackets.end() :]}"
    return _joined(text, inner)


def _joined(text: str, inner: Mapping[str, list[tuple[str, int]]]) -> list[tuple[str, int]]:
    """Factors joined by "." and "/"; inner: those of brackets by their names."""
    factors = list[tuple[str, int]]()
    for k, product in enumerate(text.split("/")):
        parts = product.split(".")
        if k and len(parts) > 1:  # a/b.c is ambiguous: brackets are required
            raise _UnknownUnit
        for part in parts:
            if (found := inner.get(part)) is None:
                if not (match := _FACTOR.fullmatch(part)):
                    raise _UnknownUnit
                found = [(match["name"], int(match["power"] or 1))] if match["name"] else []
            factors += [(name, -power if k else power) for name, power in found]
    return factors


@dataclass(frozen=True)
class LinearTransformation:
    """The transformation value -> factor * value + offset, as in SSP, except for the values in `table`."""

    factor: float = 1.0
    offset: float = 0.0
    table: tuple[tuple[float, float], ...] = field(default=(), kw_only=True)

    def __call__(self, value: Numbers) -> Numbers:
        result: Any = self.factor * value + self.offset
        for source, target in self.table:
            result = np.where(value == source, target, result)[()]
        return result  # type: ignore[no-any-return]

    def then(self, after: LinearTransformation) -> LinearTransformation:
        """The composition: this transformation first, then `after`."""
        offset = after.factor * self.offset + after.offset if self.factor else after(self.offset)
        # what `after` maps elsewhere is reached by the line from one value, if it is not constant
        reached = [((y - self.offset) / self.factor, z) for y, z in after.table if self.factor]
        table = {**dict(reached), **{source: after(target) for source, target in self.table}}
        return LinearTransformation(after.factor * self.factor, offset, table=tuple(sorted(table.items())))


IDENTITY = LinearTransformation()


@dataclass(frozen=True)
class DeclaredUnit:
    """A unit that an FMU or an SSP file declares.

    exponents   in the order of BASES; None if the file does not define the unit
    fault       error in the definition, reported when a value is to be converted; empty if there is none
    relative    of a difference: offsets do not apply (`relativeQuantity` of FMI)
    """

    name: str
    exponents: tuple[int, ...] | None = None
    factor: float = 1.0
    offset: float = 0.0
    fault: str = ""
    relative: bool = False

    @property
    def dimension(self) -> tuple[int, ...] | None:
        """Exponents of all base units except the radian."""
        return None if self.exponents is None else self.exponents[:-1]

    def __str__(self) -> str:
        return f"[{self.name}]"


def with_definition(unit: DeclaredUnit) -> DeclaredUnit:
    """The unit, with the definition of its symbol (such as bar or L/min) if the file does not define it."""
    if unit.exponents is not None:
        return unit
    try:
        definition = parse_unit(unit.name)
    except Problem:
        return unit
    factor, offset = definition.factor, definition.offset
    return replace(unit, exponents=definition.exponents, factor=factor, offset=offset)


def differences(where: str, *ends: DeclaredUnit | None) -> bool:
    """Are the values at the ends of a connection differences? Raises Problem if this matters and differs."""
    units = [unit for unit in ends if unit]
    if len({unit.relative for unit in units}) > 1 and any(unit.offset for unit in units):
        raise Problem(f"{where}: expected two differences or none (relativeQuantity), got one")
    return any(unit.relative for unit in units)


def conversion(
    source: DeclaredUnit | None, target: DeclaredUnit | None, where: str, notes: list[str] | None = None
) -> LinearTransformation:
    """The transformation from `source` to `target`; `notes` get one if it is based on an assumption.

    If one of the units is None, values are not converted. Raises Problem, beginning with `where`, if the
    dimensions differ or a definition is wrong.
    """
    notes = [] if notes is None else notes
    if source is None or target is None or source == target:
        return IDENTITY
    if source.name == target.name and None in (source.exponents, target.exponents):
        return IDENTITY
    for unit in (source, target):
        if message := _conversion_problem(unit):
            raise Problem(f"{where}: {message}")
    if source.exponents is None or target.exponents is None:  # FMI 2.0, 2.2.2; FMI 3.0, 2.4.4.2
        notes.append(f"{where}: {source} and {target} are not both defined; the value is passed unchanged")
        return IDENTITY
    if source.dimension != target.dimension:
        names = f"{_with_base_units(source)} and {_with_base_units(target)}"
        raise Problem(f"{where}: the units cannot be converted, {names}")
    difference = 0.0 if source.relative or target.relative else source.offset - target.offset
    offset = difference / target.factor
    linear = LinearTransformation(source.factor / target.factor, offset)
    if not (linear.factor and isfinite(linear.factor) and isfinite(linear.offset)):
        message = f"expected a finite factor other than 0, got {linear.factor:g}"
        raise Problem(f"{where}: {source} and {target} are too far apart: {message}")
    if source.exponents != target.exponents:
        notes.append(f"{where}: {source} and {target} differ in the radian only; taken as equal")
    return linear


_NUMBER_WITH_UNIT = re.compile(
    r"([-+]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][-+]?[0-9]++)?+)\s*([^\W\d_].*|[%°].*)"
)


def number_and_unit(text: str) -> tuple[str, str]:
    """A number and its unit: "180bar" or "180 bar" gives ("180", "bar"); (text, "") for any other text."""
    match = _NUMBER_WITH_UNIT.fullmatch(text.strip())
    return (match[1], match[2].strip()) if match else (text, "")


def from_user_unit(unit: str, target: DeclaredUnit | None, where: str) -> LinearTransformation:
    """The transformation of a value that a user gave in `unit` to the unit of a variable.

    The radian counts, unlike in `conversion`: 60 rpm is no number of Hz. Raises Problem, beginning with
    `where`, for an unknown unit or another dimension.
    """
    given = parse_unit(unit, where)
    declared = None if target is None else with_definition(target)
    expected = "a number without unit"
    if target is not None and target.name not in ("", "1"):
        shown = reader_unit(target.name)
        expected = f"a unit like {target.name}" + (f" or {shown}" if shown != target.name else "")
    if declared is None or declared.exponents is None or declared.fault:
        got = f"the FMU does not define a unit, got {unit!r}"
        raise Problem(f"{where}: expected a number without unit: {got}")
    same_name = with_definition(DeclaredUnit(declared.name)).exponents  # rad, declared without base unit
    if given.exponents not in (declared.exponents, same_name):
        raise Problem(f"{where}: expected {expected}, got {unit!r}")
    difference = 0.0 if declared.relative else given.offset - declared.offset
    return LinearTransformation(given.factor / declared.factor, difference / declared.factor)


def _conversion_problem(unit: DeclaredUnit) -> str:
    """Why values in a unit cannot be converted; empty if they can."""
    if unit.fault or (unit.factor and isfinite(unit.factor) and isfinite(unit.offset)):
        return unit.fault
    message = f"factor {unit.factor:g} and offset {unit.offset:g}"
    return f"{unit}: expected a finite factor other than 0 and a finite offset, got {message}"


def _with_base_units(unit: DeclaredUnit) -> str:
    """A unit and its base units, for a message: 'bar = kg.m-1.s-2'."""
    parts = [f"{b}{n if n != 1 else ''}" for b, n in zip(BASES, unit.exponents or (), strict=False) if n]
    base = ".".join(parts) or "1"
    return unit.name if unit.name == base else f"{unit.name} = {base}"
