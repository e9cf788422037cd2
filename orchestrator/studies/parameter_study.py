"""What `harvester sweep` does: read, run what is missing, store, report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa
from distributed import Client

from orchestrator.base.errors import Stopped
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.studies import design, pool, progress, single_run, store, study_file
from orchestrator.studies.cases import cases
from orchestrator.studies.fingerprint import fingerprint
from orchestrator.studies.single_run import FAILED, Sample, run_values
from orchestrator.studies.study import Study
from orchestrator.studies.worker import Packet, packet

FOLDER = Path("build/sweeps")


@dataclass(frozen=True)
class Where:
    """Where a study runs: on `workers` cores of this machine (default: all), on the cluster of the Dask
    scheduler at an address, or on the one that a client of Dask is connected to."""

    workers: int | None = None
    scheduler: str | None = None
    client: Client | None = None

    def connect(self) -> AbstractContextManager[Client]:
        """A client; one that is given stays open."""
        return nullcontext(self.client) if self.client else pool.client(self.workers, self.scheduler)


@dataclass(frozen=True)
class Plan:
    """A study, ready to run; samples in the order of their runs."""

    study: Study
    table: pd.DataFrame
    packet: Packet
    samples: Sequence[Sample]

    def known(self) -> tuple[pa.Table, dict[str, str]]:
        """All columns that do not take a run to know, and their units."""
        made, full = self.packet.cases, pa.Table.from_pandas(self.table, preserve_index=False)
        values = single_run.starts(self.study, made, self.samples)
        for column in values.column_names:
            full = full.append_column(column, values[column])
        units = {f.column: f.unit for f in self.study.factors if not f.relative}
        return full, units | single_run.units(made)


def plan(file: Path) -> Plan:
    """The study in a file."""
    study = study_file.read(file)
    made, table = cases(study), design.table(study)
    return Plan(study, table, packet(study, made), list(run_values(study, table, made)))


def run(
    file: Path,
    out: Path | None = None,
    where: Where = Where(),
    fresh: bool = False,
    report: bool = True,
) -> bool:
    """Run a study with its progress shown and print a summary; False if no run came to its end.

    out     folder of the results; default: build/sweeps/ and the name of the file
    fresh   forget what the folder holds
    report  write the page of the analysis too
    """
    folder = out or FOLDER / file.stem
    with progress.shown() as watch:
        results = sweep(file, folder, where, fresh, watch)
    table = results.table
    print(progress.text(results))
    print(f"\n{folder / 'runs.parquet'}: {len(table)} runs, {len(table.columns)} columns")
    if report:
        from orchestrator.studies.report import study_page

        print(f"report: {study_page.report(folder)}")
    return bool((table["status"] != FAILED).any())


def sweep(
    file: Path,
    folder: Path,
    where: Where = Where(),
    fresh: bool = False,
    watch: progress.Watch | None = None,
) -> store.Results:
    """Run a study, or what is missing of it in its folder; the results."""
    ready = plan(file)
    with ExitStack() as stack:
        if where.scheduler and (fresh or not store.finished(folder)):
            # before the folder: of an address where nobody answers nothing is left, and nothing is deleted
            where = Where(client=stack.enter_context(where.connect()))
        stack.enter_context(store.locked(folder))
        if fresh:
            store.clear(folder)
        kept = store.Store(folder, ready.study, file.read_bytes(), fingerprint(ready.packet, ready.table))
        if not kept.complete:
            _complete(ready, kept, where, watch or progress.Watch())
            kept.finish(*ready.known())
        return store.read(folder)


def _complete(ready: Plan, kept: store.Store, where: Where, watch: progress.Watch) -> None:
    """Run what is missing."""
    done = kept.done()
    missing = [s for s in ready.samples if s.run not in done]
    watch.begin(len(ready.samples), len(done))
    if not missing:
        return
    try:
        with (
            where.connect() as client,
            DeferredInterrupts() as interrupts,  # Dask's callbacks would swallow a KeyboardInterrupt
            closing(pool.rows(client, ready.packet, missing, interrupts.check)) as batches,
        ):
            for rows in batches:
                kept.add(rows)
                watch.see(rows)
    except KeyboardInterrupt:
        count = f"{len(kept.done())} of {len(ready.samples)} runs"
        raise Stopped(f"{count} are kept in {kept.folder}, the same command goes on") from None
