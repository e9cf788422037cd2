"""Interface of an FMU for an importer: variables, dependencies and capabilities.

`read_interface` reads it from modelDescription.xml and refuses FMUs that cannot be run.
"""

import pickle
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from sys import float_info
from typing import Any

from orchestrator.base.errors import NotExchangeable, Problem, Unsupported
from orchestrator.base.files import Location, is_file_name
from orchestrator.base.numerals import integer
from orchestrator.base.text import grouped
from orchestrator.base.units import DeclaredUnit
from orchestrator.base.xml import MAX_BYTES, parse_text
from orchestrator.fmi.description import (
    INITIAL,
    INTERFACES,
    Entry,
    FmuVariable,
    ModelDescription,
    Unknown,
    read_description,
)

CO_SIMULATION, MODEL_EXCHANGE = "CoSimulation", "ModelExchange"
MAX_LISTED = 5  # unsupported variables in a note
MAX_ELEMENTS = 10_000  # of an array, which are signals each
MAX_INDICATORS = 1_000_000
# bytes of a description whose interface is kept: 2500 variables, ten times as much in memory; number of them
LONGEST_KEPT, MOST_KEPT = 1 << 20, 64
# field of `FmuInterface` -> attribute of the interface type that declares it, in FMI 2.0 and in FMI 3.0
CAPABILITIES = {
    "rollback": ("canGetAndSetFMUstate", "canGetAndSetFMUState"),
    "one_per_process": ("canBeInstantiatedOnlyOncePerProcess",),
    "needs_execution_tool": ("needsExecutionTool",),
    "variable_step": ("canHandleVariableCommunicationStepSize",),
    "output_derivatives": ("maxOutputDerivativeOrder",),
    "event_mode": ("hasEventMode",),
    "early_return": ("mightReturnEarlyFromDoStep",),
    "directional_derivatives": ("providesDirectionalDerivative", "providesDirectionalDerivatives"),
}


