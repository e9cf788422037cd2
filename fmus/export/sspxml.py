"""What the files of an SSP have in common: namespaces, elements, types, units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lxml import etree

from fmus.export.model_description import digits, package_version

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"  # of version 2.0, too
NAMESPACES = {
    "ssc": f"{_SSP}Common",
    "ssd": f"{_SSP}Description",
    "ssv": f"{_SSP}ParameterValues",
    "ssb": f"{_SSP}SignalDictionary",
}
REAL = {"1.0": "Real", "2.0": "Float64"}  # SSP 2.0 names the types as FMI 3.0 does
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_SCALE = {"factor": 1.0, "offset": 0.0}  # value in base units = factor * value + offset


def tag(name: str) -> str:
    """The qualified name of "ssd:System"."""
    prefix, local = name.split(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def root(
    qualified: str, version: str, more: Mapping[str, str] | None = None, name: str | None = None
) -> etree._Element:
    """The outermost element of a file; `more` are further namespaces by prefix."""
    own = {prefix: NAMESPACES[prefix] for prefix in _prefixes(qualified)}
    element = etree.Element(tag(qualified), nsmap={**own, **(more or {})})
    told = {"version": version, "name": name, "generationTool": f"harvester-cosim {package_version()}"}
    element.attrib.update({key: value for key, value in told.items() if value is not None})
    return element


def _prefixes(qualified: str) -> list[str]:
    own = qualified.partition(":")[0]
    return ["ssc", "ssd", "ssv"] if own == "ssd" else ["ssc", own]


def add(parent: etree._Element, name: str, /, **attributes: object) -> etree._Element:
    """A new last child; numbers with all their digits, attributes that are None left out."""
    texts = {k: digits(v) if isinstance(v, float) else str(v) for k, v in attributes.items() if v is not None}
    return etree.SubElement(parent, tag(name), texts)


def text(element: etree._Element) -> bytes:
    """The file."""
    return etree.tostring(element, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def units(
    parent: etree._Element, kind: str, descriptions: Iterable[Any], only: set[str] | None = None
) -> None:
    """The units of FMUs, or those of some names; `kind` is the prefix of the file's format."""
    found = {u.name: u for d in descriptions for u in d.unitDefinitions if only is None or u.name in only}
    if not found:
        return
    holder = add(parent, f"{kind}:Units")
    for name in sorted(found):
        base = found[name].baseUnit
        exponents = {k: getattr(base, k) for k in _BASE if base is not None and getattr(base, k)}
        scale = {k: getattr(base, k) for k, v in _SCALE.items() if base is not None and getattr(base, k) != v}
        add(add(holder, "ssc:Unit", name=name), "ssc:BaseUnit", **exponents, **scale)
