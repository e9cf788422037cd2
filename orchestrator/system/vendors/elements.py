"""Elements that libcosim, Vico and OpenMCx write into their annotations."""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, children, local, required
from orchestrator.settings import Coupling
from orchestrator.system.vendors.told import Told, refused, step, unknown

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