@dataclass(frozen=True)
class FmuInterface:
    """The declared interface of an FMU.

    variables              supported variables, by name; of an array its elements
    arrays                 supported arrays, by name
    model                  the whole model description
    dependencies           output or state derivative -> inputs and states; None if not declared
    initial_dependencies   output -> variables it depends on in initialisation mode; None if not declared
    kind                   CO_SIMULATION or MODEL_EXCHANGE: how the FMU is used
    identifier             model identifier
    unsupported            unsupported variables -> their type
    can_interpolate_inputs a function takes time derivatives of inputs, as not in FMI 3.0 for Co-Simulation
    rate_inputs            input -> input that the FMU declares as its time derivative
    output_derivatives     the FMU provides time derivatives of outputs
    rollback               the FMU can save and restore its state
    one_per_process        only one instance can exist in a process
    needs_execution_tool   the FMU needs the installed tool that exported it
    event_indicators       number of event indicators, in Model Exchange
    completed_step         in Model Exchange, the FMU needs to know when the solver has accepted a step
    event_mode             for Co-Simulation in FMI 3.0: the FMU has event mode, and may stop at an event or
                           has signals that are not continuous
    early_return           the FMU may stop at an event inside of a step
    variable_step          the communication step size may vary
    stateless              the FMU declares, for Model Exchange, that it has no continuous states
    unused_inputs          inputs on which no state and no output depends after the initialisation
    directional_derivatives   the FMU provides directional derivatives
    states                 continuous state -> time derivative; empty unless the FMU lists all of them
    start, step, stop, tolerance   default experiment; times in [s]
    """

    variables: Mapping[str, FmuVariable]
    dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    initial_dependencies: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    kind: str = CO_SIMULATION
    identifier: str = ""
    model: ModelDescription = field(default_factory=lambda: ModelDescription(2))
    unsupported: Mapping[str, str] = field(default_factory=dict)
    can_interpolate_inputs: bool = False
    rate_inputs: Mapping[str, str] = field(default_factory=dict)
    output_derivatives: bool = False
    rollback: bool = False
    one_per_process: bool = False
    needs_execution_tool: bool = False
    event_indicators: int = 0
    completed_step: bool = True
    event_mode: bool = False
    early_return: bool = False
    variable_step: bool = True
    stateless: bool = False
    unused_inputs: frozenset[str] = frozenset()
    directional_derivatives: bool = False
    states: Mapping[str, str] = field(default_factory=dict)
    start: float | None = None
    step: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    arrays: Mapping[str, FmuVariable] = field(default_factory=dict)

    def nominal(self, name: str) -> float:
        """The nominal value of a variable; if it declares none, that of FMI, 1, or 0 if no variable does."""
        declared = self.variables[name].nominal
        return declared or float(any(v.nominal for v in self.variables.values()))

    def of(self, causality: str) -> Sequence[FmuVariable]:
        """All variables of one causality, in declaration order."""
        return self._of.get(causality, ())

    @cached_property
    def _of(self) -> dict[str, list[FmuVariable]]:
        return grouped(self.variables.values(), lambda v: v.causality)

    @cached_property
    def marks(self) -> dict[str, str]:
        """Mark of a variable in messages of FMUs -> its name."""
        return {v.mark: (v.array or v).name for v in self.variables.values()}

    def resized(self, values: Mapping[str, Any]) -> "FmuInterface":
        """The interface with other values of structural parameters, which are sizes of arrays."""
        sizes = {of for v in self.arrays.values() for of in v.sizes}
        given = ((self.variables[n].reference, value) for n, value in values.items() if n in self.variables)
        lengths = {reference: int(value) for reference, value in given if reference in sizes}
        if all(v.sized(lengths) is v for v in self.arrays.values()):
            return self
        return _checked((self.model.original or self.model).resized(lengths), self.kind)

    @cached_property
    def positions(self) -> dict[str, int]:
        """Variable -> its position among all variables."""
        return {name: k for k, name in enumerate(self.variables)}

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._pickled,)

    @cached_property
    def _pickled(self) -> bytes:
        """Made once for many runs in other processes, and without what is computed from the fields."""
        return pickle.dumps({f.name: getattr(self, f.name) for f in fields(self)}, pickle.HIGHEST_PROTOCOL)

    def direct_inputs(self, output: str) -> frozenset[str]:
        """Inputs with direct feedthrough to `output`; all inputs if the FMU declares no dependencies."""
        declared = self.dependencies.get(output)
        return self._inputs if declared is None else self._inputs & declared

    @cached_property
    def _inputs(self) -> frozenset[str]:
        return frozenset(v.name for v in self.of("input"))

    def initial_knowns(self, output: str) -> frozenset[str]:
        """Variables on which `output` depends in initialisation mode; all settable ones if not declared."""
        declared = self.initial_dependencies.get(output)
        if declared is None:
            return frozenset(v.name for v in self.variables.values() if v.settable)
        return declared

    @property
    def fixed_step(self) -> float:
        """The step of an FMU whose steps may not vary [s], if it declares it; else 0."""
        declared = _number(self.model.interfaces.get(self.kind, Entry()), "fixedInternalStepSize")
        return 0.0 if self.variable_step else declared or 0.0

    @property
    def linearisable(self) -> bool:
        """Does the FMU declare directional derivatives and all its states?"""
        return self.directional_derivatives and bool(self.states or self.stateless)

    def may_affect_states(self, variable: str) -> bool:
        """May a state depend on an input? True if states or dependencies of the FMU are not declared."""
        if not self.states:
            return not self.stateless or any(self.dependencies.get(y.name) is None for y in self.of("output"))
        dependencies = [self.dependencies.get(rate) for rate in self.states.values()]
        return any(names is None or variable in names for names in dependencies)

    @cached_property
    def has_clocks(self) -> bool:
        return any(v.kind == "Clock" for v in self.variables.values())

    @property
    def has_events(self) -> bool:
        """May the FMU have events inside a step, as far as its description says?"""
        return self.declares_events or (self.kind == MODEL_EXCHANGE and self.completed_step)

    @property
    def declares_events(self) -> bool:
        """Is the FMU made for events: by event mode, event indicators, or signals that are not continuous?"""
        ports = [*self.of("input"), *self.of("output")]
        exchange = self.event_indicators > 0 or any(v.variability == "discrete" for v in ports)
        return self.event_mode or (self.kind == MODEL_EXCHANGE and exchange)

    @cached_property
    def ramp_inputs(self) -> frozenset[str]:
        """Inputs whose time derivative can be set, so that they are ramps inside a step."""
        if self.can_interpolate_inputs:
            return frozenset(v.name for v in self.of("input") if v.is_real)
        return frozenset(u for u, rate in self.rate_inputs.items() if rate not in self.rate_inputs)

    def check_supported(self, variable: str, where: str) -> None:
        """Refuse an unsupported variable; `where` is the beginning of the message."""
        if variable in self.unsupported:
            type_ = self.unsupported[variable]
            raise Unsupported(f"{where}: expected a number or text, got {type_}, not supported")

    @property
    def unsupported_note(self) -> str:
        """A note on the unsupported variables; empty if there are none."""
        entries = [f"{name}, {type_}" for name, type_ in self.unsupported.items()]
        more = f"; and {len(entries) - MAX_LISTED} more" if len(entries) > MAX_LISTED else ""
        return f"left out: {'; '.join(entries[:MAX_LISTED])}{more}" if entries else ""


