"""Folder of a study: its definition, finished runs, results, and hashes of everything that determines them.

    study.toml     copy of the TOML file of the study
    study.json     the resolved study, and hashes of everything that determines its results
    lock           locked while a process runs the study; at a URL there while a process runs it
    parts/         finished batches of ranges that are not finished, and of those with a run that a limit has
                   stopped; the name of each file has a checksum of its content
    bands.parquet/ signals stored over time, for the bands of the report: run, time [s], a column per signal
    runs.parquet/  one row per run: run, status, reason, energy_error (largest energy error of the coupling,
                   over the energy that its bond exchanged), then the columns that `study` lists
    report.html, analysis.json   the analysis, written by orchestrator/studies/study_page.py

Both tables are data sets of a file for each range of run numbers, part-000000.parquet and so on. A file is
written when the last run of its range has ended; it does not depend on how often the study was started, nor
on the order of the runs. In folders of earlier versions each table is one file.

Each file is written completely or not at all. The folder may be at a URL of fsspec, such as s3://bucket/study.
"""

from __future__ import annotations

import json
import logging
import os
import platform
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import locket
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from pyarrow.compute import is_in

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import PARTIAL, Location, write_whole
from orchestrator.base.text import first_names
from orchestrator.base.toml import quote_key
from orchestrator.data.matlab import foreign
from orchestrator.data.table import Array
from orchestrator.studies import design
from orchestrator.studies.runs import STOPPED, PreparedStudy, RunOutcome, band_times, digest, limit_is_raised
from orchestrator.studies.study import Choice, Factor, Output, Study

TABLES = RUNS, BANDS = "runs.parquet", "bands.parquet"
NAMES = (*TABLES, "report.html", "analysis.json")
PARTS = "part-*.parquet"  # files of a table
RESULT = ("run", "status", "reason", "energy_error")  # columns of runs.parquet, before those of the study
MOST_VALUES = 1 << 22, 1 << 23  # of a file of each table: some megabytes, as most start values are equal
CHUNK = 10_000  # runs whose samples are text at once
GROUP = 64  # runs per row group of bands.parquet, a few megabytes
PAGES: dict[str, Any] = {"write_page_checksum": True, "write_statistics": ["run"]}  # of 500 columns: long
LONG = 200  # characters of two values together above which they are not shown
DAMAGED = "expected a checksum of the content in the name of the file, got another or none"
BAND = "band:"  # prefix of the columns of a batch file that hold a stored signal, one list per run


# ---- results


@dataclass(frozen=True)
class Results:
    """A finished study. `table` and `bands` are read when they are first asked for.

    table  one row per run
    bands  stored signals; None if there are none
    units  column of the table, or signal -> unit
    warnings  doubtful values in the study
    """

    study: Study
    table: pd.DataFrame
    bands: pd.DataFrame | None
    units: Mapping[str, str]
    warnings: tuple[str, ...] = ()

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if name in ("table", "bands") and not isinstance(value, pd.DataFrame | None):
            value = vars(self)[name] = _frame(value)
        return value

    def __repr__(self) -> str:
        runs, names = self.dataset.count_rows(), self.dataset.schema.names
        return f"Results of {self.study.title}: {runs} runs\ntable: {first_names(names)}"

    @property
    def dataset(self) -> ds.Dataset:
        """The table as a data set of Arrow, of which parts can be read: it need not fit into memory."""
        return _dataset(vars(self)["table"])

    def columns(self, *names: str) -> pd.DataFrame:
        """Columns of the table; the others are not read."""
        return _frame(vars(self)["table"], names)

    @property
    def points(self) -> int:
        """Number of rows of `bands`; 0 if there are none."""
        return 0 if vars(self)["bands"] is None else _dataset(vars(self)["bands"]).count_rows()

    def stored(self, signal: str, runs: Array) -> pd.DataFrame:
        """The rows of `bands` of some runs: run, time [s] and a signal."""
        return _frame(vars(self)["bands"], ("run", "time", signal), runs)


def _dataset(table: Any) -> ds.Dataset:
    """A table, or the one at a path; opened anew, as it keeps the metadata of each file that it reads."""
    if isinstance(table, pd.DataFrame):
        return ds.dataset(pa.Table.from_pandas(table, preserve_index=False))
    if isinstance(table, Path):
        return ds.dataset(str(table), format="parquet")
    return ds.dataset(table.path, format="parquet", filesystem=table.fs)


