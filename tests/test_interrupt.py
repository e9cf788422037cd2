"""Ctrl-C while a solver runs."""

import signal

import pytest

from fmus.monolith import held


@pytest.fixture(autouse=True)
def _python_s_own_handler():
    """A process that was started in the background ignores Ctrl-C; these tests need Python's handler."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


def test_an_interrupt_waits_for_the_end_of_the_block():
    """What runs is not disturbed, and the interrupt is not lost; later ones end at once again."""
    usual = signal.getsignal(signal.SIGINT)
    steps = []

    def block():
        with held():
            signal.raise_signal(signal.SIGINT)
            steps.append("after")

    with pytest.raises(KeyboardInterrupt):
        block()
    assert steps == ["after"]
    assert signal.getsignal(signal.SIGINT) is usual


def test_an_error_of_the_block_is_told():
    """The handlers come back after an error, too."""
    usual = signal.getsignal(signal.SIGINT)
    with pytest.raises(RuntimeError), held():
        raise RuntimeError
    assert signal.getsignal(signal.SIGINT) is usual
