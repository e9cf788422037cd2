"""How far a study is, on standard error.

What a finished study tells on the command line.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from orchestrator.base.text import TextTable, display_unit
from orchestrator.studies.analysis.results import alike
from orchestrator.studies.single_run import EARLY, FAILED, OK, Row
from orchestrator.studies.store import Results

PARTS = 10  # lines of a study where no terminal is


class Watch:
    """Is told what happens; here it looks away."""

    def begin(self, total: int, done: int) -> None:
        """So many runs there are, so many are done already."""

    def see(self, rows: Sequence[Row]) -> None:
        """A batch is done and kept."""


class Count(Watch):
    """Runs that are done, and how long the others will take."""

    def __init__(self) -> None:
        self.total = self.done = self._fresh = self._failed = 0
        self._began = time.perf_counter()

    def begin(self, total: int, done: int) -> None:
        self.total, self.done = total, done
        self._began = time.perf_counter()

    def see(self, rows: Sequence[Row]) -> None:
        self.done, self._fresh = self.done + len(rows), self._fresh + len(rows)
        self._failed += sum(r.status == FAILED for r in rows)

    def told(self) -> str:
        """Rate, time left and failed runs."""
        rate = self._fresh / (time.perf_counter() - self._began)
        left = (self.total - self.done) / rate
        return f"{rate:.1f} runs/s, {left:.0f} s left" + (f", {self._failed} failed" if self._failed else "")


class Bar(Count):
    """A bar on a terminal."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        super().__init__()
        self._progress, self._task = progress, task

    def begin(self, total: int, done: int) -> None:
        super().begin(total, done)
        self._progress.update(self._task, total=total, completed=done)

    def see(self, rows: Sequence[Row]) -> None:
        super().see(rows)
        self._progress.update(self._task, completed=self.done, description=self.told())


class Lines(Count):
    """A line for each tenth of the runs, for a pipe or a log."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream, self._tenth = stream, 0

    def begin(self, total: int, done: int) -> None:
        super().begin(total, done)
        self._tenth = PARTS * done // total if total else PARTS

    def see(self, rows: Sequence[Row]) -> None:
        super().see(rows)
        if (tenth := PARTS * self.done // self.total) > self._tenth:
            self._tenth = tenth
            told = f"{100 * tenth // PARTS} %: {self.done} of {self.total} runs, {self.told()}"
            print(told, file=self._stream, flush=True)


@contextmanager
def shown() -> Iterator[Watch]:
    """A bar that goes when it is done; lines where no terminal is."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield Lines(sys.stderr)
        return
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True) as progress:
        yield Bar(progress, progress.add_task("starting", total=None))


REASONS = 5  # of failed runs, that are told


def text(results: Results) -> str:
    """How many runs there are of each kind, what the outputs are, why runs failed."""
    counts = results.table["status"].value_counts()
    kinds = ", ".join(f"{counts[kind]} {kind}" for kind in (OK, EARLY, FAILED) if kind in counts)
    lines = [f"{len(results.table)} runs: {kinds}", ""]
    return "\n".join([*lines, *_outputs(results), *_reasons(results)])


def _outputs(results: Results) -> list[str]:
    rows = []
    for output in results.study.outputs:
        column = results.table[output.column]
        unit = display_unit(output.unit, column.abs().max())
        values = (f"{v * unit.factor:.5g}" for v in (column.min(), column.mean(), column.max()))
        rows.append((output.name, *values, unit.shown))
    return TextTable(("output", "minimum", "mean", "maximum", "unit"), rows, left=(0, 4)).lines()


def _reasons(results: Results) -> list[str]:
    """Reasons that differ by their numbers alone are told once, by the first run that has one."""
    reasons = results.table.loc[results.table["status"] == FAILED, "reason"]
    kinds = [own for _, own in reasons.groupby(alike(reasons), sort=False)]
    kinds.sort(key=len, reverse=True)
    told = [
        f"{len(own)} failed{', such as' if own.nunique() > 1 else ''}: {own.iloc[0]}"
        for own in kinds[:REASONS]
    ]
    more = [f"... and for {len(kinds) - REASONS} other reasons"] if len(kinds) > REASONS else []
    return ["", *told, *more] if told else []
