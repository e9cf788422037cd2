"""Small helpers for the XML of SSP files: elements by local name, attributes by type.

Numbers and truth values as XML Schema writes them.

Python reads more than that: 1_000, digits of other scripts, Infinity. What another tool would read otherwise,
or not at all, is refused here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.units import BASES, IDENTITY, DeclaredUnit, Linear

Element = Any  # lxml ships no types
MAPPINGS = tuple(f"{kind}MappingTransformation" for kind in ("Boolean", "Integer", "Enumeration"))


def parse(file: Location, expected: str) -> Element:
    """The root element of an XML file, which must have the local name `expected`."""
    root = _root(file)
    if local(root) != expected:
        raise Problem(f"{file}: expected the element {expected}, got {local(root)}")
    return root


def _root(file: Location) -> Element:
    """The root element; a prefix that is not declared is let pass, for there are files with one."""
    from lxml import etree

    text, safe = file.read(), {"resolve_entities": False, "no_network": True}
    parser = etree.XMLParser(**safe)
    try:
        root = etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        if fault := _fault(error, parser.error_log):
            raise Problem(f"{file}: is not XML: {fault}") from error
        root = etree.fromstring(text, etree.XMLParser(recover=True, **safe))
    for entity in root.iter(etree.Entity):  # they are not resolved, so what they stand for would be missing
        told = f"expected the content itself, got the entity {entity.text}"
        raise Problem(f"{file}: line {entity.getparent().sourceline}: {local(entity.getparent())}: {told}")
    return root


def _fault(error: Exception, log: Any) -> str:
    """The first error that is not a prefix without declaration; empty if there are only such."""
    from lxml import etree

    undeclared = etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE
    others = [f"{e.message}, line {e.line}, column {e.column}" for e in log if e.type != undeclared]
    if not len(log):
        others = [re.sub(r" *\(<string>.*\)$", "", str(error))]
    return " ".join("".join(others[:1]).split())


def local(element: Element) -> str:
    """Name without namespace or prefix; comments have none."""
    name = str(element.tag).rpartition("}")[2] if isinstance(element.tag, str) else ""
    return name.rpartition(":")[2]


def children(element: Element | None, *path: str) -> Iterator[Element]:
    """Elements reached by a path of local names."""
    if element is None:
        return
    if not path:
        yield element
        return
    for child in element:
        if local(child) == path[0]:
            yield from children(child, *path[1:])


def child(element: Element | None, *path: str) -> Element | None:
    """The first element reached by a path of local names, or None."""
    return next(children(element, *path), None)


def number(file: Location, element: Element, name: str, default: float | None = None) -> float:
    """A real attribute."""
    text = element.get(name)
    if text is None and default is not None:
        return default
    try:
        return finite(text)
    except (AttributeError, ValueError):  # AttributeError: there is none
        raise Problem(
            f"{file}: line {element.sourceline}: {local(element)}: "
            f"expected a finite number for {name}, got {text!r}"
        ) from None


def required(file: Location, element: Element, name: str) -> str:
    """An attribute that has to be there."""
    text = element.get(name)
    if text is None:
        there = ", ".join(str(n).rpartition("}")[2] for n in element.attrib) or "none"
        raise Problem(
            f"{file}: line {element.sourceline}: {local(element)}: expected an attribute {name}, got {there}"
        )
    return str(text)


def flag(element: Element, name: str) -> bool:
    """A boolean attribute, false when missing or odd."""
    return element.get(name) in ("true", "1")


def truth(file: Location, element: Element, name: str) -> bool:
    """A boolean attribute, false when missing."""
    text = element.get(name, "false")
    try:
        return truth_numerals(text)
    except ValueError:
        told = f"expected true or false for {name}, got {text!r}"
        raise Problem(f"{file}: line {element.sourceline}: {local(element)}: {told}") from None


def units(file: Location, root: Element) -> dict[str, DeclaredUnit]:
    """The units that a file defines."""
    named = ((required(file, unit, "name"), unit) for unit in children(root, "Units", "Unit"))
    return {name: _unit(file, name, unit) for name, unit in named}


def _unit(file: Location, name: str, element: Element) -> DeclaredUnit:
    """One unit; a fault in it is kept for whoever converts a value: files define units that nothing has."""
    base = child(element, "BaseUnit")
    if base is None:
        return DeclaredUnit(name)
    try:
        exponents = tuple(_whole(file, base, b) for b in BASES)
        factor, offset = number(file, base, "factor", 1.0), number(file, base, "offset", 0.0)
    except Problem as problem:
        return DeclaredUnit(name, fault=str(problem))
    return DeclaredUnit(name, exponents, factor, offset, _zero(file, base, factor))


def _zero(file: Location, base: Element, factor: float) -> str:
    """What to say of a factor that makes all values one."""
    place = f"{file}: line {base.sourceline}: BaseUnit"
    return "" if factor else f"{place}: expected a factor other than 0, got {base.get('factor')!r}"


def _whole(file: Location, base: Element, name: str) -> int:
    """An exponent of a base unit."""
    value = number(file, base, name, 0)
    if not float(value).is_integer():
        raise Problem(
            f"{file}: line {base.sourceline}: BaseUnit: expected a whole number for {name}, got {value:g}"
        )
    return int(value)


def transformation(file: Location, element: Element) -> tuple[Linear, Mapping[str, str]]:
    """The transformation inside a connection or mapping entry: a linear map, and a table of texts."""
    linear = child(element, "LinearTransformation")
    if linear is not None:
        return Linear(number(file, linear, "factor", 1.0), number(file, linear, "offset", 0.0)), {}
    for e in element:
        if local(e) in MAPPINGS:
            return IDENTITY, _table(file, e)
        if local(e).endswith("Transformation"):
            told = f"expected LinearTransformation or one of {', '.join(MAPPINGS)}"
            raise Problem(f"{file}: line {e.sourceline}: {local(e)}: {told}")
    return IDENTITY, {}


def _table(file: Location, mapping: Element) -> dict[str, str]:
    """Source -> target; each source once."""
    table = dict[str, str]()
    for e in children(mapping, "MapEntry"):
        source = required(file, e, "source")
        if source in table:
            told = f"expected each source once, got {source!r} again"
            raise Problem(f"{file}: line {e.sourceline}: MapEntry: {told}")
        table[source] = required(file, e, "target")
    if not table:
        raise Problem(f"{file}: line {mapping.sourceline}: {local(mapping)}: expected a MapEntry, got none")
    return table


_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf|nan", re.ASCII | re.IGNORECASE)
_WHOLE = re.compile(r"[+-]?\d{1,400}", re.ASCII)  # no more digits than a float has room for
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def real(text: str) -> float:
    """A number, also one that is not finite; ValueError for any other text."""
    if not _REAL.fullmatch(text.strip()):
        raise ValueError(text)
    return float(text)


def finite(text: str) -> float:
    """A finite number; ValueError for any other text."""
    value = real(text)
    if not isfinite(value):
        raise ValueError(text)
    return value


def whole(text: str) -> int:
    """A whole number; ValueError for any other text."""
    if not _WHOLE.fullmatch(text.strip()):
        raise ValueError(text)
    return int(text)


def truth_numerals(text: str) -> bool:
    """true, false, 1 or 0; ValueError for any other text."""
    try:
        return _TRUTH[text.strip()]
    except KeyError:
        raise ValueError(text) from None
