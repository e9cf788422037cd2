"""Common elements of all file formats of SSP: namespaces, units, transformations, value mappings."""

from collections.abc import Iterable, Mapping
from itertools import pairwise

from orchestrator.base.errors import Problem
from orchestrator.base.units import BASES, IDENTITY, DeclaredUnit, LinearTransformation
from orchestrator.base.xml import XmlElement, finite

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"  # version 2.0 has the same namespaces
NAMESPACES = {
    "ssc": f"{_SSP}Common",
    "ssd": f"{_SSP}Description",
    "ssv": f"{_SSP}ParameterValues",
    "ssb": f"{_SSP}SignalDictionary",
}
# names of types by version of SSP; version 2.0 uses those of FMI 3.0
TYPES: Mapping[str, Mapping[str, str]] = {
    "1.0": {"Real": "Real", "Integer": "Integer", "Boolean": "Boolean", "String": "String"},
    "2.0": {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "String": "String"},
}
MAPPINGS = tuple(f"{kind}MappingTransformation" for kind in ("Boolean", "Integer", "Enumeration"))


# ---- units


def read_units(root: XmlElement) -> dict[str, DeclaredUnit]:
    """The units that a file defines, by name."""
    return {name: _unit(name, e) for e in root.children("Units", "Unit") if (name := e.required("name"))}


def _unit(name: str, element: XmlElement) -> DeclaredUnit:
    """One unit.

    A faulty definition is reported only when a value is converted, because files define units that they
    never use.
    """
    base = element.child("BaseUnit")
    if base is None:
        return DeclaredUnit(name)
    try:
        exponents = tuple(_exponent(base, b) for b in BASES)
        factor, offset = base.number("factor", 1.0), base.number("offset", 0.0)
    except Problem as problem:
        return DeclaredUnit(name, fault=str(problem))
    message = f"expected a factor other than 0, got {base.get('factor')!r}"
    return DeclaredUnit(name, exponents, factor, offset, "" if factor else str(base.problem(message)))


def _exponent(base: XmlElement, name: str) -> int:
    value = base.number(name, 0.0)
    if not value.is_integer():
        raise base.problem(f"expected a whole number for {name}, got {value:g}")
    return int(value)


def defined_units(units: Iterable[DeclaredUnit | None]) -> dict[str, dict[str, float | None]]:
    """The units that have a definition, by name, with the attributes of BaseUnit; None for a default."""
    defined = {u.name: u for u in units if u is not None and u.exponents is not None}
    return {
        name: {base: float(n) or None for base, n in zip(BASES, u.exponents or (), strict=True)}
        | {"factor": None if u.factor == 1.0 else u.factor, "offset": u.offset or None}
        for name, u in sorted(defined.items())
    }


# ---- transformations


def read_transformation(element: XmlElement) -> tuple[LinearTransformation, Mapping[str, str]]:
    """The transformation in a connection or mapping entry.

    Either (linear transformation, {}) or (identity, value table source -> target); (identity, {}) if there
    is none.
    """
    linear = element.child("LinearTransformation")
    if linear is not None:
        return LinearTransformation(linear.number("factor", 1.0), linear.number("offset", 0.0)), {}
    for e in element.children():
        if e.name in MAPPINGS:
            return IDENTITY, _table(e)
        if e.name.endswith("Transformation"):
            raise e.problem(f"expected LinearTransformation or one of {', '.join(MAPPINGS)}, got {e.name}")
    return IDENTITY, {}


def _table(mapping: XmlElement) -> dict[str, str]:
    """The table of a mapping, source -> target."""
    table = dict[str, str]()
    for e in mapping.children("MapEntry"):
        source = e.required("source")
        if source in table:
            raise e.problem(f"expected each source once, got {source!r} twice")
        table[source] = e.required("target")
    if not table:
        raise mapping.problem("expected a MapEntry, got none")
    return table


def as_linear(table: Mapping[str, str], context: str) -> LinearTransformation:
    """A table of Boolean or integer values as a linear transformation.

    Raises Problem if a value is not a number or Boolean, if two targets have the same source, or if the
    points are not on a straight line.
    """
    booleans = {"true": "1", "false": "0"}
    try:
        points = sorted({(finite(booleans.get(a, a)), finite(booleans.get(b, b))) for a, b in table.items()})
    except ValueError:
        points = []
    for (x, _), (next_x, _) in pairwise(points):
        if x == next_x:
            raise Problem(f"{context}: {x:g} is mapped to two values, expected one")
    if len(points) == 1:
        return LinearTransformation(0.0, points[0][1])
    if len(points) >= 2:
        (x0, y0), (x1, y1) = points[:2]
        slope = (y1 - y0) / (x1 - x0)
        linear = LinearTransformation(slope, y0 - slope * x0)
        if all(linear(x) == y for x, y in points):
            return linear
    expected = "expected Booleans or numbers on a straight line"
    raise Problem(f"{context}: this mapping of values is not supported, {expected}")
