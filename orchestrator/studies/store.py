"""Folder of a study: its definition, finished runs, results, and hashes of everything that determines them.

    study.toml     copy of the TOML file of the study
    study.json     the resolved study, and hashes of everything that determines its results
    lock           locked while a process runs the study
    parts/         finished batches while the study runs, and afterwards if a limit has stopped a run; the
                   name of each file has a checksum of its content
    bands.parquet  signals stored over time, for the bands of the report: run, time [s], a column per signal
    runs.parquet   one row per run: run, status, reason, energy_error (largest energy error of the coupling,
                   over the energy that its bond exchanged), then the columns that `study` lists
    report.html, analysis.json   the analysis, written by orchestrator/studies/study_page.py

Each file is written completely or not at all. The results are written after the last run, and do not depend
on how often the study was started.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import locket
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.base.errors import Problem
from orchestrator.base.files import PARTIAL, Location, put, write_whole
from orchestrator.base.text import first_names
from orchestrator.base.toml import quote_key
from orchestrator.data.matlab import foreign
from orchestrator.studies import design
from orchestrator.studies.runs import STOPPED, PreparedStudy, RunOutcome, band_times, digest, limit_is_raised
from orchestrator.studies.study import Choice, Factor, Output, Study

NAMES = ("runs.parquet", "bands.parquet", "report.html", "analysis.json")
GROUP = 64  # runs per row group of bands.parquet, a few megabytes
LONG = 200  # characters of two values together above which they are not shown
DAMAGED = "expected a checksum of the content in the name of the file, got another or none"
BAND = "band:"  # prefix of the columns of a batch file that hold a stored signal, one list per run


@dataclass(frozen=True)
class Results:
    """A finished study.

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

    def __repr__(self) -> str:
        return f"Results of {self.study.title}: {len(self.table)} runs\ntable: {first_names(self.table)}"


def read(folder: str | Path) -> Results:
    """The results of a finished study."""
    folder = Path(folder)
    if not finished(folder):
        raise Problem(f"{folder}: expected a finished study, runs.parquet is missing")
    stored = _read_study_json(folder / "study.json")
    runs, bands = _read_results(folder / "runs.parquet"), None
    units = _units(runs.schema)
    if (folder / "bands.parquet").exists():
        bands = _read_results(folder / "bands.parquet")
        units |= _units(bands.schema)
    study = from_json(stored["study"], stored["title"])
    warnings = tuple(stored.get("warnings", ()))
    return Results(study, runs.to_pandas(), None if bands is None else bands.to_pandas(), units, warnings)


def finished(folder: Path) -> bool:
    """Whether all runs are done and the results are written."""
    return (folder / "runs.parquet").exists()


