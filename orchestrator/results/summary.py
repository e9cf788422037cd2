"""Text of a validation: values and limits of each signal, and the summary for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter

from rich.console import Console, ConsoleOptions
from rich.text import Text

from orchestrator.base.text import NO_VALUE, error_display_unit, grouped, number, percentage, short_names
from orchestrator.results.metrics import GIVEN
from orchestrator.results.validation import ValidatedSignal, Validation

NAMES = {
    "nrmse": "NRMSE",
    "rmse": "RMSE",
    "maximum": "max. error",
    "maximum_relative": "max. relative error",
    "fit": "fit",
    "vaf": "VAF",
    "iso": "ISO rating",
}


ALMOST = 99.99  # [%]
MISSED = 20  # signals outside their limits that are listed


def percent(value: float | None, rmse: float = 0.0) -> str:
    """Fit or VAF [%], rounded down. 100 % means that there is no error at all: otherwise it is `> 99.99 %`.

    rmse   of the signal: the squares in VAF lose an error of 1e-9, which fit still shows
    """
    if value is None:
        return NO_VALUE
    if value >= ALMOST and (value < 100 or rmse > 0):
        return f"> {ALMOST} %"
    return f"{math.floor(100 * value) / 100:.2f} %"


def judged_text(row: ValidatedSignal, value: float | None) -> str:
    """A value or limit of the judged metric with its unit or percent sign."""
    if row.tolerance is None or value is None:
        return NO_VALUE
    if row.tolerance.in_unit:
        return error_display_unit(row.unit).ascii(value)
    if row.tolerance.metric in ("nrmse", "maximum_relative"):
        return percentage(value)
    return _exact_percent(value) if row.tolerance.metric in ("fit", "vaf") else number(value)


def _exact_percent(value: float) -> str:
    """Fit or VAF [%] beside its limit, rounded down: two decimals, near 100 % up to four."""
    if value < 99:
        return f"{math.floor(100 * value + 1e-6) / 100:.2f} %"
    text = f"{math.floor(1e4 * value + 1e-6) / 1e4:.4f}"
    return f"{text[:-2]}{text[-2:].rstrip('0')} %"


def limit_text(row: ValidatedSignal) -> str:
    """The limit with its metric, such as `NRMSE ≤ 0.5 %`."""
    if row.tolerance is None:
        return NO_VALUE
    sign = "≤" if row.tolerance.upper else "≥"
    return f"{NAMES[row.tolerance.metric]} {sign} {judged_text(row, row.tolerance.limit)}"


def limit_share(use: float) -> str:
    """Use of a limit in percent, rounded up, so that only a kept limit is shown as at most 100 %."""
    # infinite without a value of the metric
    tenths = max(math.ceil(min(1000 * use, 1e6) - 1e-9), int(use > 0))
    return "over 100 times" if tenths > 99_999 else f"{tenths / 10:g} %"


def miss_text(row: ValidatedSignal) -> str:
    """How much a failed row exceeds its limit, such as `NRMSE 0.73 %, limit 0.5 % (1.46 times)`."""
    if row.tolerance is None or row.passed:
        return ""
    metric, allowed, value = NAMES[row.tolerance.metric], row.tolerance.limit, row.judged_value
    limits = f"limit {judged_text(row, allowed)}"
    if value is None:
        reason = row.metrics.iso.reason if row.tolerance.metric == "iso" else "; ".join(row.notes)
        return f"no {metric}, {limits}" + (f" ({reason})" if reason else "")
    if not row.tolerance.upper:
        return f"{metric} {judged_text(row, value)}, {limits} ({judged_text(row, allowed - value)} short)"
    ratio = value / allowed
    return f"{metric} {judged_text(row, value)}, {limits} ({number(ratio, 3 if ratio > 1.01 else 9)} times)"


_COLOUR = {True: "green", False: "bold red", None: "dim"}
_WIDTHS = (9, 8, 8, 7, 7, 5, 4)
_HEADINGS = ("max error", "RMSE", "NRMSE %", "fit %", "VAF %", "ISO", "")
_LEGEND = "NRMSE: over the range of the whole reference, or a given one; ISO: ISO/TS 18571, 0 to 1"


@dataclass(frozen=True)
class Summary:
    """What `harvester validate` prints: failed signals, table, notes, and the verdict as last line."""

    validation: Validation

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        validation = self.validation
        yield from (Text(f"FAIL: {reason}", _COLOUR[False]) for reason in validation.unreliable)
        yield from _missed(validation)
        yield Text(f"Compared with: {validation.title}", "bold")
        yield from _table(validation, options.max_width)
        yield from (Text(note, "dim") for note in (_LEGEND, *validation.notes, *_remarks(validation)))
        yield Text(validation.verdict, _COLOUR[validation.passed if validation.judged else None])


def _missed(validation: Validation) -> Iterator[Text]:
    """The worst signals outside their limits."""
    if not validation.failed:
        return
    failed = [(row.limit_use, row) for row in validation.failed if row.tolerance]
    failed.sort(key=lambda entry: -entry[0])
    verb = "is outside its limit" if len(failed) == 1 else "are outside their limits"
    yield Text(f"FAIL: {len(failed)} of {len(validation.judged)} signals {verb}", _COLOUR[False])
    more = [f"{len(failed) - MISSED} more, in the report"] if len(failed) > MISSED else []
    lines = [f"{row.signal}: {miss_text(row)}" for _, row in failed[:MISSED]]
    yield from (Text(f"! {line}") for line in (*lines, *more))
    yield Text()


def _table(validation: Validation, width: int) -> Iterator[Text]:
    """Headings, then a line for each group and unit, and below it a line for each signal.

    Signals without limit are last. A component is only written if another signal has the same variable.
    """
    rows = [row for row in validation.rows if row.listed]
    names = short_names(row.signal for row in rows)
    sections = grouped(sorted(rows, key=lambda row: row.tolerance is None), _section)
    name_width = min(
        max(map(len, names.values()), default=0), max(width - sum(_WIDTHS) - len(_WIDTHS) - 2, 12)
    )
    yield Text(_line("  ", "", name_width, _HEADINGS), "dim")
    for title, members in sections.items():
        yield Text(f"{title}{_limits(members)}", "bold")
        for row in members:
            mark, colour = ("! ", _COLOUR[False]) if row.passed is False else ("  ", "")
            colour = _COLOUR[None] if row.passed is None else colour
            yield Text(_line(mark, names[row.signal], name_width, _cells(row)), colour)
    if others := [row.limit_use for row in validation.rows if not row.listed]:
        yield Text(f"{len(others)} others: at most {limit_share(max(others))} of their limits", "bold")


def _section(row: ValidatedSignal) -> str:
    """Group, unit and metric of a signal, the beginning of the title of its section."""
    judged = NAMES[row.tolerance.metric] if row.tolerance else "not judged"
    return f"{row.group or 'signals'} [{error_display_unit(row.unit).display or '1'}]: {judged}"


def _limits(rows: Sequence[ValidatedSignal]) -> str:
    """The limit of a section, or the smallest and the largest one."""
    if (tolerance := rows[0].tolerance) is None:
        return ""
    sizes = sorted(row.tolerance.limit for row in rows if row.tolerance)
    ends = dict.fromkeys(judged_text(rows[0], size) for size in (sizes[0], sizes[-1]))
    return f" {'<=' if tolerance.upper else '>='} {' to '.join(ends)}"


def _remarks(validation: Validation) -> list[str]:
    """Each note with its signals that are listed; given ranges are in the report."""
    listed = ((note, row.signal) for row in validation.rows for note in row.notes if row.listed)
    notes = grouped((pair for pair in listed if not pair[0].startswith(GIVEN)), itemgetter(0))
    return [f"{note}: {', '.join(signal for _, signal in pairs)}" for note, pairs in notes.items()]


def _cells(row: ValidatedSignal) -> tuple[str, ...]:
    m, unit = row.metrics, error_display_unit(row.unit)
    fits = (
        "<-999" if v is not None and v < -999 else percent(v, m.rmse).removesuffix(" %").replace("> ", ">")
        for v in (m.fit, m.vaf)
    )
    return (
        unit.plain(m.maximum_error),
        unit.plain(m.rmse),
        percentage(m.nrmse).removesuffix(" %"),
        *fits,
        NO_VALUE if m.iso.overall is None else f"{m.iso.overall:.3f}",
        {True: "pass", False: "FAIL", None: NO_VALUE}[row.passed],
    )


def _line(mark: str, name: str, name_width: int, cells: tuple[str, ...]) -> str:
    """A row of the table; a name longer than `name_width` is in a line of its own."""
    above, name = (f"{mark}{name}\n", "") if len(name) > name_width else ("", name)
    numbers = " ".join(cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    return f"{above}{mark}{name.ljust(name_width)} {numbers}".rstrip()
