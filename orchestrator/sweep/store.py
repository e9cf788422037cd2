"""The folder of a study: what was run, what is finished, and the results.

    study.toml     the file of the study, as it was read
    study.json     the study as it was understood, and digests of all that determines its results
    parts/         while it runs: finished batches
    bands.parquet  the signals that are kept: run, time [s], and a column for each signal
    runs.parquet   one row per run: run, status, reason, then columns named as in `study`
    log.csv        run, status, and the seconds that it took; not part of the results, and not the same twice

The results are there when all runs are done, and do not depend on how often the study was started.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import locket
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.errors import Problem
from orchestrator.sweep import fingerprint
from orchestrator.sweep.changes import changes
from orchestrator.sweep.parts import Parts, put
from orchestrator.sweep.running import Row
from orchestrator.sweep.study import Study

NAMES = ("runs.parquet", "bands.parquet", "report.html", "analysis.json", "log.csv")
LOG = "run,status,seconds\n"  # first line of log.csv
GROUP = 64  # runs in a row group of the signals: few megabytes


@dataclass(frozen=True)
class Results:
    """A finished study.

    table   one row per run
    bands   the signals that are kept; None if none are
    units   column of the table, or signal -> unit
    """

    study: Study
    table: pd.DataFrame
    bands: pd.DataFrame | None
    units: Mapping[str, str]


class Store:
    """The folder of a study that is being run."""

    def __init__(self, folder: Path, study: Study, text: bytes, prints: Mapping[str, Any]) -> None:
        """text: of the study's file; prints: its fingerprint. Refuses a folder with runs of another study."""
        self.folder, self.study = folder, study
        self._accept(prints)
        told = {"title": study.title, **prints}  # first what says whose the rest is
        put(folder / "study.json", lambda f: f.write_text(json.dumps(told, indent=1), encoding="utf-8"))
        put(folder / "study.toml", lambda f: f.write_bytes(text))
        self._parts = Parts(folder / "parts", study)

    def _accept(self, prints: Mapping[str, Any]) -> None:
        file = self.folder / "study.json"
        if not file.exists():
            if others := [name for name in NAMES if (self.folder / name).exists()]:
                raise Problem(f"{self.folder}: expected a folder for this study alone, got {others[0]} too")
            return
        if changed := changes(_json(file), prints):
            raise Problem(f"{self.folder}: holds runs of another study: {changed}; --fresh deletes them")

    @property
    def complete(self) -> bool:
        """All runs are done, and the results are written."""
        return finished(self.folder)

    def done(self) -> set[int]:
        """The numbers of the runs that are done."""
        return self._parts.done()

    def add(self, rows: Sequence[Row]) -> None:
        """Keep a batch."""
        self._parts.add(rows)
        with (self.folder / "log.csv").open("a", encoding="utf-8") as log:
            if not log.tell():
                log.write(LOG)
            log.writelines(f"{r.run},{r.status},{r.wall:.6f}\n" for r in rows)

    def finish(self, table: pa.Table, units: Mapping[str, str]) -> None:
        """Write the results: `table` has all that is known before a run, in the order of the runs."""
        units = {**units, **{o.column: o.unit for o in self.study.outputs}}
        if self.study.bands:
            put(self.folder / "bands.parquet", self._write_bands)
        rows = self._parts.runs()
        for column in table.column_names:
            rows = rows.append_column(column, table[column])
        put(self.folder / "runs.parquet", lambda file: pq.write_table(_with(rows, units), file))
        self._parts.clear()

    def _write_bands(self, file: Path) -> None:
        units = {o.signal: o.signal_unit for o in self.study.outputs if o.band} | {"time": "s"}
        schema = _with(self._parts.band_schema.empty_table(), units).schema
        with pq.ParquetWriter(file, schema) as writer:
            group: list[pa.Table] = []
            for one in self._parts.bands():
                group.append(one)
                if len(group) == GROUP:
                    writer.write_table(pa.concat_tables(group).cast(schema))
                    group = []
            if group:
                writer.write_table(pa.concat_tables(group).cast(schema))


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """The folder for this process alone, until it ends in whatever way."""
    lock = locket.lock_file(str(folder / "lock"), timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except OSError as error:
        raise Problem(f"{folder}: cannot be a folder for results: {error.strerror or error}") from None
    except locket.LockError:
        raise Problem(f"{folder}: expected a folder for this study alone, another process runs it") from None
    try:
        yield
    finally:
        lock.release()


def finished(folder: Path) -> bool:
    """All runs of a study are done, and the results are written."""
    return (folder / "runs.parquet").exists()


def clear(folder: Path) -> None:
    """Remove all that a study left in its folder; nothing where there was none."""
    if not (folder / "study.json").exists():
        return
    files = [folder / name for name in NAMES]
    # last what says whose the rest is: a kill in between leaves nothing that could pass for another study's
    for file in [*(folder / "parts").glob("*"), *files, folder / "study.json"]:
        file.unlink(missing_ok=True)


def read(folder: Path) -> Results:
    """The results of a finished study."""
    if not finished(folder):
        raise Problem(f"{folder}: expected a finished study, runs.parquet is missing")
    known = _json(folder / "study.json")
    runs, bands = pq.read_table(folder / "runs.parquet"), None
    units = _units(runs.schema)
    if (folder / "bands.parquet").exists():
        bands = pq.read_table(folder / "bands.parquet")
        units |= _units(bands.schema)
    return Results(
        fingerprint.study(known["study"], known["title"]),
        runs.to_pandas(),
        None if bands is None else bands.to_pandas(),
        units,
    )


def _json(file: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        found["study"], found["files"], found["title"]
    except (ValueError, TypeError, KeyError):
        raise Problem(f"{file}: expected that of a study, got something else; --fresh deletes it") from None
    return found


def _with(table: pa.Table, units: Mapping[str, str]) -> pa.Table:
    """The table with units of its columns."""
    fields = [f.with_metadata({"unit": units[f.name]}) if units.get(f.name) else f for f in table.schema]
    return table.cast(pa.schema(fields))


def _units(schema: pa.Schema) -> dict[str, str]:
    return {f.name: f.metadata[b"unit"].decode() for f in schema if f.metadata and b"unit" in f.metadata}
