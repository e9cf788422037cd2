"""All annotations of other tools in the files of a system, and what they say together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from typing import NamedTuple

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, local
from orchestrator.system.suggested import Suggestion
from orchestrator.system.vendors.elements import algorithm, hint, own_step, task
from orchestrator.system.vendors.information import information
from orchestrator.system.vendors.told import Told, refused, unknown

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
