"""A result appears whole or not at all under its name; the rows of a run that ends early can be read."""

import json
import math
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
from kit.mistakes import problem, table
from kit.needs import needs
from kit.wait import LONG, runs, until
from zoo.command import command

from orchestrator import Problem, RunFailed, Trace, assemble, read_trace, run, write_trace
from orchestrator.__main__ import main
from orchestrator.data.trace_writer import RowLayout, TraceFile, TraceInMemory
from orchestrator.engine.result import read_metadata
from orchestrator.engine.time_grid import record_interval

posix = needs("POSIX", "limits and signals of POSIX")
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
    """Also beyond what is converted to Parquet at a time."""
    monkeypatch.setattr(f"{WRITER}.BLOCK", 600)
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
def test_a_partial_trace_can_be_read_while_it_is_written(tmp_path, suffix):
    """Each time all rows that were written; the file under its name is the earlier one until the end."""
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
    assert line.startswith("harvester: t.partial.csv: cannot be written: ")
    assert "it has the rows up to t = " in line
    assert ended.left == ()
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert {p.name for p in tmp_path.glob("*t.*")} - {*before} == {"t.partial.csv"}
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
    assert [p.name for p in tmp_path.iterdir()] == ["t.partial.csv"]
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
    assert victims != ["engine"] or until((folder / "t.partial.csv").exists)
    engine = next((child.pid for child in psutil.Process(run.pid).children()), 0)
    for victim in victims:
        os.kill(engine if engine and victim == "engine" else run.pid, signal.SIGKILL)
    try:
        _, error = run.communicate(timeout=LONG)
    finally:
        run.kill()
    assert until(lambda: not engine or not runs(engine))
    return run.returncode, error


@needs("Linux", "looks into /proc")
@pytest.mark.parametrize("case", CASES)
def test_a_kill_leaves_the_earlier_result_and_a_readable_part(fmus, tmp_path, case):
    """SIGKILL of the engine, of the supervisor, or of both, at random moments of a run."""
    chosen = random.Random(100 * SEED + case)
    suffix = FORMATS[case % 2]
    victims = chosen.choice([["engine"], ["supervisor"], ["engine", "supervisor"], ["supervisor", "engine"]])
    before = earlier(tmp_path, suffix)
    status, error = _killed(fmus["mass_b"], tmp_path, victims, chosen.uniform(0.2, 3.0), suffix)
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    partial = tmp_path / "t.partial.csv"
    text = partial.read_bytes() if partial.is_file() else b""
    if text.count(b"\n") > 1:
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


# ---- The record of a run: which points are kept, and that everything else still sees all of them


def assert_kept(kept, system, record_step, **options):
    """With a record step the trace equals the complete one at the points `kept`, bit for bit."""
    whole, thin = (run(system, record_step=r, **options).trace for r in (None, record_step))
    np.testing.assert_array_equal(thin.time, whole.time[kept])
    assert list(thin.signals) == list(whole.signals)
    for name, values in thin.signals.items():
        np.testing.assert_array_equal(values, whole[name][kept])


@pytest.mark.parametrize("every", [1, 2, 7, 256, 300])
def test_every_so_many_points_are_kept(oscillator, every):
    """Also if the size of a block is not a multiple of the interval."""
    kept = np.union1d(np.arange(0, 1501, every), 1500)
    assert_kept(kept, oscillator, every * 1e-3, step=1e-3, stop=1.5)


@table(__file__, "points", "step, interval, stop, kept")
def test_first_and_last_point_are_always_kept(oscillator, step, interval, stop, kept):
    """Whether or not the stop time is a multiple of the record step."""
    assert_kept(kept, oscillator, interval, step=step, start=0.0, stop=stop)


def test_a_run_may_record_nothing(oscillator):
    """It ends with its card, whose steps and energies do not depend on what is recorded."""
    result = run(oscillator, record=[], step=1e-2, stop=0.1, isolate=False)
    assert (result.card.steps, dict(result.trace.signals)) == (10, {})
    whole, thin = (run(oscillator, step=1e-2, stop=2.0, record_step=r).card for r in (None, 0.1))
    assert (thin.steps, thin.simulated, thin.bonds) == (whole.steps, whole.simulated, whole.bonds)
    assert (whole.record_step, thin.record_step) == (0.01, 0.1)


@pytest.mark.parametrize("record_step", [0.025, 0.005, 0.0, -0.01, math.nan, math.inf])
def test_an_interval_that_is_no_multiple_is_refused(oscillator, record_step):
    """Between two steps there is nothing to record."""
    message = problem(lambda: run(oscillator, step=0.01, stop=1.0, record_step=record_step))
    assert message == f"record step: expected a multiple of the step 0.01 s, got {record_step:g} s"


@pytest.mark.parametrize(("every", "steps"), [(1, 2000), (4, 2000), (5, 2003)])
def test_the_error_estimate_compares_recorded_points(oscillator, every, steps):
    """It is the change at half the step at the recorded points, and the order stays that of the master."""
    step = 5e-4
    card = run(oscillator, step=step, stop=steps * step, record_step=every * step, error_estimate=True).card
    estimate = {e.name: e for e in card.errors}["a.x"]
    whole, fine = (run(oscillator, step=h, stop=steps * step).trace for h in (step, step / 2))
    kept = np.union1d(np.arange(0, steps + 1, every), steps)
    change = np.abs(fine["a.x"][2 * kept] - whole["a.x"][kept]).max()
    expected = change / np.ptp(fine["a.x"][2 * kept])
    assert estimate.largest == pytest.approx(expected, rel=1e-12)  # same numbers
    # first order; the second-order term is 5 % of the error at this step
    assert estimate.order == pytest.approx(1, abs=0.15)


def test_a_failure_keeps_the_last_point_reached(fmus):
    """Also one off the grid; of values that are no number the message has the time."""
    system = assemble({"bad": fmus["fails"]}, [])
    for when, steps, kept in ((0.55, 6, [0, 0.2, 0.4, 0.6]), (0.45, 5, [0, 0.2, 0.4, 0.5])):
        with pytest.raises(RunFailed, match=f"bad: the step failed at t = {0.1 * steps:g} s") as caught:
            run(system, step=0.1, stop=1.0, record_step=0.2, set={"bad.when": when, "bad.how": 3})
        result = caught.value.result
        np.testing.assert_allclose(result.trace.time, kept)
        assert (result.complete, result.card.steps) == (False, steps)
    with pytest.raises(RunFailed, match=r"fails.y: expected a finite value, got nan at t = 0.4 s") as caught:
        run(str(fmus["fails"]), step=0.1, stop=9.0, record_step=0.9, set={"fails.when": 0.25, "fails.how": 5})
    np.testing.assert_allclose(caught.value.result.trace.time, [0, 0.3])


@table(__file__, "default", "step, interval")
def test_default_interval_of_the_command_line(step, interval):
    """It is the largest multiple of the step up to 5 ms; invalid steps are refused elsewhere."""
    # products of the step: rounding only
    assert record_interval(step) == (pytest.approx(interval, rel=1e-12) if interval else None)
