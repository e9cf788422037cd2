"""Numbers of a validation as a reader sees them: display units, few digits, named limits."""

from __future__ import annotations

import math

from orchestrator.symbols import linear, shown
from orchestrator.validation.compare import Row
from orchestrator.validation.tolerance import METRICS

NAMES = {
    "nrmse": "NRMSE",
    "rmse": "RMSE",
    "maximum": "max. error",
    "maximum_relative": "max. relative error",
    "fit": "fit",
    "vaf": "VAF",
    "iso": "ISO rating",
}
NONE = "-"
# Errors are smaller than what they are errors of.
_FINER = {"m": "mm", "m/s": "mm/s"}


def number(value: float | None, digits: int = 3) -> str:
    """A number with a few significant digits; a dash where there is none."""
    if value is None:
        return NONE
    if value == 0:
        return "0"
    text = f"{value:.{digits}g}"
    return text if "e" not in text or abs(value) < 1e-4 or abs(value) >= 1e6 else f"{value:.0f}"


def share(value: float | None) -> str:
    """A pure number as percent."""
    return NONE if value is None else f"{number(100 * value)} %"


def percent(value: float | None) -> str:
    """Fit or VAF [%], rounded down: only a perfect one shows 100 %."""
    return NONE if value is None else f"{math.floor(100 * value) / 100:.2f} %"


def finer(unit: str) -> str:
    """The unit in which errors of a signal in `unit` are shown, such as `mm` for `m` and `bar` for `Pa`."""
    return _FINER.get(unit) or shown(unit)


def plain(value: float, unit: str) -> str:
    """An error in the display unit, without the unit's name; an offset of the unit does not count."""
    return number(value * linear(unit, finer(unit), "display")[0])


def difference(value: float, unit: str) -> str:
    """An error with its display unit, such as `0.12 bar` or `0.05 mm`."""
    return f"{plain(value, unit)} {finer(unit)}".rstrip()


def judged(row: Row, value: float | None) -> str:
    """A value or limit of the row's tolerance in the words of its metric."""
    if row.tolerance is None or value is None:
        return NONE
    if row.tolerance.in_unit:
        return difference(value, row.unit)
    if row.tolerance.metric in ("nrmse", "maximum_relative"):
        return share(value)
    return percent(value) if row.tolerance.metric in ("fit", "vaf") else number(value)


def limit(row: Row) -> str:
    """The limit with its metric, such as `NRMSE ≤ 0.5 %`."""
    if row.tolerance is None:
        return NONE
    sign = "≤" if METRICS[row.tolerance.metric] else "≥"
    return f"{NAMES[row.tolerance.metric]} {sign} {judged(row, row.tolerance.limit)}"


def miss(row: Row) -> str:
    """By how much a failed row misses, such as `NRMSE 0.73 %, limit 0.5 % (1.46 times)`."""
    if row.tolerance is None or row.passed:
        return ""
    value, allowed = row.tolerance.value(row.metrics), row.tolerance.limit
    limits = f"limit {judged(row, allowed)}"
    if value is None:
        why = row.metrics.iso.reason if row.tolerance.metric == "iso" else "; ".join(row.notes)
        return f"no {NAMES[row.tolerance.metric]}, {limits}" + (f" ({why})" if why else "")
    says = f"{NAMES[row.tolerance.metric]} {judged(row, value)}, {limits}"
    if not row.tolerance.upper:
        return f"{says} ({judged(row, allowed - value)} short)"
    ratio = value / allowed
    return f"{says} ({number(ratio, 3 if ratio > 1.01 else 9)} times)"


def outcome(row: Row) -> str:
    """`pass`, `fail` or a dash."""
    return {True: "pass", False: "fail", None: NONE}[row.passed]


def rating(row: Row) -> str:
    """The ISO/TS 18571 rating with the standard's word for it."""
    iso = row.metrics.iso
    return f"{iso.overall:.3f} {iso.grade}" if iso.overall is not None else "not rated"
