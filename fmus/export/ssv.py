"""Parameter sets of an SSP: files of values by name (SSV)."""

from __future__ import annotations

from collections.abc import Mapping

from lxml import etree

from fmus.export.sspxml import REAL, add, root, text, units
from fmus.export.structure import Structure


def parameter_set(s: Structure, name: str, values: Mapping[str, float]) -> bytes:
    """A file that gives values to "component.variable" of a system."""
    named = {port: s.variable(port).unit for port in values}
    element = root("ssv:ParameterSet", s.version, name=name)
    write_parameters(element, s.version, values, named)
    descriptions = [e.description for e in s.elements.values()]
    units(element, "ssv", descriptions, {unit for unit in named.values() if unit})
    return text(element)


def write_parameters(
    parent: etree._Element, version: str, values: Mapping[str, float], named: Mapping[str, str | None]
) -> None:
    """The element Parameters with one value per name."""
    parameters = add(parent, "ssv:Parameters")
    for name, value in values.items():
        parameter = add(parameters, "ssv:Parameter", name=name)
        add(parameter, f"ssv:{REAL[version]}", value=float(value), unit=named[name])
