"""The outcome in the terminal."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from orchestrator.validation import Validation, summary
from orchestrator.validation.wording import number, percent


def shown(outcome: Validation, width: int = 160) -> str:
    """The summary as plain text."""
    console = Console(width=width, file=StringIO())
    console.print(summary(outcome))
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_shows_every_signal_its_limit_and_the_verdict(outcome: Validation) -> None:
    """Each signal stands in two lines with display units, limit and outcome; the verdict comes last."""
    text = shown(outcome)
    lines = [line.strip() for line in text.splitlines()]
    first = next(k for k, line in enumerate(lines) if line.startswith("pressure"))
    assert lines[first].split()[1:3] == ["1", "bar"]
    assert lines[first].split()[-2:] == ["not", "pass"]
    assert lines[first + 1].split() == ["pump", "1", "bar", "rated", "max.", "error", "≤", "2", "bar"]
    assert "Compared with: Shaft test" in text
    assert "compared at the 201 samples of the reference" in text
    assert text.strip().endswith("pass: 2 of 2 signals within their limits")


def test_fits_a_terminal_of_80_columns(outcome: Validation) -> None:
    """No line is longer than 80 characters and no number is cut."""
    text = shown(outcome, 80)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (1234.5, "1234"), (0.0123456, "0.0123"), (2e-7, "2e-07"), (None, "-")]
)
def test_numbers_have_few_digits(value: float | None, text: str) -> None:
    """Three significant digits, powers of ten only where digits would not fit, a dash for nothing."""
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(100.0, "100.00 %"), (99.9999, "99.99 %"), (-12.345, "-12.35 %"), (None, "-")]
)
def test_only_perfect_shows_hundred_percent(value: float | None, text: str) -> None:
    """A fit is rounded down, so that nearly perfect is not called perfect."""
    assert percent(value) == text
