"""Annotations of an SSP: suggested master and communication step, shared parameters; read and written.

The SSP standard has no elements for master and step, so each tool has an annotation of its own. Those of this
project, which other tools ignore, have the type `harvester-cosim`; docs/coupling.md shows them:

    Coupling          the attributes of `Coupling`, the communication step [s], and Factors of components
    SharedParameter   a parameter that is one physical quantity in several components
    CommonParameter   the same, if its components may have different values, which a note tells

They may be in the default experiment, in the outermost System, or in the whole file. In other places, such as
a nested file, they are ignored with a note.

If a Coupling is missing, those of other tools are used: of OMSimulator and libcosim, whose masters are Jacobi
masters. They are followed, or a run is refused until the user chooses a master or a step: a run with another
step than that of the file could be taken for its result.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import isclose
from typing import Any

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.numerals import finite, integer
from orchestrator.base.options import declarations, field_names
from orchestrator.base.xml import XmlElement, local_name
from orchestrator.ssp.coupling import Coupling, CouplingOptions, Suggestion

OWN, COUPLING, SHARED, COMMON = "harvester-cosim", "Coupling", "SharedParameter", "CommonParameter"
PATHS = ("DefaultExperiment",), ("System",), ()  # elements with annotations, as paths from the root


def read_annotations(
    roots: Sequence[XmlElement], components: Collection[str]
) -> tuple[Suggestion, dict[str, dict[str, tuple[str, ...]]], list[str]]:
    """The suggestion, parameters that components share, of the kinds `SHARED` and `COMMON`, and notes.

    roots   of the .ssd files of a system, the outermost one first
    """
    annotations = [a for path in PATHS for a in roots[0].children(*path, "Annotations", "Annotation")]
    shared: dict[str, dict[str, tuple[str, ...]]] = {SHARED: {}, COMMON: {}}
    couplings = list[XmlElement]()
    for element in (e for a in annotations if a.get("type") == OWN for e in a.children()):
        if element.name == COUPLING:
            couplings.append(element)
        elif element.name in shared:
            shared[element.name][element.required("name")] = _sharing(element, components)
        else:
            raise element.problem(f"expected {COUPLING}, {SHARED}, {COMMON} in an annotation of type {OWN}")
    if len(couplings) > 1:
        lines = ", ".join(str(e.element.sourceline) for e in couplings)
        message = f"expected one Coupling in annotations of type {OWN}, got some in lines {lines}"
        raise Problem(f"{roots[0].file}: {message}")
    read = [a.element for a in annotations]
    reason = f"annotation of type {OWN}: left out, only one of the outermost system counts"
    notes = [
        f"{root.file}: line {e.sourceline}: {reason}"
        for root in roots
        for e in root.element.iter()
        if local_name(e) == "Annotation" and e.get("type") == OWN and e not in read
    ]
    own = _suggestion(couplings[0], components) if couplings else None
    return own or _suggestion_of_other_tools(roots), shared, notes


# ---- annotation of this project ----------------------------------------------------------------------------


# type of an attribute -> what is expected, and what reads it or raises ValueError
READERS: Mapping[Any, tuple[str, Callable[[str], Any]]] = {
    None: ("a text", str),
    int: ("a whole number", integer),
    float: ("a number", finite),
}
DECLARED = [(field_names(CouplingOptions)[n], option) for n, option in declarations(CouplingOptions).items()]
SETTINGS = {name: option.numeric for name, option in DECLARED if not option.mapping}
ATTRIBUTES: Mapping[str, Any] = SETTINGS | {"step": float}
FACTOR: Mapping[str, Any] = {"component": None, "steps": int}


def _suggestion(element: XmlElement, components: Collection[str]) -> Suggestion:
    """The suggestion of a Coupling for these components."""
    choices = _attributes(element, ATTRIBUTES)
    step = choices.pop("step", None)
    if step is not None and not step > 0:
        raise element.problem(f"expected a positive number of seconds for step, got {step:g}")
    factors = _factors(element)
    try:
        coupling = Coupling(**choices, factors=factors)
        coupling.check(components)
    except Problem as problem:
        raise element.problem(str(problem)) from None
    return Suggestion(coupling, step, location=f"{element.location}: Coupling")


def _sharing(element: XmlElement, components: Collection[str]) -> tuple[str, ...]:
    """The components that share a parameter."""
    names = tuple(e.required("name") for e in element.children("Component"))
    if not names:
        raise element.problem("expected at least one Component, got none")
    for name in (n for n in names if n not in components):
        raise element.problem(f"expected a component of the system, got {name!r}{suggest(name, components)}")
    return names


def _factors(element: XmlElement) -> dict[str, int]:
    """Component -> number of its steps in one communication step."""
    factors = dict[str, int]()
    for e in element.children():
        if e.name != "Factor":
            raise e.problem("expected Factor in a Coupling")
        attributes = _attributes(e, FACTOR)
        for name in FACTOR:
            e.required(name)
        if (component := attributes["component"]) in factors:
            raise e.problem(f"component {component}: expected one Factor, got two")
        factors[component] = attributes["steps"]
    return factors


def _attributes(element: XmlElement, types: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of an element, converted to their types."""
    values = dict[str, Any]()
    for name, text in element.attributes.items():
        if name not in types:
            hint = suggest(name, types) or f"; there are {', '.join(types)}"
            raise element.problem(f"unknown attribute {name!r}{hint}")
        expected, read = READERS[types[name]]
        try:
            values[name] = read(text.strip())
        except ValueError:
            raise element.problem(f"expected {expected} for {name}, got {text!r}") from None
    return values


