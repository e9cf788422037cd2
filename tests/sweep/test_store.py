"""The folder of a study: the same content however it came about, nothing run twice, nothing mixed."""

import os
import shutil
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from kit.mistakes import problem, table
from sweep.studies import GAIN, content, run, study

from orchestrator.studies import store
from orchestrator.studies.parameter_study import prepare
from orchestrator.studies.runs import StudyRuns
from orchestrator.studies.store import PARTIAL
from orchestrator.studies.study import read

ALL = list(range(12))


@pytest.fixture(scope="module")
def finished(gain, tmp_path_factory):
    """The folder of a study, with its results in `out`."""
    file = study(tmp_path_factory.mktemp("finished"), GAIN, gain)
    assert run(file)[1] == ALL
    return file.parent


@pytest.fixture
def done(finished, tmp_path):
    """The file of a study that is finished."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path / "study.toml"


@pytest.fixture(scope="module")
def rows(finished):
    """Run -> outcome, computed apart from any folder."""
    ready = prepare(read(finished / "study.toml"))
    with closing(StudyRuns(ready)) as runs:
        return {sample.run: runs.run((sample,))[0] for sample in ready.samples}


@pytest.fixture
def begun(file):
    """The folder of a study without runs, ready to take outcomes."""
    (file.parent / "out").mkdir()
    ready = prepare(read(file))
    return store.Store(file.parent / "out", ready)


def test_a_finished_study_is_not_run_again(done):
    """No run takes place, and nothing is written anew; another title changes no result."""
    before = content(done.parent / "out")
    assert set(before) == {"runs.parquet/part-000000.parquet", "bands.parquet/part-000000.parquet"}
    done.write_text(GAIN.replace("A gain", "Another title"), encoding="utf-8")
    results, runs = run(done)
    assert runs == []
    assert results.table.equals(store.read(done.parent / "out").table)
    assert results.study.title == "Another title"
    assert content(done.parent / "out") == before


def test_only_missing_runs_take_place(file, begun, rows, finished):
    """A batch that is lost is run again, the others are not, whatever their order."""
    begun.add([rows[n] for n in (7, 2, 3)])
    (begun.folder / "parts" / f"batch-000000000.parquet{PARTIAL}").write_bytes(b"half a file")
    results, runs = run(file)
    assert runs == [0, 1, 4, 5, 6, 8, 9, 10, 11]
    assert content(begun.folder) == content(finished / "out")
    assert results.table["run"].tolist() == ALL


@table(__file__, "changes", "old, new, told")
def test_a_changed_study_is_refused(done, old, new, told):
    """The line says what changed and that --fresh deletes what is there."""
    done.write_text(GAIN.replace(old, new), encoding="utf-8")
    line = problem(lambda: run(done))
    assert line == f"{done.parent / 'out'}: holds runs of another study: {told}; --fresh deletes them"


def test_a_changed_fmu_is_refused(done, fmus):
    """It is its content that counts, not its name or its date."""
    fmu = done.parent / "gain.fmu"
    os.utime(fmu, (0, 0))
    assert run(done)[1] == []
    fmu.write_bytes(fmus.make("gain", "other_gain", more="<!-- another -->").read_bytes())
    problem(lambda: run(done), r"another study: the FMU of gain changed; --fresh deletes them$")


@pytest.mark.parametrize("text", ["{}", "[]", "half a fi"])
def test_a_folder_that_is_not_understood_is_refused(done, text):
    """Its study.json is not one of a study."""
    (done.parent / "out" / "study.json").write_text(text)
    problem(lambda: run(done), "study.json: is not the study.json of a parameter study; --fresh")


@table(__file__, "refused", "name, old, new")
def test_fresh_deletes_what_is_refused(done, name, old, new):
    """Another study, and a folder that is not understood: all runs take place. An old log goes."""
    path = done.parent / name
    path.write_text(path.read_text("utf-8").replace(old, new, 1), encoding="utf-8")
    (log := done.parent / "out" / "log.csv").touch()
    assert run(done, fresh=True)[1] == ALL
    assert not log.exists()


def test_two_processes_do_not_share_a_folder(done):
    """The second one is refused, until the first is done."""
    with store.locked(done.parent / "out"):
        assert "another process is running a study" in problem(lambda: run(done))
    run(done)


def test_runs_of_damaged_parts_are_computed_again(file, begun, rows, finished, caplog):
    """One line; nothing of the part is taken for a result. A part without a checksum counts as damaged."""
    for batch in ((0, 1), (2,), (3,), (4,)):
        begun.add([rows[n] for n in batch])
    flipped, short, old, _ = sorted((begun.folder / "parts").iterdir())
    data = bytearray(flipped.read_bytes())
    data[len(data) // 3] ^= 1
    flipped.write_bytes(data)
    short.write_bytes(short.read_bytes()[:100])
    old.rename(old.with_name("batch-000000003.parquet"))  # of an earlier version
    with caplog.at_level("WARNING"):
        assert run(file)[1] == [0, 1, 2, 3, *range(5, 12)]
    messages = [m for m in caplog.messages if "batch-" in m]
    assert len(messages) == 3
    assert all(m.endswith("its runs are computed again") and "\n" not in m for m in messages)
    assert content(begun.folder) == content(finished / "out")


def test_a_part_that_is_damaged_while_the_study_runs_is_refused(begun, rows):
    """Each read compares the checksum, not only the first one."""
    begun.add([rows[0]])
    (part,) = (begun.folder / "parts").iterdir()
    part.write_bytes(part.read_bytes()[:-1])
    problem(begun.forget_stopped, r"batch-000000000-\w+.parquet: [^\n]+ repeats its runs$")


@pytest.mark.parametrize(("name", "read"), [("runs.parquet", "table"), ("bands.parquet", "bands")])
def test_damaged_results_are_refused(done, name, read):
    """A flipped bit in a stored value is one line, not another result."""
    path = done.parent / "out" / name / "part-000000.parquet"
    whole = path.read_bytes()
    for data in (whole[:60] + bytes([whole[60] ^ 1]) + whole[61:], whole[: len(whole) // 2]):
        path.write_bytes(data)  # a bit in the first page, and an end that is missing
        problem(
            lambda: getattr(run(done)[0], read),
            rf"out/{name}/part-000000.parquet: expected a Parquet file, got a damaged one [^\n]+; without it,"
            " the same command computes its runs again, and --fresh the whole study$",
        )
    path.unlink()
    assert run(done)[1] == ALL
    assert path.read_bytes() == whole


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("name", ["runs.parquet", "report.html"])
def test_files_of_others_are_left_alone(file, name, fresh):
    """A folder with such a file that no study wrote is refused, also by --fresh."""
    other = file.parent / "out" / name
    other.parent.mkdir()
    other.write_text("of somebody else")
    line = problem(lambda: run(file, fresh=fresh))
    assert line.endswith(f"out: contains {name} but no study.json, so it is not the folder of a study")
    assert other.read_text() == "of somebody else"


def test_a_study_may_lie_in_its_own_folder(file):
    """Its file stays, also when it begins anew."""
    for fresh in (False, True):
        assert run(file, ".", fresh=fresh)[1] == ALL
        assert file.read_text() == GAIN


def test_where_no_results_are_and_none_can_be(file):
    """A folder without a finished study, and a file."""
    problem(lambda: store.read(file.parent), "expected a finished study, runs.parquet is missing$")
    (file.parent / "out").write_text("")
    problem(lambda: run(file), "out: cannot be a folder for results: File exists$")


def stopped(outcome, reason):
    """The outcome of a run that failed for a reason."""
    return replace(outcome, status="failed", reason=reason, outputs=outcome.outputs * np.nan, bands=None)


def test_a_larger_limit_runs_stopped_runs_again(file, begun, rows):
    """Also in a finished study; other failed runs and those stopped at larger limits stay."""
    late = stopped(rows[2], "time_limit = 5: not done within 5 s, stopped in fmi2DoStep of gain")
    large = stopped(rows[5], "memory_limit = 1e+09: uses more than 1e+09 GB of memory")
    begun.add([rows[0], rows[1], late])
    begun.add([large, stopped(rows[7], "segmentation fault")])
    file.write_text(f"time_limit = 5\n{GAIN}")
    _, runs = run(file)
    assert runs == [3, 4, 6, 8, 9, 10, 11]
    assert run(file)[1] == []
    file.write_text(f"time_limit = 60\n{GAIN}")
    results, runs = run(file)
    assert runs == [2]
    assert results.table["run"].tolist() == ALL
    assert list(results.table.query("status == 'failed'")["run"]) == [5, 7]
    assert len(results.bands["run"].unique()) == 10
    assert run(file)[1] == []


def test_a_run_stopped_at_its_time_limit_runs_again(file):
    """The reason of a stopped run names the limit, by which a start with a larger one finds it."""
    text = GAIN.replace("runs = 12", "runs = 2")
    text = text.replace("step = 0.01", "step = 2e-6")  # a run outlasts an interval between two checks
    file.write_text(f"time_limit = 1e-9\n{text}")
    results, _ = run(file)
    again = [i for i, r in enumerate(results.table["reason"]) if r.startswith("time_limit = 1e-09: ")]
    assert again
    file.write_text(text)
    results, runs = run(file)
    assert runs == again
    assert set(results.table["status"]) == {"ok"}
