"""The folder of a study: the same content however it came about, nothing run twice, nothing mixed."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sweep.studies import GAIN, content, run, study

from orchestrator import Problem
from orchestrator.studies import store
from orchestrator.studies.parameter_study import prepare
from orchestrator.studies.pool import outcomes
from orchestrator.studies.store import PARTIAL
from orchestrator.studies.study import read


@pytest.fixture
def file(gain, tmp_path):
    """The study of the gain."""
    return study(tmp_path, GAIN, gain)


def test_a_finished_study_is_not_run_again(file, one):
    """No run takes place, and nothing is written anew."""
    first, _ = run(file, one)
    before = content(file.parent / "out")
    again, runs = run(file, one)
    assert runs == []
    assert again.table.equals(first.table)
    assert content(file.parent / "out") == before
    assert set(before) == {"runs.parquet", "bands.parquet"}


def test_only_missing_runs_take_place(file, one):
    """A batch that is lost is run again, the others are not, whatever their order."""
    results, _ = run(file, one, "whole")
    out, ready = file.parent / "out", store_of(file, file.parent / "out")
    rows = [rows_of(file, one)[n] for n in (7, 2, 3)]
    ready.add(rows)
    (out / "parts" / f"batch-000000000.parquet{PARTIAL}").write_bytes(b"half a file")
    _, runs = run(file, one)
    assert runs == [0, 1, 4, 5, 6, 8, 9, 10, 11]
    assert content(out) == content(file.parent / "whole")
    assert results.table["run"].tolist() == list(range(12))


def rows_of(file, client):
    """Run -> outcome, computed apart from any folder."""
    ready = prepare(read(file))
    return {
        r.run: r for batch in outcomes(client, ready.payload, [(s,) for s in ready.samples]) for r in batch
    }


def store_of(file, folder):
    """The folder of a study, ready to take outcomes."""
    folder.mkdir()
    ready = prepare(read(file))
    return store.Store(folder, ready.payload.study, store.fingerprint(ready.payload, ready.table))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("seed = 3", "seed = 4", "seed was 3, is 4"),
        ("runs = 12", "runs = 13", "runs was 12, is 13"),
        ("maximum = 3", "maximum = 2", 'factors."gain.factor".maximum was 3, is 2'),
        ('"gain.u" = 2', '"gain.u" = 1', 'fixed."gain.u" was 2, is 1'),
        ("stop = 0.2", "stop = 0.3", "stop was 0.2, is 0.3"),
    ],
)
def test_a_changed_study_is_refused(file, one, old, new, told):
    """The line says what changed and that --fresh deletes what is there."""
    run(file, one)
    file.write_text(GAIN.replace(old, new), encoding="utf-8")
    with pytest.raises(Problem) as refused:
        run(file, one)
    assert str(refused.value).startswith(f"{file.parent / 'out'}: holds runs of another study: {told}")
    assert str(refused.value).endswith("; --fresh deletes them")
    assert "\n" not in str(refused.value)
    _, runs = run(file, one, fresh=True)
    assert 0 in runs


def test_a_changed_fmu_is_refused(file, one, workshop):
    """It is its content that counts, not its name or its date."""
    run(file, one)
    fmu = file.parent / "gain.fmu"
    os.utime(fmu, (0, 0))
    assert run(file, one)[1] == []
    fmu.write_bytes(workshop.make("gain", "other_gain", more="<!-- another -->").read_bytes())
    with pytest.raises(Problem, match=r"another study: the FMU of gain changed; --fresh deletes them$"):
        run(file, one)


def test_another_title_is_the_same_study(file, one):
    """It changes no result, so nothing is run again."""
    run(file, one)
    file.write_text(GAIN.replace("A gain", "Another title"), encoding="utf-8")
    results, runs = run(file, one)
    assert runs == []
    assert results.study.title == "Another title"


def test_two_processes_do_not_share_a_folder(file, one):
    """The second one is refused, until the first is done."""
    with (
        store.locked(file.parent / "out"),
        pytest.raises(Problem, match="another process is running a study"),
    ):
        run(file, one)
    run(file, one)


def test_an_unfinished_study_has_no_results(tmp_path):
    """The line names what is missing."""
    with pytest.raises(Problem, match=r"expected a finished study, runs.parquet is missing$"):
        store.read(tmp_path)


def test_the_log_stands_apart(file, one):
    """Times are in a table of their own: one row for each run, one header for all batches."""
    store_of(file, file.parent / "out").add([rows_of(file, one)[7]])
    run(file, one)
    log = pd.read_csv(file.parent / "out" / "log.csv")
    assert list(log) == ["run", "status", "seconds"]
    assert sorted(log["run"]) == list(range(12))
    assert set(log["status"]) == {"ok"}
    assert (log["seconds"] > 0).all()


@pytest.mark.parametrize("damage", ["flipped", "short", "earlier version"])
def test_runs_of_a_damaged_part_are_computed_again(file, one, damage, caplog):
    """One line; nothing of the part is taken for a result. A part without a checksum counts as damaged."""
    run(file, one, "whole")
    out, rows = file.parent / "out", rows_of(file, one)
    ready = store_of(file, out)
    ready.add([rows[0], rows[1]])
    ready.add([rows[2]])
    part, _ = sorted((out / "parts").iterdir())
    data = bytearray(part.read_bytes())
    if damage == "earlier version":
        part.rename(part.with_name("batch-000000000.parquet"))
    elif damage == "short":
        part.write_bytes(data[:100])
    else:
        data[len(data) // 3] ^= 1
        part.write_bytes(data)
    with caplog.at_level("WARNING"):
        assert run(file, one)[1] == [0, 1, *range(3, 12)]
    (message,) = [m for m in caplog.messages if "batch-" in m]
    assert message.endswith("its runs are computed again")
    assert "\n" not in message
    assert content(out) == content(file.parent / "whole")


def test_a_part_that_is_damaged_while_the_study_runs_is_refused(file, one):
    """Each read compares the checksum, not only the first one."""
    out = file.parent / "out"
    ready = store_of(file, out)
    ready.add([rows_of(file, one)[0]])
    (part,) = (out / "parts").iterdir()
    part.write_bytes(part.read_bytes()[:-1])
    with pytest.raises(Problem, match=r"batch-000000000-\w+.parquet: [^\n]+ repeats its runs$"):
        ready.done()


@pytest.mark.parametrize("name", ["runs.parquet", "bands.parquet"])
def test_damaged_results_are_refused(file, one, name):
    """A flipped bit in a stored value is one line, not another result."""
    run(file, one)
    path = file.parent / "out" / name
    data = bytearray(path.read_bytes())
    data[60] ^= 1  # in the first page
    path.write_bytes(data)
    with pytest.raises(Problem, match=rf"{name}: cannot be read [^\n]+; --fresh computes the study again$"):
        run(file, one)


@pytest.mark.parametrize("text", ["{}", "[]", "half a fi"])
def test_a_folder_that_is_not_understood_is_refused(file, one, text):
    """Its study.json is not one of a study; --fresh deletes it."""
    run(file, one)
    (file.parent / "out" / "study.json").write_text(text)
    with pytest.raises(Problem, match=r"study.json: is not the study.json of a parameter study; --fresh"):
        run(file, one)
    assert run(file, one, fresh=True)[1] == list(range(12))


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("name", ["runs.parquet", "report.html"])
def test_files_of_others_are_left_alone(file, one, name, fresh):
    """A folder with such a file that no study wrote is refused, also by --fresh."""
    other = file.parent / "out" / name
    other.parent.mkdir()
    other.write_text("of somebody else")
    with pytest.raises(
        Problem, match=f"out: contains {name} but no study.json, so it is not the folder of a study$"
    ):
        run(file, one, fresh=fresh)
    assert other.read_text() == "of somebody else"


def test_a_study_may_lie_in_its_own_folder(file, one):
    """Its file stays, also when it begins anew."""
    text = file.read_text()
    run(file, one, ".")
    assert run(file, one, ".", fresh=True)[1] == list(range(12))
    assert file.read_text() == text


def test_a_file_is_no_folder_for_results(file, one):
    """One line says so."""
    (file.parent / "out").write_text("")
    with pytest.raises(Problem, match=r"out: cannot be a folder for results: File exists$"):
        run(file, one)


def stopped(outcome, reason):
    """The outcome of a run that failed for a reason."""
    return replace(outcome, status="failed", reason=reason, outputs=outcome.outputs * np.nan, bands=None)


def test_a_larger_limit_runs_stopped_runs_again(file, one):
    """Also in a finished study; other failed runs and those stopped at larger limits stay."""
    ready, rows = store_of(file, file.parent / "out"), rows_of(file, one)
    late = stopped(rows[2], "time_limit = 5: not done within 5 s, stopped in fmi2DoStep of gain")
    large = stopped(rows[5], "memory_limit = 1e+09: uses more than 1e+09 GB of memory")
    ready.add([rows[0], rows[1], late])
    ready.add([large, stopped(rows[7], "segmentation fault")])
    file.write_text(f"time_limit = 5\n{file.read_text()}")
    _, runs = run(file, one)
    assert runs == [3, 4, 6, 8, 9, 10, 11]
    assert run(file, one)[1] == []
    file.write_text(file.read_text().replace("time_limit = 5", "time_limit = 60"))
    results, runs = run(file, one)
    assert runs == [2]
    assert results.table["run"].tolist() == list(range(12))
    assert list(results.table.query("status == 'failed'")["run"]) == [5, 7]
    assert len(results.bands["run"].unique()) == 10
    assert run(file, one)[1] == []


def test_a_run_stopped_at_its_time_limit_runs_again(file, one):
    """The reason of a stopped run names the limit, by which a start with a larger one finds it."""
    text = file.read_text().replace(
        "step = 0.01", "step = 2e-6"
    )  # a run outlasts an interval between two checks
    file.write_text(f"time_limit = 1e-9\n{text}")
    results, _ = run(file, one)
    again = [i for i, r in enumerate(results.table["reason"]) if r.startswith("time_limit = 1e-09: not done")]
    assert again
    file.write_text(text)
    results, runs = run(file, one)
    assert runs == again
    assert set(results.table["status"]) == {"ok"}


def test_a_log_that_cannot_be_written_is_left_out(file, one, caplog):
    """It is not part of the results."""
    out, ready = file.parent / "out", store_of(file, file.parent / "out")
    (out / "log.csv").mkdir()
    ready.add([rows_of(file, one)[0]])
    assert ready.done() == {0}
    assert f"{out / 'log.csv'}: cannot be written: Is a directory" in caplog.text
