"""Results of an identification procedure: estimates with intervals, findings, the panels of a figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from scipy import stats

from fmus.parameters import Number
from orchestrator.base.text import display_unit
from orchestrator.data.table import Array

CONFIDENCE = 0.95  # level of all intervals
NO_RECORDING = "no recording"  # why a procedure was skipped
LEVEL = 0.01  # probability that any finding is named although no assumption is wrong
BAR, LITRES_PER_MINUTE = ("bar", 1e5), ("L/min", 1e-3 / 60)  # display units: name, SI value of one
CurveKind = Literal["measured", "fit", "masked"]


def coverage_factor(freedom: float = math.inf) -> float:
    """Half width of a confidence interval in standard deviations: normal, or Student's t for few degrees."""
    return float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom))


@dataclass(frozen=True)
class Estimate:
    """Estimated value of one parameter with its 95 % confidence interval.

    name        as in parameters.toml; `part.name` if parts declare different parameters of one name
    sd          standard deviation
    low, high   ends of the interval, not always symmetrical; infinite if the data do not bound the value
    note        how the parameter was estimated, one line
    listed      list in parameters.toml of which the parameter is an entry, empty if it has its own table
    """

    name: str
    value: float
    unit: str
    sd: float
    low: float
    high: float
    note: str
    listed: str = ""

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
        """An estimate with a symmetrical 95 % interval.

        freedom   degrees of freedom of the standard deviation, infinite if it is known exactly
        log       interval of the logarithm, which keeps both ends of a positive value positive
        minimum   physical bound of the value, at which the interval is cut off
        """
        half = coverage_factor(freedom) * sd
        low, high = max(value - half, minimum), value + half
        if log and value > 0:
            ratio = math.exp(half / value)
            low, high = value / ratio, value * ratio
        return cls(name, value, unit, sd, low, high, note)

    @property
    def digits(self) -> int:
        """Significant digits of the value at which the interval has two significant digits."""
        half, size = (self.high - self.low) / 2, abs(self.value)
        if not (half > 0 and size > 0 and math.isfinite(half)):
            return 4
        return min(7, max(2, math.floor(math.log10(size)) - math.floor(math.log10(half)) + 2))

    def displayed(self, digits: int) -> tuple[str, str, str, str]:
        """Value, ends of the interval and unit as a reader sees them, in ASCII for any terminal."""
        unit = display_unit(self.unit)
        value, low, high = (f"{unit.factor * x:.{digits}g}" for x in (self.value, self.low, self.high))
        return value, low, high, unit.display

    def number(self) -> Number:
        """The entry for parameters.toml; that of a list has no interval, because its entries share a note."""
        if self.listed:
            sd = None if self.unit == "V" else self.sd  # commands are chosen, not estimated
            return Number(self.value, self.unit, "identified", self.note, sd, self.listed)
        low, high = (f"{end:.4g}" if math.isfinite(end) else "open" for end in (self.low, self.high))
        note = f"{self.note}; 95 % interval {low} to {high}"
        return Number(self.value, self.unit, "identified", note, self.sd)


@dataclass(frozen=True)
class Finding:
    """The result of one test.

    fault      what is wrong if the data contradict the assumption, a name such as "zero of a pressure sensor"
    p          probability of data that contradict it as much or more, if it holds
    sentence   the fault with its place and size, for the user
    """

    fault: str
    p: float
    sentence: str


def least(findings: Sequence[Finding]) -> Finding:
    """The least probable of several findings, as the only one of them [Bonferroni]."""
    found = min(findings, key=lambda finding: finding.p)
    return replace(found, p=min(1.0, len(findings) * found.p))


def named(findings: Iterable[Finding]) -> list[Finding]:
    """The findings that the data show, most certain first: Holm's method over all tests of a machine.

    However many tests there are, all assumptions hold and one is named in at most `LEVEL` of all machines
    (S. Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statistics 6, 1979, 65-70).
    """
    ordered = sorted(findings, key=lambda finding: finding.p)
    for n, finding in enumerate(ordered):
        if finding.p * (len(ordered) - n) > LEVEL:
            return ordered[:n]
    return ordered


@dataclass(frozen=True)
class Curve:
    """A curve or a cloud of points.

    line    whether the points are joined
    error   half the length of each error bar, or down and up, shape (2, n)
    """

    label: str
    x: Array
    y: Array
    kind: CurveKind = "measured"
    line: bool = False
    error: Array | None = None


@dataclass(frozen=True)
class Panel:
    """A pair of axes with curves in SI units; `x_unit` and `y_unit` are display units with their SI value."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    x_unit: tuple[str, float] = ("", 1.0)
    y_unit: tuple[str, float] = ("", 1.0)
    log: bool = False


@dataclass(frozen=True)
class ProcedureResult:
    """Estimates of one procedure, and what the report shows of them.

    procedure   name of the procedure: "valve", "hose_resistance", ...
    figure      number of the corresponding figure in the paper, 0 if there is none
    estimates   parameters of the machine
    panels      measurement with fit, then residual
    remarks     sentences on masked and corrected samples, misfit, and what the data leave open
    listed      points of the opening curves, which are written to parameters.toml as lists
    findings    of the tests of what the procedure assumes, whether the data contradict it or not
    others      other estimates, such as C_R at each voltage, which are not written to parameters.toml
    """

    procedure: str
    title: str
    figure: int
    estimates: tuple[Estimate, ...]
    panels: tuple[Panel, ...]
    remarks: tuple[str, ...] = ()
    others: tuple[Estimate, ...] = ()
    listed: tuple[Estimate, ...] = ()
    findings: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        """The estimates; of a procedure without parameters, such as a weighing, the others."""
        lines = [f"{self.procedure}:"]
        for e in self.estimates or self.others:
            value, low, high, unit = e.displayed(e.digits)
            lines.append(f"  {e.name:<38}{value:>12}  ({low} to {high}) {unit}")
        return "\n".join(lines)


def joined(results: Sequence[ProcedureResult]) -> ProcedureResult:
    """One result of several of a procedure, each of other parameters."""
    lists = ("estimates", "panels", "remarks", "others", "listed", "findings")
    every: dict[str, Any] = {n: tuple(x for r in results for x in getattr(r, n)) for n in lists}
    return replace(results[0], **every)
