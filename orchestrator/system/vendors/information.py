"""SimulationInformation, as OMSimulator, drafts of SSP and early libcosim have it.

Its child says how to couple. OMSimulator's own Python API writes attributes instead, and a solver of a name,
which the annotations of components refer to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, local, number, required
from orchestrator.settings import Coupling
from orchestrator.system.vendors.told import Told, refused, step, unknown

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
