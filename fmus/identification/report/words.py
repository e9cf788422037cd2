"""Numbers as a reader sees them: display units, as many digits as the interval bears."""

from __future__ import annotations

import math

from fmus.identification.finding import Estimate
from fmus.identification.report.style import pretty, raised
from fmus.units import display

NONE = "–"  # noqa: RUF001
WIDE = 0.5  # of a value: an interval with a larger half is told as a factor
FACTOR = "\N{MULTIPLICATION SIGN}÷"
MINUS = "\N{MINUS SIGN}"


def unit(name: str) -> str:
    """The display unit; nothing for a pure number."""
    shown = (display(name) or (name, 1.0))[0]
    return "" if shown == "1" else pretty(shown)


def in_unit(value: float, name: str) -> float:
    """A value in SI in the display unit."""
    return value * (display(name) or (name, 1.0))[1]


def number(value: float | None, digits: int = 3) -> str:
    """A number with a few significant digits; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if -4 <= exponent < 6:
        text = f"{rounded:.{max(0, digits - 1 - exponent)}f}"
    else:
        text = f"{rounded / 10.0**exponent:.{digits - 1}f}·10{raised(str(exponent))}"
    return text.replace("-", MINUS)


def digits(estimate: Estimate) -> int:
    """Significant digits that show the interval with two of its own."""
    half, size = (estimate.high - estimate.low) / 2, abs(estimate.value)
    if not (half > 0 and size > 0 and math.isfinite(half)):
        return 4
    return min(7, max(2, math.floor(math.log10(size)) - math.floor(math.log10(half)) + 2))


def value(estimate: Estimate) -> str:
    """The value in its display unit."""
    return number(in_unit(estimate.value, estimate.unit), digits(estimate))


def interval(estimate: Estimate) -> str:
    """The 95 % interval in the display unit."""
    ends = (in_unit(end, estimate.unit) for end in (estimate.low, estimate.high))
    return " to ".join(_aligned(end, estimate) for end in ends)


def _aligned(end: float, estimate: Estimate) -> str:
    """An end of the interval with as many decimals as the value."""
    if math.isinf(end):
        return "open"
    if not math.isfinite(end) or not end or not estimate.value:
        return number(end)
    shift = math.floor(math.log10(abs(in_unit(estimate.value, estimate.unit)))) - math.floor(
        math.log10(abs(end))
    )
    return number(end, max(1, digits(estimate) - shift))


def spread(estimate: Estimate) -> str:
    """Half the interval over the value; a factor where the interval is wide and lies on one side of zero."""
    half, value = (estimate.high - estimate.low) / 2, estimate.value
    if not value or not math.isfinite(half):
        return NONE
    if estimate.low * estimate.high > 0 and half > WIDE * abs(value):
        ratio = estimate.high / estimate.low
        return f"{FACTOR} {number(math.sqrt(max(ratio, 1 / ratio)), 2)}"
    return f"± {share(abs(half / value), 2)}"


def share(value: float | None, digits: int = 2) -> str:
    """A pure number as percent; what only rounding made is zero."""
    if value is not None and abs(value) < 1e-9:
        return "0 %"
    return NONE if value is None or not math.isfinite(value) else f"{number(100 * value, digits)} %"


def change(now: float, before: float | None) -> str:
    """How far a value is from the one before."""
    if before is None or before == 0:
        return NONE
    found = 100 * (now / before - 1)
    return f"{'+' if found > 0 else ''}{number(found, 2)} %"


def chance(p: float | None) -> str:
    """A probability."""
    return "< 0.001" if p is not None and p < 1e-3 else number(p, 2)
