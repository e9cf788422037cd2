"""Numbers of a validation as a reader sees them: display units, few digits, named limits.

The outcome of a validation as text for the terminal, one line per signal in 80 columns.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions
from rich.text import Text

from orchestrator.base.units import linear, shown
from orchestrator.data.description import METRICS
from orchestrator.results.compare import Row, Validation

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
    value, allowed = row.judged_value, row.tolerance.limit
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


_COLOUR = {True: "green", False: "bold red", None: "dim"}
_WIDTHS = (9, 8, 8, 7, 7, 5, 4)
_HEADINGS = ("max error", "RMSE", "NRMSE %", "fit %", "VAF %", "ISO", "")
_LEGEND = "NRMSE: over the range of the whole reference; ISO: ISO/TS 18571, 0 to 1"


@dataclass(frozen=True)
class Summary:
    """First what failed and by how much, then the table, the notes and the verdict as last line."""

    validation: Validation

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        validation = self.validation
        yield from _missed(validation)
        yield Text(f"Compared with: {validation.title}", "bold")
        yield from _table(validation, options.max_width)
        yield from (Text(note, "dim") for note in (_LEGEND, *validation.notes, *_remarks(validation)))
        colour = _COLOUR[validation.passed if validation.judged else None]
        yield Text(validation.verdict, colour)


def summary(validation: Validation) -> Summary:
    """What `harvester validate` prints about a comparison."""
    return Summary(validation)


def _missed(validation: Validation) -> Iterator[Text]:
    """The signals that miss their limits, the worst first."""
    if validation.passed:
        return
    failed = [(row.limit_use, row) for row in validation.failed if row.tolerance]
    failed.sort(key=lambda entry: -entry[0])
    verb = "misses its limit" if len(failed) == 1 else "miss their limits"
    yield Text(f"FAIL: {len(failed)} of {len(validation.judged)} signals {verb}", _COLOUR[False])
    yield from (Text(f"! {row.signal}: {miss(row)}") for _, row in failed)
    yield Text()


def _table(validation: Validation, width: int) -> Iterator[Text]:
    """Headings, then per group and limit a line that names them and one line per signal."""
    names = _names(validation)
    room = min(max(map(len, names.values()), default=0), max(width - sum(_WIDTHS) - len(_WIDTHS) - 2, 12))
    yield Text(_line("  ", "", room, _HEADINGS), "dim")
    for title, rows in _sections(validation).items():
        yield Text(title, "bold")
        for row in rows:
            mark = "! " if row.passed is False else "  "
            yield Text(_line(mark, names[row.signal], room, _cells(row)), _style(row))


def _sections(validation: Validation) -> dict[str, list[Row]]:
    """Rows that share group, unit and limit, by their headline; those that are not judged come last."""
    found: dict[str, list[Row]] = {}
    for row in sorted(validation.rows, key=lambda row: row.tolerance is None):
        judged_by = limit(row).replace("≤", "<=").replace("≥", ">=") if row.tolerance else "not judged"
        head = f"{row.group or 'signals'} [{finer(row.unit) or '1'}]: {judged_by}"
        found.setdefault(head, []).append(row)
    return found


def _names(validation: Validation) -> dict[str, str]:
    """Signal -> its name without the component where no other signal has the same."""
    short = {row.signal: row.signal.rpartition(".")[2] for row in validation.rows}
    often = Counter(short.values())
    return {signal: name if often[name] == 1 else signal for signal, name in short.items()}


def _remarks(validation: Validation) -> list[str]:
    """Notes on signals, each told once with the signals it is about."""
    about: dict[str, list[str]] = {}
    for row in validation.rows:
        for note in row.notes:
            about.setdefault(note, []).append(row.signal)
    return [f"{note}: {', '.join(signals)}" for note, signals in about.items()]


def _cells(row: Row) -> tuple[str, ...]:
    m = row.metrics
    return (
        plain(m.maximum_error, row.unit),
        plain(m.rmse, row.unit),
        share(m.nrmse).removesuffix(" %"),
        _percent(m.fit),
        _percent(m.vaf),
        NONE if m.iso.overall is None else f"{m.iso.overall:.3f}",
        outcome(row).replace("fail", "FAIL"),
    )


def _percent(value: float | None) -> str:
    """Fit or VAF, short also where it is hopeless."""
    return "<-999" if value is not None and value < -999 else percent(value).removesuffix(" %")


def _line(mark: str, name: str, room: int, cells: tuple[str, ...]) -> str:
    """A row of the table; a name that needs more than its room stands in a line of its own."""
    above, name = (f"{mark}{name}\n", "") if len(name) > room else ("", name)
    numbers = " ".join(cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    return f"{above}{mark}{name.ljust(room)} {numbers}".rstrip()


def _style(row: Row) -> str:
    return _COLOUR[False] if row.passed is False else _COLOUR[None] if row.passed is None else ""
