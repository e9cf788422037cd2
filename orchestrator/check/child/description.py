"""What an FMU declares, as far as running it needs.

Reads modelDescription.xml with the standard library only, so that a child starts fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

FLOATS = ("Real", "Float64", "Float32")
WHOLE = ("Integer", "Enumeration", *(f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)))
NUMBERS = (*FLOATS, *WHOLE, "Boolean")


@dataclass(frozen=True)
class Variable:
    """One variable.

    size    number of its scalars
    state   name of the state that it is the derivative of
    """

    name: str
    kind: str
    reference: int
    causality: str = "local"
    variability: str = "continuous"
    initial: str = ""
    start: tuple[float, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    nominal: float = 1.0
    size: int = 1
    state: str = ""

    @property
    def is_float(self) -> bool:
        return self.kind in FLOATS

    @property
    def scale(self) -> float:
        """A typical magnitude."""
        return max([abs(s) for s in self.start if math.isfinite(s)] + [self.nominal])


@dataclass(frozen=True)
class Declared:
    """One FMU.

    sides          "cs", "me" -> attributes of the element CoSimulation, ModelExchange
    derivatives    names of the derivatives of the continuous states, in the order of the state vector
    dependencies   output or derivative -> what it depends on; None when the FMU does not say
    """

    major: int
    token: str
    sides: Mapping[str, Mapping[str, str]]
    variables: Mapping[str, Variable]
    derivatives: tuple[str, ...] = ()
    dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    indicators: int = 0
    categories: tuple[str, ...] = ()
    experiment: Mapping[str, float] = field(default_factory=dict)

    def of(self, *causalities: str) -> list[Variable]:
        """Numeric variables of these causalities."""
        return [v for v in self.variables.values() if v.causality in causalities and v.kind in NUMBERS]

    def can(self, side: str, *names: str) -> bool:
        """True when this side has one of these attributes set; the versions spell them in two ways."""
        return any(self.sides[side].get(name) in ("true", "1") for name in names)

    @property
    def step(self) -> float:
        """Communication step [s]: as declared, else a 500th of the default experiment, else 10 ms."""
        start, stop = self.experiment.get("startTime", 0.0), self.experiment.get("stopTime", math.nan)
        length = (stop - start) / 500 if stop > start else 1e-2
        return self.experiment.get("stepSize", 0.0) or self.inner_step or length

    @property
    def inner_step(self) -> float:
        """The fixed step [s] inside, by which the FMU's time may be late; 0 when unknown."""
        return float(self.sides.get("cs", {}).get("fixedInternalStepSize", 0.0))

    @property
    def states(self) -> list[str]:
        """Names of the continuous states."""
        return [self.variables[d].state for d in self.derivatives if d in self.variables]


TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")  # of FMI 2


def read(folder: Path) -> Declared:
    """The model description of an unpacked FMU; raises ValueError with one line when that is not possible."""
    try:
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        return _declared(root)
    except (ElementTree.ParseError, OSError, LookupError, TypeError, ValueError) as error:
        raise ValueError(f"modelDescription.xml cannot be read: {type(error).__name__}: {error}") from None


def _declared(root: Any) -> Declared:
    major = int(root.get("fmiVersion", "0").partition(".")[0])
    if major not in (2, 3):
        raise ValueError(f"fmiVersion is {root.get('fmiVersion')!r}, expected 2.0 or 3.0")
    parent = root.find("ModelVariables")
    elements = [] if parent is None else list(parent)
    types = {t.get("name"): t for t in root.iter() if t.tag in ("SimpleType",) or t.tag.endswith("Type")}
    made = [_scalar(e, types) if major == 2 else _typed(e, types) for e in elements]
    made = _with_states(elements, made, major)
    if major == 3:
        made = _with_sizes(elements, made)
    keys = (
        {str(i): v.name for i, v in enumerate(made, 1)}
        if major == 2
        else {str(v.reference): v.name for v in made}
    )
    structure = root.find("ModelStructure")
    unknowns, derivatives = _structure([] if structure is None else structure, major, keys)
    sides = {"cs": root.find("CoSimulation"), "me": root.find("ModelExchange")}
    indicators = int(root.get("numberOfEventIndicators", 0))
    experiment = root.find("DefaultExperiment")
    return Declared(
        major=major,
        token=root.get("guid") or root.get("instantiationToken") or "",
        sides={name: dict(e.attrib) for name, e in sides.items() if e is not None},
        variables={v.name: v for v in made},
        derivatives=tuple(derivatives),
        dependencies=unknowns,
        indicators=indicators,
        categories=tuple(c.get("name") for c in root.iterfind("LogCategories/Category")),
        experiment={} if experiment is None else {k: float(x) for k, x in experiment.attrib.items()},
    )


