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
outermost System, or of the whole file. One in another place, such as a nested file, is left out, and a note
says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from orchestrator.base.coupling import Coupling, Suggestion
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.xml import Element, children, finite, local, truth_numerals, whole
from orchestrator.ssp.vendor_annotations import read_vendors

TYPE = "harvester-cosim"
PLACES = ("DefaultExperiment",), ("System",), ()  # of the annotations, from the root


class Kind(NamedTuple):
    """A type of attributes; `read` raises ValueError for another text than expected."""

    expected: str
    read: Callable[[str], Any]


TEXT, WHOLE, NUMBER = Kind("a text", str), Kind("a whole number", whole), Kind("a number", finite)
TRUTH = Kind("true or false", truth_numerals)
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


def read_suggestion(roots: Sequence[tuple[Location, Element]], components: Iterable[str]) -> Suggestion:
    """The suggestion in .ssd files, the outermost first, with these components.

    Ours, which is that of the outermost file, before those of other tools, which are taken together.
    """
    file, root = roots[0]
    found = list(_elements(file, root))
    if not found:
        return read_vendors(roots)
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
    return Suggestion(coupling, step, place=f"{file}: line {element.sourceline}: Coupling")


def left_out(roots: Sequence[tuple[Location, Element]]) -> list[str]:
    """Notes on our annotations in other places than `PLACES`, such as inner systems and nested files."""
    taken = [e for place in PLACES for e in children(roots[0][1], *place, "Annotations", "Annotation")]
    reason = f"annotation of type {TYPE}: left out, only one of the outermost system counts"
    return [
        f"{file}: line {e.sourceline}: {reason}"
        for file, root in roots
        for e in root.iter()
        if local(e) == "Annotation" and e.get("type") == TYPE and e not in taken
    ]


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
        except ValueError:
            told = f"expected {kinds[name].expected} for {name}, got {text!r}"
            raise _problem(file, element, told) from None
    return found


def _problem(file: Location, element: Element, text: str) -> Problem:
    return Problem(f"{file}: line {element.sourceline}: {local(element)}: {text}")
