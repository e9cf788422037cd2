"""What a procedure found: parameters with error bars, the figure that shows it, what has to be said."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmus.parameters import Number

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
