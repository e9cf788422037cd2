"""A result appears whole or not at all under its name; the rows of a run that ends early can be read."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import psutil
import pytest
from kit import shards
from kit.mistakes import problem
from kit.wait import LONG, runs, until
from zoo.command import command

from orchestrator import Problem, Trace, read_trace, write_trace
from orchestrator.__main__ import main
from orchestrator.data.trace_writer import RowLayout, TraceFile, TraceInMemory
from orchestrator.engine.result import read_metadata

posix = pytest.mark.skipif(sys.platform == "win32", reason="limits and signals of POSIX")
WRITER = "orchestrator.data.trace_writer"
FORMATS = (".csv", ".parquet")
ENDLESS = ("--stop", "9e3", "--step", "1e-3", "--record-step", "1e-3")


def rows(first, last):
    """Times and values of the rows from `first` on; the values are 1/3 of the times and their negative."""
    times = np.arange(first, last, dtype=float)
    return times, np.stack([times / 3, -times / 3], axis=1)


def earlier(folder, suffix):
    """Content of the files of an earlier result, by name."""
    write_trace(Trace(np.array([0.0, 1.0]), {"a": np.array([7.0, 8.0])}), folder / f"t{suffix}")
    (folder / "t.run.json").write_text("{}", encoding="utf-8")
    return {path.name: path.read_bytes() for path in folder.glob("t.*")}


def begun(path):
    """A trace file with two signals."""
    file = TraceFile(path)
    file.begin(RowLayout(("a", "b"), {"a": "m"}))
    return file


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("blocks", [[1], [3, 5], [64, 7], [10] * 40, [0, 4, 0]])
def test_rows_that_arrive_in_blocks_are_the_trace_written_at_once(tmp_path, suffix, blocks, monkeypatch):
    """Also beyond the number of rows of one Parquet file of a partial trace."""
    monkeypatch.setattr(f"{WRITER}.PART_ROWS", 64)
    file, memory, first = begun(tmp_path / f"blocks{suffix}"), TraceInMemory(), 0
    memory.begin(file.layout)
    for count in blocks:
        file.append(*rows(first, first + count))
        memory.append(*rows(first, first + count))
        first += count
    file.publish(file.finish()[0])
    again, whole = read_trace(file.path), read_trace(write_trace(memory.trace, tmp_path / f"whole{suffix}"))
    for trace in (again, whole, file.trace):
        np.testing.assert_array_equal(trace.time, np.arange(first))
        np.testing.assert_array_equal(trace["a"], np.arange(first) / 3)
    assert again.units == whole.units == ({"a": "m"} if suffix == ".parquet" else {})
    if suffix == ".csv":
        assert file.path.read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {f"blocks{suffix}", f"whole{suffix}"}


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_partial_trace_can_be_read_while_it_is_written(tmp_path, suffix, monkeypatch):
    """Each time all rows that were written; the file under its name is the earlier one until the end."""
    monkeypatch.setattr(f"{WRITER}.PART_TIME", 0.0)
    earlier(tmp_path, suffix)
    file = begun(tmp_path / f"t{suffix}")
    for n in range(1, 6):
        file.append(*rows(10 * (n - 1), 10 * n))
        np.testing.assert_array_equal(read_trace(file.partial).time, np.arange(10 * n))
        assert read_trace(file.path)["a"].tolist() == [7.0, 8.0]
    file.publish(file.finish()[0])
    assert len(read_trace(file.path).time) == 50
    assert not file.partial.exists()


def test_a_long_trace_is_read_from_its_file(tmp_path, monkeypatch):
    """Beyond a limit the rows are not kept in memory; the trace is the same."""
    monkeypatch.setattr(f"{WRITER}.MAX_KEPT", 8 * 2 * 100)
    file = begun(tmp_path / "t.csv")
    for n in range(20):
        file.append(*rows(10 * n, 10 * n + 10))
    file.publish(file.finish()[0])
    assert file._kept.rows == 0
    trace = file.trace
    np.testing.assert_array_equal(trace["b"], -np.arange(200) / 3)
    assert (len(trace.time), trace.units, file.largest("b")) == (200, {"a": "m"}, (-199 / 3, 199.0))
    path = tmp_path / "t.partial.csv"  # its last row counts only with its line break: 1.2 may have been 1.25
    path.write_text("time,a\n0.0,1.0\n1.0,1.5\n2.0,1.2", encoding="utf-8")
    assert read_trace(path).time.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("suffix", FORMATS)
def test_two_runs_do_not_write_the_same_file(tmp_path, suffix):
    """The first one does not publish the rows of the second one."""
    first, second = begun(tmp_path / f"t{suffix}"), begun(tmp_path / f"t{suffix}")
    first.append(*rows(0, 5))
    second.append(*rows(0, 9))
    problem(lambda: first.publish(first.finish()[0]), r"\.partial\S+: another process has replaced or re")
    second.publish(second.finish()[0])
    assert len(read_trace(second.path).time) == 9


def test_all_columns_are_numbers_and_of_one_length(tmp_path):
    """A trace of integers gives the file of the same numbers; no value is repeated or left out."""
    whole, real = (Trace(np.arange(3, dtype=t), {"a.b": np.arange(3, dtype=t)}) for t in (int, float))
    files = [write_trace(trace, tmp_path / f"{k}.csv").read_bytes() for k, trace in enumerate((whole, real))]
    assert files[0] == files[1]
    for values in (np.zeros(1), np.zeros(7)):
        with pytest.raises(Problem, match=r"a: expected 5 values, got \d$"):
            write_trace(Trace(np.arange(5.0), {"a": values}), tmp_path / "t.csv")


@pytest.mark.parametrize("name", ["t.partial.csv", "folder.csv"])
def test_a_name_that_cannot_be_written_is_refused_at_once(tmp_path, name):
    """A name for unfinished results, and a folder; nothing is removed."""
    (tmp_path / "folder.csv").mkdir()
    problem(lambda: TraceFile(tmp_path / name), r"expected (another name|the name of a file)")
    (tmp_path / "t.partial.parquet").mkdir()
    (tmp_path / "t.partial.parquet" / "mine.txt").touch()
    problem(lambda: begun(tmp_path / "t.parquet"), r"parts of a trace, which are replaced, got mine\.txt$")


@posix
def test_a_link_stays_a_link(tmp_path):
    """The result goes to the file that it names."""
    (tmp_path / "results").mkdir()
    (tmp_path / "t.csv").symlink_to(tmp_path / "results" / "first.csv")
    write_trace(Trace(np.array([0.0, 1.0]), {"a": np.array([7.0, 8.0])}), tmp_path / "t.csv")
    assert (tmp_path / "t.csv").is_symlink()
    assert read_trace(tmp_path / "results" / "first.csv")["a"].tolist() == [7.0, 8.0]


# ---- a full disk

LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))"


@posix
@pytest.mark.parametrize("suffix", [".csv", pytest.param(".parquet", marks=shards.faults)])
def test_a_full_disk_leaves_the_earlier_result_and_whole_rows(fmus, tmp_path, suffix):
    """The limit of a file's size is an error of the system like that of a full disk."""
    before = earlier(tmp_path, suffix)
    ended = command(["run", fmus["mass_b"], "--out", f"t{suffix}", *ENDLESS], tmp_path, setup=LIMITED)
    assert ended.status == 2
    (line,) = ended.lines
    assert line.startswith(f"harvester: t.partial{suffix}: cannot be written: ")
    assert ("it has the rows up to t = " in line) == (suffix == ".csv")  # no Parquet file fits into the limit
    assert ended.left == ()
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert {p.name for p in tmp_path.glob("*t.*")} - {*before} <= {f"t.partial{suffix}"}
    if suffix == ".csv":
        assert len(read_trace(tmp_path / "t.partial.csv").time) > 100
        assert (tmp_path / "t.partial.csv").read_bytes().endswith(b"\n")


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_disk_that_is_full_at_the_end_leaves_all_rows(tmp_path, suffix, monkeypatch):
    """As when the metadata do not fit any more."""
    file = begun(tmp_path / f"t{suffix}")
    file.append(*rows(0, 30))
    complete, _ = file.finish()
    monkeypatch.setattr(Path, "write_text", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(Problem, match=r"cannot be written: No space left on device$"):
        file.publish(complete, {tmp_path / "t.run.json": "{}"})
    file.close()
    assert [p.name for p in tmp_path.iterdir()] == [f"t.partial{suffix}"]
    assert len(read_trace(file.partial).time) == 30


# ---- processes that are killed

SEED, KILLS = 17, 20
CASES = [*range(2), *(pytest.param(n, marks=shards.faults) for n in range(2, KILLS))]  # one of each format


def _killed(fmu, folder, victims, delay, suffix):
    """Run over an earlier result, and kill the engine, the supervisor, or both."""
    arguments = [sys.executable, "-m", "orchestrator", "run", fmu, *ENDLESS, "--out", f"t{suffix}"]
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths, "TMPDIR": str(folder / "temporary")}
    (folder / "temporary").mkdir(exist_ok=True)
    run = subprocess.Popen(
        arguments, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    time.sleep(delay)
    # one that dies before its run has begun is replaced, and the run goes on
    assert victims != ["engine"] or until((folder / f"t.partial{suffix}").exists)
    engine = next((child.pid for child in psutil.Process(run.pid).children()), 0)
    for victim in victims:
        os.kill(engine if engine and victim == "engine" else run.pid, signal.SIGKILL)
    try:
        _, error = run.communicate(timeout=LONG)
    finally:
        run.kill()
    assert until(lambda: not engine or not runs(engine))
    return run.returncode, error


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("case", CASES)
def test_a_kill_leaves_the_earlier_result_and_a_readable_part(fmus, tmp_path, case):
    """SIGKILL of the engine, of the supervisor, or of both, at random moments of a run."""
    chosen = random.Random(100 * SEED + case)
    suffix = FORMATS[case % 2]
    victims = chosen.choice([["engine"], ["supervisor"], ["engine", "supervisor"], ["supervisor", "engine"]])
    before = earlier(tmp_path, suffix)
    status, error = _killed(fmus["mass_b"], tmp_path, victims, chosen.uniform(0.2, 3.0), suffix)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    partial = tmp_path / f"t.partial{suffix}"
    text = partial.read_bytes() if partial.is_file() else b""
    if any(partial.glob("*.parquet")) or text.count(b"\n") > 1:  # a part under another name is not complete
        trace = read_trace(partial)  # no row is missing
        np.testing.assert_allclose(np.diff(trace.time[:-1]), 1e-3, rtol=0, atol=1e-9)
    assert error.count("\n") <= 1
    if victims == ["engine"] and status == 2:
        assert "killed by the system" in error


def test_trace_and_metadata_belong_together(fmus, tmp_path, monkeypatch, capsys):
    """Those of a complete run, and those of a run that failed, which is told."""
    monkeypatch.chdir(tmp_path)
    arguments = ["run", str(fmus["fails"]), "--stop", "1", "--step", "0.1", "--out", "t.csv"]
    failing = [*arguments, "--set", "fails.when=0.45", "--set", "fails.how=3"]
    assert main(failing) == 2
    printed = capsys.readouterr()
    assert len(read_trace("t.partial.csv").time) == 6
    assert not Path("t.csv").exists()
    assert "the run ended early; the trace up to t = 0.5 s is in t.partial.csv" in printed.out
    assert printed.err.startswith("harvester: fails: the step failed at t = 0.5 s with status error")
    assert main(arguments) == 0
    assert read_metadata(tmp_path / "t.csv").complete
    text = (tmp_path / "t.run.json").read_bytes()
    assert main(failing) == 2
    assert (tmp_path / "t.run.json").read_bytes() == text
    assert read_metadata(tmp_path / "t.csv").complete
    assert not read_metadata(tmp_path / "t.partial.csv").complete
    assert json.loads((tmp_path / "t.partial.run.json").read_text("utf-8"))["simulated"] == 0.5
