"""`harvester sweep`: run what is missing of a parameter study, keep it in a folder, summarise it.

from orchestrator.studies import Factor, Output, Study, sweep

mass = Factor("manipulator.head_mass", "uniform", {"minimum": 300, "maximum": 400})
peak = Output("peak", "swing.swing_pressure_a", "maximum")
study = Study("Head mass", "build/harvester.ssp", runs=50, stop=5.0, factors=(mass,), outputs=(peak,))
table = sweep(study).table  # of pandas, one row per run
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import pandas as pd
import pyarrow as pa
from distributed import Client
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from orchestrator.base.errors import Stopped
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.text import TextTable, display_unit
from orchestrator.studies import design, pool, processes, store
from orchestrator.studies.analysis.results import alike
from orchestrator.studies.cases import resolve
from orchestrator.studies.single_run import EARLY, FAILED, OK, RunOutcome
from orchestrator.studies.study import Study, read

FOLDER = Path("build/sweeps")
TENTHS = 10  # lines of progress where no terminal is
REASONS = 5  # of failed runs, that are printed

Watch = Callable[[int, int, Sequence[RunOutcome]], None]  # runs in all, runs done, outcomes of the last batch


@dataclass(frozen=True)
class PreparedStudy:
    """A study whose systems are open; samples in the order of their runs."""

    payload: processes.Payload
    table: pd.DataFrame
    samples: Sequence[design.Sample]

    def known(self) -> tuple[pa.Table, dict[str, str]]:
        """All columns that are known before the runs, and their units."""
        study = self.payload.study
        starts, units = design.starts(study, self.payload.cases, self.samples)
        columns = pa.Table.from_pandas(self.table, preserve_index=False)
        for name in starts.column_names:
            columns = columns.append_column(name, starts[name])
        return columns, {f.column: f.unit for f in study.factors if not f.relative} | units


def prepare(study: Study) -> PreparedStudy:
    """Open the systems of a study and draw its samples; raises a Problem if no run can do what it asks."""
    resolved, cases = resolve(study)
    table = design.table(resolved)
    return PreparedStudy(processes.payload(resolved, cases), table, design.runs(resolved, table, cases))


def sweep(
    study: Study | str | Path,
    folder: str | Path | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    client: Client | None = None,
    fresh: bool = False,
    watch: Watch | None = None,
) -> store.Results:
    """Run a study, or what is missing of it in its folder; the results, with a pandas table of all runs.

    study      or the path of its TOML file
    folder     of the results; default: build/sweeps/ and the name of the file or the title
    workers    runs at the same time on this machine; default: one per core
    scheduler  address of a Dask cluster to run on instead, such as tcp://host:8786
    client     a connection to a Dask cluster, used instead; it stays open
    fresh      delete what the folder holds of a study
    watch      called before the first run and after each batch: runs in all, runs done, outcomes of the batch
    """
    study = study if isinstance(study, Study) else read(study)
    folder = Path(folder) if folder else FOLDER / (Path(study.source).stem or study.title or "study")
    ready = prepare(study)
    with ExitStack() as stack:
        if scheduler and not client and (fresh or not store.finished(folder)):
            # before the folder: where no scheduler answers, nothing is begun and nothing is deleted
            client = stack.enter_context(pool.client(workers, scheduler))
        stack.enter_context(store.locked(folder))
        if fresh:
            store.clear(folder)
        kept = store.Store(folder, ready.payload.study, store.fingerprint(ready.payload, ready.table))
        if not store.finished(folder):
            connection = nullcontext(client) if client else pool.client(workers)
            _complete(ready, kept, connection, watch or (lambda *_: None))
            kept.finish(*ready.known())
        return store.read(folder)


def _complete(
    ready: PreparedStudy, kept: store.Store, connection: AbstractContextManager[Client], watch: Watch
) -> None:
    """Run what is missing."""
    done, total = kept.done(), len(ready.samples)
    missing = [s for s in ready.samples if s.run not in done]
    count = len(done)
    watch(total, count, ())
    if not missing:
        return
    try:
        with (
            connection as client,
            DeferredInterrupts() as interrupts,  # Dask's callbacks would swallow a KeyboardInterrupt
            closing(pool.outcomes(client, ready.payload, missing, interrupts.check)) as batches,
        ):
            for batch in batches:
                kept.add(batch)
                count += len(batch)
                watch(total, count, batch)
    except KeyboardInterrupt:
        message = f"{len(kept.done())} of {total} runs are kept in {kept.folder}, the same command goes on"
        raise Stopped(message) from None


# ---- the command line


def run(
    file: Path,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    fresh: bool = False,
    report: bool = True,
) -> bool:
    """Run a study with its progress shown and print a summary; False if no run came to its end.

    report  write the page of the analysis too; for the rest see `sweep`
    """
    folder = out or FOLDER / file.stem
    with progress() as watch:
        results = sweep(file, folder, workers=workers, scheduler=scheduler, fresh=fresh, watch=watch)
    table = results.table
    print(summary(results))
    print(f"\n{folder / 'runs.parquet'}: {len(table)} runs, {len(table.columns)} columns")
    if report:
        from orchestrator.studies.report import study_page

        print(f"report: {study_page.report(folder)}")
    return bool((table["status"] != FAILED).any())


class StudyProgress:
    """How far a study is: a bar on a terminal, elsewhere a line for each tenth of the runs."""

    def __init__(self, stream: TextIO, bar: Progress | None = None) -> None:
        self._stream, self._bar = stream, bar
        self._task = bar.add_task("starting", total=None) if bar else None
        self._began, self._tenth, self._fresh, self._failed = time.perf_counter(), 0, 0, 0

    def __call__(self, total: int, done: int, batch: Sequence[RunOutcome]) -> None:
        tenth, text = TENTHS * done // total, ""
        if batch:
            self._fresh += len(batch)
            self._failed += sum(r.status == FAILED for r in batch)
            rate = self._fresh / (time.perf_counter() - self._began)
            text = f"{rate:.1f} runs/s, {(total - done) / rate:.0f} s left"
            text += f", {self._failed} failed" if self._failed else ""
        else:
            self._began, self._tenth = time.perf_counter(), tenth
        if self._bar and self._task is not None:
            self._bar.update(self._task, total=total, completed=done, description=text)
        elif tenth > self._tenth:
            self._tenth = tenth
            line = f"{100 * tenth // TENTHS} %: {done} of {total} runs, {text}"
            print(line, file=self._stream, flush=True)


@contextmanager
def progress() -> Iterator[Watch]:
    """Progress on standard error; a bar goes when it is done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield StudyProgress(sys.stderr)
        return
    columns = BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True) as bar:
        yield StudyProgress(sys.stderr, bar)


