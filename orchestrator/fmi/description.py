"""What an FMU declares about itself: variables, dependencies, abilities.

Reading modelDescription.xml of an FMU, FMI 2.0 or 3.0.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from orchestrator.base.errors import Problem, Unsupported
from orchestrator.base.files import Location
from orchestrator.base.units import BASES, DeclaredUnit

Value = float | int | bool | str

FLOATS = ("Real", "Float64", "Float32")
INTEGERS = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
KINDS = {
    **dict.fromkeys(FLOATS, "Real"),
    **dict.fromkeys(INTEGERS, "Integer"),
    **{kind: kind for kind in ("Boolean", "String", "Enumeration")},
}
SHOWN = 5  # names in a list


@dataclass(frozen=True)
class Variable:
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
    text: str = ""
    word: str = ""
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
class Interface:
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

    variables: Mapping[str, Variable]
    feedthrough: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    initially: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    identifier: str = ""
    guid: str = ""
    fmi: int = 2
    refused: Mapping[str, str] = field(default_factory=dict)
    interpolates: bool = False
    rates: Mapping[str, str] = field(default_factory=dict)
    slopes: int = 0
    rollback: bool = False
    serializes: bool = False
    only_one: bool = False
    needs_tool: bool = False
    indicators: int = 0
    varies: bool = True
    stateless: bool = False
    inert: frozenset[str] = frozenset()
    directional: bool = False
    states: Mapping[str, str] = field(default_factory=dict)
    knowns: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    categories: tuple[str, ...] = ()
    start: float | None = None
    step: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    version: str = ""
    tool: str = ""
    text: str = ""

    def of(self, causality: str) -> list[Variable]:
        """All variables of one causality, in declaration order."""
        return [v for v in self.variables.values() if v.causality == causality]

    def depends(self, output: str) -> frozenset[str]:
        """Inputs that feed directly through to `output`; all of them when the FMU does not say."""
        known = self.feedthrough.get(output)
        return frozenset(v.name for v in self.of("input")) if known is None else known

    def depends_initially(self, output: str) -> frozenset[str]:
        """Variables that decide `output` in initialisation mode."""
        known = self.initially.get(output)
        if known is None:
            return frozenset(v.name for v in self.variables.values() if v.settable)
        return known

    def matters(self, variable: str, outputs: Iterable[str]) -> bool:
        """False for an input that none of these outputs depends on: not directly, and there is no state."""
        return not self.stateless or any(variable in self.depends(y) for y in outputs)

    @property
    def sloped(self) -> frozenset[str]:
        """Inputs that a master may move inside a step at a constant slope."""
        if self.interpolates:
            return frozenset(v.name for v in self.of("input") if v.is_real)
        return frozenset(u for u, rate in self.rates.items() if rate not in self.rates)

    def allow(self, variable: str, where: str) -> None:
        """Refuse, beginning with `where`, a variable of a kind that is not supported."""
        if variable in self.refused:
            kind = self.refused[variable]
            raise Unsupported(f"{where}: expected a scalar number or text, got {kind}, not supported")

    @property
    def left_out(self) -> str:
        """The refused variables as text; empty when there are none."""
        told = [f"{name}, {what}" for name, what in self.refused.items()]
        more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        return f"left out: {'; '.join(told[:SHOWN])}{more}" if told else ""


SECOND = (0, 0, 1, 0, 0, 0, 0, 0)


def read_interface(fmu: Location, exchange: bool = False) -> Interface:
    """Read the model description of an FMU, FMI 2.0 or 3.0 (file, archive member or folder).

    exchange   as an FMU for Model Exchange; else for Co-Simulation
    """
    from fmpy import read_model_description

    source: Any = str(fmu.path) if fmu.is_folder else io.BytesIO(fmu.read())
    root = _root(fmu)
    try:
        description = read_model_description(source, validate=False)
    except Exception as error:  # FMPy raises plain exceptions
        raise Problem(f"{fmu}: modelDescription.xml cannot be read: {error}") from error
    _check_kind(fmu, description, exchange)
    try:
        return _interface(description, root, exchange)
    except Problem as problem:
        raise Problem(f"{fmu}: {problem}") from None


def _check_kind(fmu: Location, description: Any, exchange: bool) -> None:
    kinds = {
        "co-simulation": description.coSimulation,
        "model exchange": description.modelExchange,
        "scheduled execution": description.scheduledExecution,
    }
    wanted = "model exchange" if exchange else "co-simulation"
    if kinds[wanted] is None:
        there = " and ".join(kind for kind, found in kinds.items() if found is not None)
        raise Problem(f"{fmu}: expected an FMU for {wanted}, got one for {there or 'nothing'} only")


def _root(fmu: Location) -> Any:
    """The XML of the model description; its FMI version is checked before FMPy stumbles over another one."""
    from lxml import etree

    try:
        root = etree.fromstring(fmu.member("modelDescription.xml").read())
    except etree.XMLSyntaxError as error:
        raise Problem(f"{fmu}: modelDescription.xml is not XML: {error}") from error
    version = root.get("fmiVersion")
    if not re.fullmatch(r"2\.0|3\.\d+(\.\d+)?", version or ""):
        raise Problem(f"{fmu}: expected FMI version 2.0 or 3.0, got {version}")
    return root


def _interface(description: Any, root: Any, exchange: bool) -> Interface:
    fmi = int(root.get("fmiVersion")[0])
    kind = root.find("ModelExchange" if exchange else "CoSimulation")
    able = {name for name, value in kind.items() if value in ("true", "1")}
    units = {u.name: _unit(u) for u in description.unitDefinitions}
    declared = description.modelVariables
    refused = {v.name: what for v in declared if (what := _refusal(v))}
    variables = {v.name: _variable(v, units, fmi) for v in declared if v.name not in refused}
    _check(variables, refused, declared)
    inputs = {name for name, v in variables.items() if v.causality == "input"}
    tool = description.modelExchange if exchange else description.coSimulation
    experiment = description.defaultExperiment
    feedthrough = {v.name: None for v in variables.values() if v.causality == "output"}
    names = _names(variables.values(), fmi)
    outputs = _dependencies(description.outputs, names)
    return Interface(
        variables=variables,
        feedthrough=feedthrough | {o: d if d is None else d & inputs for o, d in outputs.items()},
        initially=outputs | _dependencies(description.initialUnknowns, names),
        identifier=tool.modelIdentifier,
        guid=description.guid,
        fmi=fmi,
        refused=refused,
        interpolates="canInterpolateInputs" in able and fmi == 2,
        rates=_rates(declared, root, variables),
        slopes=int(getattr(tool, "maxOutputDerivativeOrder", 0) or 0),
        rollback=bool(tool.canGetAndSetFMUstate),
        serializes=bool(tool.canSerializeFMUstate),
        only_one="canBeInstantiatedOnlyOncePerProcess" in able,
        needs_tool="needsExecutionTool" in able,
        indicators=int(description.numberOfEventIndicators or 0),
        varies="canHandleVariableCommunicationStepSize" in able,
        stateless=description.modelExchange is not None and not description.derivatives,
        inert=frozenset(inputs - _needed(description, inputs)),
        states=_states(description, variables),
        knowns=outputs | _dependencies(description.derivatives, names),
        directional=bool(able & {"providesDirectionalDerivative", "providesDirectionalDerivatives"}),
        categories=tuple(c.name for c in description.logCategories),
        start=_number(experiment, "startTime"),
        step=_number(experiment, "stepSize") or _number(tool, "fixedInternalStepSize"),
        stop=_number(experiment, "stopTime"),
        tolerance=_number(experiment, "tolerance"),
        version=description.version or "",
        tool=description.generationTool or "",
        text=description.description or "",
    )


def _refusal(v: Any) -> str:
    """What a variable is that cannot be used here; empty for the others."""
    if v.type == "Clock" or v.clocks:
        return "a clock" if v.type == "Clock" else f"a clocked {v.type}"
    if v.type not in KINDS:
        return f"a variable of type {v.type}"
    return f"an array of shape ({', '.join(map(str, v.shape))})" if v.shape else ""


def _check(variables: Mapping[str, Variable], refused: Mapping[str, str], declared: Iterable[Any]) -> None:
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
        if unit and unit.exponents and (unit.exponents, unit.factor, unit.offset) != (SECOND, 1, 0):
            raise Problem(f"{v.name}: expected time in seconds, got {unit}")


def _needed(description: Any, inputs: Collection[str]) -> set[str]:
    """The inputs that states or outputs depend on, as far as the FMU declares it."""
    if description.modelExchange is None:
        return set(inputs)
    unknowns = [*description.derivatives, *description.outputs]
    if any(u.dependencies is None for u in unknowns):
        return set(inputs)
    return {d.name for u in unknowns for d in u.dependencies}


def _states(description: Any, variables: Mapping[str, Variable]) -> dict[str, str]:
    """Continuous states and their time derivatives."""
    rates = [u.variable for u in description.derivatives]
    found = {v.derivative.name: v.name for v in rates if v.derivative}
    complete = len(found) == len(rates)
    return found if complete and all(name in variables for pair in found.items() for name in pair) else {}


def _names(variables: Iterable[Variable], fmi: int) -> Mapping[str, Collection[str]]:
    """Name -> all names of the same variable; FMI 3.0 lists dependencies without aliases."""
    same: dict[int | str, list[str]] = {}
    for v in variables:
        same.setdefault(v.reference if fmi == 3 else v.name, []).append(v.name)
    return {name: names for names in same.values() for name in names}


def _dependencies(
    unknowns: Iterable[Any], names: Mapping[str, Collection[str]]
) -> dict[str, frozenset[str] | None]:
    found: dict[str, frozenset[str] | None] = {}
    for u in unknowns:
        known = None
        if u.dependencies is not None:
            known = frozenset(name for d in u.dependencies for name in names.get(d.name, ()))
        found |= dict.fromkeys(names.get(u.variable.name, ()), known)
    return found


def _variable(v: Any, units: Mapping[str, DeclaredUnit], fmi: int) -> Variable:
    unit = v.unit or (v.declaredType.unit if v.declaredType is not None else None)
    word = "Int64" if v.type == "Enumeration" else v.type
    return Variable(
        name=v.name,
        kind=KINDS[v.type],
        causality=v.causality,
        variability=v.variability,
        initial=v.initial,
        reference=v.valueReference,
        unit=units.get(unit, DeclaredUnit(unit)) if unit else None,
        start=v.start,
        items=_items(v),
        nominal=_number(v, "nominal"),
        text=v.description or "",
        word=word if fmi == 3 else "",
        minimum=_bound(v, "min"),
        maximum=_bound(v, "max"),
    )


def _bound(v: Any, name: str) -> float | None:
    """Of the variable, else of its type."""
    own = _number(v, name)
    return _number(v.declaredType, name) if own is None else own


def _items(v: Any) -> dict[str, int]:
    if v.type != "Enumeration" or v.declaredType is None:
        return {}
    return {item.name: int(item.value) for item in v.declaredType.items}


def _unit(u: Any) -> DeclaredUnit:
    if u.baseUnit is None:
        return DeclaredUnit(u.name)
    base = u.baseUnit
    exponents = tuple(int(getattr(base, b)) for b in BASES)
    return DeclaredUnit(u.name, exponents, float(base.factor), float(base.offset))


def _rates(declared: Iterable[Any], root: Any, variables: Mapping[str, Variable]) -> dict[str, str]:
    """Inputs and the inputs that are their time derivatives, where the units agree.

    Declared by the attribute `derivative`, or, in FMI 2.0, by our annotation: OMSimulator takes a variable
    with that attribute for the derivative of a state.
    """
    pairs = {v.derivative.name: v.name for v in declared if v.derivative is not None}
    noted = root.iterfind("VendorAnnotations/Tool[@name='harvester-cosim']//InputDerivative")
    pairs |= {e.get("input"): e.get("derivative") for e in noted}
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
    expected = tuple(a - b for a, b in zip(unit.exponents, SECOND, strict=True))
    return rate.exponents == expected and rate.factor == unit.factor


def _number(owner: Any, name: str) -> float | None:
    text = getattr(owner, name, None)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise Problem(f"{name}: expected a number, got {text!r}") from None
