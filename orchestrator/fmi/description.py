"""What an importer needs to know of an FMU: its variables, their dependencies, and what it is able to do.

`read_interface` takes it from modelDescription.xml and refuses, in one line, what cannot be run here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from orchestrator.base.errors import Problem, Unsupported
from orchestrator.base.files import Location
from orchestrator.base.units import BASES, DeclaredUnit
from orchestrator.base.xml import parse
from orchestrator.fmi.raw_description import (
    COMBINATIONS,
    FLOATS,
    INTERFACES,
    SIGNED,
    UNSIGNED,
    DeclaredVariable,
    ModelDescription,
    UnitDefinition,
    Unknown,
    parse_int,
)
from orchestrator.fmi.read_description import read_description

Value = float | int | bool | str

KINDS = {
    **dict.fromkeys(FLOATS, "Real"),
    **dict.fromkeys((*SIGNED, *UNSIGNED), "Integer"),
    **{kind: kind for kind in ("Boolean", "String", "Enumeration")},
}
MAX_LISTED = 5  # names in a list


@dataclass(frozen=True)
class FmuVariable:
    """One scalar variable.

    kind      Real, Integer, Boolean, String or Enumeration
    word      what FMI 3.0 calls its type in functions: Float64, Int32, ...; empty in FMI 2.0
    nominal   its usual magnitude, where the FMU tells one
    text      its description
    minimum, maximum   of its values, in its unit, as the FMU declares them
    """

    name: str
    kind: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    initial: str | None = None
    reference: int = 0
    unit: DeclaredUnit | None = None
    start: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    nominal: float | None = None
    description: str = ""
    fmi_type: str = ""
    minimum: float | None = None
    maximum: float | None = None

    @property
    def is_real(self) -> bool:
        return self.kind == "Real"

    @property
    def is_continuous(self) -> bool:
        """May it change inside a step? Real variables that are discrete or tunable do not."""
        return self.is_real and self.variability == "continuous"

    @property
    def settable(self) -> bool:
        """True when a start value may be given before initialisation."""
        return self.variability != "constant" and (
            self.causality in ("input", "parameter") or self.initial in ("exact", "approx")
        )


@dataclass(frozen=True)
class FmuInterface:
    """The declared outside of one FMU.

    feedthrough   output -> inputs it depends on directly; None when the FMU does not say
    initially     output -> variables it depends on in initialisation mode; None when the FMU does not say
    fmi           2 or 3
    refused       variables that cannot be used here -> what they are
    interpolates  the FMU accepts derivatives of its inputs by a function, which FMI 3.0 lacks
    rates         input -> the input that the FMU declares as its time derivative
    slopes        highest order of output derivatives it offers
    rollback      the FMU can save and restore its state
    serializes    it can turn a saved state into bytes
    only_one      only one instance of it may exist in a process
    needs_tool    it runs only where the tool that made it is installed
    indicators    number of its event indicators, in model exchange
    varies        it takes steps of any length; else all have to be of the same
    stateless     it declares, for model exchange, that it has no continuous states
    inert         inputs that, as it declares, neither a state nor an output depends on after the start
    directional   it offers directional derivatives
    states        continuous state -> its time derivative; empty where the FMU does not list all of them
    knowns        output or time derivative of a state -> inputs and states it depends on; None: not declared
    start, step, stop, tolerance   of the experiment that the FMU suggests
    version, tool, text   of the FMU: its version, what made it, its description
    """

    variables: Mapping[str, FmuVariable]
    feedthrough: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    initial_dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    identifier: str = ""
    guid: str = ""
    fmi: int = 2
    unsupported: Mapping[str, str] = field(default_factory=dict)
    can_interpolate_inputs: bool = False
    rate_inputs: Mapping[str, str] = field(default_factory=dict)
    max_output_derivative_order: int = 0
    rollback: bool = False
    can_serialize: bool = False
    one_per_process: bool = False
    needs_execution_tool: bool = False
    event_indicators: int = 0
    variable_step: bool = True
    stateless: bool = False
    unused_inputs: frozenset[str] = frozenset()
    directional_derivatives: bool = False
    states: Mapping[str, str] = field(default_factory=dict)
    dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    categories: tuple[str, ...] = ()
    start: float | None = None
    step: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    version: str = ""
    tool: str = ""
    description: str = ""

    def of(self, causality: str) -> list[FmuVariable]:
        """All variables of one causality, in declaration order."""
        return [v for v in self.variables.values() if v.causality == causality]

    def direct_inputs(self, output: str) -> frozenset[str]:
        """Inputs that feed directly through to `output`; all of them when the FMU does not say."""
        known = self.feedthrough.get(output)
        return frozenset(v.name for v in self.of("input")) if known is None else known

    def initial_knowns(self, output: str) -> frozenset[str]:
        """Variables that decide `output` in initialisation mode."""
        known = self.initial_dependencies.get(output)
        if known is None:
            return frozenset(v.name for v in self.variables.values() if v.settable)
        return known

    def may_affect(self, variable: str, outputs: Iterable[str]) -> bool:
        """False for an input that none of these outputs depends on: not directly, and there is no state."""
        return not self.stateless or any(variable in self.direct_inputs(y) for y in outputs)

    @property
    def ramp_inputs(self) -> frozenset[str]:
        """Inputs that a master may move inside a step at a constant slope."""
        if self.can_interpolate_inputs:
            return frozenset(v.name for v in self.of("input") if v.is_real)
        return frozenset(u for u, rate in self.rate_inputs.items() if rate not in self.rate_inputs)

    def check_supported(self, variable: str, where: str) -> None:
        """Refuse, beginning with `where`, a variable of a kind that is not supported."""
        if variable in self.unsupported:
            kind = self.unsupported[variable]
            raise Unsupported(f"{where}: expected a scalar number or text, got {kind}, not supported")

    @property
    def unsupported_note(self) -> str:
        """The refused variables as text; empty when there are none."""
        told = [f"{name}, {what}" for name, what in self.unsupported.items()]
        more = f"; and {len(told) - MAX_LISTED} more" if len(told) > MAX_LISTED else ""
        return f"left out: {'; '.join(told[:MAX_LISTED])}{more}" if told else ""


SECOND_EXPONENTS = (0, 0, 1, 0, 0, 0, 0, 0)


def read_interface(fmu: Location, exchange: bool = False) -> FmuInterface:
    """Read the model description of an FMU, FMI 2.0 or 3.0 (file, archive member or folder).

    exchange   as an FMU for Model Exchange; else for Co-Simulation
    """
    root = parse(fmu.member("modelDescription.xml"), "fmiModelDescription")
    version = root.get("fmiVersion")
    if not re.fullmatch(r"2\.0|3\.\d+(\.\d+)?", version or ""):
        raise Problem(f"{fmu}: expected FMI version 2.0 or 3.0, got {version}")
    description = read_description(root, int(version[0]))
    wanted = "ModelExchange" if exchange else "CoSimulation"
    if wanted not in description.interfaces:
        there = " and ".join(name for kind, name in INTERFACES.items() if kind in description.interfaces)
        raise Problem(
            f"{fmu}: expected an FMU for {INTERFACES[wanted]}, got one for {there or 'nothing'} only"
        )
    try:
        return _interface(description, wanted)
    except Problem as problem:
        raise Problem(f"{fmu}: {problem}") from None


def _interface(description: ModelDescription, kind: str) -> FmuInterface:
    fmi, able, about = description.major, description.interfaces[kind], description.attributes
    units = {u.name: _unit(u) for u in description.units}
    declared = list(_with_aliases(description))
    refused = {v.name: what for v in declared if (what := _refusal(v))}
    variables = {v.name: _variable(v, description, units) for v in declared if v.name not in refused}
    _check(variables, refused, declared)
    inputs = {name for name, v in variables.items() if v.causality == "input"}
    feedthrough = {v.name: None for v in variables.values() if v.causality == "output"}
    outputs, derivatives, initial = (
        _dependencies(description, description.structure[section])
        for section in ("outputs", "derivatives", "initial")
    )
    exchange = "ModelExchange" in description.interfaces
    needed = [*outputs.values(), *derivatives.values()]
    silent = not exchange or None in needed
    experiment = description.experiment.attributes if description.experiment else {}
    indicators = description.structure["indicators"]
    return FmuInterface(
        variables=variables,
        feedthrough=feedthrough | {o: d if d is None else d & inputs for o, d in outputs.items()},
        initial_dependencies=outputs | initial,
        identifier=able.get("modelIdentifier"),
        guid=description.token,
        fmi=fmi,
        unsupported=refused,
        can_interpolate_inputs=able.declares("canInterpolateInputs") and fmi == 2,
        rate_inputs=_rates(declared, description, variables),
        max_output_derivative_order=parse_int(able.get("maxOutputDerivativeOrder")) or 0,
        rollback=able.declares("canGetAndSetFMUstate", "canGetAndSetFMUState"),
        can_serialize=able.declares("canSerializeFMUstate", "canSerializeFMUState"),
        one_per_process=able.declares("canBeInstantiatedOnlyOncePerProcess"),
        needs_execution_tool=able.declares("needsExecutionTool"),
        event_indicators=len(indicators)
        if fmi == 3
        else parse_int(about.get("numberOfEventIndicators")) or 0,
        variable_step=able.declares("canHandleVariableCommunicationStepSize"),
        stateless=exchange and not derivatives,
        unused_inputs=frozenset()
        if silent
        else frozenset(inputs.difference(*(d for d in needed if d is not None))),
        states=_states(description, variables),
        dependencies=outputs | derivatives,
        directional_derivatives=able.declares(
            "providesDirectionalDerivative", "providesDirectionalDerivatives"
        ),
        categories=description.categories,
        start=_number(experiment, "startTime"),
        step=_number(experiment, "stepSize") or _number(able.attributes, "fixedInternalStepSize"),
        stop=_number(experiment, "stopTime"),
        tolerance=_number(experiment, "tolerance"),
        version=about.get("version", ""),
        tool=about.get("generationTool", ""),
        description=about.get("description", ""),
    )


def _with_aliases(description: ModelDescription) -> Iterator[DeclaredVariable]:
    """The variables, then their aliases as variables of their own."""
    yield from (v for v in description.variables if v.name)
    for v in description.variables:
        for alias in v.aliases:
            yield replace(v, name=alias.get("name"), attributes={**v.attributes, **alias.attributes})


def _refusal(v: DeclaredVariable) -> str:
    """What a variable is that cannot be used here; empty for the others."""
    if v.clocked:
        return "a clock" if v.type == "Clock" else f"a clocked {v.type}"
    if v.type not in KINDS:
        return f"a variable of type {v.type}"
    return f"an array of shape ({', '.join(map(str, v.shape))})" if v.shape else ""


def _check(
    variables: Mapping[str, FmuVariable], refused: Mapping[str, str], declared: Iterable[DeclaredVariable]
) -> None:
    """Refuse what cannot be run at all: clocks, arrays only, a time that is not in seconds."""
    for name, what in refused.items():
        if "clock" in what:  # such an FMU must be run with event mode
            raise Problem(f"{name} is {what}: expected an FMU without clocks, they are not supported")
    outside = [v.name for v in declared if v.causality in ("input", "output")]
    if outside and not any(name in variables for name in outside):
        first = f"{outside[0]} is {refused[outside[0]]}"
        raise Problem(f"{first}: expected an FMU with scalar inputs or outputs, arrays are not supported")
    for v in variables.values():
        unit = v.unit if v.causality == "independent" else None
        if unit and unit.exponents and (unit.exponents, unit.factor, unit.offset) != (SECOND_EXPONENTS, 1, 0):
            raise Problem(f"{v.name}: expected time in seconds, got {unit}")


def _variable(
    v: DeclaredVariable, description: ModelDescription, units: Mapping[str, DeclaredUnit]
) -> FmuVariable:
    """A scalar variable; raises Problem, by name, for what no FMU may declare."""
    type_ = v.attributes.get("declaredType")
    if type_ is not None and type_ not in description.types:
        raise Problem(f"{v}: declaredType {type_!r} is not defined")
    if v.reference is None:
        raise Problem(f"{v}: valueReference {v.attributes.get('valueReference')!r}, expected a whole number")
    if (v.causality, v.variability) not in COMBINATIONS and not v.get("initial"):
        raise Problem(f"{v}: causality {v.causality} with variability {v.variability} is not allowed")
    word = "Int64" if v.type == "Enumeration" else v.type
    items = description.types[type_].items if type_ and v.type == "Enumeration" else ()
    try:
        values = {name: int(value) for name, value in items}
        nominal, minimum, maximum = (_number(v.attributes, name) for name in ("nominal", "min", "max"))
    except (Problem, ValueError) as problem:
        raise Problem(f"{v}: {problem}") from None
    return FmuVariable(
        name=v.name,
        kind=KINDS[v.type],
        causality=v.causality,
        variability=v.variability,
        initial=v.initial or ("exact" if v.causality == "input" else None),
        reference=v.reference,
        unit=units.get(v.unit, DeclaredUnit(v.unit)) if v.unit else None,
        start=" ".join(v.starts) if v.starts else None,
        items=values,
        nominal=nominal if v.is_float else None,
        description=v.get("description"),
        fmi_type=word if description.major == 3 else "",
        minimum=minimum,
        maximum=maximum,
    )


def _unit(unit: UnitDefinition) -> DeclaredUnit:
    if unit.base_unit is None:
        return DeclaredUnit(unit.name)
    try:
        exponents = tuple(int(unit.base_unit.get(b, "0")) for b in BASES)
        factor, offset = float(unit.base_unit.get("factor", "1")), float(unit.base_unit.get("offset", "0"))
    except ValueError as error:
        raise Problem(f"modelDescription.xml line {unit.line}: unit {unit.name}: {error}") from None
    return DeclaredUnit(unit.name, exponents, factor, offset)


def _dependencies(
    description: ModelDescription, unknowns: Iterable[Unknown]
) -> dict[str, frozenset[str] | None]:
    """Names of unknowns -> names of what they depend on, with aliases; None where the FMU does not say."""
    found: dict[str, frozenset[str] | None] = {}
    for u in unknowns:
        if u.variable is None:
            raise Problem(f"{u}: expected a variable, found none with number {u.key}")
        known = None
        if u.dependencies is not None:
            variables = [description.by_key.get(-1 if key is None else key) for key in u.dependencies]
            if None in variables:
                raise Problem(f"{u}: dependency {u.dependencies[variables.index(None)]} is no variable")
            known = frozenset(name for v in variables if v for name in v.names)
        found |= dict.fromkeys(u.variable.names, known)
    return found


def _states(description: ModelDescription, variables: Mapping[str, FmuVariable]) -> dict[str, str]:
    """Continuous states and their time derivatives; empty where one of them is missing or cannot be used."""
    pairs = [(description.state_of(v), v) for v in description.derivatives]
    found = {state.name: v.name for state, v in pairs if state}
    complete = len(found) == len(pairs)
    return found if complete and all(name in variables for pair in found.items() for name in pair) else {}


def _rates(
    declared: Iterable[DeclaredVariable], description: ModelDescription, variables: Mapping[str, FmuVariable]
) -> dict[str, str]:
    """Inputs and the inputs that are their time derivatives, where the units agree.

    Declared by the attribute `derivative`, or, in FMI 2.0, by our annotation: OMSimulator takes a variable
    with that attribute for the derivative of a state.
    """
    pairs = {state.name: v.name for v in declared if (state := description.state_of(v))}
    pairs.update(description.input_rates)
    known = ((variables.get(u), variables.get(rate)) for u, rate in pairs.items())
    return {
        u.name: rate.name
        for u, rate in known
        if u and rate and u.causality == rate.causality == "input" and _per_second(u.unit, rate.unit)
    }


def _per_second(unit: DeclaredUnit | None, rate: DeclaredUnit | None) -> bool:
    """Is the second unit the first one per second?"""
    if unit is None or rate is None:
        return unit is rate
    if unit.exponents is None or rate.exponents is None or unit.offset or rate.offset:
        return False
    expected = tuple(a - b for a, b in zip(unit.exponents, SECOND_EXPONENTS, strict=True))
    return rate.exponents == expected and rate.factor == unit.factor


def _number(attributes: Mapping[str, str], name: str) -> float | None:
    text = attributes.get(name)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise Problem(f"{name}: expected a number, got {text!r}") from None
