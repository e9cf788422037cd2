"""Runs in a process of their own, from Python: the same bits, failures with their rows, and the next run."""

import multiprocessing
import os
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from kit.fmu import in_new_process
from kit.mistakes import problem
from kit.needs import needs
from kit.wait import LONG
from zoo.faulty import faulty

from orchestrator import Problem, RunFailed, assemble, load, read_trace, run, write_ssp
from orchestrator.engine import isolated
from orchestrator.engine import run as runs
from orchestrator.engine.accuracy import AccuracySearch
from orchestrator.engine.job import Request
from orchestrator.engine.options import RunOptions
from orchestrator.engine.run import run_to_file

posix = needs("POSIX", "faults and limits of POSIX")
STEPS = {"step": 0.01, "stop": 1.0}


def test_lines_of_events_survive_an_fmu_that_closes_their_file(tmp_path):
    """Each line is in the file, and none in one that the FMU has opened in its place, which stays open."""
    kept = isolated.KeptFile(tmp_path / "events")
    kept.append("1\n")
    os.close(kept.descriptor)
    kept.append("2\n")
    os.close(kept.descriptor)
    with (tmp_path / "other").open("w") as other:
        assert other.fileno() == kept.descriptor  # the lowest number that is free
        kept.append("3\n")
        os.dup2(other.fileno(), kept.descriptor)
        kept.close()
        other.write("of the FMU")
    kept.close()
    assert (tmp_path / "events").read_text("utf-8") == "1\n2\n3\n"
    assert (tmp_path / "other").read_text("utf-8") == "of the FMU"


def process():
    """Id of the process that is kept for the next run."""
    ((worker, _),) = isolated._single._idle
    return worker.pid


def test_a_run_says_in_advance_what_it_takes_and_is_refused_if_it_cannot_fit(fmus, tmp_path, capfd):
    """Steps, rows and bytes, in one line, before the first step."""

    def told(**options):
        given = {"accept": Mock(side_effect=Problem("not now")), "options": RunOptions(**options)}
        return problem(lambda: run_to_file(fmus["gain"], None, tmp_path / "t.csv", **given))

    assert told(step=1e-7, stop=2.0, record_step=1.0) == "not now"
    size = "3 points of 2 signals, 1.4e-07 GB of values"
    assert capfd.readouterr().err == f"note: 2e+07 steps of 1e-07 s up to 2 s, {size}\n"
    assert told(step=1e-3, stop=2.0) == "not now"
    assert capfd.readouterr().err == ""
    refused = told(step=1e-3, stop=5e8)  # 1e11 rows of time and two signals, 15 bytes each, are 4500 GB
    assert refused.startswith("1e+11 points of 2 signals, 4.5e+03 GB of values, do not fit on the disk of ")
    assert refused.endswith("; choose a longer record step or stop earlier")


def test_the_numbers_are_those_of_a_run_in_this_process(oscillator):
    """Bit by bit; so are card and metadata, except for wall times."""
    one, other = (run(oscillator, **STEPS, isolate=isolate) for isolate in (True, False))
    assert one.trace == other.trace
    for field in ("bonds", "notes", "warnings", "steps", "passes", "lengths", "simulated"):
        assert getattr(one.card, field) == getattr(other.card, field)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_file_has_the_rows_of_the_result(oscillator, tmp_path, suffix):
    """In memory, in the file, and in a run without a file: each signal has its own values."""
    system = write_ssp(oscillator, tmp_path / "o.ssp")
    options = RunOptions(**STEPS, record_step=0.01)
    result, _ = run_to_file(system, None, tmp_path / f"t{suffix}", options=options)
    plain, stored = run(system, **STEPS).trace, read_trace(tmp_path / f"t{suffix}")
    assert [*result.trace.signals] == [*plain.signals] == [*stored.signals]
    for name, values in plain.signals.items():
        np.testing.assert_array_equal(result.trace[name], values, err_msg=name)
        np.testing.assert_array_equal(stored[name], values, err_msg=name)


def test_a_process_is_used_again(oscillator, monkeypatch):
    """Unless the environment variables have changed, which an FMU may read."""
    run(oscillator, **STEPS)
    first = process()
    run(oscillator, **STEPS)
    assert process() == first
    monkeypatch.setenv("HARVESTER_TEST", "1")
    run(oscillator, **STEPS)
    assert process() != first


def test_relative_paths_are_those_of_the_caller(fmus, tmp_path, monkeypatch):
    """Also if the working directory has changed since the process started."""
    run(fmus["source"], **STEPS)
    (tmp_path / "here.fmu").write_bytes(fmus["source"].read_bytes())
    monkeypatch.chdir(tmp_path)
    assert len(run("here.fmu", **STEPS).trace.time) == 101


