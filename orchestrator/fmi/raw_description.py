"""What modelDescription.xml says, the same for FMI 2.0 and 3.0, read without judging it.

Attributes stay text, since any of them may be nonsense: the rules of `orchestrator.check` judge them, and
`orchestrator.fmi.description` refuses what cannot be run. `orchestrator.fmi.read_description` reads the file.
Nothing here needs more than the standard library: a child process that is sent a description starts fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

FLOATS = ("Real", "Float64", "Float32")
SIGNED = {"Integer": 32, "Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64}  # type -> bits
UNSIGNED = {"UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
NUMERIC = (*FLOATS, *SIGNED, *UNSIGNED, "Enumeration", "Boolean")
TYPES = (*NUMERIC, "String", "Binary", "Clock")
BOOLEANS = {"true": 1.0, "false": 0.0}
INTERFACES = {  # element -> what it is called
    "ModelExchange": "model exchange",
    "CoSimulation": "co-simulation",
    "ScheduledExecution": "scheduled execution",
}
INITIAL = {  # default of `initial` by causality and variability, both versions
    **{(c, v): "exact" for c in ("parameter", "structuralParameter") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("calculatedParameter", "local") for v in ("fixed", "tunable")},
    **{(c, v): "calculated" for c in ("output", "local") for v in ("discrete", "continuous")},
    **{(c, "constant"): "exact" for c in ("output", "local")},
}
# causality and variability that go together, both versions
COMBINATIONS = {*INITIAL, ("input", "discrete"), ("input", "continuous"), ("independent", "continuous")}


def parse_int(text: str | None) -> int | None:
    """A whole number, or None."""
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def parse_numbers(text: str) -> tuple[float, ...]:
    """Numbers and truth values; raises ValueError for anything else."""
    return tuple(BOOLEANS[w] if w in BOOLEANS else float(w) for w in text.split())


@dataclass(frozen=True, eq=False)
class Entry:
    """An element of the file: its line and its attributes."""

    line: int
    attributes: Mapping[str, str]

    def get(self, name: str, default: str = "") -> str:
        """An attribute as written."""
        return self.attributes.get(name, default)

    def declares(self, *names: str) -> bool:
        """Is one of these attributes true, or above 0? The versions of FMI spell some in two ways."""
        return any(self.get(name) == "true" or (parse_int(self.get(name)) or 0) > 0 for name in names)


@dataclass(frozen=True, eq=False)
class DeclaredVariable(Entry):
    """One variable; its attributes include those of its declared type where it has none itself.

    index        place in the file, from 1
    type         Real, Float64, ...
    initial      as written, else its default; "" where there is none
    starts       start values as written; None when there are none
    shape        of an array (FMI 3), a length is None where it cannot be read; () for a scalar
    aliases      further names (FMI 3)
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
        """Its name and its aliases."""
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

    # ---- numbers; ValueError where the file has none

    @cached_property
    def size(self) -> int:
        """Number of its scalars."""
        lengths = [n for n in self.shape if n is not None]
        if len(lengths) < len(self.shape):
            raise ValueError(f"{self.name} has a dimension that is no number")
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
        """Its nominal value; 1 where it has none."""
        return abs(float(self.get("nominal", "1"))) or 1.0

    @cached_property
    def scale(self) -> float:
        """A typical magnitude."""
        return max([abs(s) for s in self.start if math.isfinite(s)] + [self.nominal])


@dataclass(frozen=True, eq=False)
class Unknown:
    """One entry of ModelStructure; `key` is an index (FMI 2) or a value reference (FMI 3)."""

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
    """One unit; `base` are the attributes of its BaseUnit."""

    name: str
    line: int
    base_unit: Mapping[str, str] | None
    display_units: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, eq=False)
class TypeDefinition(Entry):
    """One declared type; `type` is Real, Enumeration, ...; `items` of an enumeration are names and values."""

    type: str
    items: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ModelDescription:
    """The whole file; lists keep its order.

    major           2 or 3; 0 when unknown, then everything is empty
    attributes      of the root element
    by_key          what ModelStructure refers to: by index (FMI 2) or value reference (FMI 3)
    structure       outputs, derivatives, initial, clocked, indicators -> entries of ModelStructure
    interfaces      ModelExchange, CoSimulation, ScheduledExecution -> its element
    categories      of log messages
    input_rates     input -> input that carries its time derivative, by this project's annotation in FMI 2.0
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

    @cached_property
    def by_name(self) -> Mapping[str, DeclaredVariable]:
        """The variables by their first names."""
        return {v.name: v for v in self.variables}

    def of(self, *causalities: str) -> tuple[DeclaredVariable, ...]:
        """Variables of some causalities."""
        return tuple(v for v in self.variables if v.causality in causalities)

    @property
    def token(self) -> str:
        """GUID or instantiation token."""
        return self.attributes.get("guid" if self.major == 2 else "instantiationToken", "")

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The model identifiers, each once."""
        return tuple(dict.fromkeys(e.get("modelIdentifier") for e in self.interfaces.values()))

    @cached_property
    def derivatives(self) -> tuple[DeclaredVariable, ...]:
        """The listed time derivatives of the continuous states, in the order of the state vector."""
        return tuple(u.variable for u in self.structure.get("derivatives", ()) if u.variable)

    @cached_property
    def states(self) -> tuple[DeclaredVariable, ...]:
        """The continuous states: what the listed derivatives are derivatives of, each once."""
        return tuple(dict.fromkeys(s for v in self.derivatives if (s := self.state_of(v))))

    def state_of(self, derivative: DeclaredVariable) -> DeclaredVariable | None:
        """What a variable is the time derivative of."""
        key = parse_int(derivative.attributes.get("derivative"))
        return None if key is None else self.by_key.get(key)
