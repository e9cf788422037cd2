"""Estimates with their 95 % confidence intervals; the result of a procedure with figure and remarks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.parameters import Number

Array = NDArray[np.float64]
CONFIDENCE = 0.95  # of all intervals


def coverage_factor(freedom: float = math.inf) -> float:
    """Half width of a confidence interval in standard deviations: normal, or Student's t for few degrees."""
    return float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom))


def confidence_interval(
    value: float,
    sd: float,
    freedom: float = math.inf,
    *,
    log: bool = False,
    minimum: float = -math.inf,
    maximum: float = math.inf,
) -> tuple[float, float]:
    """Both ends of the 95 % interval of a value with this standard deviation.

    freedom            degrees of freedom of the standard deviation, infinite if it is known
    log                interval of the logarithm, which keeps a positive value positive
    minimum, maximum   bounds of the value: the interval ends there
    """
    reach = coverage_factor(freedom) * sd
    if log and value > 0:
        ratio = math.exp(reach / value)
        return value / ratio, value * ratio
    return max(value - reach, minimum), min(value + reach, maximum)


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval.

    name   as in parameters.toml; `part.name` where parts declare different things by one name
    sd     one standard deviation
    low, high   the interval, not always symmetrical; infinite where the data do not bound it
    note   source: how it was estimated, one line
    """

    name: str
    value: float
    unit: str
    sd: float
    low: float
    high: float
    note: str

    @classmethod
    def normal(
        cls,
        name: str,
        value: float,
        unit: str,
        sd: float,
        note: str,
        freedom: float = math.inf,
        *,
        log: bool = False,
        minimum: float = -math.inf,
    ) -> Estimate:
        """An estimate with the interval of `confidence_interval`."""
        low, high = confidence_interval(value, sd, freedom, log=log, minimum=minimum)
        return cls(name, value, unit, sd, low, high, note)

    def number(self) -> Number:
        """The entry for parameters.toml."""
        low, high = (f"{end:.4g}" if math.isfinite(end) else "open" for end in (self.low, self.high))
        note = f"{self.note}; 95 % interval {low} to {high}"
        return Number(self.value, self.unit, "identified", note, self.sd)


Kind = Literal["measured", "fit", "masked", "compared", "corrected"]


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
class ProcedureResult:
    """What one procedure estimated, as the page shows it.

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
