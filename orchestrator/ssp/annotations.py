"""Annotations of an SSP: suggested master and communication step, shared parameters; read and written.

The SSP standard has no elements for master and step, so each tool has an annotation of its own. The
annotation of this project, which other tools ignore, is

    <ssd:DefaultExperiment>
      <ssd:Annotations>
        <ssc:Annotation type="harvester-cosim">
          <hc:Coupling xmlns:hc="urn:harvester-cosim:coupling" master="hermite" step="0.005" passes="2">
            <hc:Factor component="arm" steps="4"/>
          </hc:Coupling>
        </ssc:Annotation>
      </ssd:Annotations>
    </ssd:DefaultExperiment>

with the attributes of `Coupling` and the communication step [s]. Another annotation of the same type names
parameters that are one physical quantity in several components:

          <hc:SharedParameter xmlns:hc="urn:harvester-cosim:coupling" name="stroke">
            <hc:Component name="arm"/>
            <hc:Component name="cylinder"/>
          </hc:SharedParameter>

A `CommonParameter` is likewise one quantity, such as the density of the oil, but its components may have
different values: a note tells them.

All may also be annotations of the outermost System, or of the whole file. In other places, such as a nested
file, they are ignored with a note.

If a Coupling is missing, those of other tools are used. They are followed, or a run is refused until the
user chooses a master or a step: a run with another step than that of the file could be taken for its result.

    OMSimulator   org.openmodelica: FixedStepMaster, VariableStepMaster; Jacobi, held inputs
    a draft       SimulationInformation directly in a System, as in drafts of SSP: as that of OMSimulator
    libcosim      com.opensimulationplatform, org.open-simulation-platform: FixedStepAlgorithm; as before
    others        FMIGo, Ecos, OpenMCx, Vico: refused
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.options import declarations
from orchestrator.base.xml import XmlElement, finite, integer, local_name
from orchestrator.ssp.coupling import Coupling, Suggestion

OWN, COUPLING, SHARED, COMMON = "harvester-cosim", "Coupling", "SharedParameter", "CommonParameter"
PATHS = ("DefaultExperiment",), ("System",), ()  # elements with annotations, as paths from the root


def read_suggestion(roots: Sequence[XmlElement], components: Iterable[str]) -> Suggestion:
    """The suggestion in .ssd files for these components; roots: the outermost file first."""
    elements = [e for e in _own_elements(roots[0]) if e.name == COUPLING]
    if not elements:
        return _suggestion_of_other_tools(roots)
    if len(elements) > 1:
        lines = ", ".join(str(e.element.sourceline) for e in elements)
        message = f"expected one Coupling in annotations of type {OWN}, got some in lines {lines}"
        raise Problem(f"{roots[0].file}: {message}")
    (element,) = elements
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


def read_shared(root: XmlElement, components: Collection[str], kind: str) -> dict[str, tuple[str, ...]]:
    """Parameter -> components that share it; root: the outermost file; kind: `SHARED` or `COMMON`."""
    shared = dict[str, tuple[str, ...]]()
    for element in _own_elements(root):
        if element.name == kind:
            names = tuple(e.required("name") for e in element.children("Component"))
            if not names:
                raise element.problem("expected at least one Component, got none")
            for name in names:
                if name not in components:
                    expected = f"expected a component of the system, got {name!r}"
                    raise element.problem(f"{expected}{suggest(name, components)}")
            shared[element.required("name")] = names
    return shared


def ignored_annotations(roots: Sequence[XmlElement]) -> list[str]:
    """Notes on annotations of this project in other places than `PATHS`, such as nested files."""
    read = [e.element for path in PATHS for e in roots[0].children(*path, "Annotations", "Annotation")]
    reason = f"annotation of type {OWN}: left out, only one of the outermost system counts"
    return [
        f"{root.file}: line {e.sourceline}: {reason}"
        for root in roots
        for e in root.element.iter()
        if local_name(e) == "Annotation" and e.get("type") == OWN and e not in read
    ]


# ---- annotation of this project ----------------------------------------------------------------------------


# type of an attribute -> what is expected, and what reads it or raises ValueError
READERS: Mapping[Any, tuple[str, Callable[[str], Any]]] = {
    None: ("a text", str),
    int: ("a whole number", integer),
    float: ("a number", finite),
}
SETTINGS = {name: option.numeric for name, option in declarations(Coupling).items() if not option.mapping}
ATTRIBUTES: Mapping[str, Any] = SETTINGS | {"master": None, "step": float}
FACTOR: Mapping[str, Any] = {"component": None, "steps": int}


def _own_elements(root: XmlElement) -> Iterator[XmlElement]:
    """The elements in annotations of this project."""
    for path in PATHS:
        for annotation in root.children(*path, "Annotations", "Annotation"):
            for e in annotation.children() if annotation.get("type") == OWN else ():
                if e.name not in (COUPLING, SHARED, COMMON):
                    raise e.problem(f"expected {COUPLING}, {SHARED}, {COMMON} in an annotation of type {OWN}")
                yield e


def _factors(element: XmlElement) -> dict[str, int]:
    """Component -> number of its steps in one communication step."""
    factors = dict[str, int]()
    for e in element.children():
        if e.name != "Factor":
            raise e.problem("expected Factor in a Coupling")
        attributes = _attributes(e, FACTOR)
        for name in FACTOR:
            if name not in attributes:
                raise e.problem(f"expected an attribute {name}, got none")
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
DRAFT = "a draft of SSP"
JACOBI = Coupling("jacobi")


@dataclass(frozen=True)
class Request:
    """Coupling and step that one element of a tool's annotation requests.

    coupling    None if it requests only a step
    step        [s]
    component   the component that it applies to; empty: all
    """

    tool: str
    element: XmlElement
    coupling: Coupling | None
    step: float
    component: str = ""

    def __str__(self) -> str:
        master = self.coupling.method.name if self.coupling else "any master"
        adaptive = (
            f", adaptive {self.coupling.adaptive:g}" if self.coupling and self.coupling.adaptive else ""
        )
        line = self.element.element.sourceline
        return f"line {line} ({self.tool}) requests {master}{adaptive}, step {self.step:g} s"

    def agrees(self, other: Request) -> bool:
        """Are two requests compatible?"""
        same_step = abs(self.step - other.step) <= SAME_STEP * self.step
        return same_step and (None in (self.coupling, other.coupling) or self.coupling == other.coupling)


def _suggestion_of_other_tools(roots: Iterable[XmlElement]) -> Suggestion:
    """The suggestion of all annotations of other tools in these files."""
    try:
        requests = [r for root in roots for r in _requests(root)]
        for one, other in combinations(requests, 2):
            if not one.agrees(other):
                here, there = one.element.file, other.element.file
                raise Problem(f"{here}: {one}, but {'' if there == here else f'{there}: '}{other}")
    except Problem as problem:
        return Suggestion(refusal=str(problem))
    if not requests:
        return Suggestion()
    masters = [r for r in requests if r.coupling is not None]
    chosen = masters or requests
    tools = (
        f"SimulationInformation of {r.tool}" if r.tool == DRAFT else f"the annotation of {r.tool}"
        for r in chosen
    )
    files = dict.fromkeys(str(r.element.file) for r in chosen)
    first = chosen[0]
    return Suggestion(
        coupling=first.coupling,
        step=first.step,
        source=f"{' and '.join(dict.fromkeys(tools))} in {' and '.join(files)}",
        location=f"{first.element.location} ({first.tool})",
        components=() if masters else tuple(dict.fromkeys(r.component for r in requests)),
    )


def _requests(root: XmlElement) -> Iterator[Request]:
    """All requests in a file."""
    for raw in root.element.iter():
        element = XmlElement(root.file, raw)
        if element.name == "Annotation":
            type_ = (element.get("type") or "").strip()
            for prefix, tool in REFUSED.items():
                if type_.startswith(prefix):
                    raise _refusal(element, f"the annotation {type_} of {tool} is not supported")
            if type_ in TOOLS:
                yield from _elements(element, TOOLS[type_])
        elif element.name == "SimulationInformation" and local_name(raw.getparent()) == "System":
            yield from _simulation_information(element, DRAFT)


def _elements(parent: XmlElement, annotation: AnnotationType) -> Iterator[Request]:
    """The requests in an annotation; OMSimulator nests annotations."""
    for e in parent.children():
        if e.name == "Annotations":
            yield from _elements(e, annotation)
        elif e.name in annotation.readers:
            yield from annotation.readers[e.name](e, annotation.tool)
        elif e.name not in annotation.ignored:
            raise _unsupported(e, annotation.tool)


def _refusal(element: XmlElement, reason: str) -> Problem:
    return Problem(f"{element.location}: {reason}")


def _unsupported(element: XmlElement, tool: str) -> Problem:
    """An unknown element may affect the run, so it is not ignored."""
    return _refusal(element, f"{element.name} of {tool} is not supported")


def _step(element: XmlElement, name: str) -> float:
    """A step [s]; the attribute is required."""
    element.required(name)
    value = element.number(name)
    if not value > 0:
        raise element.problem(f"expected a positive number of seconds for {name}, got {element.get(name)!r}")
    return value


def _owner(element: XmlElement) -> str:
    """The name of the component or system that has the annotation."""
    ancestors = (
        e.get("name") for e in element.element.iterancestors() if local_name(e) in ("Component", "System")
    )
    return next(filter(None, ancestors), "the system")


def _algorithm(element: XmlElement, tool: str) -> Iterator[Request]:
    """Algorithm: the element inside has the step."""
    children = list(element.children())
    if not children:
        raise _refusal(element, f"{element.name} of {tool}: expected a FixedStepAlgorithm, got none")
    for e in children:
        for unknown in (*([] if e.name == "FixedStepAlgorithm" else [e]), *e.children()):
            raise _unsupported(unknown, tool)
        yield Request(tool, e, JACOBI, _step(e, "baseStepSize"))


def _step_size_hint(element: XmlElement, tool: str) -> Iterator[Request]:
    """StepSizeHint of libcosim: the step of one component."""
    yield Request(tool, element, None, _step(element, "value"), _owner(element))


# SimulationInformation of OMSimulator, drafts of SSP and early libcosim. A child element is the master.

VARIABLE = ("initialStepSize", "minimumStepSize", "maximumStepSize", "relativeTolerance")
RESULTS = ("name", "resultFile", "loggingInterval", "bufferSize", "signalFilter")


def _simulation_information(element: XmlElement, tool: str) -> Iterator[Request]:
    for name in element.attributes:  # another one may be a step, or a solver
        if name not in RESULTS:
            raise _refusal(element, f"attribute {name} of {element.name} ({tool}) is not supported")
    for e in element.children():
        if e.name == "FixedStepMaster":
            yield Request(tool, e, JACOBI, _step(e, "stepSize"))
        elif e.name == "VariableStepMaster":
            yield _variable_step(e, tool)
        elif e.name == "VariableStepSolver":
            method = e.get("description") or e.name
            request = f"{e.name} of {tool} requests Model Exchange ({method})"
            raise _refusal(e, f"{request}, expected Co-Simulation")
        else:
            raise _unsupported(e, tool)


def _variable_step(element: XmlElement, tool: str) -> Request:
    """A master with adaptive steps; the nearest one of this project has the same tolerance and limits."""
    for name in VARIABLE:
        element.required(name)
    first, smallest, largest, tolerance = map(element.number, VARIABLE)
    if not first > 0:
        message = f"initialStepSize: expected a positive number of seconds, got {first:g}"
        raise _refusal(element, message)
    try:
        coupling = Coupling("jacobi", adaptive=tolerance, smallest=smallest or None, largest=largest)
    except Problem as problem:
        raise element.problem(str(problem)) from None
    return Request(tool, element, coupling, first)


Reader = Callable[[XmlElement, str], Iterator[Request]]


class AnnotationType(NamedTuple):
    """Readers of the elements in one type of annotations, and elements without effect on a run."""

    tool: str
    readers: Mapping[str, Reader]
    ignored: tuple[str, ...] = ()


_LIBCOSIM = AnnotationType(
    "libcosim",
    {
        "Algorithm": _algorithm,
        "SimulationInformation": _simulation_information,
        "StepSizeHint": _step_size_hint,
    },
)
TOOLS = {
    "org.openmodelica": AnnotationType(
        "OMSimulator", {"SimulationInformation": _simulation_information}, ("Buses",)
    ),
    "com.opensimulationplatform": _LIBCOSIM,
    "org.open-simulation-platform": _LIBCOSIM,
}
REFUSED = {  # by the prefix of the annotation type
    "se.umu.math.umit.": "FMIGo",
    "com.avl.model.connect.ssp.": "OpenMCx",
    "com.github.ntnu-ihb.vico": "Vico",
    "com.github.ecos-platform.scenario": "Ecos",
}


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
