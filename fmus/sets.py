"""Numbers for several parts at once: what identification writes and `harvester build --parameters` reads.

The format is that of a parameters.toml, with tables `[parameters.NAME]` only. A NAME holds for every part
that declares it, as the valves are identical; `[parameters."swing.initial_preload"]` for that part alone.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from fmus.contract import ModelError, Subsystem, quantities
from fmus.parameters import Number, check, numbers, read

Set: TypeAlias = Mapping[str, Number]


def read_set(path: Path, subs: Iterable[Subsystem]) -> Set:
    """The numbers of a file, each checked against the parts that declare it; there must be one."""
    found = read(path)
    if found["start"]:
        raise ModelError(
            f"{path}: [start.{min(found['start'])}] is no parameter, expected [parameters.*] only"
        )
    if not found["parameters"]:
        raise ModelError(f"{path}: no table [parameters.NAME], expected at least one")
    declared = {
        (sub.component, name): quantity
        for sub in subs
        for name, quantity in quantities(sub.parameters).items()
    }
    for name, number in found["parameters"].items():
        meant = [q for (part, own), q in declared.items() if name in (own, f"{part}.{own}")]
        if not meant:
            known = {own for _, own in declared} | {f"{part}.{own}" for part, own in declared}
            near = difflib.get_close_matches(name, known, 1) or ["a name that `harvester parameters` shows"]
            raise ModelError(f"{path}: [parameters.{name}] is declared by no part, expected {near[0]}")
        for quantity in meant:
            check(path, f"[parameters.{name}]", quantity, number)
    return found["parameters"]


def with_numbers(sub: Subsystem, given: Set, start: Mapping[str, float] | None = None) -> Subsystem:
    """The subsystem with the numbers of a set in place of its own; what it does not declare is left out.

    start   start values by `component.variable` that follow from them
    """
    tables, part = numbers(sub), sub.component
    own = {n: given.get(f"{part}.{n}", given.get(n, old)) for n, old in tables["parameters"].items()}
    followed = {
        n: replace(old, value=(start or {}).get(f"{part}.{n}", old.value))
        for n, old in tables["start"].items()
    }
    return replace(sub, numbers={"parameters": own, "start": followed})
