"""What a command does at the moment is shown on a terminal, and told in a log if it takes long."""

import io
import time

import pytest
from kit.wait import until

from orchestrator.base import progress
from orchestrator.base.progress import Doing


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self):
        return True


def test_a_terminal_has_one_line():
    """Each text replaces the one before, and the end leaves nothing."""
    screen = Terminal()
    line = Doing("one of 2", screen)
    line.update("two of 2")
    line.end()
    assert screen.getvalue() == "\r\x1b[Kone of 2\r\x1b[Ktwo of 2\r\x1b[K"


def test_a_notebook_has_one_line_without_control_sequences():
    """Spaces erase it, because Jupyter knows the carriage return only."""
    cell = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})()
    line = Doing("one of 2", cell)
    line.end()
    assert [text.rstrip() for text in cell.getvalue().split("\r")] == ["", "one of 2", "", ""]


def test_a_log_has_a_line_only_for_what_takes_long(monkeypatch):
    """Each text that lasts is printed once, a shorter one never, and nothing after the end."""
    monkeypatch.setattr(progress, "LONG", 0.05)
    log = io.StringIO()
    line = Doing("short", log)
    for text in ("one of 2", "two of 2"):
        line.update(text)
        assert until(lambda text=text: text in log.getvalue())
        time.sleep(0.15)  # three times LONG
    line.update("three of 2")
    line.end()
    time.sleep(0.15)
    assert log.getvalue() == "one of 2 ...\ntwo of 2 ...\n"


def test_the_line_ends_with_its_block(monkeypatch):
    """Also if the block fails."""
    screen = Terminal()
    monkeypatch.setattr(progress.sys, "stderr", screen)
    with pytest.raises(ValueError, match="no"), progress.doing("this"):
        raise ValueError("no")
    assert screen.getvalue() == "\r\x1b[Kthis\r\x1b[K"
