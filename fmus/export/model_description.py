"""XML files of an FMU: modelDescription.xml of FMI 2.0 and 3.0, two files of FMI 3.0, a reference experiment.

The two files are sources/buildDescription.xml and terminalsAndIcons/terminalsAndIcons.xml, which describes
the terminals of a subsystem and the size of its icon.

Any tool can run the reference experiment and compare the result; its files conform to the layered standard
FMI-LS-REF (draft 1.0.0-alpha.1). The data are files next to the subsystem, written by `python -m
benchmarks.reference`: parameters and start values, inputs, result. They are valid for any parameter values
that the FMU is built with, because the experiment sets all parameters.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lxml import etree

from fmus.contract import Subsystem, quantities
from fmus.export.c_code import DEFAULT_TOLERANCE, TEMPLATES
from fmus.export.interface import Interface, Variable, dependencies, initial_dependencies
from orchestrator.base.errors import Problem
from orchestrator.base.text import rendered
from orchestrator.base.units import display_conversion, normalised, parse_unit
from orchestrator.base.xml import generation_tool, package_version, rendered_xml, shortest_decimal
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.common_elements import NAMESPACES
from orchestrator.ssp.write import parameter_set

TOOL = "harvester-cosim"  # in vendor annotations and terminal kinds
LOG_CATEGORIES = {
    "logEvents": "Function calls",
    "logStatusWarning": "Warnings",
    "logStatusDiscard": "Values that could not be computed",
    "logStatusError": "Errors",
    "logAll": "All messages",
}
_ONE_PROCESS = {"needsExecutionTool": "false", "canBeInstantiatedOnlyOncePerProcess": "false"}
_COMMON_2 = {
    **_ONE_PROCESS,
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
_COMMON_3 = {
    **_ONE_PROCESS,
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
}
# FMI version -> element -> attributes of FMUs with compiled C code
CAPABILITIES: Mapping[int, Mapping[str, Mapping[str, str]]] = {
    2: {
        "ModelExchange": _COMMON_2,
        "CoSimulation": {
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": "true",
            "maxOutputDerivativeOrder": "1",
            "canRunAsynchronuously": "false",
            **_COMMON_2,
        },
    },
    3: {
        # after each step of the importer's solver the FMU checks the requirements of the model
        "ModelExchange": {**_COMMON_3, "needsCompletedIntegratorStep": "true"},
        "CoSimulation": {
            **_COMMON_3,
            "canHandleVariableCommunicationStepSize": "true",
            "maxOutputDerivativeOrder": "1",
            "providesIntermediateUpdate": "true",
            "canReturnEarlyAfterIntermediateUpdate": "true",
            "hasEventMode": "true",
        },
    },
}
# FMI version -> attributes of CoSimulation of a sampled model or one in Python, and others of the latter
_WHOLE_STEPS = {
    2: {"maxOutputDerivativeOrder": "0"},
    3: {
        "maxOutputDerivativeOrder": "0",
        "providesIntermediateUpdate": "false",
        "canReturnEarlyAfterIntermediateUpdate": "false",
    },
}
_IN_PYTHON = {
    2: {"needsExecutionTool": "true", "providesDirectionalDerivative": "false"},
    3: {
        "needsExecutionTool": "true",
        "providesDirectionalDerivatives": "false",
        "hasEventMode": "false",
    },
}
# group of unknowns in FMI 2 -> each unknown with its dependencies, each with its dependenciesKind
Unknowns = Mapping[str, Sequence[tuple[Variable, Sequence[tuple[Variable, str]]]]]


def model_description(
    interface: Interface,
    fmi: int,
    token: str,
    step: float,
    stop: float,
    sources: Sequence[str] = (),
    structure: Unknowns | None = None,
) -> bytes:
    """The content of modelDescription.xml, of FMI 2 or 3.

    token          the GUID (FMI 2) or instantiation token (FMI 3)
    step, stop     default experiment [s]
    sources        C files to compile, for FMI 2; FMI 3 lists them in buildDescription.xml
    structure      unknowns and dependencies for ModelStructure; default: derived from the equations
    """
    units = {v.quantity.unit for v in interface.variables}
    units |= {"s"} if fmi == 3 else set()  # where time is a variable, and needs its unit
    rows = (unknowns(interface) if structure is None else structure).items()
    return rendered_xml(
        TEMPLATES / "modelDescription.xml.j2",
        fmi=fmi,
        tool=TOOL,
        interface=interface,
        token=token,
        version=package_version(),
        generation_tool=generation_tool(),
        capabilities=_capabilities(interface, fmi),
        sources=sources,
        units={name: (base_unit(name), display_conversion(name)) for name in sorted(units)},
        categories=LOG_CATEGORIES,
        experiment={"startTime": 0.0, "stopTime": stop, "tolerance": DEFAULT_TOLERANCE, "stepSize": step},
        # The attribute `derivative` of FMI 2.0 would declare rates, but tools such as OMSimulator count all
        # variables that have it as derivatives of states, and find more states than the FMU has. FMI 3.0 uses
        # the attribute.
        rates=[v for v in interface.inputs if v.quantity.rate and fmi == 2],
        optional=[v for v in interface.inputs if v.quantity.optional],
        held=[v for v in interface.inputs if v.quantity.held],
        noisy=[v for v in interface.outputs if v.quantity.noisy],
        not_shipped=_not_shipped(interface),
        variables=list(_variables(interface, fmi)),
        structure={group: [_unknown(*row, fmi) for row in members] for group, members in rows},
    )


def _capabilities(interface: Interface, fmi: int) -> Mapping[str, Mapping[str, str]]:
    """ModelExchange and CoSimulation -> attributes.

    A sampled model, or one in Python, has no derivatives of outputs, and stops nowhere within a step. One in
    Python has no derivatives at all, and no events.
    """
    found, others = CAPABILITIES[fmi], dict[str, str]()
    if interface.sampling or interface.in_python:
        others = _WHOLE_STEPS[fmi]
    if interface.in_python:
        found, others = {"CoSimulation": found["CoSimulation"]}, others | _IN_PYTHON[fmi]
    return {kind: {**flags, **others} if kind == "CoSimulation" else flags for kind, flags in found.items()}


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's and SSP's BaseUnit element."""
    parsed = parse_unit(unit)
    if normalised(unit) != unit:  # other tools read only this spelling
        raise Problem(f'unit "{unit}": expected "{normalised(unit)}"')
    attributes = {name: str(n) for name, n in parsed.base().items()}
    return attributes if parsed.factor == 1.0 else attributes | {"factor": shortest_decimal(parsed.factor)}


