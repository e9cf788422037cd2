"""Content of modelDescription.xml as data classes, common to FMI 2.0 and 3.0, without validation.

Attributes are stored as text, because any of them can be invalid; properties that read a number from one
raise ValueError then. The rules of `orchestrator.check` validate the attributes. `orchestrator.fmi.interface`
refuses descriptions that cannot be run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from itertools import product

from orchestrator.base.numerals import fraction, integer, real
from orchestrator.base.units import BASES, DeclaredUnit
from orchestrator.base.xml import Element, attributes_of, child, children, local_name

Value = float | int | bool | str
WHOLE = 2**53  # all whole numbers up to here are numbers of a trace, which are float64

FLOATS = ("Real", "Float64", "Float32")
SIGNED = {"Integer": 32, "Int8": 8, "Int16": 16, "Int32": 32, "Int64": 64}  # type -> bits
UNSIGNED = {"UInt8": 8, "UInt16": 16, "UInt32": 32, "UInt64": 64}
NUMERIC = (*FLOATS, *SIGNED, *UNSIGNED, "Enumeration", "Boolean")
TYPES = (*NUMERIC, "String", "Binary", "Clock")
KINDS = {  # type -> type in FMI 2.0, for those that can be run
    **dict.fromkeys(FLOATS, "Real"),
    **dict.fromkeys((*SIGNED, *UNSIGNED), "Integer"),
    **{kind: kind for kind in ("Boolean", "String", "Enumeration", "Binary", "Clock")},
}
MAX_LOCALS = 100  # local variables that are observed if the FMU has no outputs
BOOLEANS = {"true": 1.0, "false": 0.0}
INTERFACES = {  # element -> name of the interface type
    "ModelExchange": "model exchange",
    "CoSimulation": "co-simulation",
    "ScheduledExecution": "scheduled execution",
}
INITIAL: dict[tuple[str, str], tuple[str, ...]] = {
    **{(c, v): ("exact",) for c in ("parameter", "structuralParameter") for v in ("fixed", "tunable")},
    **{
        (c, v): ("calculated", "approx")
        for c in ("calculatedParameter", "local")
        for v in ("fixed", "tunable")
    },
    **{
        (c, v): ("calculated", "exact", "approx")
        for c in ("output", "local")
        for v in ("discrete", "continuous")
    },
    **{(c, "constant"): ("exact",) for c in ("output", "local")},
    **{("input", v): () for v in ("discrete", "continuous")},
    ("independent", "continuous"): (),
}  # (causality, variability), all that are allowed -> allowed values of `initial`, the default first
INITIAL_3 = INITIAL | {("input", v): ("exact",) for v in ("discrete", "continuous")}  # in FMI 3.0


def parse_int(text: str | None) -> int | None:
    """An integer; None for any other text."""
    try:
        return None if text is None else integer(text)
    except ValueError:
        return None


def parse_float(text: str | None) -> float | None:
    """A number; None for any other text."""
    try:
        return None if text is None else real(text)
    except ValueError:
        return None


def parse_numbers(text: str) -> tuple[float, ...]:
    """Numbers and booleans, separated by white space; ValueError for any other text."""
    return tuple(BOOLEANS[w] if w in BOOLEANS else real(w) for w in text.split())


@dataclass(frozen=True, eq=False, kw_only=True)
class Entry:
    """An XML element: its line and its attributes."""

    line: int = 0
    attributes: Mapping[str, str] = field(default_factory=dict, repr=False)

    def get(self, name: str, default: str = "") -> str:
        """The text of an attribute."""
        return self.attributes.get(name, default)

    def number(self, name: str) -> float | None:
        """The value of an attribute; None if it is missing."""
        text = self.attributes.get(name)
        return None if text is None else real(text)

    def declares(self, *names: str) -> bool:
        """True if one of these attributes is true or above 0; FMI 2.0 and 3.0 spell some differently."""
        return any(self.get(name) == "true" or (parse_int(self.get(name)) or 0) > 0 for name in names)


@dataclass(frozen=True, eq=False)
class TypeDefinition(Entry):
    """A declared type; `type`: Real, Enumeration, ...; `items`: names and values of an enumeration."""

    type: str
    items: tuple[tuple[str, str], ...] = ()

    @cached_property
    def values(self) -> Mapping[str, int]:
        """The values of an enumeration by name."""
        return {name: integer(value) for name, value in self.items}


@dataclass(frozen=True, eq=False)
class FmuVariable(Entry):
    """A variable; missing attributes are those of its declared type.

    type         Real, Float64, ...
    initial      the attribute or its default; "" if there is none
    reference    value reference; -1 for a text that is not a number
    unit         of a floating-point variable; None if there is none
    starts       texts of the start values; None if there are none
    definition   the declared type, if it exists
    fmi          FMI version
    shape        of an array (FMI 3.0); None for a dimension that is not a number; () for a scalar
    sizes        value reference of the structural parameter that is the size of each dimension; None: fixed
    aliases      further names (FMI 3.0)
    array        of an element: the array that has it; position: its place there, row by row
    """

    name: str
    type: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    initial: str = ""
    reference: int = 0
    unit: DeclaredUnit | None = None
    starts: tuple[str, ...] | None = None
    definition: TypeDefinition | None = None
    fmi: int = 2
    shape: tuple[int | None, ...] = ()
    sizes: tuple[int | None, ...] = ()
    aliases: tuple[Entry, ...] = ()
    array: FmuVariable | None = None
    position: int = 0

    def __str__(self) -> str:
        return f"modelDescription.xml line {self.line}: {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """The name and the aliases; those of an array are the names of its elements."""
        names = self.name, *(a.get("name") for a in self.aliases)
        return tuple(e for name in names for e in self._elements_of(name)) if self.shape else names

    @cached_property
    def elements(self) -> tuple[str, ...]:
        """The names of the elements of an array, row by row: y[1,1], y[1,2] ...; the name of a scalar."""
        return tuple(self._elements_of(self.name)) if self.shape else (self.name,)

    def _elements_of(self, name: str) -> Iterator[str]:
        places = product(*(range(1, (n or 0) + 1) for n in self.shape))
        return (f"{name}[{','.join(map(str, place))}]" for place in places)

    @property
    def scalars(self) -> Iterator[FmuVariable]:
        """The elements of an array as scalar variables; a scalar itself. One start value is that of all."""
        if not self.shape:
            yield self
            return
        starts = (self.starts or ()) * (self.size if len(self.starts or ()) == 1 else 1)
        for k, name in enumerate(self.elements):
            start = (starts[k],) if starts else None
            yield replace(
                self, name=name, shape=(), sizes=(), aliases=(), starts=start, array=self, position=k
            )

    def sized(self, lengths: Mapping[int, int]) -> FmuVariable:
        """The variable with other values of structural parameters, by reference; start values must fit."""
        pairs = zip(self.shape, self.sizes, strict=True)
        shape = tuple(n if of is None else lengths.get(of, n) for n, of in pairs)
        if shape == self.shape:
            return self
        fits = len(self.starts or ()) in (1, math.prod(n or 0 for n in shape))
        return replace(self, shape=shape, starts=self.starts if fits else None)

    @property
    def kind(self) -> str:
        """The type in FMI 2.0: Real, Integer, Boolean, String or Enumeration; Binary or Clock."""
        return KINDS.get(self.type, "")

    @property
    def value_type(self) -> str:
        """The type of the values: Real, Integer, Boolean or String; those of enumerations are integers."""
        return "Integer" if self.kind == "Enumeration" else self.kind

    def typed(self, value: Value) -> Value:
        """A value of another variable as one of this variable; neither is a String."""
        if self.is_real:
            return float(value)
        if self.kind == "Boolean":
            return bool(value)
        return round(value) if isinstance(value, float) else int(value)

    @property
    def function_type(self) -> str:
        """The type in the names of the FMI functions that get and set it, such as Real or Float64."""
        return self.type if self.type != "Enumeration" else "Integer" if self.fmi == 2 else "Int64"

    @property
    def mark(self) -> str:
        """How messages of the FMU name it: 12 in FMI 3.0, r12 for a Real variable in FMI 2.0 (2.1.5)."""
        return f"{self.function_type[0].lower() if self.fmi == 2 else ''}{self.reference}"

    @property
    def is_real(self) -> bool:
        return self.type in FLOATS

    @property
    def is_continuous(self) -> bool:
        """True for a real variable that can change inside a step, which is neither discrete nor tunable."""
        return self.is_real and self.variability == "continuous" and not self.clocks

    @property
    def is_number(self) -> bool:
        return self.type in NUMERIC

    @property
    def settable(self) -> bool:
        """True if the start value can be set before initialisation."""
        return self.variability != "constant" and (
            self.causality in ("input", "parameter") or self.initial in ("exact", "approx")
        )

    @property
    def clocks(self) -> tuple[int | None, ...]:
        """The value references of the clocks that it belongs to."""
        return tuple(map(parse_int, self.get("clocks").split()))

    @property
    def clocked(self) -> bool:
        return bool(self.get("clocks")) or self.type == "Clock"

    @property
    def is_triggered_input(self) -> bool:
        """Is it a clock that ticks with the one that is connected to it?"""
        return self.causality == "input" and self.get("intervalVariability") == "triggered"

    def fraction(self, name: str) -> Fraction | None:
        """`interval` or `shift` of a clock [s], exactly as it is declared; None if it is not.

        With `supportsFraction` the fraction is the exact one, else the decimal number. Raises ValueError for
        what is no number of seconds.
        """
        decimal, counter = self.get(f"{name}Decimal"), self.get(f"{name}Counter")
        resolution = self.get("resolution")
        exact = counter and resolution and (self.declares("supportsFraction") or not decimal)
        if not exact:
            return fraction(decimal) if decimal else None
        if (parts := integer(resolution)) < 1:
            raise ValueError(f"expected a resolution of 1 or more, got {resolution!r}")
        return Fraction(integer(counter), parts)

    @property
    def description(self) -> str:
        return self.get("description")

    @property
    def unit_name(self) -> str | None:
        return self.attributes.get("unit") if self.is_real else None

    @property
    def items(self) -> Mapping[str, int]:
        """Names and values of an enumeration."""
        return self.definition.values if self.definition and self.type == "Enumeration" else {}

    @cached_property
    def size(self) -> int:
        """Number of scalar elements."""
        lengths = [n for n in self.shape if n is not None]
        if len(lengths) < len(self.shape):
            raise ValueError(f"{self.name} has a dimension that is not a number")
        return math.prod(lengths)

    @property
    def start(self) -> str | None:
        """Text of the start value."""
        return " ".join(self.starts) if self.starts else None

    @cached_property
    def start_values(self) -> tuple[float, ...]:
        """Start values of a numeric variable."""
        return parse_numbers(self.start or "") if self.is_number else ()

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Minimum and maximum of a numeric variable, infinite if not declared."""
        if not self.is_number:
            return -math.inf, math.inf
        return real(self.get("min", "-inf")), real(self.get("max", "inf"))

    @cached_property
    def nominal(self) -> float | None:
        """The nominal value of a floating-point variable."""
        return self.number("nominal") if self.is_real else None

    @cached_property
    def magnitude(self) -> float:
        """Magnitude of the nominal value; default: 1."""
        return abs(self.number("nominal") or 1.0)

    @cached_property
    def scale(self) -> float:
        """Typical magnitude: the largest of that of the nominal value and the finite start values."""
        return max([abs(s) for s in self.start_values if math.isfinite(s)] + [self.magnitude])


