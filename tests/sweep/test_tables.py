"""The tables of a study as data sets: files of ranges of runs, which do not depend on how they came about."""

import random
import shutil
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pyarrow.dataset
import pyarrow.parquet as pq
import pytest
from kit.mistakes import problem
from sweep.studies import GAIN, content, run, study

from orchestrator.studies import design, store, study_page
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.parameter_study import prepare, sweep
from orchestrator.studies.runs import StudyRuns
from orchestrator.studies.study import read

RANGES, BATCHES = ("runs.parquet", "bands.parquet"), "parts/batch-*.parquet"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Ranges of four runs: files of 70 numbers, at the 17 columns of the gain's table."""
    monkeypatch.setattr(store, "MOST_VALUES", (70, 1 << 20))


@pytest.fixture
def ready(file):
    """The study of twelve runs, in three ranges."""
    return prepare(read(file))


@pytest.fixture(scope="module")
def rows(gain, tmp_path_factory):
    """Run -> outcome, computed apart from any folder."""
    ready = prepare(read(study(tmp_path_factory.mktemp("rows"), GAIN, gain)))
    with closing(StudyRuns(ready)) as runs:
        return {sample.run: runs.run((sample,))[0] for sample in ready.samples}


@pytest.fixture
def undisturbed(ready, rows, tmp_path):
    """What the folder has if all runs end in their order, at once."""
    begun = store.Store(folder(tmp_path, "undisturbed"), ready)
    begun.add([rows[n] for n in range(12)])
    begun.finish()
    found = content(begun.folder)
    assert [*found] == [f"{table}/part-00000{n}.parquet" for table in sorted(RANGES) for n in range(3)]
    return found


def folder(where, name):
    """A new folder."""
    (where / name).mkdir()
    return where / name


@pytest.mark.parametrize("seed", range(4))
def test_ranges_do_not_depend_on_the_order_of_the_runs(ready, rows, undisturbed, tmp_path, seed):
    """A range is there, and its batches are gone, as soon as its last run has ended; a new start goes on."""
    order, shuffled = [*range(12)], random.Random(seed)
    shuffled.shuffle(order)
    begun = store.Store(folder(tmp_path, "out"), ready)
    while order:
        some, order = order[:3], order[3:]
        begun.add([rows[n] for n in some])
        if shuffled.random() < 0.5:
            begun = store.Store(begun.folder, ready)
        assert begun.done() == {*range(12)} - {*order}
        complete = {n for n in range(3) if not {*range(4 * n, 4 * n + 4)} & {*order}}
        there = {int(name[-9:-8]) for name in content(begun.folder)}
        assert there == complete
        kept = {n for f in begun.folder.glob(BATCHES) for n in pq.read_table(f)["run"].to_pylist()}
        assert kept == {n for n in begun.done() if n // 4 not in complete}
        assert store.finished(begun.folder) == (not order)
    begun.finish()
    assert content(begun.folder) == undisturbed


@pytest.mark.parametrize("write", range(1, 16))
def test_a_kill_between_two_writes_changes_nothing(ready, rows, undisturbed, tmp_path, monkeypatch, write):
    """Before each file that is written or removed: no run is lost, none is there twice."""
    begun, count = store.Store(folder(tmp_path, "out"), ready), 0

    def killed(do, *given):
        nonlocal count
        count += 1
        if count == write:
            raise KeyboardInterrupt
        return do(*given)

    def go_on():
        for some in ((0, 1, 5), (2, 3, 6, 7), (4,), (8, 9, 10, 11)):
            begun.add([rows[n] for n in some])
        begun.finish()

    with monkeypatch.context() as patch:
        patch.setattr(store, "write_whole", partial(killed, store.write_whole))
        patch.setattr(store, "_remove", partial(killed, store._remove))
        patch.setattr(begun, "_drop", partial(killed, begun._drop))
        with pytest.raises(KeyboardInterrupt):
            go_on()
    again = store.Store(begun.folder, ready)
    again.forget_stopped()
    again.add([rows[n] for n in range(12) if n not in again.done()])
    again.finish()
    assert content(begun.folder) == undisturbed
    assert not [*begun.folder.glob(BATCHES)]


def test_a_larger_limit_opens_the_range_of_the_stopped_run(file, rows, undisturbed, tmp_path):
    """The other ranges stay as they are; in the end all are as if no limit had stopped a run."""
    file.write_text(f"time_limit = 5\n{GAIN}", encoding="utf-8")
    begun = store.Store(folder(tmp_path, "out"), prepare(read(file)))
    lost = {"outputs": np.full(1, np.nan), "bands": None, "reason": "time_limit = 5: not done within 5 s"}
    begun.add([replace(rows[n], status="failed", **lost) if n == 5 else rows[n] for n in range(12)])
    begun.finish()
    assert store.finished(begun.folder)
    assert {store.read(begun.folder).table["status"][5]} == {"failed"}
    file.write_text(f"time_limit = 60\n{GAIN}", encoding="utf-8")
    assert run(file)[1] == [5]
    assert content(begun.folder) == undisturbed


def test_folders_of_earlier_versions(file, ready, rows, undisturbed, tmp_path):
    """Tables that are single files are read and not run again; batches of several ranges are taken over."""
    whole = run(file)[0]
    table, bands = whole.table, whole.bands
    for name in RANGES:
        old = pyarrow.dataset.dataset(str(tmp_path / "out" / name)).to_table()
        shutil.rmtree(tmp_path / "out" / name)
        pq.write_table(old, tmp_path / "out" / name, write_page_checksum=True)
    found, runs = run(file)
    assert runs == []
    assert found.table.equals(table)
    assert found.bands.equals(bands)
    assert found.units == whole.units
    assert run(file, fresh=True)[1] == [*range(12)]
    begun = store.Store(folder(tmp_path, "begun"), ready)
    begun._size = 1 << 20  # as if without ranges
    begun.add([rows[n] for n in (1, 4, 6, 11)])
    again = store.Store(begun.folder, ready)
    assert again.done() == {1, 4, 6, 11}
    again.add([rows[n] for n in range(12) if n not in again.done()])
    again.finish()
    assert content(begun.folder) == undisturbed


def test_a_folder_at_a_url(file, undisturbed):
    """The same files, by fsspec; a second start runs nothing, a lock names its holder, fresh starts anew."""
    import fsspec

    url, runs = "memory://studies/gain", []
    sweep(file, url, workers=1, watch=lambda *of: runs.extend(r.run for r in of[2]))
    results = sweep(file, url, watch=lambda *of: runs.extend(r.run for r in of[2]))
    assert sorted(runs) == [*range(12)]
    files = fsspec.filesystem("memory")
    names = {name.removeprefix("/studies/gain/"): files.cat(name) for name in files.find("/studies/gain")}
    assert {name: names[name] for name in undisturbed} == undisturbed
    assert {*names} == {*undisturbed, "study.json", "study.toml"}
    assert len(results.table) == results.dataset.count_rows() == 12
    study_page.write(store.place(url), results)
    assert files.cat("/studies/gain/report.html").startswith(b"<!doctype html>")
    with store.locked(store.place(url)):
        told = r"another process is running .*, process \d+ on .*; if it has ended, remove memory://.*/lock$"
        problem(lambda: sweep(file, url), told)
    sweep(file, url, workers=1, fresh=True, watch=lambda *of: runs.extend(r.run for r in of[2]))
    assert len(runs) == 24
    problem(lambda: sweep(file, "nothing://x"), r"^nothing://x: .*nothing")


def test_fsspec_is_imported_for_urls_only(file, tmp_path):
    """A study in a folder needs no package of the extra cluster."""
    code = "import sys; from orchestrator.studies import sweep; sys.modules['fsspec'] = None"
    code += f"; sys.modules['upath'] = None; sweep({str(file)!r}, {str(tmp_path / 'out')!r}).table"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)


