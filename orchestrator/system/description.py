"""Reading modelDescription.xml of an FMU, FMI 2.0 or 3.0."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.system.interface import KINDS, Interface, Variable
from orchestrator.units import BASES, Unit

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


def _variable(v: Any, units: Mapping[str, Unit], fmi: int) -> Variable:
    unit = v.unit or (v.declaredType.unit if v.declaredType is not None else None)
    word = "Int64" if v.type == "Enumeration" else v.type
    return Variable(
        name=v.name,
        kind=KINDS[v.type],
        causality=v.causality,
        variability=v.variability,
        initial=v.initial,
        reference=v.valueReference,
        unit=units.get(unit, Unit(unit)) if unit else None,
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


def _unit(u: Any) -> Unit:
    if u.baseUnit is None:
        return Unit(u.name)
    base = u.baseUnit
    exponents = tuple(int(getattr(base, b)) for b in BASES)
    return Unit(u.name, exponents, float(base.factor), float(base.offset))


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


def _per_second(unit: Unit | None, rate: Unit | None) -> bool:
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
