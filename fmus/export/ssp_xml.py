"""What the files of an SSP have in common: namespaces, elements, types, units.

The signal dictionary of an SSP (SSB): every output, as a trace names it, with unit and text.

Parameter sets of an SSP: files of values by name (SSV).

Vendor annotations of an SSP that hold the communication step: SSP has no place of its own for it.

Ours also says that the components are stepped one after the other: OMSimulator's and libcosim's stand for
masters that step all at once, and our orchestrator does as they say where ours is not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lxml import etree

from fmus.export.model_description import digits, package_version
from fmus.export.ssp_structure import Structure

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


NAME, FILE = "signals", "signals.ssb"


def signal_dictionary(s: Structure) -> bytes:
    """A file with one entry per output of a component."""
    element = root("ssb:SignalDictionary", s.version)
    for component, e in s.elements.items():
        for name in e.outputs:
            variable = e.variables[name]
            entry = add(
                element,
                "ssb:DictionaryEntry",
                name=f"{component}.{name}",
                description=variable.description or None,
            )
            add(entry, f"ssc:{REAL[s.version]}", unit=variable.unit)
    shown = {e.variables[name].unit for e in s.elements.values() for name in e.outputs}
    units(element, "ssb", [e.description for e in s.elements.values()], shown)
    return text(element)


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


_DRAFT_SSP = "http://ssp-standard.org/SSP1/SystemStructure"
_OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
_OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
_HC = "urn:harvester-cosim:coupling"
# they belong on the root: libcosim takes one on osp:Algorithm for a child
VENDOR_NAMESPACES = {"oms": _OMS, "osp": _OSP, "hc": _HC}


def annotate(system: etree._Element, experiment: etree._Element, step: float) -> None:
    """Write the step [s] for OMSimulator, which opens no system without it, libcosim and ourselves."""
    text = f"{step:.12f}".rstrip("0")  # a decimal for OMSimulator's schema: no exponent
    holder = etree.SubElement(_annotation(system, "org.openmodelica"), f"{{{_OMS}}}Annotations")
    information = etree.SubElement(holder, f"{{{_OMS}}}SimulationInformation")
    master = {"description": "oms-ma", "stepSize": text, "relativeTolerance": "0.0001"}
    etree.SubElement(information, f"{{{_OMS}}}FixedStepMaster", master)
    algorithm = etree.SubElement(
        _annotation(experiment, "com.opensimulationplatform"), f"{{{_OSP}}}Algorithm"
    )
    etree.SubElement(algorithm, f"{{{_OSP}}}FixedStepAlgorithm", baseStepSize=text)
    own = {"master": "gauss-seidel", "step": text}
    etree.SubElement(_annotation(experiment, "harvester-cosim"), f"{{{_HC}}}Coupling", own)


def _annotation(parent: etree._Element, kind: str) -> etree._Element:
    tag = f"{{{_DRAFT_SSP}Description}}Annotations"
    holder = parent.find(tag)
    holder = etree.SubElement(parent, tag) if holder is None else holder
    return etree.SubElement(holder, f"{{{_DRAFT_SSP}Common}}Annotation", type=kind)
