"""Mistakes of users and the one line that tells each of them: tables in TOML beside the tests, one runner."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestrator import Problem
from orchestrator.__main__ import main


def entry(file: str, name: str) -> Any:
    """The entry `name` of the TOML file beside a test; `file` is its __file__."""
    return tomllib.loads(Path(file).with_suffix(".toml").read_text(encoding="utf-8"))[name]


def table(file: str, name: str, columns: str) -> Any:
    """Parametrizes a test with the rows `name` of the TOML file beside its own; `file` is its __file__."""
    rows = entry(file, name)
    return pytest.mark.parametrize(columns, rows, ids=[str(row[-1])[:60] for row in rows])


def problem(call: Callable[[], object], pattern: str = "") -> str:
    """The line of the Problem that a call raises, in which a regular expression is found."""
    with pytest.raises(Problem, match=pattern or None) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    return text


def refused(capsys: pytest.CaptureFixture[str], arguments: Sequence[object], status: int = 2) -> str:
    """The only line that a command prints on stderr when it refuses its arguments."""
    assert main([str(word) for word in arguments]) == status
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    return told