def _not_shipped(interface: Interface) -> dict[tuple[str, str], dict[str, float]]:
    """File and checksum -> parameters with other values than the shipped FMU, and the shipped values."""
    by_file: dict[tuple[str, str], dict[str, float]] = {}
    for name, number in interface.not_shipped.items():
        if number.shipped is not None:
            by_file.setdefault(number.file, {})[name] = number.shipped
    return by_file


def _variables(interface: Interface, fmi: int) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Attributes of each variable, and those of its type; in FMI 3 time is the last variable."""
    # a model by hand has states without derivatives
    derivative_of = {dx.name: x for dx, x in zip(interface.derivatives, interface.states, strict=False)}
    if fmi == 3:
        derivative_of |= {v.quantity.rate: v for v in interface.inputs if v.quantity.rate}
    for v in interface.variables:
        general = {"name": v.name, "valueReference": v.reference, "description": v.quantity.text}
        general |= _causality(v)
        derivative = {"derivative": _index(derivative_of[v.name], fmi)} if v.name in derivative_of else {}
        if fmi == 2:
            yield general, _real_attributes(v) | derivative
        else:
            intermediate = {} if v.kind in ("FIXED", "TUNABLE") else {"intermediateUpdate": True}
            yield general | intermediate | derivative, _real_attributes(v)
    if fmi == 3:
        name = "independent_time" if any(v.name == "time" for v in interface.variables) else "time"
        time = {"causality": "independent", "variability": "continuous", "unit": "s"}
        yield {"name": name, "valueReference": len(interface.variables), "description": "Time", **time}, {}


def _index(v: Variable, fmi: int) -> int:
    """How attributes refer to a variable: by its index from 1 in FMI 2, by its value reference in FMI 3."""
    return v.reference + 1 if fmi == 2 else v.reference


def _causality(v: Variable) -> dict[str, str]:
    """Attributes causality, variability and initial."""
    if v.kind in ("FIXED", "TUNABLE"):
        return {"causality": "parameter", "variability": v.kind.lower(), "initial": "exact"}
    if v.kind == "INPUT":
        return {"causality": "input", "variability": "continuous"}
    return {
        "causality": "output" if v.output else "local",
        "variability": "continuous",
        "initial": "exact" if v.kind == "STATE" else "calculated",
    }


def _real_attributes(v: Variable) -> dict[str, str | float | None]:
    """Attributes of a real variable: units, bounds, nominal and start value."""
    q, display_unit = v.quantity, display_conversion(v.quantity.unit)
    return {
        "unit": q.unit,
        "displayUnit": display_unit[0] if display_unit else None,
        "min": q.minimum,
        "max": q.maximum,
        "nominal": None if q.nominal == 1.0 else q.nominal,
        "start": v.start,
    }


def unknowns(interface: Interface) -> Unknowns:
    """Outputs, Derivatives and InitialUnknowns, each with its dependencies."""
    current, initial = dependencies(interface), initial_dependencies(interface)
    calculated = [v for v in interface.states if v.kind == "CALCULATED_STATE"]
    initial_unknowns = sorted(
        [*calculated, *interface.derivatives, *interface.outputs], key=lambda v: v.reference
    )
    return {
        "Outputs": [(v, current[v.name]) for v in interface.variables if v.output],
        "Derivatives": [(v, current[v.name]) for v in interface.derivatives],
        "InitialUnknowns": [(v, initial[v.name]) for v in initial_unknowns],
    }


def _unknown(v: Variable, knowns: Sequence[tuple[Variable, str]], fmi: int) -> dict[str, object]:
    """Attributes of an unknown in ModelStructure."""
    knowns = sorted(knowns, key=lambda pair: pair[0].reference)
    return {
        "index" if fmi == 2 else "valueReference": _index(v, fmi),
        "dependencies": " ".join(str(_index(known, fmi)) for known, _ in knowns),
        "dependenciesKind": " ".join(kind for _, kind in knowns),
    }


def build_description(name: str, sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: the C files to compile."""
    return rendered_xml(TEMPLATES / "buildDescription.xml.j2", name=name, sources=sources)