def _frame(table: Any, names: Sequence[str] = (), runs: Array | None = None) -> pd.DataFrame:
    """Columns of a table or of the one at a path, of all or some runs."""
    if isinstance(table, pd.DataFrame):
        return table.loc[slice(None) if runs is None else table["run"].isin(runs), [*names]]

    def read(file: Path) -> pa.Table:
        with _opened(file) as opened:
            rows = opened.read([*names] or None)
        return rows if runs is None else rows.filter(is_in(rows["run"], pa.array(runs)))

    with ThreadPoolExecutor() as threads:
        rows = pa.concat_tables(threads.map(read, _parts(table)))
    return rows.to_pandas(split_blocks=True, self_destruct=True)


def _parts(table: Path) -> list[Path]:
    """The files of a table, in the order of the runs; one in a folder of an earlier version."""
    return [table] if table.is_file() else sorted(table.glob(PARTS))


@contextmanager
def _opened(file: Path) -> Iterator[pq.ParquetFile]:
    """A file of a table, whose pages have checksums."""
    try:
        with foreign(file, "a Parquet"), _stream(file) as opened:
            yield pq.ParquetFile(opened, page_checksum_verification=True)
    except Problem as problem:
        remedy = "without it, the same command computes its runs again, and --fresh the whole study"
        raise Problem(f"{problem}; {remedy}") from None


def read(folder: str | Path) -> Results:
    """The results of a finished study."""
    folder, units = place(folder), dict[str, str]()
    if not finished(folder):
        lacks = "not complete" if (folder / RUNS).exists() else "missing"
        raise Problem(f"{folder}: expected a finished study, {RUNS} is {lacks}")
    tables: list[Any] = [table if (table := folder / name).exists() else None for name in TABLES]
    for table in filter(None, tables):
        with _opened(_parts(table)[0]) as file:
            units |= _units(file.schema_arrow)
    stored = _read_study_json(folder / "study.json")
    study = from_json(stored["study"], stored["title"])
    return Results(study, tables[0], tables[1], units, tuple(stored.get("warnings", ())))


# ---- the folder


def place(folder: str | Path) -> Path:
    """A folder, or an object with the methods of a Path for the URL of one."""
    scheme, separator, _ = str(folder).partition("://")
    if not separator:
        return Path(folder)
    require("cluster", f"a folder at {scheme}://", "upath")
    from upath import UPath

    try:
        found: Any = UPath(folder)
        found.fs.invalidate_cache()  # of what other processes may have changed
    except (ImportError, ValueError) as error:  # no package for such storage
        raise Problem(f"{folder}: {error}") from None
    return Path(found.path) if scheme == "file" else found


