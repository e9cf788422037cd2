"""The outcome of a validation as a table for the terminal."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from orchestrator.validation import wording
from orchestrator.validation.compare import Row, Validation

_COLOUR = {True: "green", False: "bold red", None: "dim"}


def table(validation: Validation) -> Table:
    """One line per signal: errors, rating, limit, pass or fail."""
    made = Table(title=f"Compared with: {validation.title}", title_justify="left", header_style="bold")
    made.add_column("signal", overflow="fold")
    for heading in ("max. error", "RMSE", "NRMSE over range", "fit", "VAF", "ISO/TS 18571"):
        made.add_column(heading, justify="right")
    made.add_column("limit", no_wrap=True)
    made.add_column("", no_wrap=True)
    for rows in validation.groups.values():
        for row in rows:
            made.add_row(*_cells(row), Text(wording.outcome(row), _COLOUR[row.passed]))
        made.add_section()
    return made


def summary(validation: Validation) -> RenderableType:
    """The table, the notes below it and the verdict as last line."""
    notes = [*validation.notes, *(f"{row.signal}: {note}" for row in validation.rows for note in row.notes)]
    colour = _COLOUR[validation.passed if validation.judged else None]
    lines = [Text(f"  {note}", "dim") for note in notes]
    return Group(table(validation), *lines, Text(validation.verdict, colour))


def _cells(row: Row) -> tuple[str, ...]:
    """A row's texts up to the limit."""
    m = row.metrics
    return (
        row.signal,
        wording.difference(m.maximum_error, row.unit),
        wording.difference(m.rmse, row.unit),
        wording.share(m.nrmse),
        wording.percent(m.fit),
        wording.percent(m.vaf),
        wording.rating(row),
        wording.limit(row),
    )