@dataclass(frozen=True, eq=False)
class Unknown:
    """An entry of ModelStructure; `key` is an index (FMI 2.0) or a value reference (FMI 3.0)."""

    section: str
    line: int
    key: int | None
    dependencies: tuple[int | None, ...] | None
    dependency_kinds: tuple[str, ...] | None
    variable: FmuVariable | None = None

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

    @cached_property
    def declared(self) -> DeclaredUnit:
        """The unit for conversions; a text that is not a number is a fault, and NaN as factor or offset."""
        if self.base_unit is None:
            return DeclaredUnit(self.name)
        texts = self.base_unit.get("factor", "1"), self.base_unit.get("offset", "0")
        factor, offset = (math.nan if (number := parse_float(t)) is None else number for t in texts)
        try:
            exponents = tuple(integer(self.base_unit.get(b, "0")) for b in BASES)
            _ = [*map(real, texts)]
        except ValueError as error:
            return DeclaredUnit(self.name, None, factor, offset, str(error))
        return DeclaredUnit(self.name, exponents, factor, offset)


@dataclass(frozen=True)
class ParameterSetFile:
    """A file of parameter values that an FMU was built with: its name, and its SHA-256.

    shipped   parameter -> text of the value in the shipped FMU, for those that differ from it
    """

    file: str
    sha256: str
    shipped: Mapping[str, str]


