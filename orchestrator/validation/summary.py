"""The outcome of a validation as text for the terminal, one line per signal in 80 columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions
from rich.text import Text

from orchestrator.validation import wording
from orchestrator.validation.compare import Row, Validation

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
    failed = [(row.tolerance.use(row.metrics), row) for row in validation.failed if row.tolerance]
    failed.sort(key=lambda entry: -entry[0])
    verb = "misses its limit" if len(failed) == 1 else "miss their limits"
    yield Text(f"FAIL: {len(failed)} of {len(validation.judged)} signals {verb}", _COLOUR[False])
    yield from (Text(f"! {row.signal}: {wording.miss(row)}") for _, row in failed)
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
        limit = wording.limit(row).replace("≤", "<=").replace("≥", ">=") if row.tolerance else "not judged"
        head = f"{row.group or 'signals'} [{wording.finer(row.unit) or '1'}]: {limit}"
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
        wording.plain(m.maximum_error, row.unit),
        wording.plain(m.rmse, row.unit),
        wording.share(m.nrmse).removesuffix(" %"),
        _percent(m.fit),
        _percent(m.vaf),
        wording.NONE if m.iso.overall is None else f"{m.iso.overall:.3f}",
        wording.outcome(row).replace("fail", "FAIL"),
    )


def _percent(value: float | None) -> str:
    """Fit or VAF, short also where it is hopeless."""
    return "<-999" if value is not None and value < -999 else wording.percent(value).removesuffix(" %")


def _line(mark: str, name: str, room: int, cells: tuple[str, ...]) -> str:
    """A row of the table; a name that needs more than its room stands in a line of its own."""
    above, name = (f"{mark}{name}\n", "") if len(name) > room else ("", name)
    numbers = " ".join(cell.rjust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    return f"{above}{mark}{name.ljust(room)} {numbers}".rstrip()


def _style(row: Row) -> str:
    return _COLOUR[False] if row.passed is False else _COLOUR[None] if row.passed is None else ""
