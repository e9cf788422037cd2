"""Signals during a run: noted, handled between steps; the usual handling comes back after it."""

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from orchestrator.base.interrupts import DeferredInterrupts, of_user


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


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows has no such signal")
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
