"""What the annotations of other tools in an SSP say about the coupling of its components.

SSP has no place for the communication step, so each tool has its own. What is said is followed, or the run is
refused until the user says how to couple: a run with another step than the file's would look like its result.

OMSimulator   org.openmodelica (and drafts of 2018): FixedStepMaster, VariableStepMaster; Jacobi, held inputs
libcosim      com.opensimulationplatform, org.open-simulation-platform: FixedStepAlgorithm; as before
Vico          com.github.ntnu-ihb.vico: FixedStepAlgorithm, FixedStepMaster; Jacobi, held inputs
OpenMCx       com.avl.model.connect.ssp.task: Task; Gauss-Seidel if it is sequential, else Jacobi
FMIGo         se.umu.math.umit.fmigo-master.arguments: refused
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, children, local, number
from orchestrator.settings import Coupling

OMS, TASK, TASK_STEP = (
    "org.openmodelica",
    "com.avl.model.connect.ssp.task",
    "com.avl.model.connect.ssp.component",
)
OSP = ("com.opensimulationplatform", "org.open-simulation-platform", "com.github.ntnu-ihb.vico")
FMIGO = "se.umu.math.umit.fmigo-master."
NAMES = {
    OMS: "OMSimulator",
    OSP[0]: "libcosim",
    OSP[1]: "libcosim",
    OSP[2]: "Vico",
    TASK: "OpenMCx",
    TASK_STEP: "OpenMCx",
}
ORDERS: dict[str | None, Coupling | None] = {  # stepType of OpenMCx
    None: None,
    "sequential": Coupling("gauss-seidel"),
    **dict.fromkeys(("parallel", "parallel_single_thread", "parallel_multi_thread"), Coupling("jacobi")),
}
INSTEAD = "to choose a way of your own, give --master and --step"
NEAR = 1e-9  # relative: two texts of one step size


class Unsupported(Exception):
    """What an element says cannot be followed; the text says why."""


@dataclass(frozen=True)
class Told:
    """What one element says: a coupling, None where it names a step alone; step [s]."""

    tool: str
    line: int
    coupling: Coupling | None
    step: float | None


@dataclass(frozen=True)
class Known:
    """What all annotations say together.

    coupling, step   to follow; None where nothing is said
    refusal          why they cannot be followed; empty where they can
    note             one line for the card of a run
    """

    coupling: Coupling | None = None
    step: float | None = None
    refusal: str = ""
    note: str = ""


def read_vendors(file: Location, root: Element) -> Known:
    """What the annotations of other tools in a .ssd file say."""
    try:
        told = list(_told(file, root))
    except Unsupported as reason:
        return Known(refusal=f"{file}: {reason}; {INSTEAD}")
    if not told:
        return Known()
    first = told[0]
    for other in told[1:]:
        if not _agree(first, other):
            return Known(refusal=f"{file}: {_said(first)}, but {_said(other)}; {INSTEAD}")
    step = next((t.step for t in told if t.step is not None), None)
    coupling = next((t.coupling for t in told if t.coupling is not None), None)
    tools = ", ".join(dict.fromkeys(t.tool for t in told))
    return Known(coupling, step, note=f"coupled as the annotation of {tools} in {file} says")


def _agree(a: Told, b: Told) -> bool:
    steps = a.step is None or b.step is None or abs(a.step - b.step) <= NEAR * a.step
    return steps and (a.coupling is None or b.coupling is None or a.coupling == b.coupling)


def _said(told: Told) -> str:
    way = told.coupling.master if told.coupling else "any master"
    how = f", adaptive {told.coupling.adaptive:g}" if told.coupling and told.coupling.adaptive else ""
    step = f", step {told.step:g} s" if told.step is not None else ""
    return f"line {told.line} ({told.tool}) wants {way}{how}{step}"


def _told(file: Location, root: Element) -> Iterator[Told]:
    """All that stands in annotations, outermost first."""
    for element in root.iter():
        name, parent = local(element), element.getparent()
        if name == "Annotation":
            kind = (element.get("type") or "").strip()
            if kind.startswith(FMIGO):
                raise Unsupported(f"line {element.sourceline}: arguments of FMIGo's master are not supported")
            if kind in NAMES:
                yield from _annotation(file, element, kind)
        elif name == "SimulationInformation" and local(parent) == "System":  # a draft of SSP
            yield from _information(file, element, NAMES[OMS])


def _annotation(file: Location, annotation: Element, kind: str) -> Iterator[Told]:
    tool = NAMES[kind]
    for e in annotation.iter():
        name = local(e)
        if name == "SimulationInformation":
            yield from _information(file, e, tool)
        elif name in ("Algorithm", "MasterAlgorithm"):
            yield from _algorithm(file, e, tool)
        elif name in ("StepSizeHint", "Component"):
            step = _step(file, e, "value" if name == "StepSizeHint" else "deltaTime")
            if step is not None:
                yield Told(tool, e.sourceline, None, step)
        elif name == "Task":
            yield _task(file, e, tool)


def _information(file: Location, information: Element, tool: str) -> Iterator[Told]:
    """One child that says how, or, in OMSimulator's newest files, a solver as attributes."""
    if information.get("method"):
        raise Unsupported(_solver(information, tool))
    for e in information:
        name = local(e)
        if name == "FixedStepMaster":
            yield Told(tool, e.sourceline, Coupling("jacobi"), _step(file, e, "stepSize"))
        elif name == "VariableStepMaster":
            yield _variable(file, e, tool)
        elif name == "VariableStepSolver":
            raise Unsupported(_solver(e, tool))
        elif name:
            raise Unsupported(f"line {e.sourceline}: {name} of {tool} is not supported")