def clear(folder: Path) -> None:
    """Remove the runs, the results and study.json; do nothing if the folder contains no study.

    study.toml and the lock stay.
    """
    if not (folder / "study.json").exists():
        return
    files = [folder / name for name in (*NAMES, "log.csv")]  # the log is of earlier versions
    # study.json is removed last, as it identifies the other files if this process is killed
    for file in [*(folder / "parts").glob("*"), *files, folder / "study.json"]:
        file.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock the folder for this process, until the end of the block or of the process."""
    lock = locket.lock_file(str(folder / "lock"), timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except OSError as error:
        raise Problem(f"{folder}: cannot be a folder for results: {error.strerror or error}") from None
    except locket.LockError:
        raise Problem(f"{folder}: another process is running a study in this folder") from None
    try:
        yield
    finally:
        lock.release()


class Store:
    """The folder of a running study: finished batches, and at the end the results.

    A batch is one file in parts/ with a row for each run; a stored signal is a column of lists there.
    """

    def __init__(self, folder: Path, prepared: PreparedStudy) -> None:
        """Refuses a folder with runs of another study."""
        self.folder, self._prepared, self._parts = folder, prepared, folder / "parts"
        self.study = study = prepared.study
        file, fingerprint = folder / "study.json", self._fingerprint()
        if not file.exists() and (others := [name for name in NAMES if (folder / name).exists()]):
            message = f"contains {others[0]} but no study.json, so it is not the folder of a study"
            raise Problem(f"{folder}: {message}")
        if file.exists() and (changed := changes(_read_study_json(file), fingerprint)):
            raise Problem(f"{folder}: holds runs of another study: {changed}; --fresh deletes them")
        # study.json is written first, as it identifies the other files
        text = json.dumps(
            {"title": study.title, "warnings": list(prepared.warnings), **fingerprint}, indent=1
        )
        write_whole(file, text)
        if study.source:
            write_whole(folder / "study.toml", Location(Path(study.source)).read())
        for unfinished in self._parts.glob(f".*{PARTIAL}"):
            unfinished.unlink()
        for part in self._files():
            if not _is_intact(part, Location(part).read()):
                logging.getLogger(__name__).warning("%s: %s: its runs are computed again", part, DAMAGED)
                part.unlink()

    def done(self) -> set[int]:
        """The numbers of the runs that are done."""
        return {n for file in self._files() for n in _read(file, ["run"])["run"].to_pylist()}

    def forget_stopped(self) -> None:
        """Forget the runs that a limit has stopped that is larger now; they are computed again."""
        for file in self._files():
            rows = _read(file)
            keep = [not limit_is_raised(reason, self.study) for reason in rows["reason"].to_pylist()]
            kept = rows.filter(pa.array(keep))
            if len(kept) == len(rows):
                continue
            (self.folder / "runs.parquet").unlink(missing_ok=True)  # the study is not finished any more
            file.unlink()
            if len(kept):
                self._put(kept)

    def _put(self, rows: pa.Table) -> None:
        content = BytesIO()
        pq.write_table(rows, content)
        name = f"batch-{rows['run'][0].as_py():09}-{digest(content.getvalue())[:16]}.parquet"
        write_whole(self._parts / name, content.getvalue())

    def add(self, batch: Sequence[RunOutcome]) -> None:
        """Store the outcomes of a batch."""
        self._parts.mkdir(exist_ok=True)
        batch = sorted(batch, key=lambda r: r.run)
        names = ("run", "status", "reason", "energy_error", "start")
        columns = {name: pa.array([getattr(r, name) for r in batch]) for name in names}
        for i, output in enumerate(self.study.outputs):
            columns[output.column] = pa.array([float(r.outputs[i]) for r in batch])
        for i, name in enumerate(self.study.bands):
            lists = [np.empty(0) if r.bands is None else r.bands[i] for r in batch]
            columns[f"{BAND}{name}"] = pa.array(lists, pa.list_(pa.float64()))
        self._put(pa.table(columns))

    def finish(self) -> None:
        """Write the results, with samples and start values."""
        if self.study.bands:
            put(self.folder / "bands.parquet", self._write_bands)
        names = ["run", "status", "reason", "energy_error", *(o.column for o in self.study.outputs)]
        runs = pa.concat_tables([_read(file, names) for file in self._files()]).sort_by("run")
        starts, units = design.starts(self.study, self._prepared.cases, self._prepared.samples)
        table = self._prepared.table.items()
        samples = {name: pa.array(column, from_pandas=True) for name, column in table}
        runs = pa.table({**{name: runs[name] for name in names}, **samples, **starts})
        units |= {f.column: f.unit for f in self.study.factors if not f.relative}
        units |= {o.column: o.unit for o in self.study.outputs}
        write = partial(pq.write_table, _with_units(runs, units), write_page_checksum=True)
        put(self.folder / "runs.parquet", write)
        if any(STOPPED.match(reason) for reason in runs["reason"].to_pylist()):
            return  # larger limits compute these runs again, and keep the others
        for file in self._parts.glob("*"):
            file.unlink()
        self._parts.rmdir()

    def _write_bands(self, file: Path) -> None:
        """Write the signals of all runs in their order, with a row for each point of time."""
        names, units = self.study.bands, {o.signal: o.signal_unit for o in self.study.outputs} | {"time": "s"}
        columns = [("run", pa.int64()), ("time", pa.float64()), *((name, pa.float64()) for name in names)]
        schema = _with_units(pa.schema(columns).empty_table(), units).schema
        stored = ["run", "start", *(f"{BAND}{name}" for name in names)]
        runs = pa.concat_tables([_read(part, stored) for part in self._files()]).sort_by("run")
        with pq.ParquetWriter(file, schema, write_page_checksum=True) as writer:
            for first in range(0, len(runs), GROUP):
                some = runs.slice(first, GROUP)
                lists = [some[f"{BAND}{name}"].combine_chunks() for name in names]
                counts = lists[0].value_lengths().to_numpy()
                starts = zip(some["start"].to_pylist(), counts.tolist(), strict=True)
                time = np.concatenate([band_times(self.study, start, count) for start, count in starts])
                run = np.repeat(some["run"].to_numpy(), counts)
                writer.write_table(pa.table([run, time, *(x.flatten() for x in lists)], schema=schema))

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
        samples = digest(prepared.table.to_csv(float_format="%.17g").encode())
        return {"study": to_json(study), "files": {**files, "the samples": samples}}

    def _files(self) -> list[Path]:
        return sorted(self._parts.glob("batch-*.parquet"))


def _is_intact(part: Path, content: bytes) -> bool:
    """True if the content of a batch file matches its name; False for files of earlier versions."""
    return part.stem.endswith(f"-{digest(content)[:16]}")


def _read(part: Path, columns: list[str] | None = None) -> pa.Table:
    """The rows of a batch file."""
    content = Location(part).read()
    if not _is_intact(part, content):  # damaged since the study was started
        raise Problem(f"{part}: {DAMAGED}; the same command repeats its runs")
    return pq.read_table(BytesIO(content), columns=columns)


def _read_results(file: Path) -> pa.Table:
    """The rows of a file of results, whose pages have checksums."""
    try:
        with foreign(file, "a Parquet"):
            return pq.read_table(BytesIO(Location(file).read()), page_checksum_verification=True)
    except Problem as problem:
        raise Problem(f"{problem}; --fresh computes the study again") from None


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
        stored: dict[str, Any] = json.loads(Location(file).text())
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