# ---- annotations of other tools ----------------------------------------------------------------------------

SAME_STEP = 1e-9  # relative difference of two equal steps
TOOLS = {"org.openmodelica": "OMSimulator", "com.opensimulationplatform": "libcosim"}  # by type of annotation
# tool -> element -> what is known inside; there any other element may affect the run
INSIDE: Mapping[str, Mapping[str, Sequence[str]]] = {
    "OMSimulator": {
        **dict.fromkeys(("Annotation", "Annotations"), ("Annotations", "SimulationInformation", "Buses")),
        "SimulationInformation": ("FixedStepMaster", "VariableStepMaster", "VariableStepSolver"),
    },
    "libcosim": {
        "Annotation": ("Algorithm", "StepSizeHint"),
        "Algorithm": ("FixedStepAlgorithm",),
        "FixedStepAlgorithm": (),  # StepSizes of components would be inside
    },
}
# element -> attributes with its step [s], and limits and tolerance of an adaptive one
STEPS = {
    "FixedStepMaster": ("stepSize",),
    "VariableStepMaster": ("initialStepSize", "minimumStepSize", "maximumStepSize", "relativeTolerance"),
    "FixedStepAlgorithm": ("baseStepSize",),
    "StepSizeHint": ("value",),  # of one component, here of all
}
RESULTS = ("name", "resultFile", "loggingInterval", "bufferSize", "signalFilter")  # of SimulationInformation


def _suggestion_of_other_tools(roots: Iterable[XmlElement]) -> Suggestion:
    """The suggestion of all annotations of other tools in these files."""
    try:
        found = [s for root in roots for s in _suggestions(root)]
        for one, other in combinations(found, 2):
            if one.coupling != other.coupling or not isclose(
                one.step or 0, other.step or 0, rel_tol=SAME_STEP
            ):
                raise Problem(f"{_requested(one)}, but {_requested(other)}")
    except Problem as problem:
        return Suggestion(refusal=str(problem))
    sources = " and ".join(dict.fromkeys(s.source for s in found))
    return replace(found[0], source=sources) if found else Suggestion()


def _requested(found: Suggestion) -> str:
    coupling = found.coupling or Coupling()
    adaptive = f", adaptive {coupling.adaptive:g}" if coupling.adaptive else ""
    return f"{found.location} requests {coupling.text}{adaptive}, step {found.step:g} s"


def _suggestions(root: XmlElement) -> Iterator[Suggestion]:
    """The suggestions of all annotations of other tools in a file."""
    for raw in root.element.iter():
        element = XmlElement(root.file, raw)
        tool = TOOLS.get((element.get("type") or "").strip()) if element.name == "Annotation" else None
        if tool is not None:
            yield from _inside(element, tool)


def _inside(parent: XmlElement, tool: str) -> Iterator[Suggestion]:
    """The suggestions inside of an element of a tool's annotation."""
    children = list(parent.children())
    if parent.name == "Algorithm" and not children:
        raise Problem(f"{parent.location}: Algorithm of {tool}: expected a FixedStepAlgorithm, got none")
    for e in children:
        if e.name not in INSIDE[tool][parent.name]:
            raise Problem(f"{e.location}: {e.name} of {tool} is not supported")
        if e.name == "SimulationInformation":
            for name in (n for n in e.attributes if n not in RESULTS):  # it may be a step, or a solver
                raise Problem(f"{e.location}: attribute {name} of {e.name} ({tool}) is not supported")
        if e.name == "VariableStepSolver":
            request = f"{e.name} of {tool} requests Model Exchange ({e.get('description') or e.name})"
            raise Problem(f"{e.location}: {request}, expected Co-Simulation")
        if e.name in STEPS:
            yield _suggested(e, tool)
        if e.name in INSIDE[tool]:
            yield from _inside(e, tool)


def _suggested(element: XmlElement, tool: str) -> Suggestion:
    """Coupling and step [s] that one element requests; the nearest ones of this project."""
    for attribute in STEPS[element.name]:
        element.required(attribute)
    name, (step, *limits) = STEPS[element.name][0], map(element.number, STEPS[element.name])
    if not step > 0:
        raise element.problem(f"expected a positive number of seconds for {name}, got {element.get(name)!r}")
    smallest, largest, tolerance = limits or (None, None, None)
    try:
        coupling = Coupling("jacobi", adaptive=tolerance, smallest=smallest or None, largest=largest)
    except Problem as problem:
        raise element.problem(str(problem)) from None
    source = f"the annotation of {tool} in {element.file}"
    return Suggestion(coupling, step, source=source, location=f"{element.location} ({tool})")


# ---- writing -----------------------------------------------------------------------------------------------


def coupling_attributes(suggestion: Suggestion) -> dict[str, Any]:
    """Attributes of the annotation of this project: master, step, and settings that are not the default."""
    coupling, default = suggestion.coupling or Coupling(), Coupling()
    if suggestion.step is None and suggestion.coupling is None:
        return {}
    if coupling.method.own:
        raise Problem(f"master {coupling.method.name}: expected one that a file can name, got one of Python")
    values = {name: getattr(coupling, name) for name in ATTRIBUTES if name not in ("master", "step")}
    changed = {n: value for n, value in values.items() if value != getattr(default, n)}
    return {"master": coupling.method.name, "step": suggestion.step} | changed
