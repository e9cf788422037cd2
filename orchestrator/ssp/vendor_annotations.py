"""What one element of an annotation says, and how its attributes are read.

Elements that libcosim, Vico and OpenMCx write into their annotations.

SimulationInformation, as OMSimulator, drafts of SSP and early libcosim have it.

Its child says how to couple. OMSimulator's own Python API writes attributes instead, and a solver of a name,
which the annotations of components refer to.

All annotations of other tools in the files of a system, and what they say together.

What the annotations of other tools in an SSP say about the coupling of its components.

SSP has no place for the communication step, so each tool has its own. What is said is followed, or the run is
refused until the user says how to couple: a run with another step than the file's would look like its result.

OMSimulator   org.openmodelica: FixedStepMaster, VariableStepMaster, or their attributes; Jacobi, held inputs
a draft       SimulationInformation directly in a System, as drafts of SSP had it: as that of OMSimulator
libcosim      com.opensimulationplatform, org.open-simulation-platform: FixedStepAlgorithm; as before
Vico          com.github.ntnu-ihb.vico: FixedStepAlgorithm, FixedStepMaster; Jacobi, held inputs
OpenMCx       com.avl.model.connect.ssp.task: Task; Gauss-Seidel if it is sequential, else Jacobi
FMIGo, Ecos   arguments, order of execution, kinematic constraints, scenarios: refused
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import NamedTuple

from orchestrator.base.coupling import Coupling, Suggestion
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.xml import Element, children, local, number, required


@dataclass(frozen=True)
class Told:
    """What one element says.

    tool        whose annotation it is
    line        of the element in `file`
    coupling    None where the element names a step alone
    step        [s]
    component   the only one that is meant; empty: all are
    """

    tool: str
    file: Location
    line: int
    coupling: Coupling | None
    step: float
    component: str = ""

    def __str__(self) -> str:
        way = self.coupling.master if self.coupling else "any master"
        how = f", adaptive {self.coupling.adaptive:g}" if self.coupling and self.coupling.adaptive else ""
        return f"line {self.line} ({self.tool}) wants {way}{how}, step {self.step:g} s"


def step(file: Location, element: Element, name: str) -> float:
    """A step [s], which has to be there: with another one the run would not be that of the file."""
    required(file, element, name)
    value = number(file, element, name)
    if not value > 0:
        wanted = f"expected a positive number of seconds for {name}, got {element.get(name)!r}"
        raise refused(file, element, f"{local(element)}: {wanted}")
    return value


def refused(file: Location, element: Element, reason: str) -> Problem:
    """Why an element cannot be followed."""
    return Problem(f"{file}: line {element.sourceline}: {reason}")


def unknown(file: Location, element: Element, tool: str) -> Problem:
    """An element that nobody here knows may say anything about the run, so it is not passed over."""
    return refused(file, element, f"{local(element)} of {tool} is not supported")


FIXED = ("FixedStepAlgorithm", "FixedStepMaster")  # of libcosim and Vico
ORDERS: dict[str | None, Coupling] = {  # stepType of OpenMCx; without one it is sequential
    **dict.fromkeys((None, "sequential"), Coupling("gauss-seidel")),
    **dict.fromkeys(("parallel", "parallel_single_thread", "parallel_multi_thread"), Coupling("jacobi")),
}


def algorithm(file: Location, element: Element, tool: str) -> Iterator[Told]:
    """Algorithm and MasterAlgorithm: one child that says how."""
    inside = [e for e in element if local(e)]
    if not inside:
        raise refused(file, element, f"{local(element)} of {tool}: expected a FixedStepAlgorithm, got none")
    for e in inside:
        if local(e) not in FIXED:
            raise unknown(file, e, tool)
        _sizes(file, e, tool)
        yield Told(tool, file, e.sourceline, Coupling("jacobi"), step(file, e, "baseStepSize"))


def _sizes(file: Location, element: Element, tool: str) -> None:
    """Refuse steps of single components, unless they are the base step."""
    for e in children(element, "StepSizes", "StepSize"):
        many = required(file, e, "multipleOf")
        if many.strip() != "1":
            who = e.get("component", "a component")
            told = f"{who} wants a step of its own, {many} times the base step of {tool}"
            raise refused(file, e, f"{told}, which is not supported")


def hint(file: Location, element: Element, tool: str) -> Iterator[Told]:
    """A StepSizeHint of libcosim or Vico."""
    yield Told(tool, file, element.sourceline, None, step(file, element, "value"), _owner(element))


def own_step(file: Location, element: Element, tool: str) -> Iterator[Told]:
    """Component of OpenMCx: its own step."""
    if element.get("deltaTime") is not None:
        yield Told(tool, file, element.sourceline, None, step(file, element, "deltaTime"), _owner(element))


def task(file: Location, element: Element, tool: str) -> Iterator[Told]:
    """Task of OpenMCx."""
    kind, end = element.get("stepType"), element.get("endType")
    if kind not in ORDERS:
        raise refused(file, element, f"stepType {kind!r} of {tool} is not supported")
    if end not in (None, "end_time"):
        raise refused(file, element, f"endType {end!r} of {tool} is not supported, expected 'end_time'")
    yield Told(tool, file, element.sourceline, ORDERS[kind], step(file, element, "deltaTime"))


def _owner(element: Element) -> str:
    """The component whose annotation this is, or the system."""
    above = (e.get("name") for e in element.iterancestors() if local(e) in ("Component", "System"))
    return next(filter(None, above), "the system")


EXCHANGE = ("euler", "cvode")  # methods that solve by Model Exchange
STEPS = ("initialStepSize", "minimumStepSize", "maximumStepSize")
VARIABLE = (*STEPS, "relativeTolerance")
USUAL = dict(zip(VARIABLE, (1e-6, 1e-12, 1e-3, 1e-4), strict=True))  # where an attribute is missing there
TAKEN = {"oms_ma": ("fixedStepSize", "relativeTolerance"), "oms_mav": VARIABLE, "oms_mav2": VARIABLE}
TOLERANCES = ("tolerance", "absoluteTolerance")  # that API writes what it is given, and does not read these
RESULTS = ("name", "resultFile", "loggingInterval", "bufferSize", "signalFilter")


def information(file: Location, element: Element, tool: str) -> Iterator[Told]:
    """What a SimulationInformation says, in either way."""
    if element.get("method") is not None:
        yield _solver(file, element, tool)
    else:
        _attributes(file, element, tool, RESULTS)
        _reference(file, element, tool)
    for e in element:
        if local(e) == "FixedStepMaster":
            yield Told(tool, file, e.sourceline, Coupling("jacobi"), step(file, e, "stepSize"))
        elif local(e) == "VariableStepMaster":
            yield _variable(file, e, tool, partial(_given, file, e))
        elif local(e) == "VariableStepSolver":
            raise _exchange(file, e, tool)
        elif local(e):
            raise unknown(file, e, tool)


def _solver(file: Location, element: Element, tool: str) -> Told:
    """A solver as attributes."""
    method = element.get("method")
    if method in EXCHANGE:
        raise _exchange(file, element, tool)
    if method not in TAKEN:
        raise refused(file, element, f"the method {method!r} of {tool} is not supported")
    _attributes(file, element, tool, (*RESULTS, "method", *TAKEN[method], *TOLERANCES))
    _used(file, element, tool)
    if method == "oms_ma":
        return Told(tool, file, element.sourceline, Coupling("jacobi"), step(file, element, "fixedStepSize"))
    return _variable(file, element, tool, lambda name: number(file, element, name, USUAL[name]))


def _exchange(file: Location, element: Element, tool: str) -> Problem:
    how = element.get("description") or element.get("method") or local(element)
    wanted = f"{local(element)} of {tool} wants Model Exchange ({how})"
    return refused(file, element, f"{wanted}, here FMUs take part by Co-Simulation only")


def _variable(file: Location, element: Element, tool: str, read: Callable[[str], float]) -> Told:
    """A master that chooses its steps: the nearest of ours has the same tolerance and limits."""
    first, smallest, largest, tolerance = (read(name) for name in VARIABLE)
    if not first > 0:
        raise refused(file, element, f"initialStepSize: expected a positive number of seconds, got {first:g}")
    try:
        coupling = Coupling("jacobi", adaptive=tolerance, smallest=smallest or None, largest=largest)
    except Problem as problem:
        raise refused(file, element, f"{local(element)}: {problem}") from None
    return Told(tool, file, element.sourceline, coupling, first)


def _given(file: Location, element: Element, name: str) -> float:
    """An attribute that has to be there: of the element no tool says what it means without."""
    required(file, element, name)
    return number(file, element, name)


def _attributes(file: Location, element: Element, tool: str, known: tuple[str, ...]) -> None:
    """Refuse attributes that nobody reads: one may be a step that is meant."""
    for name in element.attrib:
        if not name.startswith("{") and name not in known:
            raise refused(file, element, f"attribute {name} of {local(element)} ({tool}) is not supported")


def _used(file: Location, element: Element, tool: str) -> None:
    """A solver that no component names has no effect: OMSimulator gives them its usual one."""
    name = element.get("name")
    named = {e.get("name") for e in _all(element) if e.get("method") is None}
    if name is not None and name not in named:
        raise refused(file, element, f"no component names the solver {name!r} of {tool}")


def _reference(file: Location, element: Element, tool: str) -> None:
    """A solver that is named has to be there."""
    name, solvers = element.get("name"), [e for e in _all(element) if e.get("method") is not None]
    if name is not None and name not in [e.get("name") for e in solvers]:
        raise refused(file, element, f"no solver of {tool} has the name {name!r}")


def _all(element: Element) -> list[Element]:
    """Every SimulationInformation in the file of this one."""
    return [e for e in element.getroottree().iter() if local(e) == "SimulationInformation"]


Reader = Callable[[Location, Element, str], Iterator[Told]]
NEAR = 1e-9  # relative: two texts of one step size
DRAFT = "a draft of SSP"


class Kind(NamedTuple):
    """A type of annotations: what of its elements is read, and which say nothing about a run."""

    tool: str
    readers: Mapping[str, Reader]
    idle: tuple[str, ...] = ()


LIBCOSIM: Mapping[str, Reader] = {
    "Algorithm": algorithm,
    "SimulationInformation": information,
    "StepSizeHint": hint,
}
VICO: Mapping[str, Reader] = {"Algorithm": algorithm, "MasterAlgorithm": algorithm, "StepSizeHint": hint}
KINDS = {
    "org.openmodelica": Kind("OMSimulator", {"SimulationInformation": information}, ("Buses",)),
    "com.opensimulationplatform": Kind("libcosim", LIBCOSIM),
    "org.open-simulation-platform": Kind("libcosim", LIBCOSIM),
    "com.github.ntnu-ihb.vico": Kind("Vico", VICO, ("Transform",)),
    "com.avl.model.connect.ssp.task": Kind("OpenMCx", {"Task": task}),
    "com.avl.model.connect.ssp.component": Kind("OpenMCx", {"Component": own_step}),
}
REFUSED = {  # by the beginning of their type
    "se.umu.math.umit.": "FMIGo",
    "com.avl.model.connect.ssp.connection": "OpenMCx",
    "com.github.ecos-platform.scenario": "Ecos",
}


def read_vendors(roots: Iterable[tuple[Location, Element]]) -> Suggestion:
    """What the annotations of other tools say in these .ssd files, each with its root element."""
    try:
        told = [t for file, root in roots for t in _told(file, root)]
        _check(told)
    except Problem as problem:
        return Suggestion(refusal=str(problem))
    return _together(told) if told else Suggestion()


def _check(told: list[Told]) -> None:
    """All have to say the same."""
    for one, other in combinations(told, 2):
        if not _agree(one, other):
            where = "" if other.file == one.file else f"{other.file}: "
            raise Problem(f"{one.file}: {one}, but {where}{other}")


def _agree(a: Told, b: Told) -> bool:
    same = abs(a.step - b.step) <= NEAR * a.step
    return same and (a.coupling is None or b.coupling is None or a.coupling == b.coupling)


def _together(told: list[Told]) -> Suggestion:
    """One suggestion from what all say."""
    masters = [t for t in told if t.coupling is not None]
    said = masters or told
    tools = " and ".join(dict.fromkeys(_source(t.tool) for t in said))
    files = " and ".join(dict.fromkeys(str(t.file) for t in said))
    return Suggestion(
        coupling=said[0].coupling,
        step=said[0].step,
        source=f"{tools} in {files}",
        place=f"{said[0].file}: line {said[0].line} ({said[0].tool})",
        only=() if masters else tuple(dict.fromkeys(t.component for t in told)),
    )


def _source(tool: str) -> str:
    return f"SimulationInformation of {DRAFT}" if tool == DRAFT else f"the annotation of {tool}"


def _told(file: Location, root: Element) -> Iterator[Told]:
    """All that stands in annotations, outermost first."""
    for element in root.iter():
        if local(element) == "Annotation":
            yield from _annotation(file, element, (element.get("type") or "").strip())
        elif local(element) == "SimulationInformation" and local(element.getparent()) == "System":
            yield from information(file, element, DRAFT)


def _annotation(file: Location, annotation: Element, kind: str) -> Iterator[Told]:
    """What one annotation says; of other types nothing."""
    for beginning, tool in REFUSED.items():
        if kind.startswith(beginning):
            raise refused(file, annotation, f"the annotation {kind} of {tool} is not supported")
    if kind in KINDS:
        yield from _elements(file, annotation, KINDS[kind])


def _elements(file: Location, parent: Element, kind: Kind) -> Iterator[Told]:
    """The elements of an annotation, which OMSimulator puts into another one."""
    for e in parent:
        if local(e) == "Annotations":
            yield from _elements(file, e, kind)
        elif local(e) in kind.readers:
            yield from kind.readers[local(e)](file, e, kind.tool)
        elif local(e) and local(e) not in kind.idle:
            raise unknown(file, e, kind.tool)


__all__ = ["read_vendors"]