@posix
def test_a_crash_gives_the_rows_and_the_next_run_works(tmp_path):
    """The point before the crash is the last row, also between two recorded ones."""
    crashing, good = faulty(tmp_path, "segfault", name="bad"), faulty(tmp_path)
    for record_step in (0.01, 0.03):
        told = r"^segmentation fault in fmi2DoStep at t = 0\.5 s of bad "
        with pytest.raises(RunFailed, match=told) as failed:
            run(crashing.fmu, **STEPS, record_step=record_step)
        trace = failed.value.result.trace
        expected = [*np.arange(0.0, 0.5 - 1e-9, record_step), 0.5]
        np.testing.assert_allclose(trace.time, expected, rtol=0, atol=1e-12)  # rounding
        assert not failed.value.result.complete
        assert failed.value.result.card.steps == 50
    assert len(run(good.fmu, **STEPS).trace.time) == 101


@posix
def test_rows_behind_a_lost_message_are_left_out(tmp_path, monkeypatch):
    """Bytes that an FMU writes to its connection may take rows with them: no gap in what is kept."""
    receive, messages = isolated._Supervision._receive, []

    def second_lost(supervision, name, content):
        messages.append(name)
        if name != "points" or messages.count("points") != 2:
            receive(supervision, name, content)

    monkeypatch.setattr(isolated._Supervision, "_receive", second_lost)
    with pytest.raises(RunFailed) as failed:
        run(faulty(tmp_path, "segfault").fmu, step=0.5 / 400, stop=1.0)  # it crashes at 0.5 s
    times = failed.value.result.trace.time
    assert messages.count("points") == 2
    assert 0 < len(times) < 400
    np.testing.assert_allclose(times, 0.5 / 400 * np.arange(len(times)), rtol=0, atol=1e-12)  # rounding


@posix
def test_an_fmu_computes_in_its_own_rounding_mode(tmp_path):
    """Another one has the bits of a run without it; a warning, once, names the one that changed the mode."""
    good = faulty(tmp_path, name="good").fmu

    def results(other, **options):
        return run(assemble({"first": other, "second": good}, []), **STEPS, set={"second.u": 1e7}, **options)

    phases = ("instantiate", "initialise", "step")
    changing = [faulty(tmp_path, "rounding", phase, name=phase).fmu for phase in phases]
    for options in ({}, {"isolate": False}, {"master": "jacobi"}):
        usual = results(good, **options)
        assert not usual.card.warnings
        for fmu in changing:
            found = results(fmu, **options)
            np.testing.assert_array_equal(found["second.y"], usual["second.y"])
            (warning,) = found.card.warnings
            assert warning.startswith("first")
            assert "the FMU changed the floating-point environment" in warning


@posix
@needs("x86-64", "sets a bit of that processor")
def test_small_numbers_are_flushed_to_zero_by_no_fmu(tmp_path):
    """That does not change the rounding mode, so it is found at the end of a block, among all FMUs."""
    flushing, good = faulty(tmp_path, "flush", name="bad").fmu, faulty(tmp_path).fmu
    system = assemble({"first": flushing, "second": good}, ["first.y -> second.u"])
    (warning,) = run(system, **STEPS, isolate=False).card.warnings
    assert "the FMU or second changed the floating-point environment" in warning
    assert np.float64(5e-324) * 1.0 != 0.0
    assert np.float64(2.3e-308) * 0.5 != 0.0


@posix
@needs("x86-64", "sets bits of that processor")
@pytest.mark.parametrize("phase", ["instantiate", "initialise"])
def test_traps_that_an_fmu_switches_on_end_no_process(tmp_path, phase):
    """Python goes on after its call, as with the spare instance that `hermite` tries; warnings name it."""
    trapping, good = faulty(tmp_path, "trap", phase, name="bad").fmu, faulty(tmp_path).fmu
    system = assemble({"first": trapping, "second": good}, ["first.y -> second.u"])
    for master in ("hermite", "jacobi"):
        assert all(line.startswith("first") for line in run(system, master=master, **STEPS).card.warnings)


def test_a_time_limit_is_one_for_all_runs(oscillator, monkeypatch):
    """Those of a search for an accuracy, which ends there, and those of an estimate of errors."""
    deadlines = []

    def noted(job, *arguments):
        deadlines.append(job.deadline)
        return run_isolated(job, *arguments)

    run_isolated = isolated.run_isolated
    monkeypatch.setattr(runs, "run_isolated", noted)
    for options in (STEPS | {"error_estimate": True}, {"stop": 10.0, "record_step": 0.1, "accuracy": 1e-5}):
        deadlines.clear()
        run(oscillator, **options, time_limit=LONG)
        assert len(deadlines) > 1
        assert len(set(deadlines)) == 1
    late = Request.of(oscillator, None, RunOptions(accuracy=1e-6, time_limit=1.0))
    search = AccuracySearch(replace(late, deadline=0.0))
    assert not search.goes_on()  # after a run that failed, nor after one that is not accurate enough
    coarse = run(oscillator, **STEPS)
    assert not search.accepts(coarse)
    problem(lambda: search.choose_stricter(coarse), "^accuracy 1e-06: not reached: .*after 1 s$")


