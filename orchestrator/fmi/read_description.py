"""Reads modelDescription.xml, FMI 2.0 and 3.0 alike, without judging it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from orchestrator.base.xml import Element, child, children, local_name
from orchestrator.fmi.raw_description import (
    FLOATS,
    INITIAL,
    INTERFACES,
    TYPES,
    DeclaredVariable,
    Entry,
    ModelDescription,
    TypeDefinition,
    UnitDefinition,
    Unknown,
    parse_int,
)

SECTIONS = {  # list of ModelStructure -> its path in FMI 2 and in FMI 3
    "outputs": (("Outputs", "Unknown"), ("Output",)),
    "derivatives": (("Derivatives", "Unknown"), ("ContinuousStateDerivative",)),
    "initial": (("InitialUnknowns", "Unknown"), ("InitialUnknown",)),
    "clocked": ((), ("ClockedState",)),
    "indicators": ((), ("EventIndicator",)),
}


def read_description(root: Element | None, major: int) -> ModelDescription:
    """The description behind a root element; empty when there is none or its version is not known."""
    if root is None or not major or local_name(root) != "fmiModelDescription":
        return ModelDescription(major)
    types = dict(_types(root, major))
    listed = child(root, "ModelVariables")
    elements = [e for e in (() if listed is None else listed) if local_name(e)]
    lengths = {e.get("valueReference"): parse_int(e.get("start")) for e in elements if e.get("start")}
    variables = tuple(_variable(e, index, major, types, lengths) for index, e in enumerate(elements, 1))
    by_key = {v.index if major == 2 else v.reference: v for v in reversed(variables)}
    known = {k: v for k, v in by_key.items() if k is not None}
    structure = {}
    for section, paths in SECTIONS.items():
        path = paths[major - 2]
        found = children(root, "ModelStructure", *path) if path else ()
        structure[section] = tuple(_unknown(e, "/".join(path), known, major) for e in found)
    experiment = child(root, "DefaultExperiment")
    rates = (e for e in root.iterfind("VendorAnnotations/Tool[@name='harvester-cosim']//InputDerivative"))
    return ModelDescription(
        major=major,
        attributes=dict(root.attrib),
        variables=variables,
        by_key=known,
        structure=structure,
        units=tuple(map(_unit, children(root, "UnitDefinitions", "Unit"))),
        types=types,
        interfaces={name: _entry(e) for name in INTERFACES if (e := child(root, name)) is not None},
        experiment=None if experiment is None else _entry(experiment),
        categories=tuple(c.get("name", "") for c in children(root, "LogCategories", "Category")),
        input_rates={e.get("input"): e.get("derivative") for e in rates},
    )


def _entry(element: Element) -> Entry:
    return Entry(element.sourceline, dict(element.attrib))


def _types(root: Element, major: int) -> Iterator[tuple[str, TypeDefinition]]:
    """Type definitions by name: in FMI 2 a SimpleType holds the type, in FMI 3 the element is Float64Type."""
    listed = child(root, "TypeDefinitions")
    for outer in () if listed is None else listed:
        inner = next((e for e in outer if local_name(e) in TYPES), None) if major == 2 else outer
        type_ = "" if inner is None else local_name(inner).removesuffix("Type")
        if inner is not None and type_ in TYPES:
            own = {k: v for k, v in inner.attrib.items() if k not in ("name", "description")}
            items = tuple((i.get("name", ""), i.get("value", "")) for i in children(inner, "Item"))
            yield outer.get("name", ""), TypeDefinition(inner.sourceline, own, type_, items)


def _variable(
    e: Element,
    index: int,
    major: int,
    types: Mapping[str, TypeDefinition],
    lengths: Mapping[str, int | None],
) -> DeclaredVariable:
    """One variable: in FMI 2 a child of the element holds the type, in FMI 3 the element is the type."""
    inner = next((i for i in e if local_name(i) in TYPES), e) if major == 2 else e
    own = {**e.attrib, **inner.attrib}
    type_, causality = local_name(inner), own.get("causality", "local")
    variability = own.get("variability") or _variability(type_, causality, major)
    default = "exact" if (major, causality) == (3, "input") else INITIAL.get((causality, variability), "")
    declared = types.get(own.get("declaredType", ""))
    starts = tuple(s.get("value", "") for s in children(inner, "Start"))
    if not starts and "start" in own:
        many = major == 3 and type_ not in ("String", "Binary")
        starts = tuple(own["start"].split()) if many else (own["start"],)
    dimensions = children(e, "Dimension") if major == 3 else ()
    return DeclaredVariable(
        line=e.sourceline,
        attributes={**declared.attributes, **own} if declared else own,
        name=own.get("name", ""),
        index=index,
        type=type_,
        reference=parse_int(own.get("valueReference")),
        causality=causality,
        variability=variability,
        initial=own.get("initial", default),
        starts=starts if starts or "start" in own else None,
        shape=tuple(parse_int(d.get("start")) or lengths.get(d.get("valueReference")) for d in dimensions),
        aliases=tuple(map(_entry, children(e, "Alias"))),
    )


def _variability(type_: str, causality: str, major: int) -> str:
    """The default. FMI 2 says continuous for all; tools take discrete for what is not Real."""
    if causality in ("parameter", "calculatedParameter", "structuralParameter") and major == 3:
        return "fixed"
    return "continuous" if type_ in FLOATS else "discrete"


def _unknown(e: Element, section: str, known: Mapping[int, DeclaredVariable], major: int) -> Unknown:
    key = parse_int(e.get("index" if major == 2 else "valueReference"))
    names, kinds = e.get("dependencies"), e.get("dependenciesKind")
    return Unknown(
        section=section,
        line=e.sourceline,
        key=key,
        dependencies=None if names is None else tuple(parse_int(n) for n in names.split()),
        dependency_kinds=None if kinds is None else tuple(kinds.split()),
        variable=None if key is None else known.get(key),
    )


def _unit(unit: Element) -> UnitDefinition:
    base = child(unit, "BaseUnit")
    displays = {d.get("name", ""): dict(d.attrib) for d in children(unit, "DisplayUnit")}
    return UnitDefinition(
        unit.get("name", ""), unit.sourceline, None if base is None else dict(base.attrib), displays
    )
