"""Content of modelDescription.xml as data classes, common to FMI 2.0 and 3.0, without validation.

Attributes are stored as text, because any of them can be invalid. The rules of `orchestrator.check` validate
them. `orchestrator.fmi.description` refuses descriptions that cannot be run, and
`orchestrator.fmi.read_description` reads the file. This module needs only the standard library, so that a
child process that receives a description starts fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

FLOATS = ("Real", "Float64", "Float32")
SIGNED = {"Integer": 32, "Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64}  # type -> bits
UNSIGNED = {"UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
NUMERIC = (*FLOATS, *SIGNED, *UNSIGNED, "Enumeration", "Boolean")
TYPES = (*NUMERIC, "String", "Binary", "Clock")
MAX_LOCALS = 100  # local variables that are observed if the FMU has no outputs
BOOLEANS = {"true": 1.0, "false": 0.0}
INTERFACES = {  # element -> name of the interface type
    "ModelExchange": "model exchange",
    "CoSimulation": "co-simulation",
    "ScheduledExecution": "scheduled execution",
}
INITIAL = {  # (causality, variability) -> default of `initial`, in both versions
    **{(c, v): "exact" for c in ("parameter", "structuralParameter") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("calculatedParameter", "local") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("output", "local") for v in ("discrete", "continuous")},
    **{(c, "constant"): "exact" for c in ("output", "local")},
}
# Allowed combinations of causality and variability, in both versions.
COMBINATIONS = {*INITIAL, ("input", "discrete"), ("input", "continuous"), ("independent", "continuous")}


def parse_int(text: str | None) -> int | None:
    """An integer; None for any other text."""
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def parse_numbers(text: str) -> tuple[float, ...]:
    """Numbers and booleans, separated by white space; ValueError for any other text."""
    return tuple(BOOLEANS[w] if w in BOOLEANS else float(w) for w in text.split())


@dataclass(frozen=True, eq=False)
class Entry:
    """An XML element: its line and its attributes."""

    line: int
    attributes: Mapping[str, str]

    def get(self, name: str, default: str = "") -> str:
        """The text of an attribute."""
        return self.attributes.get(name, default)

    def declares(self, *names: str) -> bool:
        """True if one of these attributes is true or above 0; FMI 2.0 and 3.0 spell some differently."""
        return any(self.get(name) == "true" or (parse_int(self.get(name)) or 0) > 0 for name in names)


@dataclass(frozen=True, eq=False)
class DeclaredVariable(Entry):
    """A variable; missing attributes are those of its declared type.

    index        index in the file, from 1
    type         Real, Float64, ...
    reference    value reference
    initial      the attribute or its default; "" if there is none
    starts       texts of the start values; None if there are none
    shape        of an array (FMI 3.0); None for a dimension that is not a number; () for a scalar
    aliases      further names (FMI 3.0)
    """

    name: str
    index: int
    type: str
    reference: int | None
    causality: str
    variability: str
    initial: str
    starts: tuple[str, ...] | None = None
    shape: tuple[int | None, ...] = ()
    aliases: tuple[Entry, ...] = ()

    def __str__(self) -> str:
        return f"modelDescription.xml line {self.line}: {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """The name and the aliases."""
        return self.name, *(a.get("name") for a in self.aliases)

    @property
    def is_float(self) -> bool:
        return self.type in FLOATS

    @property
    def is_number(self) -> bool:
        return self.type in NUMERIC

    @property
    def unit(self) -> str | None:
        return self.attributes.get("unit") if self.is_float else None

    @property
    def clocked(self) -> bool:
        return bool(self.get("clocks")) or self.type == "Clock"

    # ---- numeric attributes; ValueError for a text that is not a number

    @cached_property
    def size(self) -> int:
        """Number of scalar elements."""
        lengths = [n for n in self.shape if n is not None]
        if len(lengths) < len(self.shape):
            raise ValueError(f"{self.name} has a dimension that is not a number")
        return math.prod(lengths)

    @cached_property
    def start(self) -> tuple[float, ...]:
        """Start values of a numeric variable."""
        return parse_numbers(" ".join(self.starts or ())) if self.is_number else ()

    @cached_property
    def minimum(self) -> float:
        return float(self.get("min", "-inf")) if self.is_number else -math.inf

    @cached_property
    def maximum(self) -> float:
        return float(self.get("max", "inf")) if self.is_number else math.inf

    @cached_property
    def nominal(self) -> float:
        """The nominal value; default: 1."""
        return abs(float(self.get("nominal", "1"))) or 1.0

    @cached_property
    def scale(self) -> float:
        """Typical magnitude: the largest of the nominal value and the finite start values."""
        return max([abs(s) for s in self.start if math.isfinite(s)] + [self.nominal])


@dataclass(frozen=True, eq=False)
class Unknown:
    """An entry of ModelStructure; `key` is an index (FMI 2.0) or a value reference (FMI 3.0)."""

    section: str
    line: int
    key: int | None
    dependencies: tuple[int | None, ...] | None
    dependency_kinds: tuple[str, ...] | None
    variable: DeclaredVariable | None = None

    def __str__(self) -> str:
        name = f" {self.variable.name}" if self.variable else ""
        return f"modelDescription.xml line {self.line}: {self.section}{name}"


@dataclass(frozen=True)
class UnitDefinition:
    """A declared unit.

    base_unit       attributes of BaseUnit; None if there is none
    display_units   name -> attributes of DisplayUnit
    """

    name: str
    line: int
    base_unit: Mapping[str, str] | None
    display_units: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, eq=False)
class TypeDefinition(Entry):
    """A declared type; `type`: Real, Enumeration, ...; `items`: names and values of an enumeration."""

    type: str
    items: tuple[tuple[str, str], ...] = ()

    @cached_property
    def values(self) -> Mapping[str, int]:
        """The values of an enumeration by name; ValueError for a text that is not a number."""
        return {name: int(value) for name, value in self.items}


@dataclass(frozen=True)
class ParameterSetFile:
    """A file of parameter values that an FMU was built with: its name, and its SHA-256.

    shipped   parameter -> text of the value in the shipped FMU, for those that differ from it
    """

    file: str
    sha256: str
    shipped: Mapping[str, str]


@dataclass(frozen=True)
class ModelDescription:
    """The content of modelDescription.xml, in the order of the file.

    major           FMI version, 2 or 3; 0 if unknown, then all other fields are empty
    attributes      of the root element
    by_key          variables by the keys of ModelStructure: index (FMI 2.0) or value reference (FMI 3.0)
    structure       outputs, derivatives, initial, clocked, indicators -> entries of ModelStructure
    interfaces      ModelExchange, CoSimulation, ScheduledExecution -> element
    categories      log categories
    input_rates     input -> input that is its time derivative, from this project's annotation in FMI 2.0
    optional_inputs input -> what it means if nothing feeds it, from this project's annotation
    parameter_sets  files of parameters that the FMU was built with, from this project's annotation
    """

    major: int = 0
    attributes: Mapping[str, str] = field(default_factory=dict)
    variables: tuple[DeclaredVariable, ...] = ()
    by_key: Mapping[int, DeclaredVariable] = field(default_factory=dict)
    structure: Mapping[str, tuple[Unknown, ...]] = field(default_factory=dict)
    units: tuple[UnitDefinition, ...] = ()
    types: Mapping[str, TypeDefinition] = field(default_factory=dict)
    interfaces: Mapping[str, Entry] = field(default_factory=dict)
    experiment: Entry | None = None
    categories: tuple[str, ...] = ()
    input_rates: Mapping[str, str] = field(default_factory=dict)
    optional_inputs: Mapping[str, str] = field(default_factory=dict)
    parameter_sets: tuple[ParameterSetFile, ...] = ()

    @cached_property
    def by_name(self) -> Mapping[str, DeclaredVariable]:
        """The variables by name, without aliases."""
        return {v.name: v for v in self.variables}

    def for_run(self, *names: str) -> ModelDescription:
        """The description without most local variables, of which FMUs can have 100 000, for a child process.

        Kept are those with these names, derivatives, states, dependencies, and the first `MAX_LOCALS`.
        """
        entries = [u for unknowns in self.structure.values() for u in unknowns]
        keys = {key for u in entries for key in u.dependencies or ()}
        kept = {u.variable for u in entries} | {self.by_key.get(-1 if k is None else k) for k in keys}
        kept |= {*self.states}
        kept |= {*self.of("local")[:MAX_LOCALS], *(v for name in names if (v := self.by_name.get(name)))}
        variables = tuple(v for v in self.variables if v.causality != "local" or v in kept)
        kept.update(variables)
        return replace(
            self, variables=variables, by_key={key: v for key, v in self.by_key.items() if v in kept}
        )

    def of(self, *causalities: str) -> tuple[DeclaredVariable, ...]:
        """The variables of some causalities."""
        return tuple(v for v in self.variables if v.causality in causalities)

    @property
    def token(self) -> str:
        """GUID or instantiation token."""
        return self.attributes.get("guid" if self.major == 2 else "instantiationToken", "")

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The model identifiers, without duplicates."""
        return tuple(dict.fromkeys(e.get("modelIdentifier") for e in self.interfaces.values()))

    @cached_property
    def derivatives(self) -> tuple[DeclaredVariable, ...]:
        """The declared time derivatives of the continuous states, in the order of the state vector."""
        return tuple(u.variable for u in self.structure.get("derivatives", ()) if u.variable)

    @cached_property
    def states(self) -> tuple[DeclaredVariable, ...]:
        """The continuous states that belong to the declared derivatives, without duplicates."""
        return tuple(dict.fromkeys(s for v in self.derivatives if (s := self.state_of(v))))

    def state_of(self, derivative: DeclaredVariable) -> DeclaredVariable | None:
        """The variable whose time derivative `derivative` is, or None."""
        key = parse_int(derivative.attributes.get("derivative"))
        return None if key is None else self.by_key.get(key)
