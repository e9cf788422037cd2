"""What modelDescription.xml says, the same for FMI 2 and FMI 3, read without judging it.

Attributes stay text, since any of them may be nonsense; rules judge them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from orchestrator.base.xml import child, children, local
from orchestrator.check.finding import some

Element = Any  # lxml ships no types

KINDS = ("ModelExchange", "CoSimulation", "ScheduledExecution")
FLOATS = ("Real", "Float32", "Float64")
WHOLE = {"Integer": 32, "Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64}
NATURAL = {"UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
TYPES = (*FLOATS, *WHOLE, *NATURAL, "Boolean", "String", "Binary", "Enumeration", "Clock")
INITIAL = {  # default of `initial` by causality and variability, both versions
    **{(c, v): "exact" for c in ("parameter", "structuralParameter") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("calculatedParameter", "local") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("output", "local") for v in ("discrete", "continuous")},
    **{(c, "constant"): "exact" for c in ("output", "local")},
}


@dataclass(frozen=True, eq=False)
class Variable:
    """One variable.

    index      place in the file, from 1
    type       Real, Float64, ...
    said       attributes as written, with those of the declared type where it says none
    initial    as written, else its default; "" where there is none
    starts     start values as written; None when there are none
    aliases    further names (FMI 3)
    """

    name: str
    line: int
    index: int
    type: str
    reference: int | None
    causality: str
    variability: str
    initial: str
    said: Mapping[str, str]
    starts: tuple[str, ...] | None = None
    aliases: tuple[str, ...] = ()
    declared_variability: bool = True

    def __str__(self) -> str:
        return f"modelDescription.xml line {self.line}: {self.name}"

    @property
    def is_float(self) -> bool:
        return self.type in FLOATS

    @property
    def unit(self) -> str | None:
        return self.said.get("unit") if self.is_float else None

    @property
    def clocked(self) -> bool:
        return bool(self.said.get("clocks")) or self.type == "Clock"


@dataclass(frozen=True, eq=False)
class Unknown:
    """One entry of ModelStructure; `key` is an index (FMI 2) or a value reference (FMI 3)."""

    section: str
    line: int
    key: int | None
    dependencies: tuple[int | None, ...] | None
    kinds: tuple[str, ...] | None
    variable: Variable | None = None

    def __str__(self) -> str:
        name = f" {self.variable.name}" if self.variable else ""
        return f"modelDescription.xml line {self.line}: {self.section}{name}"


@dataclass(frozen=True)
class UnitDefinition:
    """One unit; `base` are the attributes of its BaseUnit."""

    name: str
    line: int
    base: Mapping[str, str] | None
    displays: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class Model:
    """The whole file; lists keep the order of the file. `by_key` is what ModelStructure refers to."""

    root: Element | None = None
    major: int = 0
    variables: tuple[Variable, ...] = ()
    by_key: Mapping[int, Variable] = field(default_factory=dict)
    structure: Mapping[str, tuple[Unknown, ...]] = field(default_factory=dict)
    units: tuple[UnitDefinition, ...] = ()
    types: Mapping[str, Element] = field(default_factory=dict)
    interfaces: Mapping[str, Element] = field(default_factory=dict)

    def of(self, *causalities: str) -> tuple[Variable, ...]:
        """Variables of some causalities."""
        return tuple(v for v in self.variables if v.causality in causalities)

    @property
    def experiment(self) -> Element | None:
        return child(self.root, "DefaultExperiment")

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The model identifiers, each once."""
        return tuple(dict.fromkeys(e.get("modelIdentifier", "") for e in self.interfaces.values()))

    @property
    def states(self) -> tuple[Variable, ...]:
        """The continuous states: what the listed derivatives are derivatives of."""
        listed = (u.variable for u in self.structure.get("derivatives", ()) if u.variable)
        found = (self.by_key.get(whole(v.said.get("derivative")) or -1) for v in listed)
        return tuple(dict.fromkeys(s for s in found if s))


def listed(variables: Sequence[Variable]) -> str:
    """Line of the first variable, and the names of all."""
    return f"modelDescription.xml line {variables[0].line}: {some([v.name for v in variables])}"


SECTIONS = {  # what a list is called here: its path in FMI 2 and in FMI 3
    "outputs": (("Outputs", "Unknown"), ("Output",)),
    "derivatives": (("Derivatives", "Unknown"), ("ContinuousStateDerivative",)),
    "initial": (("InitialUnknowns", "Unknown"), ("InitialUnknown",)),
    "clocked": (None, ("ClockedState",)),
    "indicators": (None, ("EventIndicator",)),
}


