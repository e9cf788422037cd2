"""What an SSP suggests for the coupling of its components: an annotation of ours, else of other tools.

Ours, which other tools pass over:

<ssd:DefaultExperiment>
  <ssd:Annotations>
    <ssc:Annotation type="harvester-cosim">
      <hc:Coupling xmlns:hc="urn:harvester-cosim:coupling" master="hermite" step="0.005" passes="2">
        <hc:Factor component="arm" steps="4"/>
      </hc:Coupling>
    </ssc:Annotation>
  </ssd:Annotations>
</ssd:DefaultExperiment>

The attributes are those of `Coupling`, and the communication step [s]. The annotation may also be one of the
outermost System, or of the whole file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

from orchestrator.errors import Problem, suggest
from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, children, local
from orchestrator.settings import Coupling
from orchestrator.system.vendors import read_vendors

TYPE = "harvester-cosim"
PLACES = ("DefaultExperiment",), ("System",), ()  # of the annotations, from the root


class Kind(NamedTuple):
    """A type of attributes; `read` raises ValueError or KeyError for another text than expected."""

    expected: str
    read: Callable[[str], Any]


def _number(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError
    return value


TEXT, WHOLE, NUMBER = Kind("a text", str), Kind("a whole number", int), Kind("a number", _number)
TRUTH = Kind("true or false", {"true": True, "1": True, "false": False, "0": False}.__getitem__)
KINDS: Mapping[str, Kind] = {
    "master": TEXT,
    "step": NUMBER,
    "order": WHOLE,
    "passes": WHOLE,
    "tolerance": NUMBER,
    "correct": TRUTH,
    "lag": WHOLE,
    "adaptive": NUMBER,
    "guard": NUMBER,
    "control": TEXT,
    "smallest": NUMBER,
    "largest": NUMBER,
}
FACTOR: Mapping[str, Kind] = {"component": TEXT, "steps": WHOLE}


@dataclass(frozen=True)
class Suggestion:
    """How to couple.

    coupling, step   None where none is suggested; step [s]
    refusal          why what other tools' annotations say cannot be followed; empty where it can
    note             where the suggestion comes from, if it is not our annotation
    """

    coupling: Coupling | None
    step: float | None = None
    refusal: str = ""
    note: str = ""


def read_suggestion(file: Location, root: Element, components: Iterable[str]) -> Suggestion:
    """The suggestion in a .ssd file with these components, ours before those of other tools."""
    found = list(_elements(file, root))
    if not found:
        known = read_vendors(file, root)
        return Suggestion(known.coupling, known.step, known.refusal, known.note)
    if len(found) > 1:
        lines = ", ".join(str(e.sourceline) for e in found)
        raise Problem(
            f"{file}: expected one Coupling in annotations of type {TYPE}, got some in lines {lines}"
        )
    (element,) = found
    given = _attributes(file, element, KINDS)
    step = given.pop("step", None)
    if step is not None and not step > 0:
        raise _problem(file, element, f"expected a positive number of seconds for step, got {step:g}")
    factors = _factors(file, element)
    try:
        coupling = Coupling(**given, factors=factors)
        coupling.check(components)
    except Problem as problem:
        raise _problem(file, element, str(problem)) from None
    return Suggestion(coupling, step)


def _elements(file: Location, root: Element) -> Iterator[Element]:
    """What stands in annotations of our type."""
    for place in PLACES:
        for annotation in children(root, *place, "Annotations", "Annotation"):
            for e in annotation if annotation.get("type") == TYPE else ():
                if local(e) and local(e) != "Coupling":
                    raise _problem(file, e, f"expected Coupling in an annotation of type {TYPE}")
                if local(e):
                    yield e


def _factors(file: Location, element: Element) -> dict[str, int]:
    """Component -> how many steps it takes in each communication step."""
    factors = dict[str, int]()
    for e in element:
        if not local(e):
            continue  # a comment
        if local(e) != "Factor":
            raise _problem(file, e, "expected Factor in a Coupling")
        given = _attributes(file, e, FACTOR)
        for name in FACTOR:
            if name not in given:
                raise _problem(file, e, f"expected an attribute {name}, got none")
        if given["component"] in factors:
            raise _problem(file, e, f"component {given['component']} has a Factor already, expected one")
        factors[given["component"]] = given["steps"]
    return factors


def _attributes(file: Location, element: Element, kinds: Mapping[str, Kind]) -> dict[str, Any]:
    """The attributes in their types; those of other namespaces are not ours."""
    found = dict[str, Any]()
    for name, text in element.attrib.items():
        if name.startswith("{"):
            continue
        if name not in kinds:
            near = suggest(name, kinds) or f"; there are {', '.join(kinds)}"
            raise _problem(file, element, f"unknown attribute {name!r}{near}")
        try:
            found[name] = kinds[name].read(text.strip())
        except (ValueError, KeyError):
            told = f"expected {kinds[name].expected} for {name}, got {text!r}"
            raise _problem(file, element, told) from None
    return found


def _problem(file: Location, element: Element, text: str) -> Problem:
    return Problem(f"{file}: line {element.sourceline}: {local(element)}: {text}")