_kept: dict[tuple[bytes, str], FmuInterface] = {}  # text of the description and kind -> interface


@lru_cache(MOST_KEPT)
def _unpickled(data: bytes) -> FmuInterface:
    """One object for all runs of an FMU in a process."""
    return FmuInterface(**pickle.loads(data))


SECOND_EXPONENTS = (0, 0, 1, 0, 0, 0, 0, 0)


def read_interface(fmu: Location, kind: str = "") -> FmuInterface:
    """Read the interface of an FMU, FMI 2.0 or 3.0 (file, archive member or folder).

    kind    CO_SIMULATION or MODEL_EXCHANGE; default: the first of them that the FMU has

    The last ones that were read are kept, but for very long descriptions: a command reads a system several
    times, and a system may have an FMU several times, also under different names.
    """
    text = fmu.member("modelDescription.xml").read(MAX_BYTES)
    interface = _kept.pop((text, kind), None) or _read_interface(fmu, text, kind)
    if len(text) <= LONGEST_KEPT:
        _kept[text, kind] = interface  # as the last one
        for oldest in [*_kept][:-MOST_KEPT]:
            _kept.pop(oldest, None)
    return interface


def _read_interface(fmu: Location, text: bytes, kind: str) -> FmuInterface:
    root = parse_text(text, fmu.member("modelDescription.xml"), "fmiModelDescription")
    version = root.get("fmiVersion")
    if not re.fullmatch(r"2\.0|3\.\d+(\.\d+)?", version or ""):
        raise Problem(f"{fmu}: expected FMI version 2.0 or 3.0, got {version}")
    description = read_description(root, int(version[0]))
    asked = [kind] if kind else [CO_SIMULATION, MODEL_EXCHANGE]
    element = next((e for e in asked if e in description.interfaces), "")
    if not element:
        got = " and ".join(INTERFACES[e] for e in INTERFACES if e in description.interfaces) or "nothing"
        expected = " or ".join(INTERFACES[e] for e in asked)
        refusal = NotExchangeable if kind == MODEL_EXCHANGE else Problem
        raise refusal(f"{fmu}: expected an FMU for {expected}, got one for {got} only")
    try:
        return _checked(description, element)
    except Problem as problem:
        raise Problem(f"{fmu}: {problem}") from None


def _checked(description: ModelDescription, element: str) -> FmuInterface:
    interface = _interface(description, element)
    return interface if element == CO_SIMULATION else _integrated(interface)


def _integrated(interface: FmuInterface) -> FmuInterface:
    """What an FMU for Model Exchange can do with a solver of this project.

    Without functions for its state it can go back if the continuous states are all of it.
    """
    continuous = not interface.event_indicators and not interface.completed_step
    rollback = interface.rollback or continuous
    return replace(interface, rollback=rollback, variable_step=True, can_interpolate_inputs=True)