def read(root: Element | None, major: int) -> Model:
    """The model behind a root element; empty when there is none or its version is not known."""
    if root is None or not major or local(root) != "fmiModelDescription":
        return Model(root, major)
    types = dict(_types(root))
    variables = tuple(_variables(root, major, types))
    by_key = {v.index if major == 2 else v.reference: v for v in reversed(variables)}
    known = {k: v for k, v in by_key.items() if k is not None}
    structure = {}
    for section, paths in SECTIONS.items():
        path = paths[major - 2]
        found = children(root, "ModelStructure", *path) if path else ()
        structure[section] = tuple(_unknown(e, "/".join(path or ()), known, major) for e in found)
    interfaces = {kind: e for kind in KINDS if (e := child(root, kind)) is not None}
    return Model(root, major, variables, known, structure, tuple(_units(root)), types, interfaces)


def whole(text: str | None) -> int | None:
    """A whole number, or None."""
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def _types(root: Element) -> Iterator[tuple[str, Element]]:
    """Name and the typed element of each type definition."""
    for simple in children(root, "TypeDefinitions", "SimpleType"):  # FMI 2
        inner = next((e for e in simple if local(e) in TYPES), None)
        if inner is not None:
            yield simple.get("name", ""), inner
    listed = child(root, "TypeDefinitions")
    for element in [] if listed is None else listed:
        if local(element).removesuffix("Type") in TYPES:  # FMI 3: Float64Type
            yield element.get("name", ""), element


def _variables(root: Element, major: int, types: Mapping[str, Element]) -> Iterator[Variable]:
    listed = child(root, "ModelVariables")
    elements = [e for e in listed if local(e)] if listed is not None else []
    for index, element in enumerate(elements, 1):
        typed = next((e for e in element if local(e) in TYPES), None) if major == 2 else element
        yield _variable(element, element if typed is None else typed, index, major, types)


def _variable(e: Element, typed: Element, index: int, major: int, types: Mapping[str, Element]) -> Variable:
    type_ = local(typed)
    said = {**dict(e.attrib), **dict(typed.attrib)}
    declared = types.get(said.get("declaredType", ""))
    if declared is not None:
        said = {**{k: v for k, v in declared.attrib.items() if k not in ("name", "description")}, **said}
    causality = said.get("causality", "local")
    variability = said.get("variability") or _variability(type_, causality, major)
    default = "exact" if (major, causality) == (3, "input") else INITIAL.get((causality, variability), "")
    return Variable(
        name=said.get("name", ""),
        line=e.sourceline,
        index=index,
        type=type_,
        reference=whole(said.get("valueReference")),
        causality=causality,
        variability=variability,
        initial=said.get("initial", default),
        said=said,
        starts=_starts(typed, said, major),
        aliases=tuple(a.get("name", "") for a in children(e, "Alias")),
        declared_variability="variability" in said,
    )


def _variability(type_: str, causality: str, major: int) -> str:
    """The default. FMI 2 says continuous for all; tools take discrete for what is not Real."""
    if causality in ("parameter", "calculatedParameter", "structuralParameter") and major == 3:
        return "fixed"
    return "continuous" if type_ in FLOATS else "discrete"


def _starts(typed: Element, said: Mapping[str, str], major: int) -> tuple[str, ...] | None:
    listed = tuple(s.get("value", "") for s in children(typed, "Start"))
    if listed:
        return listed
    start = said.get("start")
    if start is None:
        return None
    return tuple(start.split()) if major == 3 and local(typed) not in ("String", "Binary") else (start,)


def _unknown(e: Element, section: str, known: Mapping[int, Variable], major: int) -> Unknown:
    key = whole(e.get("index" if major == 2 else "valueReference"))
    names, kinds = e.get("dependencies"), e.get("dependenciesKind")
    return Unknown(
        section=section,
        line=e.sourceline,
        key=key,
        dependencies=None if names is None else tuple(whole(n) for n in names.split()),
        kinds=None if kinds is None else tuple(kinds.split()),
        variable=None if key is None else known.get(key),
    )


def _units(root: Element) -> Iterator[UnitDefinition]:
    for unit in children(root, "UnitDefinitions", "Unit"):
        base = child(unit, "BaseUnit")
        displays = {d.get("name", ""): dict(d.attrib) for d in children(unit, "DisplayUnit")}
        yield UnitDefinition(
            unit.get("name", ""), unit.sourceline, None if base is None else dict(base.attrib), displays
        )