def test_the_analysis_reads_the_columns_that_it_needs(file, monkeypatch):
    """Never the whole table; start values are in no column that is read."""
    run(file)
    asked = set()
    reading = pq.ParquetFile.read

    def read_columns(opened, columns=None, *given, **options):
        assert columns
        asked.update(columns)
        return reading(opened, columns, *given, **options)

    monkeypatch.setattr(pq.ParquetFile, "read", read_columns)
    results = store.read(file.parent / "out")
    found = study_page.study_report(results, analyse(results))
    assert found.html()
    start = {name for name in results.dataset.schema.names if name.startswith("start:")}
    assert len(start) == 3
    assert not asked & start
    assert {"status", "reason", "factor:gain.factor"} <= asked
    assert isinstance(vars(results)["table"], type(file))  # and nothing of it stays in memory


def test_other_tools_read_the_data_set(file):
    """pandas and Arrow read the folder as one table, in the order of the runs, as `results.table` is."""
    results = run(file)[0]
    path = file.parent / "out" / "runs.parquet"
    for table in (pd.read_parquet(path), store.read(file.parent / "out").dataset.to_table().to_pandas()):
        pd.testing.assert_frame_equal(table, results.table)
    some = results.dataset.to_table(["run"], filter=pyarrow.dataset.field("run") >= 10)
    assert some["run"].to_pylist() == [10, 11]


def test_samples_are_made_when_they_are_asked_for(ready):
    """A slice has the runs of a list, and what another process gets has no other samples."""
    import pickle

    every = [*ready.samples]
    assert [*ready.samples[3:7]] == every[3:7]
    assert ready.samples[-1] == every[-1]
    assert pickle.loads(pickle.dumps(ready.samples[3:7])) == tuple(every[3:7])


def test_start_values_of_a_range_are_those_of_all_runs(ready):
    """Range by range, as the tables are written."""
    whole, units = design.starts(ready.study, ready.cases, ready.samples)
    for first in range(0, 12, 5):
        some, same = design.starts(ready.study, ready.cases, ready.samples[first : first + 5])
        assert same == units
        assert some == {name: column[first : first + 5] for name, column in whole.items()}