def finished(folder: Path) -> bool:
    """Whether all runs are done and the results are written."""
    if not (folder / RUNS).is_dir() or not (folder / "study.json").exists():
        return (folder / RUNS).is_file()  # of an earlier version
    stored = _read_study_json(folder / "study.json")
    study = from_json(stored["study"], "")
    return len(_written(folder, study)) == -(-study.count // int(stored["range"]))


def _written(folder: Path, study: Study) -> set[int]:
    """The ranges of runs that have a file in each table."""
    tables = [folder / name for name in (TABLES if study.bands else (RUNS,))]
    found = [{int(file.stem.removeprefix("part-")) for file in table.glob(PARTS)} for table in tables]
    return set[int].intersection(*found)


def clear(folder: Path) -> None:
    """Remove the runs, the results and study.json; do nothing if the folder contains no study.

    study.toml and the lock stay.
    """
    if not (folder / "study.json").exists():
        return
    # study.json is removed last, as it identifies the other files if this process is killed
    for name in ("parts", *NAMES, "log.csv", "study.json"):  # the log is of earlier versions
        _remove(folder / name)


def _remove(path: Path) -> None:
    """Remove a file, or a folder of files."""
    if not path.is_dir():
        path.unlink(missing_ok=True)
        return
    for file in path.glob("*"):
        file.unlink()
    if path.exists():  # at a URL a folder may end with its files
        path.rmdir()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock the folder for this process, until the end of the block or of the process.

    At a URL the lock is a file that exists until the end of the block; it stays if the process is killed.
    """
    file, taken = folder / "lock", f"{folder}: another process is running a study in this folder"
    lock = locket.lock_file(str(file), timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if isinstance(folder, Path):
            lock.acquire()
        elif file.exists():
            raise Problem(f"{taken}, {file.read_text()}; if it has ended, remove {file}")
        else:
            with file.open("xb") as made:  # fails if another process has just made it
                made.write(f"process {os.getpid()} on {platform.node()}".encode())
    except OSError as error:
        raise Problem(f"{folder}: cannot be a folder for results: {error.strerror or error}") from None
    except locket.LockError:
        raise Problem(taken) from None
    try:
        yield
    finally:
        lock.release() if isinstance(folder, Path) else file.unlink(missing_ok=True)


class Store:
    """The folder of a running study: finished ranges of runs, and finished batches of the other ranges.

    A batch is one file in parts/ with a row for each run; a stored signal is a column of lists there. The
    batches of a range stay if a limit has stopped a run: a larger one computes this run again.
    """

    def __init__(self, folder: Path, prepared: PreparedStudy) -> None:
        """Refuses a folder with runs of another study."""
        self.folder, self._prepared, self._parts = folder, prepared, folder / "parts"
        self.study = study = prepared.study
        file, fingerprint = folder / "study.json", self._fingerprint()
        if not file.exists() and (others := [name for name in NAMES if (folder / name).exists()]):
            message = f"contains {others[0]} but no study.json, so it is not the folder of a study"
            raise Problem(f"{folder}: {message}")
        stored = _read_study_json(file) if file.exists() else fingerprint
        if changed := changes(stored, fingerprint):
            raise Problem(f"{folder}: holds runs of another study: {changed}; --fresh deletes them")
        self._size = stored.get("range") or _range_size(prepared)
        # study.json is written first, as it identifies the other files
        about = {"title": study.title, "warnings": list(prepared.warnings), "range": self._size}
        write_whole(file, json.dumps({**about, **fingerprint}, indent=1))
        if study.source:
            write_whole(folder / "study.toml", Location(Path(study.source)).read())
        for part in (self._parts, *(folder / name for name in TABLES)):
            for unfinished in part.glob(f".*{PARTIAL}"):
                unfinished.unlink()
        self._written = _written(folder, study)
        self._batches = defaultdict[int, dict[Path, list[int]]](dict)  # range -> file -> runs
        for part in sorted(self._parts.glob("batch-*.parquet")):
            if _is_intact(part, _content(part)):
                runs = _read(part, ["run"])["run"].to_pylist()
                if (n := runs[0] // self._size) == runs[-1] // self._size:
                    self._batches[n][part] = runs
                    continue
                self._put(_read(part))  # of an earlier version
            else:
                logging.getLogger(__name__).warning("%s: %s: its runs are computed again", part, DAMAGED)
            part.unlink()

    def done(self) -> set[int]:
        """The numbers of the runs that are done."""
        stored = (runs for files in self._batches.values() for runs in files.values())
        return {run for runs in (*map(self._runs, self._written), *stored) for run in runs}

    def forget_stopped(self) -> None:
        """Forget the runs that a limit has stopped that is larger now; they are computed again."""
        for n, file in [(n, file) for n, files in self._batches.items() for file in files]:
            rows = _read(file)
            keep = [not limit_is_raised(reason, self.study) for reason in rows["reason"].to_pylist()]
            kept = rows.filter(pa.array(keep))
            if len(kept) == len(rows):
                continue
            for name in TABLES:  # the study is not finished any more
                table = self.folder / name  # a file of an earlier version
                (table if table.is_file() else self._file(name, n)).unlink(missing_ok=True)
            self._written.discard(n)
            file.unlink()
            del self._batches[n][file]
            self._put(kept)
        for n in self._written & {*self._batches}:  # another process was killed before
            self._drop(n)

    def _runs(self, n: int) -> range:
        return range(n * self._size, min((n + 1) * self._size, self.study.count))

    def _file(self, table: str, n: int) -> Path:
        return self.folder / table / f"part-{n:06}.parquet"

    def _put(self, rows: pa.Table) -> None:
        """Write batches, one for each range."""
        ranges = rows["run"].to_numpy() // self._size
        for n in np.unique(ranges).tolist():
            some, content = rows.filter(pa.array(ranges == n)), BytesIO()
            pq.write_table(some, content)
            runs = some["run"].to_pylist()
            name = f"batch-{runs[0]:09}-{digest(content.getvalue())[:16]}.parquet"
            self._batches[n][write_whole(self._parts / name, content.getvalue())] = runs

    def add(self, batch: Sequence[RunOutcome]) -> None:
        """Store the outcomes of a batch, and the ranges of runs that it completes."""
        batch = sorted(batch, key=lambda r: r.run)
        columns = {name: pa.array([getattr(r, name) for r in batch]) for name in (*RESULT, "start")}
        for i, output in enumerate(self.study.outputs):
            columns[output.column] = pa.array([float(r.outputs[i]) for r in batch])
        for i, name in enumerate(self.study.bands):
            lists = [np.empty(0) if r.bands is None else r.bands[i] for r in batch]
            columns[f"{BAND}{name}"] = pa.array(lists, pa.list_(pa.float64()))
        self._put(pa.table(columns))
        for n in {r.run // self._size for r in batch}:
            if sum(map(len, self._batches[n].values())) == len(self._runs(n)):
                self._write(n)

    def finish(self) -> None:
        """Write the ranges that are left when the last run has ended."""
        for n in {*range(-(-self.study.count // self._size))} - self._written:
            self._write(n)
        if not self._batches:
            _remove(self._parts)

    def _write(self, n: int) -> None:
        """Write the tables of a range, with samples and start values."""
        if self.study.bands:
            self._write_bands(n)
        numbers, names = self._runs(n), [*RESULT, *(o.column for o in self.study.outputs)]
        runs = pa.concat_tables([_read(file, names) for file in self._batches[n]]).sort_by("run")
        rows = slice(numbers.start, numbers.stop)
        starts, units = design.starts(self.study, self._prepared.cases, self._prepared.samples[rows])
        table = self._prepared.table.iloc[rows].items()
        samples = {name: pa.array(column, from_pandas=True) for name, column in table}
        runs = pa.table({**{name: runs[name] for name in names}, **samples, **starts})
        units |= {f.column: f.unit for f in self.study.factors if not f.relative}
        units |= {o.column: o.unit for o in self.study.outputs}
        content = BytesIO()
        pq.write_table(_with_units(runs, units), content, **PAGES)
        write_whole(self._file(RUNS, n), content.getvalue())
        self._written.add(n)
        self._drop(n)

    def _drop(self, n: int) -> None:
        """Remove the batches of a range, unless a limit has stopped a run."""
        reasons = (r for file in self._batches[n] for r in _read(file, ["reason"])["reason"].to_pylist())
        if not any(map(STOPPED.match, reasons)):
            for file in self._batches.pop(n):
                file.unlink()

    def _write_bands(self, n: int) -> None:
        """Write the signals of a range of runs in their order, with a row for each point of time."""
        names, units = self.study.bands, {o.signal: o.signal_unit for o in self.study.outputs} | {"time": "s"}
        columns = [("run", pa.int64()), ("time", pa.float64()), *((name, pa.float64()) for name in names)]
        schema = _with_units(pa.schema(columns).empty_table(), units).schema
        stored = ["run", "start", *(f"{BAND}{name}" for name in names)]
        runs = pa.concat_tables([_read(part, stored) for part in self._batches[n]]).sort_by("run")
        content = BytesIO()
        with pq.ParquetWriter(content, schema, **PAGES) as writer:
            for first in range(0, len(runs), GROUP):
                some = runs.slice(first, GROUP)
                lists = [some[f"{BAND}{name}"].combine_chunks() for name in names]
                counts = lists[0].value_lengths().to_numpy()
                starts = zip(some["start"].to_pylist(), counts.tolist(), strict=True)
                time = np.concatenate([band_times(self.study, start, count) for start, count in starts])
                run = np.repeat(some["run"].to_numpy(), counts)
                writer.write_table(pa.table([run, time, *(x.flatten() for x in lists)], schema=schema))
        write_whole(self._file(BANDS, n), content.getvalue())

    def _fingerprint(self) -> dict[str, Any]:
        """The study and the hashes of everything else that determines its results, for study.json.

        The key "files" holds the hashes: of FMUs, start values, scenarios, connections (with coupling and
        step) and samples, each under the name that a message about a change shows.
        """
        study, prepared, files = self.study, self._prepared, dict[str, str]()
        digests = {source: digest(archive) for source, archive in prepared.archives.items()}
        for options, case in prepared.cases.items():
            chosen = {c.name: f" {o}" for c, o in zip(study.choices, options, strict=True)}
            each = ", ".join(f"{c.name}={o}" for c, o in zip(study.choices, options, strict=True))
            combination = f" with {each}" if each else ""
            for name, component in case.system.components.items():
                if component.source is not None:
                    files[f"the FMU of {name}{chosen.get(name, '')}"] = digests[component.source]
                starts = repr(sorted(component.start.items())).encode()
                files[f"the start values of {name}{combination}"] = digest(starts)
            if case.scenario is not None:
                columns = repr(sorted((str(p), c) for p, c in case.scenario.columns.items())).encode()
                data = b"".join(np.ascontiguousarray(array).tobytes() for array in case.scenario.table.arrays)
                files[f"the scenario{chosen.get('scenario', '')}"] = digest(columns + data)
            connections = repr((case.system.connections, case.system.coupling, case.system.step)).encode()
            files[f"the connections{combination}"] = digest(connections)
        samples = sha256()
        for first in range(0, len(prepared.table), CHUNK):
            rows = prepared.table.iloc[first : first + CHUNK]
            samples.update(rows.to_csv(float_format="%.17g", header=not first).encode())
        return {"study": to_json(study), "files": {**files, "the samples": samples.hexdigest()}}


def _range_size(prepared: PreparedStudy) -> int:
    """Runs in a file of the tables, a power of two."""
    study, cases = prepared.study, prepared.cases
    starts, _ = design.starts(study, cases, prepared.samples[:1])
    columns = len(RESULT) + len(study.outputs) + prepared.table.shape[1] + len(starts)
    points = max(job.times.stop - job.times.start for job in cases.values()) / study.band_step + 1
    most = min(MOST_VALUES[0] / columns, MOST_VALUES[1] / (points * max(len(study.bands), 1)))
    return 1 << max(int(most), 1).bit_length() - 1


def _stream(file: Path) -> AbstractContextManager[IO[bytes]]:
    return Location(file).opened() if isinstance(file, Path) else file.open("rb")


def _content(file: Path) -> bytes:
    return Location(file).read() if isinstance(file, Path) else file.read_bytes()


def _is_intact(part: Path, content: bytes) -> bool:
    """True if the content of a batch file matches its name; False for files of earlier versions."""
    return part.stem.endswith(f"-{digest(content)[:16]}")


def _read(part: Path, columns: list[str] | None = None) -> pa.Table:
    """The rows of a batch file."""
    content = _content(part)
    if not _is_intact(part, content):  # damaged since the study was started
        raise Problem(f"{part}: {DAMAGED}; the same command repeats its runs")
    return pq.read_table(BytesIO(content), columns=columns)


def _with_units(table: pa.Table, units: Mapping[str, str]) -> pa.Table:
    """The table with units of its columns."""
    fields = [f.with_metadata({"unit": units[f.name]}) if units.get(f.name) else f for f in table.schema]
    return table.cast(pa.schema(fields))


def _units(schema: pa.Schema) -> dict[str, str]:
    return {f.name: f.metadata[b"unit"].decode() for f in schema if f.metadata and b"unit" in f.metadata}


# ---- what determines the results


def to_json(study: Study) -> dict[str, Any]:
    """A study for JSON, without the fields that have no effect on its results."""
    fields = asdict(study)
    for name in ("folder", "source", "title", "time_limit", "memory_limit"):
        del fields[name]
    if not fields["options"]:
        del fields["options"]  # as written by versions without them
    json_types: dict[str, Any] = json.loads(json.dumps(fields))
    return json_types


def from_json(fields: Mapping[str, Any], title: str) -> Study:
    """The study that `to_json` wrote."""
    kinds = {"factors": Factor, "choices": Choice, "outputs": Output}
    items = {name: tuple(kind(**item) for item in fields[name]) for name, kind in kinds.items()}
    return Study(title=title, **{**fields, **items})


def _read_study_json(file: Path) -> dict[str, Any]:
    try:
        stored: dict[str, Any] = json.loads(_content(file))
        stored["study"], stored["files"], stored["title"]
        dict(_flat("", stored["study"]))
    except (ValueError, TypeError, KeyError, RecursionError):  # such as items without a name
        raise Problem(f"{file}: is not the study.json of a parameter study; --fresh deletes it") from None
    return stored


def changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """The first difference of two fingerprints, and the number of others; empty if there is none.

    If the studies differ, the hashes are not compared: most of them follow from the study.
    """
    kinds = [[dict(_flat("", stored["study"])) for stored in (old, new)], [old["files"], new["files"]]]
    for before, after in kinds:
        if not (names := [n for n in dict.fromkeys([*before, *after]) if before.get(n) != after.get(n)]):
            continue
        more = f", and {len(names) - 1} more changed" if len(names) > 1 else ""
        was, now = (json.dumps(values.get(names[0])).removesuffix(".0") for values in (before, after))
        shown = before is not old["files"] and len(was) + len(now) <= LONG
        return f"{names[0]} {f'was {was}, is {now}' if shown else 'changed'}{more}"
    return ""


def _flat(where: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Each value of a study by its key, such as `outputs.end.measure`; first the names of a list of items."""
    if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        value = {item["name"]: item for item in value}
        yield where, [*value]
    if not isinstance(value, Mapping):
        yield where, value
        return
    for key, inner in value.items():
        hidden = key in ("numbers", "options")  # which study.toml does not have
        yield from _flat(where if hidden else f"{where}.{quote_key(key)}".lstrip("."), inner)
