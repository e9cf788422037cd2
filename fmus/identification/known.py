"""The numbers of the machine by `part.name`: those of the parameter files, and what was found since."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fmus.contract import ModelError
from fmus.identification.finding import Estimate
from fmus.machine import SUBSYSTEMS
from fmus.parameters import Number, read

Known = Mapping[str, Number]


def nominal() -> dict[str, Number]:
    """All parameters of the parts and their variants; lengths of hoses are numbers of `detailed` only."""
    return {
        f"{part}.{name}": number
        for part, sub in SUBSYSTEMS.items()
        for name, number in read(sub.values)["parameters"].items()
    }


def updated(known: Known, estimates: Iterable[Estimate]) -> dict[str, Number]:
    """With estimates in the place of what was known: a bare name goes to every part that has it."""
    found = dict(known)
    for estimate in estimates:
        targets = targets_of(estimate.name, known)
        if not targets:
            raise ModelError(f"{estimate.name} was estimated, expected a parameter of the machine")
        found |= dict.fromkeys(targets, estimate.number())
    return found


def targets_of(name: str, known: Known) -> list[str]:
    """The parameters, `part.name`, that a name stands for."""
    return [full for full in known if name in (full, full.partition(".")[2])]


def plain(name: str, known: Known) -> str:
    """The shortest name that means the same parameters: without part where parts do not differ."""
    bare = name.rpartition(".")[2]
    return bare if targets_of(bare, known) == targets_of(name, known) else name


def lookup(name: str, known: Known) -> Number:
    """The number of a name, with or without part."""
    return known[targets_of(name, known)[0]]