def _scalar(element: Any, types: Mapping[str, Any]) -> Variable:
    """FMI 2: ScalarVariable with one child that holds the type."""
    inner = _inner(element)
    declared = types.get(inner.get("declaredType"))
    inherited = {} if declared is None or not len(declared) else dict(declared[0].attrib)
    return _variable(element.attrib, inherited | dict(inner.attrib), inner.tag)


def _inner(element: Any) -> Any:
    found = next((e for e in element if e.tag in TYPES), None)
    if found is None:
        raise ValueError(f"{element.get('name')} has none of {', '.join(TYPES)}")
    return found


def _typed(element: Any, types: Mapping[str, Any]) -> Variable:
    """FMI 3: the element is the type."""
    declared = types.get(element.get("declaredType"))
    inherited = {} if declared is None else dict(declared.attrib)
    return _variable(element.attrib, inherited | dict(element.attrib), element.tag)


def _variable(outer: Mapping[str, str], inner: Mapping[str, str], kind: str) -> Variable:
    return Variable(
        name=outer["name"],
        kind=kind,
        reference=int(outer["valueReference"]),
        causality=outer.get("causality", "local"),
        variability=outer.get("variability", "continuous" if kind in FLOATS else "discrete"),
        initial=outer.get("initial", ""),
        start=_numbers(inner["start"]) if kind in NUMBERS and "start" in inner else (),
        low=float(inner.get("min", -math.inf)) if kind in NUMBERS else -math.inf,
        high=float(inner.get("max", math.inf)) if kind in NUMBERS else math.inf,
        nominal=abs(float(inner.get("nominal", 1.0))) or 1.0,
    )


def _numbers(text: str) -> tuple[float, ...]:
    words = {"true": 1.0, "false": 0.0}
    return tuple(words[w] if w in words else float(w) for w in text.split())


def _with_states(elements: list[Any], made: list[Variable], major: int) -> list[Variable]:
    """Derivatives know their state."""
    names = {v.reference if major == 3 else i: v.name for i, v in enumerate(made, 1)}
    result = []
    for element, v in zip(elements, made, strict=True):
        inner = element if major == 3 else _inner(element)
        of = inner.get("derivative")
        result.append(replace(v, state=names.get(int(of), "")) if of else v)
    return result


def _with_sizes(elements: list[Any], made: list[Variable]) -> list[Variable]:
    """FMI 3 arrays: the product of their dimensions, which are numbers or structural parameters."""
    lengths = {v.reference: int(v.start[0]) for v in made if v.causality == "structuralParameter" and v.start}
    result = []
    for element, v in zip(elements, made, strict=True):
        size = 1
        for dimension in element.iterfind("Dimension"):
            fixed = dimension.get("start")
            size *= int(fixed) if fixed else lengths[int(dimension.get("valueReference"))]
        result.append(replace(v, size=size) if size != 1 else v)
    return result


def _structure(
    structure: Any, major: int, names: Mapping[str, str]
) -> tuple[dict[str, frozenset[str] | None], list[str]]:
    """Dependencies of outputs and derivatives, and the derivatives in order."""
    key = "index" if major == 2 else "valueReference"
    groups = {"Output": "out", "ContinuousStateDerivative": "der"}
    if major == 2:
        rows = [(e, "out") for e in structure.iterfind("Outputs/Unknown")] if len(structure) else []
        rows += [(e, "der") for e in structure.iterfind("Derivatives/Unknown")] if len(structure) else []
    else:
        rows = [(e, groups[e.tag]) for e in structure if e.tag in groups]
    table: dict[str, frozenset[str] | None] = {}
    for element, _ in rows:
        listed = element.get("dependencies")
        known = None if listed is None else frozenset(names[d] for d in listed.split() if d in names)
        table[names[element.get(key)]] = known
    return table, [names[e.get(key)] for e, group in rows if group == "der"]
