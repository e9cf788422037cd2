"""What an FMU declares about itself: variables, dependencies, abilities. Read from modelDescription.xml."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from orchestrator.archive import Location
from orchestrator.errors import Problem
from orchestrator.units import BASES, Unit

Value = float | int | bool | str


@dataclass(frozen=True)
class Variable:
    """One scalar variable.

    kind      Real, Integer, Boolean, String or Enumeration
    nominal   its usual magnitude, where the FMU tells one
    text      its description
    """

    name: str
    kind: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    initial: str | None = None
    reference: int = 0
    unit: Unit | None = None
    start: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    nominal: float | None = None
    text: str = ""

    @property
    def is_real(self) -> bool:
        return self.kind == "Real"

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
    interpolates  the FMU accepts derivatives of its inputs
    slopes        highest order of output derivatives it offers
    rollback      the FMU can save and restore its state
    version, tool, text   of the FMU: its version, what made it, its description
    """

    variables: Mapping[str, Variable]
    feedthrough: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    initially: Mapping[str, frozenset[str] | None] = field(default_factory=dict)
    identifier: str = ""
    guid: str = ""
    interpolates: bool = False
    slopes: int = 0
    rollback: bool = False
    categories: tuple[str, ...] = ()
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


def read_interface(fmu: Location) -> Interface:
    """Read the model description of an FMI 2.0 co-simulation FMU (file, archive member or folder)."""
    from fmpy import read_model_description

    source: Any = str(fmu.path) if fmu.is_folder else io.BytesIO(fmu.read())
    _check_version(fmu)
    try:
        description = read_model_description(source, validate=False)
    except Exception as error:  # FMPy raises plain exceptions
        raise Problem(f"{fmu}: modelDescription.xml cannot be read: {error}") from error
    if description.coSimulation is None:
        raise Problem(f"{fmu}: expected an FMU for co-simulation, got one for model exchange only")
    return _interface(description)


def _check_version(fmu: Location) -> None:
    """Name the FMI version before FMPy stumbles over it."""
    from lxml import etree

    try:
        version = etree.fromstring(fmu.member("modelDescription.xml").read()).get("fmiVersion")
    except etree.XMLSyntaxError as error:
        raise Problem(f"{fmu}: modelDescription.xml is not XML: {error}") from error
    if version != "2.0":
        raise Problem(f"{fmu}: expected FMI version 2.0, got {version}")


def _interface(description: Any) -> Interface:
    units = {u.name: _unit(u) for u in description.unitDefinitions}
    variables = {v.name: _variable(v, units) for v in description.modelVariables}
    inputs = {name for name, v in variables.items() if v.causality == "input"}
    tool, experiment = description.coSimulation, description.defaultExperiment
    feedthrough = {v.name: None for v in variables.values() if v.causality == "output"}
    outputs = _dependencies(description.outputs)
    return Interface(
        variables=variables,
        feedthrough=feedthrough | {o: d if d is None else d & inputs for o, d in outputs.items()},
        initially=outputs | _dependencies(description.initialUnknowns),
        identifier=tool.modelIdentifier,
        guid=description.guid,
        interpolates=bool(tool.canInterpolateInputs),
        slopes=int(tool.maxOutputDerivativeOrder or 0),
        rollback=bool(tool.canGetAndSetFMUstate),
        categories=tuple(c.name for c in description.logCategories),
        step=_number(experiment, "stepSize"),
        stop=_number(experiment, "stopTime"),
        tolerance=_number(experiment, "tolerance"),
        version=description.version or "",
        tool=description.generationTool or "",
        text=description.description or "",
    )


def _dependencies(unknowns: Iterable[Any]) -> dict[str, frozenset[str] | None]:
    return {
        u.variable.name: None if u.dependencies is None else frozenset(d.name for d in u.dependencies)
        for u in unknowns
    }


def _variable(v: Any, units: Mapping[str, Unit]) -> Variable:
    unit = v.unit or (v.declaredType.unit if v.declaredType is not None else None)
    return Variable(
        name=v.name,
        kind=v.type,
        causality=v.causality,
        variability=v.variability,
        initial=v.initial,
        reference=v.valueReference,
        unit=units.get(unit, Unit(unit)) if unit else None,
        start=v.start,
        items=_items(v),
        nominal=_number(v, "nominal"),
        text=v.description or "",
    )


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


def _number(owner: Any, name: str) -> float | None:
    text = getattr(owner, name, None)
    return None if text is None else float(text)
