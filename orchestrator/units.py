"""Units as an FMU or an SSP file declares them, and the conversion between two of them.

A value v in a unit means `factor * v + offset` in SI base units. Two units can be converted into each other
when their base exponents agree; the radian is a base unit in FMI, but many tools leave it out. A unit that no
file defines is read by its symbol.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from orchestrator import symbols
from orchestrator.errors import Problem

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
class Unit:
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


def defined(unit: Unit) -> Unit:
    """The unit itself; one that no file defines by its symbol, if that is known, such as bar or L/min."""
    if unit.exponents is not None:
        return unit
    try:
        known = symbols.parse(unit.name)
    except Problem:
        return unit
    kg, m, s, ampere, kelvin, rad = known.exponents
    return Unit(unit.name, (kg, m, s, ampere, kelvin, 0, 0, rad), known.factor, known.offset)


def conversion(source: Unit | None, target: Unit | None, where: str) -> tuple[Linear, str | None]:
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


def _wrong(unit: Unit) -> str:
    """Why values of a unit cannot be converted; empty if they can."""
    if unit.fault or (unit.factor and isfinite(unit.factor) and isfinite(unit.offset)):
        return unit.fault
    told = f"factor {unit.factor:g} and offset {unit.offset:g}"
    return f"{unit}: expected a finite factor other than 0 and a finite offset, got {told}"


def _base(unit: Unit) -> str:
    """The unit and its base units, for a message: 'bar = kg.m-1.s-2'."""
    parts = [f"{b}{n if n != 1 else ''}" for b, n in zip(BASES, unit.exponents or (), strict=False) if n]
    base = ".".join(parts) or "1"
    return unit.name if unit.name == base else f"{unit.name} = {base}"