@posix
def test_what_an_fmu_prints_is_a_note(tmp_path):
    """It does not reach the terminal, and not the next run."""
    printing, good = faulty(tmp_path, "print", name="prints"), faulty(tmp_path)
    notes = run(printing.fmu, **STEPS).card.notes
    assert [note for note in notes if note.startswith("the FMUs printed: ")]
    assert not [note for note in run(good.fmu, **STEPS).card.notes if "printed" in note]


@posix
def test_a_crash_at_the_end_does_not_hide_why_the_run_failed(tmp_path):
    """Many FMUs crash when they are freed after an error."""
    failing, crashing = faulty(tmp_path, "nan", name="lag"), faulty(tmp_path, "segfault", "free", name="bad")
    system = assemble({"first": failing.fmu, "second": crashing.fmu}, ["first.y -> second.u"])
    told = r"^first\.y: expected a .* got nan .*; then segmentation fault in fmi2Free"
    with pytest.raises(RunFailed, match=told):
        run(system, **STEPS)


@posix
@pytest.mark.parametrize(
    ("fault", "told"), [("segfault", "segmentation fault in fmi2F"), ("sleep", "no end within 0.5 s in f")]
)
def test_a_run_that_is_complete_keeps_its_file(tmp_path, monkeypatch, fault, told):
    """Whatever an FMU does when it is freed: the file of all rows, and one line."""
    monkeypatch.setattr(isolated, "CLOSE_TIME", 0.5)
    bad = faulty(tmp_path, fault, "free", name="bad")
    with pytest.raises(RunFailed, match=f"^the run is complete; then {told}") as failed:
        run_to_file(bad.fmu, None, tmp_path / "a.csv", options=RunOptions(**STEPS))
    assert len(read_trace(tmp_path / "a.csv").time) == 101
    assert failed.value.result.complete
    assert not [*tmp_path.glob("*.partial*")]


@posix
def test_a_forked_process_has_its_own_process_for_runs(fmus, oscillator):
    """That of the parent is neither used nor ended by it."""
    run(oscillator, **STEPS)
    before = process()
    child = multiprocessing.get_context("fork").Process(target=run, args=(fmus["source"],), kwargs=STEPS)
    child.start()
    child.join(LONG)
    assert child.exitcode == 0
    run(oscillator, **STEPS)
    assert process() == before


@needs("Linux", "misuses of Linux")
@pytest.mark.parametrize("fault", ["timers", "files", "daemon", "none"])
def test_a_process_in_which_an_fmu_left_something_is_not_used_again(tmp_path, fault):
    """Timers, another standard input, a child: they would end or disturb the run of another FMU."""
    good, other = faulty(tmp_path, name="good").fmu, faulty(tmp_path, fault).fmu
    run(good, **STEPS)
    before = process()
    run(other, **STEPS)
    assert len(run(good, **STEPS).trace.time) == 101
    assert (process() == before) == (fault == "none")


def test_a_defect_has_the_traceback_of_the_child(oscillator):
    """A mistake of ours is not taken for one of the user."""
    broken = load(next(iter(oscillator.components.values())).source.path)
    broken.components["mass_a"].__dict__["start"] = {"mass": object()}
    problem(lambda: run(broken, **STEPS), r"^the process failed \(Traceback.*line \d+.*TypeError")
    assert run(oscillator, **STEPS).complete


INTERRUPTS = """
import os, random, signal, sys, threading
from orchestrator import run
signal.signal(signal.SIGINT, signal.default_int_handler)
run(sys.argv[1], step=0.01, stop=1.0)
chosen, lost = random.Random(17), 0
for _ in range(40):
    timer = threading.Timer(chosen.uniform(0.0, 0.03), os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        run(sys.argv[1], step=0.01, stop=1.0)
        lost += timer.finished.is_set()
        timer.join()
        signal.pause()
    except KeyboardInterrupt:
        timer.join()
print(lost)
"""


@posix
def test_no_interrupt_is_lost(fmus):
    """Whenever it comes: a loop over runs ends, also if the run is complete at the same moment."""
    assert in_new_process(INTERRUPTS, fmus["source"]) == "0\n"
