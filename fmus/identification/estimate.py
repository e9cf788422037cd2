"""Estimates of parameters and their 95 % confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import stats

from fmus.parameters import Number
from orchestrator.base.text import display_unit

CONFIDENCE = 0.95  # level of all intervals


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
