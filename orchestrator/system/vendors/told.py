"""What one element of an annotation says, and how its attributes are read."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.xml import Element, local, number, required
from orchestrator.settings import Coupling


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