def summary(results: store.Results) -> str:
    """How many runs there are of each status, the outputs, and why runs failed."""
    counts = results.table["status"].value_counts()
    kinds = ", ".join(f"{counts[kind]} {kind}" for kind in (OK, EARLY, FAILED) if kind in counts)
    rows = []
    for output in results.study.outputs:
        column = results.table[output.column]
        unit = display_unit(output.unit, column.abs().max())
        values = (f"{v * unit.factor:.5g}" for v in (column.min(), column.mean(), column.max()))
        rows.append((output.name, *values, unit.display))
    lines = TextTable(("output", "minimum", "mean", "maximum", "unit"), rows, left=(0, 4)).lines()
    return "\n".join([f"{len(results.table)} runs: {kinds}", "", *lines, *_reasons(results)])


def _reasons(results: store.Results) -> list[str]:
    """Reasons that differ by their numbers alone count as one, shown by the first run that has it."""
    reasons = results.table.loc[results.table["status"] == FAILED, "reason"]
    groups = sorted((own for _, own in reasons.groupby(alike(reasons), sort=False)), key=len, reverse=True)
    lines = [
        f"{len(own)} failed{', such as' if own.nunique() > 1 else ''}: {own.iloc[0]}"
        for own in groups[:REASONS]
    ]
    if len(groups) > REASONS:
        lines.append(f"... and for {len(groups) - REASONS} other reasons")
    return ["", *lines] if lines else []
