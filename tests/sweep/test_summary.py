"""What a finished study tells on the command line: how many runs, and why some failed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from sweep.synthetic import ISHIGAMI, ishigami, results

from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.results import without_numbers
from orchestrator.studies.parameter_study import summary
from orchestrator.studies.report.study_page import PAGE, write
from orchestrator.studies.store import Results


def _failed(reasons: dict[int, str]) -> Results:
    """40 runs; those of these numbers failed, for these reasons."""
    found = results(ishigami, ISHIGAMI, "latin", 40, failed=lambda t: t["run"].isin(list(reasons)).to_numpy())
    told = found.table["run"].map(reasons).fillna("")
    return replace(found, table=found.table.assign(reason=told))


@pytest.mark.parametrize("failed", [5, 20, 35])
def test_runs_that_ended_come_first(failed: int) -> None:
    """However many failed."""
    found = _failed(dict.fromkeys(range(failed), "it broke"))
    assert summary(found).splitlines()[0] == f"40 runs: {40 - failed} ok, {failed} failed"


def test_an_early_end_stands_between() -> None:
    """ok, early, failed."""
    found = _failed({0: "it broke", 1: "it broke", 2: "it broke"})
    status = found.table["status"].where(found.table["run"] != 2, "early")
    found = replace(found, table=found.table.assign(status=status))
    assert summary(found).splitlines()[0] == "40 runs: 37 ok, 1 early, 2 failed"


def test_failures_are_grouped_whatever_the_numbers_in_their_reasons() -> None:
    """The first run of a kind is the example; a reason that is always the same is told as it is."""
    reasons = {n: f"operator_input: swing_1_rise is {-0.1 * n:g}, expected at least 0" for n in range(3, 9)}
    found = _failed({**reasons, 30: "the process ended by signal 11 (SIGSEGV)"})
    assert summary(found).splitlines()[-2:] == [
        "6 failed, such as: operator_input: swing_1_rise is -0.3, expected at least 0",
        "1 failed: the process ended by signal 11 (SIGSEGV)",
    ]


def test_other_kinds_are_counted() -> None:
    """Five groups of reasons are printed."""
    found = _failed({n: f"part {'abcdefg'[n % 7]} broke at {n} s" for n in range(14)})
    lines = summary(found).splitlines()
    assert lines[-1] == "... and for 2 other reasons"
    assert lines[-6] == "2 failed, such as: part a broke at 0 s"


def test_the_page_groups_them_too(tmp_path: Path) -> None:
    """One row with the number of runs, the first of them as its example."""
    found = _failed({n: f"mass is {-n} kg" for n in (7, 5, 9)})
    one = analyse(found)
    assert [(f.reason, f.count, f.examples, f.various) for f in one.failures] == [
        ("mass is -5 kg", 3, (5, 7, 9), True)
    ]
    write(tmp_path, found, one)
    assert "(run 5; the numbers differ from run to run)" in (tmp_path / PAGE).read_text("utf-8")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("x is 1.5e-3 m at 0.4 s", "x is -2 m at 12 s", True),
        ("swing_1_rise is 3", "swing_2_rise is 3", False),
        ("x is inf", "x is nan", False),
        ("in [0.5, 2]", "in [3, 1e9]", True),
    ],
)
def test_names_are_no_numbers(one: str, other: str, same: bool) -> None:
    """Digits in a name tell of what it is the name."""
    assert (without_numbers(pd.Series([one, other])).nunique() == 1) is same
