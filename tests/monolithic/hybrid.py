"""The models of hybrid.c as FMUs for Model Exchange."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

from kit.compile import library

SOURCE = Path(__file__).with_name("hybrid.c")
# name, type, causality, variability, start or None, value reference
Variable = tuple[str, str, str, str, object, int]
MODELS: dict[str, list[Variable]] = {
    "ball": [
        ("h", "Real", "output", "continuous", 1.0, 1),
        ("v", "Real", "output", "continuous", 0.0, 2),
        ("der_h", "Real", "local", "continuous", None, 3),
        ("der_v", "Real", "local", "continuous", None, 4),
        ("e", "Real", "parameter", "fixed", 0.7, 5),
        ("z", "Real", "local", "continuous", None, 6),
    ],
    "counter": [
        ("count", "Integer", "output", "discrete", None, 1),
        ("last", "Integer", "parameter", "fixed", 1000, 2),
    ],
    "thermo": [
        ("y", "Real", "input", "continuous", 0.0, 1),
        ("low", "Real", "parameter", "fixed", 0.4, 2),
        ("high", "Real", "parameter", "fixed", 0.6, 3),
        ("on", "Boolean", "output", "discrete", None, 4),
        ("z", "Real", "local", "continuous", None, 6),
    ],
    "room": [
        ("T", "Real", "output", "continuous", 0.0, 1),
        ("der_T", "Real", "local", "continuous", None, 2),
        ("power", "Real", "parameter", "fixed", 1.0, 3),
        ("on", "Boolean", "input", "discrete", False, 5),
    ],
    "gain": [
        ("u", "Real", "input", "continuous", 0.0, 1),
        ("y", "Real", "output", "continuous", None, 2),
        ("a", "Real", "parameter", "fixed", 0.5, 3),
        ("b", "Real", "parameter", "fixed", 0.0, 4),
    ],
}
STATES = {"ball": {1: 3, 2: 4}, "room": {1: 2}}  # state -> time derivative
DEPENDS = {("gain", 2): [1], ("room", 2): [1]}  # unknown -> knowns; of the others: none, or the states
INDICATOR = 6


def build(folder: Path, model: str, version: int = 2) -> Path:
    """The FMU `model` for FMI 2.0 or 3.0."""
    binary = library("hybrid", [SOURCE], f"-DFMI={version}", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")
    path = folder / f"{model}{version}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description(model, version))
        platform = "linux64" if version == 2 else "x86_64-linux"
        archive.writestr(f"binaries/{platform}/{model}.so", binary)
    return path


def description(model: str, version: int) -> str:
    """modelDescription.xml."""
    head = f'modelName="{model}" {"guid" if version == 2 else "instantiationToken"}="{model}"'
    if version == 2:
        count = sum(v[5] == INDICATOR for v in MODELS[model])
        head += f' fmiVersion="2.0" numberOfEventIndicators="{count}"'
    else:
        head += ' fmiVersion="3.0"'
    body = f'<ModelExchange modelIdentifier="{model}"/>'
    text = _variables(model, version) + _structure(model, version)
    return f"<fmiModelDescription {head}>{body}{text}</fmiModelDescription>"


def _variables(model: str, version: int) -> str:
    types = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}
    derivatives = {rate: state for state, rate in STATES.get(model, {}).items()}
    index = {v[5]: k for k, v in enumerate(MODELS[model], 1)}
    rows = []
    if version == 3:
        rows.append(
            '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
        )
    for name, kind, causality, variability, start, reference in MODELS[model]:
        own = f'start="{str(start).lower()}"' if start is not None else ""
        if reference in derivatives:
            state = derivatives[reference]
            own += f' derivative="{index[state] if version == 2 else state}"'
        common = (
            f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
        )
        if reference in STATES.get(model, {}):
            common += ' initial="exact"'
        if version == 2:
            rows.append(f"<ScalarVariable {common}><{kind} {own}/></ScalarVariable>")
        else:
            rows.append(f"<{types[kind]} {common} {own}/>")
    return f"<ModelVariables>{''.join(rows)}</ModelVariables>"


def _structure(model: str, version: int) -> str:
    index = {v[5]: k for k, v in enumerate(MODELS[model], 1)}

    def unknowns(element: str, references: Sequence[int]) -> str:
        rows = []
        for reference in references:
            knowns = DEPENDS.get((model, reference), [*STATES.get(model, {})])
            if version == 2:
                knowns = [index[k] for k in knowns]
                rows.append(
                    f'<Unknown index="{index[reference]}" dependencies="{" ".join(map(str, knowns))}"/>'
                )
            else:
                dependencies = (
                    "" if element == "EventIndicator" else f' dependencies="{" ".join(map(str, knowns))}"'
                )
                rows.append(f'<{element} valueReference="{reference}"{dependencies}/>')
        return "".join(rows)

    outputs = [v[5] for v in MODELS[model] if v[2] == "output"]
    rates = [*STATES.get(model, {}).values()]
    if version == 2:
        parts = {"Outputs": outputs, "Derivatives": rates}
        inner = "".join(f"<{name}>{unknowns('', refs)}</{name}>" for name, refs in parts.items() if refs)
    else:
        inner = unknowns("Output", outputs) + unknowns("ContinuousStateDerivative", rates)
        inner += unknowns("EventIndicator", [v[5] for v in MODELS[model] if v[5] == INDICATOR])
    return f"<ModelStructure>{inner}</ModelStructure>"
