"""A system to be written as an SSP: components with their variables, wires, start values; checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fmpy

from orchestrator.base.errors import Problem

Sets = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Element:
    """A component: its model description, and the connectors to show, by name."""

    description: Any
    variables: Mapping[str, Any]
    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass(frozen=True)
class Structure:
    """What the files of an SSP tell; see `ssp.write_ssp` for the meaning of each.

    wires   (source, "component.input"), where a source is "component.output" or an input of the system
    """

    name: str
    elements: Mapping[str, Element]
    wires: Sequence[tuple[str, str]]
    inputs: Mapping[str, Sequence[str]]
    start: Mapping[str, float] = field(default_factory=dict)
    sets: Sets = field(default_factory=dict)
    bound: Sequence[str] = ()
    columns: Sequence[Sequence[str]] = ()
    stop: float = 10.0
    step: float = 1e-3
    version: str = "1.0"

    def variable(self, port: str) -> Any:
        """The declaration of "component.variable", or of what an input of the system feeds first."""
        component, name = split(self.inputs[port][0] if port in self.inputs else port)
        return self.elements[component].variables[name]


def split(port: str) -> tuple[str, str]:
    """Component and variable of "component.variable"."""
    component, _, variable = port.partition(".")
    return component, variable


def read_elements(fmus: Mapping[str, Path], wires: Sequence[tuple[str, str]]) -> dict[str, Element]:
    """The components. Shown are all outputs, and connected inputs: the others keep their start value."""
    fed = {end for _, end in wires}
    elements = {}
    for component, file in fmus.items():
        description = fmpy.read_model_description(str(file), validate=False)
        variables = {v.name: v for v in description.modelVariables}
        inputs = [v for v in _named(variables, "input") if f"{component}.{v}" in fed]
        elements[component] = Element(description, variables, inputs, _named(variables, "output"))
    return elements


def _named(variables: Mapping[str, Any], causality: str) -> list[str]:
    return [v.name for v in variables.values() if v.causality == causality]


def check(s: Structure) -> None:
    """Refuse wires that do not fit, and values of what is no variable."""
    fed: dict[str, str] = {}
    for source, end in s.wires:
        target = _end(s, end, "input")
        if end in fed:
            raise Problem(f"{s.name}: {end} is connected to {fed[end]} and to {source}, expected one source")
        fed[end] = source
        first = s.inputs[source][0] if source in s.inputs else source
        unit = _end(s, first, "input" if source in s.inputs else "output").unit
        if unit != target.unit:
            raise Problem(f"{s.name}: {source} is in {unit}, {end} in {target.unit}; expected the same unit")
    for what, values in {"start value": s.start, **{f"set {n}": v for n, v in s.sets.items()}}.items():
        for port in values:
            component, variable = split(port)
            if component not in s.elements or variable not in s.elements[component].variables:
                raise Problem(f"{s.name}: {what} of {port}, which is no variable of a component")
    for name in s.bound:
        if name not in s.sets:
            raise Problem(f"{s.name}: {name} is bound, expected one of the sets {', '.join(s.sets)}")


def _end(s: Structure, port: str, causality: str) -> Any:
    component, variable = split(port)
    if component not in s.elements:
        raise Problem(f"{s.name}: {port} names no component, expected one of {', '.join(s.elements)}")
    found = s.elements[component].variables.get(variable)
    if found is None or found.causality != causality:
        got = "no such variable" if found is None else f"causality {found.causality}"
        raise Problem(f"{s.name}: {port} has {got}, expected an {causality} of {component}")
    return found
