"""What is finished while a study runs: files that are there as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.errors import Problem
from orchestrator.sweep.running import Row, band_times
from orchestrator.sweep.study import Study

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