def _interface(description: ModelDescription, element: str) -> FmuInterface:
    fmi, capabilities = description.major, description.interfaces[element]
    for u in description.units:
        if u.declared.fault:
            raise Problem(f"modelDescription.xml line {u.line}: unit {u.name}: {u.declared.fault}")
    declared = list(_with_aliases(description))
    unsupported = {v.name: type_ for v in declared if (type_ := _unsupported_type(v))}
    supported = [v for v in declared if v.name not in unsupported]
    for v in supported:
        _check_variable(v)
    scalars = [scalar for v in supported for scalar in v.scalars]
    for name, count in Counter([*(v.name for v in scalars), *unsupported]).most_common(1):
        if count > 1:
            lines = ", ".join(map(str, sorted({v.line for v in [*scalars, *declared] if v.name == name})))
            raise Problem(
                f"modelDescription.xml: expected one variable {name!r}, got {count}, in lines {lines}"
            )
    variables = {v.name: v for v in scalars}
    _check_identity(description, capabilities)
    _check(
        variables, unsupported, declared, element == CO_SIMULATION and capabilities.declares("hasEventMode")
    )
    inputs = {name for name, v in variables.items() if v.causality == "input"}
    outputs, derivatives, initial = (
        _dependencies(description, description.structure[section], unsupported)
        for section in ("outputs", "derivatives", "initial")
    )
    exchange = MODEL_EXCHANGE in description.interfaces
    used = [*outputs.values(), *derivatives.values()]
    known = [names for names in used if names is not None]
    experiment = description.experiment
    attributes: dict[str, Any] = {n: capabilities.declares(*names) for n, names in CAPABILITIES.items()}
    ports = [v for v in variables.values() if v.causality in ("input", "output")]
    attributes["event_mode"] &= attributes["early_return"] or not all(v.is_continuous for v in ports)
    return FmuInterface(
        variables=variables,
        arrays={v.name: v for v in supported if v.shape},
        dependencies=derivatives | outputs,
        initial_dependencies=outputs | initial,
        kind=element,
        identifier=capabilities.get("modelIdentifier"),
        model=description,
        unsupported=unsupported,
        can_interpolate_inputs=capabilities.declares("canInterpolateInputs") and fmi == 2,
        rate_inputs=_rate_inputs(supported, description, variables),
        event_indicators=_indicator_count(description),
        completed_step=capabilities.declares("needsCompletedIntegratorStep")
        if fmi == 3
        else not capabilities.declares("completedIntegratorStepNotNeeded"),
        stateless=exchange and not derivatives,
        unused_inputs=frozenset(inputs.difference(*known) if exchange and None not in used else ()),
        states=_states(description, unsupported),
        start=_number(experiment, "startTime"),
        step=_number(experiment, "stepSize") or _number(capabilities, "fixedInternalStepSize"),
        stop=_number(experiment, "stopTime"),
        tolerance=max(_number(experiment, "tolerance") or 0.0, 0.0) or None,
        **attributes,
    )


def _with_aliases(description: ModelDescription) -> Iterator[FmuVariable]:
    """The variables, followed by their aliases as further variables."""
    yield from (v for v in description.variables if v.name)
    for v in description.variables:
        for alias in v.aliases:
            yield replace(v, name=alias.get("name"), attributes={**v.attributes, **alias.attributes})


def _unsupported_type(v: FmuVariable) -> str:
    """The type of an unsupported variable, for messages; empty for supported variables."""
    if not v.kind:
        return f"a variable of type {v.type}"
    if None in v.shape or v.size > MAX_ELEMENTS:
        shape = ", ".join("?" if n is None else str(n) for n in v.shape)
        return f"an array of shape ({shape}), of known sizes and {MAX_ELEMENTS} elements at most"
    return ""


def _check(
    variables: Mapping[str, FmuVariable],
    unsupported: Mapping[str, str],
    declared: Iterable[FmuVariable],
    event_mode: bool,
) -> None:
    """Refuse an FMU that cannot be run: clocks without event mode, no numbers, a time not in seconds."""
    for v in variables.values():
        try:
            if v.clocked and not event_mode:
                raise Problem(
                    f"{v.name} has a clock: expected Co-Simulation with event mode, got an FMU without"
                )
            for name in ("interval", "shift") if v.kind == "Clock" else ():
                if not 0 <= (v.fraction(name) or 0) <= float_info.max:
                    raise ValueError(f"expected 0 s or more, got {v.get(f'{name}Decimal')!r}")
        except ValueError as error:
            raise Problem(f"{v}: interval and shift of a clock [s]: {error}") from None
    ports = [v.name for v in declared if v.causality in ("input", "output")]
    if ports and all(name in unsupported for name in ports):
        first = f"{ports[0]} is {unsupported[ports[0]]}"
        raise Problem(f"{first}: expected an FMU with inputs or outputs that are supported")
    for v in variables.values():
        unit = v.unit if v.causality == "independent" else None
        if unit and unit.exponents and (unit.exponents, unit.factor, unit.offset) != (SECOND_EXPONENTS, 1, 0):
            raise Problem(f"{v.name}: expected time in seconds, got {unit}")


def _check_identity(description: ModelDescription, capabilities: Entry) -> None:
    """Refuse an FMU without the attributes that loading it needs."""
    token = "guid" if description.major == 2 else "instantiationToken"
    if token not in description.attributes:
        raise Problem(f"expected an attribute {token}, got none")
    identifier = capabilities.get("modelIdentifier")
    if not is_file_name(identifier):  # a path could lead to a library outside of the FMU
        raise Problem(f"modelIdentifier: expected a C identifier, got {identifier!r}")