def terminals(sub: Subsystem, interface: Interface) -> bytes:
    """terminalsAndIcons.xml; raises Problem for a terminal member that is not an input or output."""
    visible = {v.name for v in interface.variables if v.output or v.kind == "INPUT"}
    for terminal in sub.terminals:
        for member in terminal.members:
            if member.variable not in visible:
                raise Problem(
                    f"{sub.name}: terminal {terminal.name}: {member.variable} is not an input or output"
                )
    return rendered_xml(TEMPLATES / "terminalsAndIcons.xml.j2", terminals=sub.terminals, tool=TOOL)


# ---- reference experiment ----------------------------------------------------------------------------

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
PAGE = "documentation/fmi-ls-ref.html"
COMMUNICATION_STEP = 1e-2  # s
TOLERANCE = 1e-9  # relative, of the FMU's solver; 1000 times tighter than its default
# limit of the RMS deviation from the reference, relative to the range of a signal; the default tolerance of
# the solver gives hundreds of times more
NRMSE_LIMIT = 1e-5
_PARAMETER = f"{{{NAMESPACES['ssv']}}}Parameter"


_PART = "Part of a work cycle"
# how the manifest describes a file: MIME type, role, description
_RELATED = {
    "parameters.ssv": (
        "application/x-ssp-parameter-set",
        "parameter",
        "Parameters and start values of the experiment",
    ),
    "experiment.exp": ("application/x-ma-hs-experiments", "experiment/validation", _PART),
    "input.csv": ("text/csv", "other", f"Inputs, set every {1e3 * COMMUNICATION_STEP:g} ms"),
    "result.csv": ("text/csv", "result", "Result, computed with CVODES from the equations"),
    f"../../{PAGE}": ("text/html", "document", "Description of the experiment"),
}


def data_file(sub: Subsystem, name: str) -> Path:
    """Path of a data file of the experiment; the variants of a component share one input.csv."""
    variant = sub.name.removeprefix(sub.component).strip("_")
    prefix = f"reference_{variant}" if variant and name != "input.csv" else "reference"
    return sub.folder / f"{prefix}_{name}"


def ls_ref_files(sub: Subsystem) -> dict[str, bytes]:
    """The files by path in the FMU; none if there is no reference result or it has other variables."""
    data = {name: data_file(sub, name) for name in ("parameters.ssv", "input.csv", "result.csv")}
    files = {name: path.read_bytes() for name, path in data.items() if path.is_file()}
    groups = (sub.parameters, sub.inputs, sub.states, sub.outputs)
    declared = {name for group in groups for name in quantities(group)}
    if "result.csv" not in files or not _names(files) <= declared:
        return {}
    lines = files["result.csv"].decode().strip().splitlines()
    stop = float(lines[-1].partition(",")[0])
    content = {
        "name": sub.name,
        "stop": stop,
        "step": COMMUNICATION_STEP,
        "tolerance": TOLERANCE,
        "limit": NRMSE_LIMIT,
        "folder": f"../{FOLDER}",
        "description": _PART,
        "signals": lines[0].split(",")[1:],
        "has_inputs": "input.csv" in files,
    }
    # in the experiments format of the Modelica Association (draft of 2026)
    files["experiment.exp"] = rendered_xml(TEMPLATES / "experiment.exp.j2", **content)
    related = {name: file for name, file in _RELATED.items() if name in files or name.startswith("..")}
    files["fmi-ls-manifest.xml"] = rendered_xml(TEMPLATES / "fmi-ls-manifest.xml.j2", related=related)
    page = rendered(TEMPLATES / "fmi-ls-ref.html.j2", escaped=True, **content)
    return {f"{FOLDER}/{name}": content for name, content in files.items()} | {PAGE: page.encode()}


def _names(files: Mapping[str, bytes]) -> set[str]:
    """Names of the variables in the CSV files and in parameters.ssv."""
    tables = (content for name, content in files.items() if name.endswith(".csv"))
    columns = {name for t in tables for name in t.decode().partition("\n")[0].split(",")[1:]}
    return columns | {str(e.get("name")) for e in etree.fromstring(files["parameters.ssv"]).iter(_PARAMETER)}


def reference_parameters(sub: Subsystem, values: Mapping[str, float]) -> bytes:
    """parameters.ssv, in the units of the variables; equal values give equal bytes in all versions."""
    parameters = {name: (FmuVariable(name), value) for name, value in values.items()}
    return parameter_set(f"{sub.name} reference experiment", parameters)