@dataclass(frozen=True)
class ModelDescription(Entry):
    """The content of modelDescription.xml, in the order of the file.

    major           FMI version, 2 or 3; 0 if unknown, then all other fields are empty
    attributes      of the root element
    by_key          variables by the keys of ModelStructure: index (FMI 2.0) or value reference (FMI 3.0)
    structure       outputs, derivatives, initial, clocked, indicators -> entries of ModelStructure
    interfaces      ModelExchange, CoSimulation, ScheduledExecution -> element
    categories      log categories
    input_rates     input -> input that is its time derivative, from this project's annotation in FMI 2.0
    optional_inputs input -> what it means if nothing feeds it, from this project's annotation
    held_inputs     inputs that the FMU takes as constant in a step, from this project's annotation
    noisy_outputs   outputs that jump by noise or a resolution, from this project's annotation
    parameter_sets  files of parameters that the FMU was built with, from this project's annotation
    original        the description of the file, if structural parameters have other values
    """

    major: int = 0
    variables: tuple[FmuVariable, ...] = ()
    by_key: Mapping[int, FmuVariable] = field(default_factory=dict)
    structure: Mapping[str, tuple[Unknown, ...]] = field(default_factory=dict)
    units: tuple[UnitDefinition, ...] = ()
    types: Mapping[str, TypeDefinition] = field(default_factory=dict)
    interfaces: Mapping[str, Entry] = field(default_factory=dict)
    experiment: Entry = field(default_factory=Entry)
    categories: tuple[str, ...] = ()
    input_rates: Mapping[str, str] = field(default_factory=dict)
    optional_inputs: Mapping[str, str] = field(default_factory=dict)
    held_inputs: frozenset[str] = frozenset()
    noisy_outputs: frozenset[str] = frozenset()
    parameter_sets: tuple[ParameterSetFile, ...] = ()
    original: ModelDescription | None = None

    @cached_property
    def by_name(self) -> Mapping[str, FmuVariable]:
        """The variables by name, without aliases."""
        return {v.name: v for v in self.variables}

    def for_run(self) -> ModelDescription:
        """The description without most local variables, of which FMUs can have 100 000, for a child process.

        Kept are derivatives, states, dependencies, and the first `MAX_LOCALS`.
        """
        entries = [u for unknowns in self.structure.values() for u in unknowns]
        keys = {key for u in entries for key in u.dependencies or ()}
        kept = {u.variable for u in entries} | {self.by_key.get(-1 if k is None else k) for k in keys}
        kept |= {*self.states, *self.of("local")[:MAX_LOCALS]}
        variables = tuple(v for v in self.variables if v.causality != "local" or v in kept)
        kept.update(variables)
        by_key = {key: v for key, v in self.by_key.items() if v in kept}
        return replace(self, variables=variables, by_key=by_key)

    def of(self, *causalities: str) -> tuple[FmuVariable, ...]:
        """The variables of some causalities."""
        return tuple(v for v in self.variables if v.causality in causalities)

    def resized(self, lengths: Mapping[int, int]) -> ModelDescription:
        """The description with other values of structural parameters, by value reference."""
        sized = {v: v.sized(lengths) for v in self.variables}
        structure = {
            section: tuple(replace(u, variable=sized.get(u.variable) if u.variable else None) for u in of)
            for section, of in self.structure.items()
        }
        by_key = {key: sized[v] for key, v in self.by_key.items()}
        variables = tuple(sized.values())
        return replace(self, variables=variables, by_key=by_key, structure=structure, original=self)

    @property
    def token(self) -> str:
        """GUID or instantiation token."""
        return self.get("guid" if self.major == 2 else "instantiationToken")

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The model identifiers, without duplicates."""
        return tuple(dict.fromkeys(e.get("modelIdentifier") for e in self.interfaces.values()))

    @cached_property
    def derivatives(self) -> tuple[FmuVariable, ...]:
        """The declared time derivatives of the continuous states, in the order of the state vector."""
        return tuple(u.variable for u in self.structure.get("derivatives", ()) if u.variable)

    @cached_property
    def states(self) -> tuple[FmuVariable, ...]:
        """The continuous states that belong to the declared derivatives, without duplicates."""
        return tuple(dict.fromkeys(s for v in self.derivatives if (s := self.state_of(v))))

    def state_of(self, derivative: FmuVariable) -> FmuVariable | None:
        """The variable whose time derivative `derivative` is, or None."""
        key = parse_int(derivative.attributes.get("derivative"))
        return None if key is None else self.by_key.get(key)


# ---- reading

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
NOISY = (
    "VendorAnnotations/Tool[@name='harvester-cosim.outputs']//NoisyOutput",
    "Annotations/Annotation[@type='harvester-cosim.outputs']//NoisyOutput",
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
    units = tuple(map(_unit, children(root, "UnitDefinitions", "Unit")))
    known = {u.name: u.declared for u in units}
    variables = tuple(_variable(e, major, types, known, lengths) for e in elements)
    keys = range(1, len(variables) + 1) if major == 2 else [v.reference for v in variables]
    by_key = {key: v for key, v in reversed([*zip(keys, variables, strict=True)]) if key != -1}
    structure = {}
    for section, paths in SECTIONS.items():
        path = paths[major - 2]
        entries = children(root, "ModelStructure", *path) if path else ()
        structure[section] = tuple(_unknown(e, "/".join(path), by_key, major) for e in entries)
    annotation = root.find(OWN_ANNOTATION[major - 2])
    rates, optional, held = (
        () if annotation is None else annotation.iterfind(f".//{name}")
        for name in ("InputDerivative", "OptionalInput", "HeldInput")
    )
    return ModelDescription(
        major=major,
        line=root.sourceline,
        attributes=attributes_of(root),
        variables=variables,
        by_key=by_key,
        structure=structure,
        units=units,
        types=types,
        interfaces={name: _entry(e) for name in INTERFACES if (e := child(root, name)) is not None},
        experiment=_entry(child(root, "DefaultExperiment")),
        categories=tuple(c.get("name", "") for c in children(root, "LogCategories", "Category")),
        input_rates={e.get("input"): e.get("derivative") for e in rates},
        optional_inputs={e.get("input"): text for e in optional if (text := e.get("without"))},
        held_inputs=frozenset(e.get("input") for e in held),
        noisy_outputs=frozenset(e.get("output") for e in root.iterfind(NOISY[major - 2])),
        parameter_sets=tuple(map(_parameter_set, root.iterfind(PARAMETERS[major - 2]))),
    )


def _parameter_set(element: Element) -> ParameterSetFile:
    shipped = {e.get("name", ""): e.get("shipped", "") for e in element.iterfind("Parameter")}
    return ParameterSetFile(element.get("file", ""), element.get("sha256", ""), shipped)


def _entry(element: Element | None) -> Entry:
    return Entry() if element is None else Entry(line=element.sourceline, attributes=attributes_of(element))


def _types(root: Element, major: int) -> Iterator[tuple[str, TypeDefinition]]:
    """Type definitions by name. FMI 2.0: a child of SimpleType. FMI 3.0: an element such as Float64Type."""
    definitions = child(root, "TypeDefinitions")
    for outer in () if definitions is None else definitions:
        inner = next((e for e in outer if local_name(e) in TYPES), None) if major == 2 else outer
        type_ = "" if inner is None else local_name(inner).removesuffix("Type")
        if inner is not None and type_ in TYPES:
            attributes = {k: v for k, v in attributes_of(inner).items() if k not in ("name", "description")}
            items = tuple((i.get("name", ""), i.get("value", "")) for i in children(inner, "Item"))
            yield (
                outer.get("name", ""),
                TypeDefinition(type_, items, line=inner.sourceline, attributes=attributes),
            )


def _variable(
    e: Element,
    major: int,
    types: Mapping[str, TypeDefinition],
    units: Mapping[str, DeclaredUnit],
    lengths: Mapping[str, int | None],
) -> FmuVariable:
    """A variable. FMI 2.0: a child of the element is the type. FMI 3.0: the element itself is the type."""
    inner = next((i for i in e if local_name(i) in TYPES), e) if major == 2 else e
    attributes = attributes_of(e)
    if inner is not e:
        attributes.update(attributes_of(inner))
    type_, causality = local_name(inner), attributes.get("causality", "local")
    variability = attributes.get("variability") or _variability(type_, causality, major)
    allowed = (INITIAL_3 if major == 3 else INITIAL).get((causality, variability))
    definition = types.get(attributes.get("declaredType", ""))
    complete = {**definition.attributes, **attributes} if definition else attributes
    name = complete.get("unit") if type_ in FLOATS else None
    unit = units.get(name, DeclaredUnit(name)) if name else None
    if unit and complete.get("relativeQuantity") in ("true", "1"):
        unit = replace(unit, relative=True)
    reference = parse_int(attributes.get("valueReference"))
    starts = tuple(s.get("value", "") for s in children(inner, "Start"))
    if not starts and "start" in attributes:
        many = major == 3 and type_ not in ("String", "Binary")
        starts = tuple(attributes["start"].split()) if many else (attributes["start"],)
    dimensions = [*children(e, "Dimension")] if major == 3 else []
    return FmuVariable(
        line=e.sourceline,
        attributes=complete,
        name=attributes.get("name", ""),
        fmi=major,
        type=type_,
        definition=definition,
        reference=-1 if reference is None else reference,
        causality=causality,
        variability=variability,
        initial=attributes.get("initial", allowed[0] if allowed else ""),
        unit=unit,
        starts=starts if starts or "start" in attributes else None,
        shape=tuple(
            parse_int(d.get("start")) if d.get("start") else lengths.get(d.get("valueReference"))
            for d in dimensions
        ),
        sizes=tuple(None if d.get("start") else parse_int(d.get("valueReference")) for d in dimensions),
        aliases=tuple(map(_entry, children(e, "Alias"))),
    )


def _variability(type_: str, causality: str, major: int) -> str:
    """Default variability. FMI 2.0 defines continuous for all types; tools use discrete except for Real."""
    if causality in ("parameter", "calculatedParameter", "structuralParameter") and major == 3:
        return "fixed"
    return "continuous" if type_ in FLOATS else "discrete"


def _unknown(e: Element, section: str, by_key: Mapping[int, FmuVariable], major: int) -> Unknown:
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
    displays = {d.get("name", ""): attributes_of(d) for d in children(unit, "DisplayUnit")}
    return UnitDefinition(
        unit.get("name", ""), unit.sourceline, None if base is None else attributes_of(base), displays
    )
