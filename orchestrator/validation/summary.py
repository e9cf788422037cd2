"""The outcome of a validation as a table for the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from orchestrator.validation import wording
from orchestrator.validation.compare import Row, Validation

_COLOUR = {True: "green", False: "bold red", None: "dim"}


def table(validation: Validation) -> Table:
    """Two lines per signal, to fit 80 columns: errors, rating, limit, pass or fail."""
    made = Table(title=f"Compared with: {validation.title}", title_justify="left", header_style="bold")
    made.box, made.show_edge, made.pad_edge, made.padding = SIMPLE_HEAD, False, False, (0, 1, 0, 0)
    made.add_column("signal", overflow="fold")
    for heading in ("max. error\nRMSE", "NRMSE\nover\nrange", "fit", "VAF", "ISO/TS\n18571"):
        made.add_column(heading, justify="right")
    made.add_column("limit")
    for rows in validation.groups.values():
        for row in rows:
            made.add_row(*_cells(row))
        made.add_section()
    return made


def summary(validation: Validation) -> RenderableType:
    """The table, the notes below it and the verdict as last line."""
    notes = [*validation.notes, *(f"{row.signal}: {note}" for row in validation.rows for note in row.notes)]
    colour = _COLOUR[validation.passed if validation.judged else None]
    lines = [Text(f"  {note}", "dim") for note in notes]
    return Group(table(validation), *lines, Text(validation.verdict, colour))


def _cells(row: Row) -> tuple[RenderableType, ...]:
    """A row's texts."""
    m = row.metrics
    component, _, variable = row.signal.rpartition(".")
    iso = f"{m.iso.overall:.3f}" if m.iso.overall is not None else "not rated"
    return (
        Text.assemble(variable, "\n", (component, "dim")),
        f"{wording.difference(m.maximum_error, row.unit)}\n{wording.difference(m.rmse, row.unit)}",
        wording.share(m.nrmse),
        wording.percent(m.fit),
        wording.percent(m.vaf),
        iso.replace(" ", "\n"),
        Text.assemble((wording.outcome(row), _COLOUR[row.passed]), f"\n{wording.limit(row)}"),
    )
