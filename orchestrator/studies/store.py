"""The folder of a study: what was run, what is finished, and the results.

    study.toml     the file of the study, as it was read
    study.json     the study as it was understood, and digests of all that determines its results
    parts/         while it runs: finished batches
    bands.parquet  the signals that are kept: run, time [s], and a column for each signal
    runs.parquet   one row per run: run, status, reason, then columns named as in `study`
    log.csv        run, status, and the seconds that it took; not part of the results, and not the same twice

The results are there when all runs are done, and do not depend on how often the study was started.

What is finished while a study runs: files that are there as a whole or not at all.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import locket
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.base.errors import Problem
from orchestrator.studies import fingerprint
from orchestrator.studies.fingerprint import changes
from orchestrator.studies.single_run import Row, band_times
from orchestrator.studies.study import Study

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


RUNS, BANDS, HALF = "runs-", "bands-", ".half"
OPEN = 8  # part files in memory while all are put in order


class Parts:
    """Rows of finished batches in a folder, one file each, with another one for the signals that are kept."""

    def __init__(self, folder: Path, study: Study) -> None:
        self._folder, self._study = folder, study
        for half in folder.glob(f"*{HALF}"):
            half.unlink()

    def add(self, rows: Sequence[Row]) -> None:
        """Keep the rows of a batch."""
        self._folder.mkdir(exist_ok=True)
        rows = sorted(rows, key=lambda r: r.run)
        name = f"{rows[0].run:09}.parquet"
        if self._study.bands:
            put(self._folder / f"{BANDS}{name}", lambda file: pq.write_table(self._bands(rows), file))
        put(self._folder / f"{RUNS}{name}", lambda file: pq.write_table(self._runs(rows), file))

    def runs(self) -> pa.Table:
        """All rows, in the order of their numbers."""
        files = self._files(RUNS)
        if not files:
            return self._runs([])
        return pa.concat_tables([_read(f) for f in files]).sort_by("run")

    def done(self) -> set[int]:
        """The numbers of the runs that are kept."""
        return {n for f in self._files(RUNS) for n in _read(f, ["run"])["run"].to_pylist()}

    def bands(self) -> Iterator[pa.Table]:
        """The signals of one run after the other, in the order of their numbers."""
        place: dict[int, Path] = {}
        for file in map(_beside, self._files(RUNS)):
            place |= dict.fromkeys(_read(file, ["run"])["run"].to_pylist(), file)
        read = lru_cache(maxsize=OPEN)(_by_run)
        for run in sorted(place):
            yield read(place[run])[run]

    def clear(self) -> None:
        """Remove all."""
        for file in self._folder.glob("*"):
            file.unlink()
        if self._folder.exists():
            self._folder.rmdir()

    @property
    def band_schema(self) -> pa.Schema:
        """The columns of the signals."""
        columns = [("run", pa.int64()), ("time", pa.float64())]
        return pa.schema([*columns, *((name, pa.float64()) for name in self._study.bands)])

    def _files(self, kind: str) -> list[Path]:
        """Of one kind; runs whose signals are lost do not count."""
        files = sorted(self._folder.glob(f"{kind}*.parquet"))
        return [f for f in files if _beside(f).exists()] if self._study.bands else files

    def _runs(self, rows: Sequence[Row]) -> pa.Table:
        columns = {
            "run": pa.array([r.run for r in rows], pa.int64()),
            "status": pa.array([r.status for r in rows], pa.string()),
            "reason": pa.array([r.reason for r in rows], pa.string()),
        }
        for i, output in enumerate(self._study.outputs):
            columns[output.column] = pa.array([float(r.outputs[i]) for r in rows], pa.float64())
        return pa.table(columns)

    def _bands(self, rows: Sequence[Row]) -> pa.Table:
        none = np.zeros((len(self._study.bands), 0))
        kept = [none if r.bands is None else r.bands for r in rows]
        counts = [bands.shape[1] for bands in kept]
        times = [band_times(self._study, r.start, n) for r, n in zip(rows, counts, strict=True)]
        runs = np.repeat(np.array([r.run for r in rows], np.int64), counts)
        columns = [runs, np.concatenate(times), *np.concatenate(kept, axis=1)]
        return pa.Table.from_arrays([pa.array(c) for c in columns], schema=self.band_schema)


def put(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file so that it is never there in part, whenever the process or the machine stops."""
    half = path.with_name(path.name + HALF)
    try:
        write(half)
        with half.open("rb+") as file:
            os.fsync(file.fileno())
        half.replace(path)
    except OSError as error:
        raise Problem(f"{path}: cannot be written: {error.strerror or error}") from None


def _beside(file: Path) -> Path:
    """The signals that belong to the runs of a file."""
    return file.with_name(file.name.replace(RUNS, BANDS))


def _read(file: Path, columns: list[str] | None = None) -> pa.Table:
    try:
        return pq.read_table(file, columns=columns)
    except (OSError, pa.ArrowException) as error:
        told = " ".join(str(error).split())
        raise Problem(f"{file}: cannot be read ({told}); without this file its runs are run again") from None


def _by_run(file: Path) -> dict[int, pa.Table]:
    """The rows of each run; those of one run stand together."""
    table = _read(file)
    runs, first, counts = np.unique(table["run"].to_numpy(), return_index=True, return_counts=True)
    return {int(r): table.slice(f, n) for r, f, n in zip(runs, first, counts, strict=True)}
