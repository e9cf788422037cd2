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
    from lxml import etree

    try:
        root = etree.fromstring(file.read(), etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise Problem(f"{file}: is not XML: {error}") from error
    if local(root) != expected:
        raise Problem(f"{file}: expected the element {expected}, got {local(root)}")
    return root


def local(element: Element) -> str:
    """Name without namespace; comments have none."""
    return str(element.tag).rpartition("}")[2] if isinstance(element.tag, str) else ""


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


def flag(element: Element, name: str) -> bool:
    """A boolean attribute, false when missing."""
    return element.get(name) in ("true", "1")


def units(file: Location, root: Element) -> dict[str, Unit]:
    """The units that a file defines."""
    found = {}
    for unit in children(root, "Units", "Unit"):
        name, base = unit.get("name"), child(unit, "BaseUnit")
        if base is None:
            found[name] = Unit(name)
            continue
        exponents = tuple(int(number(file, base, b, 0)) for b in BASES)
        factor, offset = number(file, base, "factor", 1.0), number(file, base, "offset", 0.0)
        found[name] = Unit(name, exponents, factor, offset)
    return found


def transformation(file: Location, element: Element) -> tuple[Linear, Mapping[str, str]]:
    """The transformation inside a connection or mapping entry: a linear map, and a table of texts."""
    linear = child(element, "LinearTransformation")
    if linear is not None:
        return Linear(number(file, linear, "factor", 1.0), number(file, linear, "offset", 0.0)), {}
    for kind in ("Boolean", "Integer", "Enumeration"):
        entries = list(children(element, f"{kind}MappingTransformation", "MapEntry"))
        if entries:
            return IDENTITY, {e.get("source"): e.get("target") for e in entries}
    return IDENTITY, {}
