"""The numbers of the machine by `part.name`: those of the parameter files, and what was found since.

What a procedure found: parameters with error bars, the figure that shows it, what has to be said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmus.machine.parts import SUBSYSTEMS
from fmus.parameters import Number, read
from orchestrator.base.errors import Problem

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
            raise Problem(f"{estimate.name} was estimated, expected a parameter of the machine")
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


Array = NDArray[np.float64]
Kind = Literal["measured", "fit", "masked", "compared", "corrected"]


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval.

    name   as in parameters.toml; `part.name` where parts declare different things by one name
    sd     one standard deviation
    low, high   the interval, not always symmetrical; infinite where nothing tells
    note   how it was found, one line
    """

    name: str
    value: float
    unit: str
    sd: float
    low: float
    high: float
    note: str

    def number(self) -> Number:
        """The entry for parameters.toml."""
        low, high = (f"{end:.4g}" if math.isfinite(end) else "open" for end in (self.low, self.high))
        note = f"{self.note}; 95 % interval {low} to {high}"
        return Number(self.value, self.unit, "identified", note, self.sd)


@dataclass(frozen=True)
class Curve:
    """One curve or cloud of a panel; `error` are half bars, `line` joins the points."""

    label: str
    x: Array
    y: Array
    kind: Kind = "measured"
    line: bool = False
    error: Array | None = None


@dataclass(frozen=True)
class Panel:
    """One pair of axes; SI inside, `x_unit` and `y_unit` are what to show (factor = SI value of one)."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    x_unit: tuple[str, float] = ("", 1.0)
    y_unit: tuple[str, float] = ("", 1.0)
    log: bool = False


@dataclass(frozen=True)
class Finding:
    """What one procedure found.

    procedure   "valve", "hose_resistance", ...
    figure      the paper's figure that this one corresponds to, 0 if none
    estimates   parameters of the machine
    others      what else was estimated, such as C_R at each voltage; not for parameters.toml
    panels      measurement with fit, then residual
    remarks     what the reader must know: what was masked, corrected, left out, in whole sentences
    """

    procedure: str
    title: str
    figure: int
    estimates: tuple[Estimate, ...]
    panels: tuple[Panel, ...]
    remarks: tuple[str, ...] = ()
    others: tuple[Estimate, ...] = ()
