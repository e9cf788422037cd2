"""Reads modelDescription.xml of FMI 2.0 and 3.0 to a `ModelDescription`, without validation."""

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
    ParameterSetFile,
    TypeDefinition,
    UnitDefinition,
    Unknown,
    parse_int,
)

SECTIONS = {  # section of ModelStructure -> its path in FMI 2.0 and in FMI 3.0
    "outputs": (("Outputs", "Unknown"), ("Output",)),
    "derivatives": (("Derivatives", "Unknown"), ("ContinuousStateDerivative",)),
    "initial": (("InitialUnknowns", "Unknown"), ("InitialUnknown",)),
    "clocked": ((), ("ClockedState",)),
    "indicators": ((), ("EventIndicator",)),
}
# annotations of this project, in FMI 2.0 and in FMI 3.0
OWN_ANNOTATION = (
    "VendorAnnotations/Tool[@name='harvester-cosim']",
    "Annotations/Annotation[@type='harvester-cosim']",
)
PARAMETERS = (
    "VendorAnnotations/Tool[@name='harvester-cosim.parameters']//ParameterSet",
    "Annotations/Annotation[@type='harvester-cosim.parameters']//ParameterSet",
)


def read_description(root: Element | None, major: int) -> ModelDescription:
    """The description with this root element; empty without a root or with an unknown version."""
    if root is None or not major or local_name(root) != "fmiModelDescription":
        return ModelDescription(major)
    types = dict(_types(root, major))
    model_variables = child(root, "ModelVariables")
    elements = [e for e in (() if model_variables is None else model_variables) if local_name(e)]
    lengths = {e.get("valueReference"): parse_int(e.get("start")) for e in elements if e.get("start")}
    variables = tuple(_variable(e, index, major, types, lengths) for index, e in enumerate(elements, 1))
    by_key = {v.index if major == 2 else v.reference: v for v in reversed(variables)}
    valid = {k: v for k, v in by_key.items() if k is not None}
    structure = {}
    for section, paths in SECTIONS.items():
        path = paths[major - 2]
        entries = children(root, "ModelStructure", *path) if path else ()
        structure[section] = tuple(_unknown(e, "/".join(path), valid, major) for e in entries)
    experiment = child(root, "DefaultExperiment")
    annotation = root.find(OWN_ANNOTATION[major - 2])
    rates, optional = (
        () if annotation is None else annotation.iterfind(f".//{name}")
        for name in ("InputDerivative", "OptionalInput")
    )
    return ModelDescription(
        major=major,
        attributes=dict(root.attrib),
        variables=variables,
        by_key=valid,
        structure=structure,
        units=tuple(map(_unit, children(root, "UnitDefinitions", "Unit"))),
        types=types,
        interfaces={name: _entry(e) for name in INTERFACES if (e := child(root, name)) is not None},
        experiment=None if experiment is None else _entry(experiment),
        categories=tuple(c.get("name", "") for c in children(root, "LogCategories", "Category")),
        input_rates={e.get("input"): e.get("derivative") for e in rates},
        optional_inputs={e.get("input"): e.get("without", "") for e in optional},
        parameter_sets=tuple(map(_parameter_set, root.iterfind(PARAMETERS[major - 2]))),
    )


def _parameter_set(element: Element) -> ParameterSetFile:
    shipped = {e.get("name", ""): e.get("shipped", "") for e in element.iterfind("Parameter")}
    return ParameterSetFile(element.get("file", ""), element.get("sha256", ""), shipped)


def _entry(element: Element) -> Entry:
    return Entry(element.sourceline, dict(element.attrib))


def _types(root: Element, major: int) -> Iterator[tuple[str, TypeDefinition]]:
    """Type definitions by name. FMI 2.0: a child of SimpleType. FMI 3.0: an element such as Float64Type."""
    definitions = child(root, "TypeDefinitions")
    for outer in () if definitions is None else definitions:
        inner = next((e for e in outer if local_name(e) in TYPES), None) if major == 2 else outer
        type_ = "" if inner is None else local_name(inner).removesuffix("Type")
        if inner is not None and type_ in TYPES:
            attributes = {k: v for k, v in inner.attrib.items() if k not in ("name", "description")}
            items = tuple((i.get("name", ""), i.get("value", "")) for i in children(inner, "Item"))
            yield outer.get("name", ""), TypeDefinition(inner.sourceline, attributes, type_, items)


def _variable(
    e: Element, index: int, major: int, types: Mapping[str, TypeDefinition], lengths: Mapping[str, int | None]
) -> DeclaredVariable:
    """A variable. FMI 2.0: a child of the element is the type. FMI 3.0: the element itself is the type."""
    inner = next((i for i in e if local_name(i) in TYPES), e) if major == 2 else e
    attributes = dict(e.items())  # faster than attrib
    if inner is not e:
        attributes.update(inner.items())
    type_, causality = local_name(inner), attributes.get("causality", "local")
    variability = attributes.get("variability") or _variability(type_, causality, major)
    default = "exact" if (major, causality) == (3, "input") else INITIAL.get((causality, variability), "")
    declared = types.get(attributes.get("declaredType", ""))
    starts = tuple(s.get("value", "") for s in children(inner, "Start"))
    if not starts and "start" in attributes:
        many = major == 3 and type_ not in ("String", "Binary")
        starts = tuple(attributes["start"].split()) if many else (attributes["start"],)
    dimensions = children(e, "Dimension") if major == 3 else ()
    return DeclaredVariable(
        line=e.sourceline,
        attributes={**declared.attributes, **attributes} if declared else attributes,
        name=attributes.get("name", ""),
        index=index,
        type=type_,
        reference=parse_int(attributes.get("valueReference")),
        causality=causality,
        variability=variability,
        initial=attributes.get("initial", default),
        starts=starts if starts or "start" in attributes else None,
        shape=tuple(parse_int(d.get("start")) or lengths.get(d.get("valueReference")) for d in dimensions),
        aliases=tuple(map(_entry, children(e, "Alias"))),
    )


def _variability(type_: str, causality: str, major: int) -> str:
    """Default variability. FMI 2.0 defines continuous for all types; tools use discrete except for Real."""
    if causality in ("parameter", "calculatedParameter", "structuralParameter") and major == 3:
        return "fixed"
    return "continuous" if type_ in FLOATS else "discrete"


def _unknown(e: Element, section: str, by_key: Mapping[int, DeclaredVariable], major: int) -> Unknown:
    key = parse_int(e.get("index" if major == 2 else "valueReference"))
    dependencies, kinds = e.get("dependencies"), e.get("dependenciesKind")
    return Unknown(
        section=section,
        line=e.sourceline,
        key=key,
        dependencies=None if dependencies is None else tuple(parse_int(n) for n in dependencies.split()),
        dependency_kinds=None if kinds is None else tuple(kinds.split()),
        variable=None if key is None else by_key.get(key),
    )


def _unit(unit: Element) -> UnitDefinition:
    base = child(unit, "BaseUnit")
    displays = {d.get("name", ""): dict(d.attrib) for d in children(unit, "DisplayUnit")}
    return UnitDefinition(
        unit.get("name", ""), unit.sourceline, None if base is None else dict(base.attrib), displays
    )
