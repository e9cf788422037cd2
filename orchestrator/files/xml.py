"""Small helpers for the XML of SSP files: elements by local name, attributes by type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.units import BASES, IDENTITY, Linear, Unit

Element = Any  # lxml ships no types


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
        return etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        if any(e.type != etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE for e in parser.error_log):
            line = " ".join(str(error).split()).removesuffix(" (<string>)")
            raise Problem(f"{file}: is not XML: {line}") from error
        return etree.fromstring(text, etree.XMLParser(recover=True, **safe))


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
        return float(text)
    except (TypeError, ValueError):
        raise Problem(
            f"{file}: line {element.sourceline}: {local(element)}: expected a number for {name}, got {text!r}"
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
    """A boolean attribute, false when missing."""
    return element.get(name) in ("true", "1")


def units(file: Location, root: Element) -> dict[str, Unit]:
    """The units that a file defines."""
    found = {}
    for unit in children(root, "Units", "Unit"):
        name, base = required(file, unit, "name"), child(unit, "BaseUnit")
        if base is None:
            found[name] = Unit(name)
            continue
        exponents = tuple(_whole(file, base, b) for b in BASES)
        factor, offset = number(file, base, "factor", 1.0), number(file, base, "offset", 0.0)
        found[name] = Unit(name, exponents, factor, offset)
    return found


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
    for kind in ("Boolean", "Integer", "Enumeration"):
        entries = list(children(element, f"{kind}MappingTransformation", "MapEntry"))
        if entries:
            return IDENTITY, {required(file, e, "source"): required(file, e, "target") for e in entries}
    return IDENTITY, {}
