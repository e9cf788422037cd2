"""Common elements of all file formats of SSP: namespaces, units, transformations, value mappings."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

from orchestrator.base.errors import Problem
from orchestrator.base.numerals import boolean, integer
from orchestrator.base.units import BASES, IDENTITY, DeclaredUnit, LinearTransformation
from orchestrator.base.xml import XmlElement

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"  # version 2.0 has the same namespaces
NAMESPACES = {
    "ssc": f"{_SSP}Common",
    "ssd": f"{_SSP}Description",
    "ssv": f"{_SSP}ParameterValues",
}
# names of types by version of SSP; version 2.0 uses those of FMI 3.0
TYPES: Mapping[str, Mapping[str, str]] = {
    "1.0": {"Real": "Real", "Integer": "Integer", "Boolean": "Boolean", "String": "String"},
    "2.0": {
        **{"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "String": "String"},
        **{"Binary": "Binary", "Clock": "Clock"},
    },
}
MAPPINGS: Mapping[str, Callable[[str], float]] = {
    "BooleanMappingTransformation": boolean,
    "IntegerMappingTransformation": integer,
}
ENUMERATION_MAPPING = "EnumerationMappingTransformation"
Items = Mapping[str, int]  # of an enumeration: name -> value


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
        exponents = tuple(_whole(base, b) for b in BASES)
        factor, offset = base.number("factor", 1.0), base.number("offset", 0.0)
    except Problem as problem:
        return DeclaredUnit(name, fault=str(problem))
    message = f"expected a factor other than 0, got {base.get('factor')!r}"
    return DeclaredUnit(name, exponents, factor, offset, "" if factor else str(base.problem(message)))


def _whole(element: XmlElement, name: str) -> int:
    value = element.number(name, 0.0)
    if not value.is_integer():
        raise element.problem(f"expected a whole number for {name}, got {value:g}")
    return int(value)


def read_enumerations(root: XmlElement) -> dict[str, Items]:
    """The enumerations that a file defines, by name."""
    return {
        e.required("name"): {i.required("name"): _whole(i, "value") for i in e.children("Item")}
        for e in root.children("Enumerations", "Enumeration")
    }


def defined_units(units: Iterable[DeclaredUnit | None]) -> dict[str, dict[str, float | None]]:
    """The units that have a definition, by name, with the attributes of BaseUnit; None for a default."""
    defined = {u.name: u for u in units if u is not None and u.exponents is not None}
    return {
        name: {base: float(n) or None for base, n in zip(BASES, u.exponents or (), strict=True)}
        | {"factor": None if u.factor == 1.0 else u.factor, "offset": u.offset or None}
        for name, u in sorted(defined.items())
    }


# ---- transformations


class Transformation(NamedTuple):
    """The transformation of a connection or mapping entry; names: of items, source -> target."""

    linear: LinearTransformation = IDENTITY
    names: Mapping[str, str] = MappingProxyType({})

    def between(self, source: Items, target: Items, where: str) -> LinearTransformation:
        """The map between two connectors with these enumerations."""
        for names, items in ((self.names, source), (self.names.values(), target)):
            for name in (name for name in names if name not in items):
                expected = f"expected one of the items {', '.join(items) or 'none'}"
                raise Problem(f"{where}: {expected}, got {name!r}")
        table = ((float(source[a]), float(target[b])) for a, b in self.names.items())
        return replace(self.linear, table=tuple(sorted(table))) if self.names else self.linear


def read_transformation(element: XmlElement) -> Transformation:
    """The transformation in a connection or mapping entry; what is not in a mapping keeps its value."""
    found = [e for e in element.children() if e.name.endswith("Transformation")]
    if len(found) > 1:
        raise found[1].problem(f"expected one transformation, got a {found[0].name}, too")
    for e in found:
        if e.name == "LinearTransformation":
            return Transformation(LinearTransformation(e.number("factor", 1.0), e.number("offset", 0.0)))
        if e.name == ENUMERATION_MAPPING:
            return Transformation(names=_table(e, str))
        if e.name not in MAPPINGS:
            kinds = ", ".join((*MAPPINGS, ENUMERATION_MAPPING))
            raise e.problem(f"expected LinearTransformation or one of {kinds}, got {e.name}")
        entries = _table(e, MAPPINGS[e.name]).items()
        return Transformation(LinearTransformation(table=tuple(sorted(entries))))
    return Transformation()


def _table(mapping: XmlElement, read: Callable[[str], Any]) -> dict[Any, Any]:
    """The table of a mapping, source -> target."""
    table = dict[Any, Any]()
    for e in mapping.children("MapEntry"):
        values = list[Any]()
        for text in (e.required("source"), e.required("target")):
            try:
                values.append(read(text))
            except ValueError:
                raise e.problem(f"expected values of {mapping.name}, got {text!r}") from None
        source, target = values
        if source in table:
            raise e.problem(f"expected each source once, got {e.get('source')!r} twice")
        table[source] = target
    if not table:
        raise mapping.problem("expected a MapEntry, got none")
    return table
