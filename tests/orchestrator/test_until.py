"""Functions of a user that hear of each row or end a run; signals, which wait until between steps."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from kit.mistakes import problem, table
from kit.needs import needs

from orchestrator import Coupling, Interrupted, Master, RunFailed, read_trace, run, write_ssp
from orchestrator.__main__ import main
from orchestrator.base.errors import Problem
from orchestrator.base.interrupts import DeferredInterrupts, of_user
from orchestrator.base.processes import mapping

STEPS = {"step": 1e-2, "stop": 2.0}
EACH = pytest.mark.parametrize("isolate", [True, False])


@pytest.fixture(scope="module")
def whole(oscillator):
    """The run without a condition."""
    return run(oscillator, **STEPS).trace


def first(whole, holds):
    """The number of rows up to the first one where a condition on a.x holds."""
    return int(np.flatnonzero(holds(whole["a.x"]))[0]) + 1


@EACH
@pytest.mark.parametrize(
    ("until", "holds"),
    [
        *(("a.x < -0.5", lambda x: x < -0.5), ("a.x<=-50cm", lambda x: x <= -0.5)),
        *(("a.x > 1e-1 m", lambda x: x > 0.1), ("a.x >= 0.1", lambda x: x >= 0.1)),
    ],
)
def test_a_run_ends_at_the_first_row_where_the_condition_holds(oscillator, whole, isolate, until, holds):
    """Complete, with the rows of the whole run until then, and a note."""
    result = run(oscillator, until=until, isolate=isolate, **STEPS)
    n = first(whole, holds)
    assert result.complete
    np.testing.assert_array_equal(result.trace["a.x"], whole["a.x"][:n])
    end = whole.time[n - 1]
    assert result.card.notes[-1] == f"the run ends at t = {end:.6g} s: {until}"
    assert result.card.simulated == pytest.approx(end, rel=1e-12)  # rounding
    assert result.card.inside  # the process has ended the run itself, and was not killed


@EACH
@pytest.mark.parametrize("ends", [True, False])
def test_a_function_hears_of_each_row_and_may_end_the_run(oscillator, whole, isolate, ends):
    """In order, with the recorded signals; the row at which it returns True is the last."""
    heard = []

    def below(time, row):
        heard.append((time, row["a.x"]))
        return row["a.x"] < -0.5 if ends else None

    result = run(oscillator, until=below, isolate=isolate, **STEPS)
    n = first(whole, lambda x: x < -0.5) if ends else len(whole.time)
    assert heard == list(zip(whole.time[:n], whole["a.x"][:n], strict=True))
    assert result.complete
    np.testing.assert_array_equal(result.trace["a.x"], whole["a.x"][:n])


def spins():
    """A loop of Python."""
    while True:
        pass


def sleeps():
    """A call that a signal wakes; short, for a signal that comes just before it."""
    while True:
        time.sleep(1.0)


def waits():
    """A lock that nobody opens; as above."""
    while not threading.Event().wait(1.0):
        pass


@needs("POSIX", "a signal wakes no call there")
@pytest.mark.parametrize("hang", [spins, sleeps, waits])
@pytest.mark.parametrize("options", [{}, {"isolate": False}, {"master": True}], ids=str)
def test_the_first_interrupt_ends_a_function_that_hangs(oscillator, whole, hang, options):
    """Of `until` in either process, and of a master; the rows until then are kept, the next run is whole."""

    def hangs(time, _):
        if time > 0.495:
            threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT)).start()
            hang()

    def steps(components, time, length):
        for component in components.values():
            component.step(time, length)
        hangs(time + length, None)

    options = {"master": Master("mine", step=steps)} if options.get("master") else options | {"until": hangs}
    with pytest.raises(Interrupted) as interrupted:
        run(oscillator, **STEPS, **options)
    rows = 50 + ("until" in options)  # that of the call is recorded before `until`, and after a master
    np.testing.assert_array_equal(interrupted.value.result.trace.time, whole.time[:rows])
    simulated = interrupted.value.result.card.simulated
    assert simulated == pytest.approx(whole.time[rows - 1], rel=1e-12)  # rounding
    assert run(oscillator, **STEPS).trace == whole


@EACH
@pytest.mark.parametrize(
    ("raised", "expected"),
    [
        *((ValueError("no"), RunFailed), (SystemExit(3), RunFailed)),
        *((KeyboardInterrupt(), Interrupted), (GeneratorExit(), RunFailed)),
    ],
)
def test_whatever_a_function_raises_keeps_the_rows(oscillator, whole, isolate, raised, expected):
    """Also what is no error: of `until`, and of a master; it is named with the time of its call."""

    def raises(time, _):
        if time > 0.495:
            raise raised

    def steps(components, time, length):
        for component in components.values():
            component.step(time, length)
        raises(time + length, None)

    mine = Master("mine", step=steps)
    for options, rows, at in (({"until": raises}, 51, "0.5"), ({"master": mine}, 50, "0.49")):
        with pytest.raises(expected) as ended:
            run(oscillator, isolate=isolate, **STEPS, **options)
        np.testing.assert_array_equal(ended.value.result.trace.time, whole.time[:rows])
        told = f"the function failed at t = {at} s: {raised!r}"
        assert expected is Interrupted or told in str(ended.value)


def test_the_signal_of_a_condition_is_recorded(oscillator):
    """Beside those that are asked for; with adaptive steps and an estimate of errors too."""
    options = {"record": ["b.x"], "until": "a.x < -0.5", "stop": 2.0}
    result = run(oscillator, master=Coupling("hermite", adaptive=1e-4), error_estimate=True, **options)
    assert set(result.trace.signals) == {"a.x", "b.x"}
    assert result.trace["a.x"][-1] < -0.5 < result.trace["a.x"][-2]
    assert "no error estimate: the run ended before its stop time" in result.card.notes


def test_an_accuracy_and_a_condition(open_oscillator):
    """The last run of the search ends there, as accurate as it was asked."""
    result = run(open_oscillator, accuracy=1e-4, until="a.x < -0.5", stop=2.0)
    assert result.trace["a.x"][-1] < -0.5 <= result.trace["a.x"][:-1].min()
    assert any(note.startswith("accuracy 0.0001") for note in result.card.notes)


def test_the_command_ends_with_status_0(oscillator, tmp_path, capsys):
    """And writes a complete file."""
    system, out = write_ssp(oscillator, tmp_path / "pair.ssp"), tmp_path / "o.csv"
    command = ["run", str(system), "--until", "a.x < -0.5", "--stop", "2", "--out", str(out)]
    assert main(command) == 0
    assert "note: the run ends at t = " in capsys.readouterr().out
    assert read_trace(out)["a.x"][-1] < -0.5


@table(__file__, "no_conditions", "until, message")
def test_what_is_no_condition_is_told(oscillator, until, message):
    """In one line, before the run."""
    assert problem(lambda: run(oscillator, until=until)).startswith(message)


# ---- Signals during a run: noted, handled between steps; the usual handling comes back after it


def test_a_signal_waits_for_the_next_check():
    """Nothing is raised where it comes, which may be inside a function that an FMU calls."""
    with DeferredInterrupts() as interrupts:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        interrupts.check()  # once is enough
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(RuntimeError), DeferredInterrupts():  # it comes back after an error, too
        raise RuntimeError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_signal_at_the_very_end_and_a_second_one_are_handled():
    """No check comes after the first; a second one does not wait for an FMU that may never come back."""
    with pytest.raises(KeyboardInterrupt), DeferredInterrupts():
        signal.raise_signal(signal.SIGINT)
    with DeferredInterrupts():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    # it waits where raising is of no use: CVODES takes an exception in its equations for a step that failed
    raised = []
    with pytest.raises(KeyboardInterrupt), DeferredInterrupts(second_at_once=False):
        raised.extend(signal.raise_signal(signal.SIGINT) for _ in range(2))
    assert len(raised) == 2


def test_a_signal_is_handled_at_once_in_a_function_of_the_user():
    """Also one that came just before; but not in a function that C calls there, such as an FMU its logger."""
    handled, module = [], {"__name__": "orchestrator.fmi.library", "signal": signal}
    exec("def logger(): signal.raise_signal(signal.SIGINT)", module)

    def deferred(second_at_once, function, *arguments):
        with DeferredInterrupts(second_at_once):
            function(*arguments)
            handled.append("after it")

    def raises():
        signal.raise_signal(signal.SIGINT)
        handled.append("too late")

    def nested():
        with DeferredInterrupts():
            signal.raise_signal(signal.SIGINT)
            handled.append("nested")

    def before():
        signal.raise_signal(signal.SIGINT)
        of_user(handled.append, "too late")

    for second_at_once in (True, False):
        for calls in ([of_user, raises], [of_user, nested], [before], [of_user, module["logger"]]):
            with pytest.raises(KeyboardInterrupt):
                deferred(second_at_once, *calls)
    assert handled == 2 * ["nested", "after it"]


@needs("POSIX", "Windows has no such signal")
def test_only_signals_that_python_handles_wait():
    """The way in which a command ends when its terminal closes is among them."""

    def handler(*_):
        raise KeyboardInterrupt("terminal closed")

    usual = signal.signal(signal.SIGHUP, handler)
    try:
        with DeferredInterrupts() as interrupts:
            assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
            signal.raise_signal(signal.SIGHUP)
            with pytest.raises(KeyboardInterrupt, match="terminal closed"):
                interrupts.check()
        assert signal.getsignal(signal.SIGHUP) is handler
    finally:
        signal.signal(signal.SIGHUP, usual)


def test_runs_in_other_threads_leave_signals_alone():
    """Only the main thread may say what a signal does."""

    def seen():
        with DeferredInterrupts():
            return signal.getsignal(signal.SIGINT)

    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(seen).result() is signal.default_int_handler


# ---- Work in several processes: results in order, and an end if one of them is killed


def test_a_killed_process_ends_the_work():
    """In one line, where the others would wait for ever; the results until then are in order."""
    with mapping(2) as each:
        assert list(each(abs, [-3, -1, -2])) == [3, 1, 2]
    with pytest.raises(Problem, match="a helper process was ended from outside"), mapping(2) as each:
        list(each(os._exit, [9, 9, 9]))