def _check_variable(v: FmuVariable) -> None:
    """Refuse an invalid declaration."""
    type_ = v.attributes.get("declaredType")
    if type_ is not None and v.definition is None:
        raise Problem(f"{v}: declaredType {type_!r} is not defined")
    if not 0 <= v.reference < 2**32:
        got = v.attributes.get("valueReference")
        raise Problem(f"{v}: valueReference: expected a whole number below 2^32, got {got!r}")
    if (v.causality, v.variability) not in INITIAL and not v.get("initial"):
        raise Problem(f"{v}: causality {v.causality} with variability {v.variability} is not allowed")
    if any((n or 0) < 0 for n in v.shape):
        raise Problem(f"{v}: expected dimensions of 0 or more, got ({', '.join(map(str, v.shape))})")
    if v.shape and len(v.starts or ()) not in (0, 1, v.size):
        raise Problem(f"{v}: expected {v.size} start values, got {len(v.starts or ())}")
    try:
        _ = v.items
        for name in ("nominal", "min", "max"):
            _number(v, name)
    except (Problem, ValueError) as problem:
        raise Problem(f"{v}: {problem}") from None


def _dependencies(
    description: ModelDescription, unknowns: Iterable[Unknown], unsupported: Mapping[str, str]
) -> dict[str, frozenset[str] | None]:
    """Unknown -> variables it depends on, aliases included; None if not declared. No arrays left out."""
    result: dict[str, frozenset[str] | None] = {}
    for u in unknowns:
        if u.variable is None:
            raise Problem(f"{u}: expected a variable, got none with the index or value reference {u.key}")
        names = None
        if u.dependencies is not None:
            variables = [description.by_key.get(-1 if key is None else key) for key in u.dependencies]
            if None in variables:
                raise Problem(f"{u}: dependency {u.dependencies[variables.index(None)]} is not a variable")
            supported = [v for v in variables if v and not (v.shape and v.name in unsupported)]
            names = frozenset(name for v in supported for name in v.names)
        if not (u.variable.shape and u.variable.name in unsupported):
            result |= dict.fromkeys(u.variable.names, names)
    return result


def _indicator_count(description: ModelDescription) -> int:
    """The number of event indicators; in FMI 3.0 one variable may hold several."""
    try:
        if description.major == 2:
            count = integer(description.get("numberOfEventIndicators", "0"))
        else:
            count = sum(u.variable.size if u.variable else 1 for u in description.structure["indicators"])
    except ValueError as error:
        raise Problem(f"event indicators: {error}") from None
    if not 0 <= count <= MAX_INDICATORS:
        raise Problem(f"expected 0 to {MAX_INDICATORS} event indicators, got {count}")
    return count


def _states(description: ModelDescription, unsupported: Mapping[str, str]) -> dict[str, str]:
    """Continuous states and their time derivatives; empty if one of them is missing or unsupported."""
    states = dict[str, str]()
    for v in description.derivatives:
        state = description.state_of(v)
        if state is None or state.name in unsupported or v.name in unsupported:
            return {}
        states |= zip(state.elements, v.elements, strict=False)
    return states if len(states) == sum(v.size for v in description.derivatives) else {}


def _rate_inputs(
    supported: Iterable[FmuVariable], description: ModelDescription, variables: Mapping[str, FmuVariable]
) -> dict[str, str]:
    """Inputs and the inputs that are their time derivatives, if the units agree.

    They are declared by the attribute `derivative`, or in FMI 2.0 by this project's annotation, because
    OMSimulator treats a variable with that attribute as the derivative of a state.
    """
    pairs = {
        of: rate
        for v in supported
        if (state := description.state_of(v))
        for of, rate in zip(state.elements, v.elements, strict=False)
    }
    pairs.update(description.input_rates)
    inputs = ((variables.get(u), variables.get(rate)) for u, rate in pairs.items())
    return {
        u.name: rate.name
        for u, rate in inputs
        if u and rate and u.causality == rate.causality == "input" and _per_second(u.unit, rate.unit)
    }


def _per_second(unit: DeclaredUnit | None, rate: DeclaredUnit | None) -> bool:
    """True if `rate` is `unit` per second."""
    if unit is None or rate is None:
        return unit is rate
    if unit.exponents is None or rate.exponents is None or unit.offset or rate.offset:
        return False
    expected = tuple(a - b for a, b in zip(unit.exponents, SECOND_EXPONENTS, strict=True))
    return rate.exponents == expected and rate.factor == unit.factor


def _number(entry: Entry, name: str) -> float | None:
    try:
        return entry.number(name)
    except ValueError:
        raise Problem(f"{name}: expected a number, got {entry.get(name)!r}") from None
