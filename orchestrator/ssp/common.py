"""What the files of an SSP have in common (namespace ssc): units, transformations, types; read and
written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from itertools import pairwise

from orchestrator.base.errors import Problem
from orchestrator.base.units import BASES, IDENTITY, DeclaredUnit, LinearTransformation
from orchestrator.base.xml import Element, XmlElement, finite, shortest_decimal

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"  # version 2.0 has the same namespaces
NAMESPACES = {
    "ssc": f"{_SSP}Common",
    "ssd": f"{_SSP}Description",
    "ssv": f"{_SSP}ParameterValues",
    "ssb": f"{_SSP}SignalDictionary",
}
# names of the types by version of SSP; those of 2.0 are the ones of FMI 3.0
TYPES: Mapping[str, Mapping[str, str]] = {
    "1.0": {"Real": "Real", "Integer": "Integer", "Boolean": "Boolean", "String": "String"},
    "2.0": {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "String": "String"},
}
MAPPINGS = tuple(f"{kind}MappingTransformation" for kind in ("Boolean", "Integer", "Enumeration"))


def read_units(root: XmlElement) -> dict[str, DeclaredUnit]:
    """The units that a file defines, by name."""
    return {name: _unit(name, e) for e in root.children("Units", "Unit") if (name := e.required("name"))}


def _unit(name: str, element: XmlElement) -> DeclaredUnit:
    """One unit; a mistake in it counts when a value is converted: files define units that nothing uses."""
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


def read_transformation(element: XmlElement) -> tuple[LinearTransformation, Mapping[str, str]]:
    """The transformation inside a connection or mapping entry: a linear one, and a table of texts."""
    linear = element.child("LinearTransformation")
    if linear is not None:
        return LinearTransformation(linear.number("factor", 1.0), linear.number("offset", 0.0)), {}
    for e in element.children():
        if e.name in MAPPINGS:
            return IDENTITY, _table(e)
        if e.name.endswith("Transformation"):
            raise e.problem(f"expected LinearTransformation or one of {', '.join(MAPPINGS)}")
    return IDENTITY, {}


def _table(mapping: XmlElement) -> dict[str, str]:
    """Source -> target; each source once."""
    table = dict[str, str]()
    for e in mapping.children("MapEntry"):
        source = e.required("source")
        if source in table:
            raise e.problem(f"expected each source once, got {source!r} again")
        table[source] = e.required("target")
    if not table:
        raise mapping.problem("expected a MapEntry, got none")
    return table


def as_linear(table: Mapping[str, str], where: str) -> LinearTransformation:
    """A table of Boolean or integer values as a linear transformation, where it is one."""
    words = {"true": "1", "false": "0"}
    try:
        points = sorted({(finite(words.get(a, a)), finite(words.get(b, b))) for a, b in table.items()})
    except ValueError:
        points = []
    for (x, _), (other, _) in pairwise(points):
        if x == other:
            raise Problem(f"{where}: this mapping gives two values for {x:g}, expected one")
    if len(points) == 1:
        return LinearTransformation(0.0, points[0][1])
    if len(points) >= 2:
        (x0, y0), (x1, y1) = points[:2]
        slope = (y1 - y0) / (x1 - x0)
        line = LinearTransformation(slope, y0 - slope * x0)
        if all(line(x) == y for x, y in points):
            return line
    raise Problem(f"{where}: this mapping of values is not supported on a connection")


# ---- writing -----------------------------------------------------------------------------------------------


@cache
def package_version() -> str:
    """Version of the installed distribution, "0" when it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("harvester-cosim")
    except PackageNotFoundError:
        return "0"


def generation_tool() -> str:
    """This program and its version."""
    return f"harvester-cosim {package_version()}"


def new_root(qualified: str, more: Mapping[str, str] | None = None, /, **attributes: str | None) -> Element:
    """The outermost element of a new file; `more` are further namespaces by prefix."""
    from lxml import etree

    prefix, _, name = qualified.partition(":")
    known = ("ssc", "ssd", "ssv") if prefix == "ssd" else ("ssc", prefix)
    namespaces = {p: NAMESPACES[p] for p in known} | dict(more or {})
    root = etree.Element(f"{{{NAMESPACES[prefix]}}}{name}", nsmap=namespaces)
    root.attrib.update({key: text for key, text in attributes.items() if text is not None})
    return root


def add(parent: Element, qualified: str, /, **attributes: object) -> Element:
    """A new last child such as "ssd:System"; numbers with all their digits, attributes that are None left
    out."""
    from lxml import etree

    prefix, _, name = qualified.partition(":")
    namespace = NAMESPACES.get(prefix) or parent.nsmap[prefix]
    given = {k: v for k, v in attributes.items() if v is not None}
    return etree.SubElement(parent, f"{{{namespace}}}{name}", {k: as_text(v) for k, v in given.items()})


def as_text(value: object) -> str:
    """A value as XML writes it."""
    if isinstance(value, float):
        return shortest_decimal(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def xml_text(root: Element) -> bytes:
    """The content of the file."""
    from lxml import etree

    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def write_units(root: Element, prefix: str, units: Iterable[DeclaredUnit | None]) -> None:
    """The definitions of these units, as far as they have one; `prefix` is that of the file's format."""
    known = {u.name: u for u in units if u is not None and u.exponents is not None}
    holder = add(root, f"{prefix}:Units") if known else None
    for name in sorted(known):
        u = known[name]
        base: dict[str, float] = {b: n for b, n in zip(BASES, u.exponents or (), strict=True) if n}
        base |= {k: v for k, v, usual in (("factor", u.factor, 1.0), ("offset", u.offset, 0.0)) if v != usual}
        add(add(holder, "ssc:Unit", name=name), "ssc:BaseUnit", **base)
