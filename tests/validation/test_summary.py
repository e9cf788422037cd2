"""The outcome in the terminal."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import table
from validation.conftest import Edit

from orchestrator.base.text import number
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording, read_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import limit_share, miss_text, percent, summary


def shown(outcome: Validation) -> list[str]:
    """The summary as lines."""
    return summary(outcome).splitlines()


def line(lines: list[str], start: str) -> list[str]:
    """The words of the first line that starts so."""
    return next(text for text in lines if text.startswith(start)).split()


def made(**signals: Tolerance | None) -> Validation:
    """Signals in m that are 0.1 m off a sine of amplitude 1 m, by name with two underscores for the dot."""
    t = np.linspace(0, 6, 61)
    names = {name.replace("__", "."): tolerance for name, tolerance in signals.items()}
    run = Trace(t, {name: np.sin(t) + 0.1 for name in names}, dict.fromkeys(names, "m"))
    known = dict.fromkeys(names, np.sin(t))
    criteria = {name: Criterion(tolerance=limit) for name, limit in names.items()}
    reference = Recording(t, known, dict.fromkeys(names, "m"), Path("ref.csv"), criteria=criteria)
    return validate(run, reference)


def test_a_line_per_signal_below_its_group_and_limit(outcome: Validation) -> None:
    """Unit, metric and limit stand in the group's line, the name without its component."""
    lines = shown(outcome)
    assert "\n".join(lines).isascii()  # a redirected output on Windows knows few other characters
    assert max(map(len, lines)) <= 80
    assert lines[0] == "Compared with: Shaft test"
    assert lines[1].split() == ["max", "error", "RMSE", "NRMSE", "%", "fit", "%", "VAF", "%", "of", "limit"]
    at = lines.index("pressure [bar]: max. error, limit 2 bar")
    assert lines[at - 2] == "angle [deg]: NRMSE, limit 1 %"
    assert line(lines, "  angle")[-2:] == ["0.1", "%"]
    # range 20 (1 + exp(-pi / 20)) = 37.1 bar, standard deviation about 20 / sqrt(8) = 7.1 bar
    name, largest, rms, share, fit, *rest = lines[at + 1].split()
    assert (name, largest, rms, share, fit[:3]) == ("pressure", "1", "1", "2.7", "85.")
    # VAF ignores the offset of 1 bar, but 100.00 would say that there is no error
    assert rest == [">99.99", "50.1", "%"]  # the use of a limit is rounded up
    assert "compared at the 201 samples of the reference, 0 to 2 s" in lines
    assert lines[-1] == "pass: 2 of 2 signals within their limits"


def test_a_failed_run_says_first_what_missed_and_by_how_much(edited: Edit, trace: Trace) -> None:
    """Signal, value, limit and their ratio come first; the row is marked without colour too."""
    edited("limit = 0.01", "limit = 1e-20")
    lines = shown(validate(trace, read_recording(edited("limit = 2.0", "limit = 0.4"))))
    assert lines[0] == "FAIL: 2 of 2 signals are outside their limits"
    assert lines[1].startswith("! shaft.angle: NRMSE ")  # the worst first
    assert lines[2] == "! pump.pressure: max. error 1 bar, limit 0.4 bar (2.5 times)"
    assert lines[3] == ""
    assert line(lines, "! pressure")[-3:] == ["FAIL", "250.1", "%"]
    assert lines[-1] == "fail: 0 of 2 signals within their limits"


@table(__file__, "misses", "metric, limit, told")
def test_a_miss_in_the_words_of_its_metric(metric: str, limit: float, told: str) -> None:
    """Errors are multiples of the limit, ratings are differences from it, undefined metrics have a reason."""
    lines = shown(made(a__x=Tolerance(metric, limit)))
    assert lines[:2] == ["FAIL: 1 of 1 signals is outside its limit", f"! a.x: {told}"]


def test_signals_that_are_not_judged_come_last() -> None:
    """Below a line that says so; signals of one metric stand together, with the ends of their limits."""
    lines = shown(made(a__x=None, a__y=Tolerance("rmse", 1.0), a__z=Tolerance("rmse", 2.0)))
    heads = [text for text in lines if text.startswith("signals")]
    limits = ("RMSE, limit 1000 mm to 2000 mm", "not judged")
    assert heads == [f"signals [mm]: {limit}" for limit in limits]
    assert line(lines, "  x")[-1] == "-"


def test_names_keep_their_component_where_they_need_it_and_share_a_note() -> None:
    """Two signals of one name in two components; a note on many is told once, with the signals' names."""
    validation = made(left__x=None, right__x=None, right__y=None)
    lines = shown(replace(validation, rows=tuple(replace(r, notes=("is odd",)) for r in validation.rows)))
    assert [text.split()[0] for text in lines if text.startswith("  ")][1:] == ["left.x", "right.x", "y"]
    assert "is odd: left.x, right.x, right.y" in lines


def test_numbers_have_few_digits() -> None:
    """Three significant digits, powers of ten only where digits would not fit, a dash for nothing."""
    texts = {0.0: "0", 1234.5: "1234", 0.0123456: "0.0123", 2e-7: "2e-07", None: "-"}
    assert {value: number(value) for value in texts} == texts


@pytest.mark.parametrize(
    ("value", "rmse", "text"),
    [
        (100.0, 0.0, "100.00 %"),
        (100.0, 1e-9, "> 99.99 %"),  # VAF of an error of 1e-9, whose square is below the rounding of 100
        (99.9999999, 1e-9, "> 99.99 %"),  # its fit
        (99.987, 1e-2, "99.98 %"),
        (-12.345, 1.0, "-12.35 %"),
        (None, 1.0, "-"),
    ],
)
def test_only_perfect_shows_hundred_percent(value: float | None, rmse: float, text: str) -> None:
    """Fit and VAF of one error never contradict each other: neither is 100 % unless there is no error."""
    assert percent(value, rmse) == text


@pytest.mark.parametrize(("value", "text"), [(99.9912, "fit 99.9912 %"), (99.5, "fit 99.5 %")])
def test_a_value_and_its_limit_near_hundred_percent_differ(value: float, text: str) -> None:
    """A fit of 99.9912 % misses a limit of 99.995 %, and both are printed so that this is seen."""
    row = made(a__x=Tolerance("fit", 99.995)).rows[0]
    told = miss_text(replace(row, passed=False, metrics=replace(row.metrics, fit=value)))
    assert told.startswith(f"{text}, limit 99.995 %")


def test_the_use_of_a_limit_is_rounded_up_to_a_tenth_of_a_percent() -> None:
    """A use above a limit is never 100 %; the cards of the report and the terminal have the same text."""
    texts = {0.0: "0 %", 1e-9: "0.1 %", 0.1034: "10.4 %", 1.0: "100 %", 1.00001: "100.1 %"}
    texts[2e9] = "over 100 times"
    assert {use: limit_share(use) for use in texts} == texts
