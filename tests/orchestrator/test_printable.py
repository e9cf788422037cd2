"""Control characters of foreign files and FMUs: nothing raw on the terminal."""

import io
import logging
import sys
from pathlib import Path

import pytest
from kit.any_fmu.description import packed

from orchestrator.__main__ import PrintableStream, main
from orchestrator.base.errors import Problem
from orchestrator.fmi import library
from orchestrator.fmi.messages import WARNING, Log

# ESC, BEL, CR, backspace, DEL, C1, writing direction, line separator
RAW = "a\x1b[2J\x1b]0;title\x07\rb\bc\x7f\x9b31m\u202ed\u2028e"
ESCAPED = r"a\x1b[2J\x1b]0;title\x07\rb\x08c\x7f\x9b31m\u202ed\u2028e"
DESCRIPTION = Path(__file__).with_suffix(".xml").read_text("utf-8")


def test_standard_output_has_no_control_characters():
    """Breaks, tabs and colours stay, all others are escaped; a Problem is one line, whatever it quotes."""
    stream = io.StringIO()
    print(f"\x1b[31mred\x1b[0m\tµ 1·10⁻³\n{RAW}", file=PrintableStream(stream))
    assert stream.getvalue() == f"\x1b[31mred\x1b[0m\tµ 1·10⁻³\n{ESCAPED}\n"
    assert str(Problem(f"x: {RAW}\n")) == rf"x: {ESCAPED}\n"


def test_messages_of_an_fmu_have_no_control_characters(caplog, monkeypatch):
    """In warnings and errors, and in the log if no instance is known."""
    monkeypatch.delitem(sys.modules, "fmpy.fmi1", raising=False)  # it would get messages of unknown instances
    log = Log("pump")
    log.add(WARNING, RAW)
    for text in (*log.warnings(), log.error_message("failed", "badly"), log.messages[0].text):
        assert text.isprintable()
        assert r"\x1b[2J" in text
    with caplog.at_level(logging.WARNING):
        library._receive2(12345, b"nobody", WARNING, None, RAW.encode())
    assert caplog.messages == [f"nobody: warning: {ESCAPED}"]


@pytest.mark.parametrize("command", ["check", "signals"])
def test_names_and_texts_of_a_file_have_no_control_characters(tmp_path, capsys, command):
    """XML allows C1 controls and marks of the writing direction in names and descriptions."""
    main([command, str(packed(tmp_path / "odd.fmu", {"modelDescription.xml": DESCRIPTION}))])
    out, err = capsys.readouterr()
    assert out + err
    assert (out + err).replace("\n", "").isprintable()
    assert "\\x9b" in out + err
