"""Writing of XML files of an SSP: namespaces, names of types, elements and attributes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from orchestrator.base.xml import Element, shortest_decimal

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


@cache
def package_version() -> str:
    """Version of the installed distribution; "0" if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("harvester-cosim")
    except PackageNotFoundError:
        return "0"


def generation_tool() -> str:
    """Name and version of this program, for the attribute generationTool."""
    return f"harvester-cosim {package_version()}"


def new_root(qualified: str, more: Mapping[str, str] | None = None, /, **attributes: str | None) -> Element:
    """The root element of a new file; `more`: prefix -> further namespace."""
    from lxml import etree

    prefix, _, name = qualified.partition(":")
    prefixes = ("ssc", "ssd", "ssv") if prefix == "ssd" else ("ssc", prefix)
    namespaces = {p: NAMESPACES[p] for p in prefixes} | dict(more or {})
    root = etree.Element(f"{{{NAMESPACES[prefix]}}}{name}", nsmap=namespaces)
    root.attrib.update({key: text for key, text in attributes.items() if text is not None})
    return root


def add(parent: Element, qualified: str, /, **attributes: object) -> Element:
    """Append a child such as "ssd:System"; attributes that are None are left out."""
    from lxml import etree

    prefix, _, name = qualified.partition(":")
    namespace = NAMESPACES.get(prefix) or parent.nsmap[prefix]
    texts = {key: as_text(value) for key, value in attributes.items() if value is not None}
    return etree.SubElement(parent, f"{{{namespace}}}{name}", texts)


def as_text(value: object) -> str:
    """A value as XML text; a float has all digits that are needed to read it back."""
    if isinstance(value, float):
        return shortest_decimal(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def xml_text(root: Element) -> bytes:
    """The content of the file with this root."""
    from lxml import etree

    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text