def _solver(element: Element, tool: str) -> str:
    how = element.get("description") or element.get("method")
    return (
        f"line {element.sourceline}: {tool} solves this by Model Exchange ({how}), "
        "here FMUs take part by Co-Simulation only"
    )


def _variable(file: Location, e: Element, tool: str) -> Told:
    """A master that chooses its steps: the nearest of ours has the same tolerance and limits."""
    smallest, largest = number(file, e, "minimumStepSize", 0.0), number(file, e, "maximumStepSize", 0.0)
    tolerance = number(file, e, "relativeTolerance", 1e-4)
    coupling = Coupling("jacobi", adaptive=tolerance, smallest=smallest or None, largest=largest or None)
    return Told(tool, e.sourceline, coupling, _step(file, e, "initialStepSize"))


def _algorithm(file: Location, algorithm: Element, tool: str) -> Iterator[Told]:
    """FixedStepAlgorithm of libcosim, FixedStepMaster of Vico."""
    for e in algorithm:
        if local(e) not in ("FixedStepAlgorithm", "FixedStepMaster", ""):
            raise Unsupported(f"line {e.sourceline}: {local(e)} of {tool} is not supported")
        if not local(e):
            continue
        for own in children(e, "StepSizes", "StepSize"):
            if own.get("multipleOf") not in (None, "1"):
                raise Unsupported(
                    f"line {own.sourceline}: {own.get('component')} wants a step of its own, "
                    f"{own.get('multipleOf')} times the base step of {tool}, which is not supported"
                )
        yield Told(tool, e.sourceline, Coupling("jacobi"), _step(file, e, "baseStepSize"))


def _task(file: Location, task: Element, tool: str) -> Told:
    kind = task.get("stepType")
    if kind not in ORDERS:
        raise Unsupported(f"line {task.sourceline}: stepType {kind!r} of {tool} is not supported")
    return Told(tool, task.sourceline, ORDERS[kind], _step(file, task, "deltaTime"))


def _step(file: Location, element: Element, name: str) -> float | None:
    """A step [s], None where the element names none."""
    if element.get(name) is None:
        return None
    step = number(file, element, name)
    if not 0 < step < float("inf"):
        raise Problem(
            f"{file}: line {element.sourceline}: {local(element)}: expected a positive number of seconds "
            f"for {name}, got {element.get(name)!r}"
        )
    return step
